"""Facts of the nearest point of a polyhedron."""

import numpy as np
import pytest

from softrobot_twin.solvers.polyhedron_projection import SLACK_COST, PolyhedronProjection, SoftBounds


def program(seed, n=6, m=9):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((m, n)) * rng.uniform(0.1, 10.0, m)[:, None]
    q = rng.standard_normal(n)
    inside = rows @ (0.3 * rng.standard_normal(n))
    return PolyhedronProjection(rows, q / np.linalg.norm(q)), rows, inside - 0.1, inside + 0.1


@pytest.mark.parametrize("seed", range(10))
def test_the_answer_meets_the_kkt_conditions(seed):
    nearest, rows, lower, upper = program(seed)
    lower[:2] = upper[:2] = 0.5 * (lower + upper)[:2]
    w, duals = nearest.solve(lower, upper, np.array([0, 1]))
    unit = rows / nearest.lengths[:, None]
    np.testing.assert_allclose(w + nearest.q + unit.T @ duals, 0.0, atol=1e-9)
    values = rows @ w
    assert np.all(values >= lower - 1e-9) and np.all(values <= upper + 1e-9)
    room = np.where(duals > 0.0, upper - values, values - lower)
    assert np.abs(duals * room).max() < 1e-9


def test_equations_that_follow_from_others_are_left_out():
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((3, 5))
    rows = np.vstack([rows, rows[0], rows[1] + rows[2]])
    nearest = PolyhedronProjection(rows, rng.standard_normal(5))
    chosen = nearest.independent(np.arange(5))
    assert len(chosen) == 3 and np.linalg.matrix_rank(rows[chosen]) == 3
    values = rows @ rng.standard_normal(5)
    np.testing.assert_allclose(rows @ nearest.solve(values, values, chosen).w, values, atol=1e-12)


def test_equations_that_contradict_each_other_have_no_answer():
    nearest = PolyhedronProjection(np.array([[1.0, 0.0], [1.0, 0.0]]), np.zeros(2))
    values = np.array([0.0, 1e-3])
    assert nearest.solve(values, values, nearest.independent(np.arange(2))) is None


def test_a_soft_bound_is_exceeded_by_the_least():
    """w_0 ≥ 2 is a soft bound and w_0 ≤ 1 a hard one; w_1 ≥ 1 is feasible."""
    nearest = PolyhedronProjection(np.eye(2), np.zeros(2))
    soft = SoftBounds(np.array([0, 1]), np.array([2.0, 1.0]), np.full(2, np.inf))
    none = np.zeros(0, dtype=int)
    answer = nearest.solve_softly(np.full(2, -np.inf), np.array([1.0, np.inf]), none, soft)
    assert answer.w[0] == pytest.approx(1.0, abs=1e-12)
    assert answer.w[1] == pytest.approx(1.0, abs=2.0 * SLACK_COST)


def test_an_inaccurate_answer_is_refined():
    nearest, rows, lower, upper = program(3)
    answer = nearest.solve(lower, upper, np.zeros(0, dtype=int))
    off = answer._replace(w=answer.w + 1e-6)
    mended = nearest.refined(off, lower, upper)
    active = answer.duals != 0.0
    assert active.any()
    reached = np.where(answer.duals > 0.0, upper, lower)
    np.testing.assert_allclose((rows @ mended)[active], reached[active], atol=1e-13)


def test_a_bound_that_hardly_depends_on_what_is_free_is_met():
    """A gap that an actuator closes by a millionth of what its own force does: w = (actuator, force)."""
    nearest = PolyhedronProjection(np.array([[0.0, 1.0], [3e-6, 1.0]]), np.array([-1.0, 0.0]))
    found = nearest.solve(np.array([0.0, -np.inf]), np.array([0.0, 1.8e-6]), np.array([0]))
    np.testing.assert_allclose(found.w, [0.6, 0.0], atol=1e-9)
