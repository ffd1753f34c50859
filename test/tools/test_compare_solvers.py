"""``tools/compare_solvers.py`` compares solvers in time and accuracy."""

import sys

import numpy as np
import pytest
from compare_solvers import (
    AS_SHIPPED,
    QP_SOLVERS,
    TIGHT_DAQP,
    certified,
    compare_factorizations,
    compare_qp_solvers,
    enumerated,
    exact_multipliers,
    main,
    random_problems,
    recorded_problems,
)

from softrobot_twin.simulation import Simulation
from softrobot_twin.solvers.quadratic_program import WhitenedQP
from softrobot_twin.study.bench_measurement import given_cases


@pytest.fixture
def without_optional(monkeypatch):
    """As if neither were installed."""
    for package in ("qdldl", "pypardiso"):
        monkeypatch.setitem(sys.modules, package, None)


def test_the_comparison_prints_writes_and_documents_itself(
        column, tmp_path, monkeypatch, capsys, without_optional):
    arguments = ["compare_solvers.py", column, "--steps", 5, "--output", tmp_path / "made",
                 "--docs", tmp_path / "docs"]
    monkeypatch.setattr(sys, "argv", [str(argument) for argument in arguments])
    assert main() == 0
    output = capsys.readouterr().out
    page = (tmp_path / "docs" / "solvers.md").read_text()
    for words in ("multifrontal Cholesky", "SuperLU", "DAQP 1e-9", AS_SHIPPED, *QP_SOLVERS):
        assert words in output and words in page, words
    for package in ("qdldl", "pypardiso"):
        assert f"{package} is not installed" in output
    assert "Not installed here: qdldl, pypardiso" in page
    factorizations = (tmp_path / "made" / "factorizations.csv").read_text().splitlines()
    assert len(factorizations) == 3 and "residual of dx" in factorizations[0]
    qp_solvers = (tmp_path / "made" / "qp_solvers.csv").read_text().splitlines()
    assert len(qp_solvers) == 1 + 6 * len(QP_SOLVERS)


def test_every_factorization_gives_the_same_answer(column):
    found = compare_factorizations(Simulation.from_scene_file(column), 1)
    assert len(found.figures) + len(found.absent) == 4
    for one in found.figures:
        assert one.residual < 1e-9 and one.compliance_error < 1e-9, one.name
        assert one.factor.median > 0.0 and one.solves.median > 0.0


def test_a_run_is_recorded(column):
    problems = recorded_problems(given_cases([column])[0], 7)
    assert (problems.count, len(problems.sequences[0])) == (4, 7)
    different = [problem.q.tobytes() for problem in problems.sequences[0]]
    assert len(set(different)) > 1


def test_enumeration_and_the_certified_active_set_agree():
    for sequence in random_problems(4, 3).sequences:
        for problem in sequence:
            np.testing.assert_allclose(enumerated(problem), certified(problem), rtol=1e-6,
                                       atol=1e-8)


def test_a_projection_onto_a_box_has_the_exact_answer():
    # The point nearest to (3, -2) in [-1, 1]² is a corner; two rows each, as in a step.
    C = np.vstack([np.eye(2), np.eye(2)])
    bounds = np.ones(4)
    problem = WhitenedQP(np.array([-3.0, 2.0]), C, -bounds, bounds, 2.0 * np.eye(2))
    for solve in (enumerated, certified, exact_multipliers):
        np.testing.assert_allclose(solve(problem), [2.0, -2.0], atol=1e-9)


def test_contradicting_bounds_have_no_exact_answer():
    C = np.vstack([np.eye(2), np.eye(2)])
    problem = WhitenedQP(np.ones(2), C, np.array([1.0, 0, -1, -1]), np.array([2.0, 1, 0, 1]),
                         np.eye(2))
    assert enumerated(problem) is None and certified(problem) is None


def test_random_problems_have_active_bounds_and_repeat():
    for n, twice in ((4, False), (8, True)):
        problems, again = random_problems(n, 4, twice), random_problems(n, 4, twice)
        first = problems.sequences[0][0]
        assert problems.count == n and first.C.shape == (2 * n, n)
        np.testing.assert_array_equal(first.q, again.sequences[0][0].q)
        free = [np.all((q.C @ -q.q > q.lower) & (q.C @ -q.q < q.upper))
                for sequence in problems.sequences for q in sequence]
        assert not all(free)


def test_a_tight_active_set_is_exact_and_the_default_answers_all():
    figures = {one.solver: one for one in compare_qp_solvers([random_problems(8, 4)])}
    assert list(figures) == list(QP_SOLVERS)
    assert figures[TIGHT_DAQP].judged == figures[TIGHT_DAQP].posed == 24
    assert figures[TIGHT_DAQP].worst_error < 1e-5
    assert figures[AS_SHIPPED].solved_share == 1.0
