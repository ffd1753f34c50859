"""A factorization as tasks: the same bits for any number of threads."""

import numpy as np
import pytest

from softrobot_twin.solvers.multifrontal import Multifrontal, front_tasks
from softrobot_twin.solvers.multifrontal.front_tasks import (
    DIAGONAL,
    FILL,
    FRONTS,
    TILE,
    UPDATE,
    plan_tasks,
)
from test.solvers.multifrontal.conftest import PATTERNS, System


@pytest.fixture
def threads_pay(monkeypatch):
    """Small systems are cut into small tasks."""
    for name, value in (("LEAST_COST", 0.0), ("LEAST_GAIN", -10.0), ("GRAIN", 2e3), ("PARTS", (64,)),
                        ("WAKE", 0.0), ("BLOCK", 24)):  # fmt: skip
        monkeypatch.setattr(front_tasks, name, value)


def _all_results(system, H, b, multipliers):
    solver = system.solver
    assert solver.factor()
    condensed = solver.condense(H, b)
    return condensed.W, condensed.free, solver.expand(multipliers).copy(), solver.solve(b)


@pytest.mark.parametrize("name", PATTERNS)
def test_results_are_the_same_bits_for_any_number_of_threads(name, threads_pay):
    system = System(PATTERNS[name])
    H, b = system.constraint_rows(11), system.rng.standard_normal((system.count, 3))
    multipliers = system.rng.standard_normal(11)
    expected = _all_results(system, H, b, multipliers)
    for count in (2, 3, 4, 1):
        system.solver.use_threads(count)
        for _ in range(3):
            for found, value in zip(_all_results(system, H, b, multipliers), expected, strict=True):
                np.testing.assert_array_equal(found, value)


def test_a_late_helper_does_not_touch_what_comes_later(threads_pay):
    """Rows, and the memory for them, change between two runs of the same list."""
    system = System(PATTERNS["slab"])
    b, solver = system.rng.standard_normal((system.count, 3)), system.solver
    assert solver.factor()
    rows = [system.constraint_rows(count) for count in (2, 30, 9, 17)]
    expected = [solver.condense(H, b) for H in rows]
    solver.use_threads(4)
    for _ in range(50):
        assert solver.factor()
        for H, value in zip(rows, expected, strict=True):
            found = (solver if len(H.row_index) < 50 else solver.with_other_rows()).condense(H, b)
            np.testing.assert_array_equal(found.W, value.W)
            np.testing.assert_array_equal(found.free, value.free)


def test_all_kinds_of_tasks_are_tried(threads_pay):
    solver = System(PATTERNS["grid"]).solver
    tasks = plan_tasks(solver.elimination, solver.layout, 2).tasks
    assert set(tasks["kind"]) == {FRONTS, FILL, DIAGONAL, TILE, UPDATE}


@pytest.mark.parametrize("seed", range(5))
def test_an_indefinite_matrix_is_found_by_all_threads(seed, threads_pay):
    system = System(PATTERNS["grid"], seed)
    node = system.rng.integers(system.count)
    system.A[3 * node, 3 * node] *= -1.0
    system.solver.use_threads(3)
    system.assemble()
    assert not system.solver.factor()
    system.A[3 * node, 3 * node] *= -1.0
    system.assemble()
    assert system.solver.factor()


def test_thick_bodies_gain_what_is_asked_for():
    """Of 5,616 unknowns, by the estimated costs; the bar of a step is 1.6 on two and 2.5 on four."""
    # All pairs of a cell, as elements couple them.
    index = np.arange(12 * 12 * 13).reshape(12, 12, 13)
    cells = [index[a : 11 + a, b : 11 + b, c : 12 + c].ravel() for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    pairs = [(one, other) for one in cells for other in cells]
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    solver = Multifrontal(rows, columns, index.size)
    for threads, gain in ((2, 1.7), (4, 2.9)):
        found = plan_tasks(solver.elimination, solver.layout, threads)
        assert solver.elimination.cost / found.cost > gain
