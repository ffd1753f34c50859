"""The optimum from a guess of the active set: proved or not claimed."""

import itertools

import numpy as np
import pytest

from softrobot_twin.solvers.pivoting import solve_by_pivoting
from softrobot_twin.solvers.qpcc import QPCC, Stationarity
from softrobot_twin.solvers.warm_start import minimum_under_equations, optimum_from_active_set

ADMISSIBLE = 1.0e-9


def contiguous(problem):
    return QPCC(*map(np.array, problem))


def guess(problem, touching, active):
    return optimum_from_active_set(*contiguous(problem), touching, active)


def no_guess(problem):
    own = len(problem.g) - problem.contact_count
    return np.zeros(own + len(problem.row_lower), dtype=np.int64)


def is_at_a_corner(problem, z):
    return np.any((problem.forces(z) < 1e-7) & (problem.gaps(z) < 1e-9))


@pytest.mark.parametrize("seed", range(40))
def test_the_solution_s_own_active_set_is_proved_except_where_branches_meet(robot_in_contact, seed):
    robot = robot_in_contact(seed)
    problem = robot.problem()
    answer = solve_by_pivoting(problem, robot.held, robot.touching)
    found = guess(problem, answer.touching, answer.active)
    proved, z, objective, touching, active, pivots = found
    assert proved != is_at_a_corner(problem, answer.unknowns)
    if proved:
        assert pivots == 0
        np.testing.assert_array_equal(touching, answer.touching)
        np.testing.assert_array_equal(active, answer.active)
        np.testing.assert_allclose(z, answer.unknowns, rtol=1e-6, atol=1e-6)
        assert objective == pytest.approx(answer.objective, rel=1e-10)


@pytest.mark.parametrize("what", ["a bound", "a contact"])
def test_a_wrong_guess_is_corrected_or_not_proved(
    robot_in_contact, complementarity_residual, eliminated, what
):
    proofs, seeds = 0, itertools.count()
    while proofs < 8:
        seed = next(seeds)
        robot = robot_in_contact(seed, contacts=5)
        problem = robot.problem()
        answer = solve_by_pivoting(problem, robot.held, robot.touching)
        touching, active = answer.touching.copy(), answer.active.copy()
        if what == "a bound":
            if not active.any():
                continue
            active[np.flatnonzero(active)[0]] = 0
        else:
            touching[seed % 5] = not touching[seed % 5]
        proved, z, _, branch, found, pivots = guess(problem, touching, active)
        if not proved:
            continue
        proofs += 1
        assert pivots == np.count_nonzero(branch != touching)
        if what == "a bound":
            np.testing.assert_array_equal(found, answer.active)
        assert complementarity_residual(problem, z) < ADMISSIBLE
        assert np.all(z >= problem.lower) and np.all(z <= problem.upper)
        assert problem.row_excess(z).max() < 1e-12
        best = problem.objective(eliminated(problem, branch))
        assert problem.objective(z) == pytest.approx(best, rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_search_finds_the_same_solution_with_and_without_a_warm_start(robot_in_contact, seed):
    """The target has moved on since."""
    robot = robot_in_contact(seed)
    last = solve_by_pivoting(robot.problem(), robot.held, robot.touching)
    system = robot.system._replace(effectors=1.02 * robot.system.effectors)
    moved = robot._replace(system=system)
    given = (moved.problem(), robot.held, robot.touching, last.touching)
    searched = solve_by_pivoting(*given)
    guessed = solve_by_pivoting(*given, active=last.active)
    assert guessed.solved and guessed.programs <= searched.programs
    np.testing.assert_array_equal(guessed.touching, searched.touching)
    np.testing.assert_allclose(guessed.unknowns, searched.unknowns, rtol=1e-6, atol=1e-6)


def test_without_a_budget_the_held_state_is_returned(robot_in_contact):
    robot = robot_in_contact(0)
    last = solve_by_pivoting(robot.problem(), robot.held, robot.touching)
    given = (robot.problem(), robot.held, robot.touching, last.touching, 0, last.active)
    answer = solve_by_pivoting(*given)
    assert not answer.solved and answer.stationarity is Stationarity.HELD
    np.testing.assert_array_equal(answer.unknowns, robot.held)


def one_contact(pull, force_max=np.inf):
    """min ½(u - pull)² + ½ λ² where gap = u + λ: pressed in by a negative pull."""
    return QPCC(
        np.eye(2), np.array([-pull, 0.0]), np.array([-9.0, 0.0]), np.array([9.0, np.inf]),
        np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.ones((1, 2)), np.zeros(1),
        np.array([force_max]),
    )  # fmt: skip


@pytest.mark.parametrize("touching", [True, False])
@pytest.mark.parametrize("pull, presses", [(-1.0, True), (1.0, False)])
def test_a_contact_closes_or_opens_as_the_load_requires(touching, pull, presses):
    problem = one_contact(pull)
    proved, z, _, branch, _, pivots = guess(problem, np.array([touching]), no_guess(problem))
    assert proved and branch.tolist() == [presses] and pivots == (touching != presses)
    np.testing.assert_allclose(z, [-0.5, 0.5] if presses else [1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("touching", [True, False])
def test_where_two_branches_meet_nothing_is_proved(touching):
    problem = one_contact(0.0)
    assert not guess(problem, np.array([touching]), no_guess(problem))[0]


def test_a_force_beyond_its_limit_is_not_proved():
    problem = one_contact(-1.0, force_max=0.4)
    assert not guess(problem, np.array([True]), no_guess(problem))[0]


def test_duplicate_contacts_are_not_proved(robot_in_contact):
    robot = robot_in_contact(1, contacts=3)
    twice = robot.with_contacts(np.tile(np.arange(3), 2))
    problem = twice.problem()
    assert not guess(problem, np.ones(6, dtype=bool), no_guess(problem))[0]


@pytest.mark.parametrize("field", ["g", "P", "A", "C", "d", "lower", "upper", "row_lower"])
def test_a_problem_with_nan_is_not_proved(robot_in_contact, field):
    robot = robot_in_contact(0)
    problem = robot.problem()
    answer = solve_by_pivoting(problem, robot.held, robot.touching)
    broken = getattr(problem, field).copy()
    broken.flat[0] = np.nan
    problem = problem._replace(**{field: broken})
    assert not guess(problem, answer.touching, answer.active)[0]


def random_quadratic(seed, n=9, k=3):
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    P = (Q * np.logspace(0.0, -6.0, n)) @ Q.T
    return 0.5 * (P + P.T), rng.standard_normal(n), rng.standard_normal((k, n)), rng


@pytest.mark.parametrize("seed", range(10))
def test_the_minimum_solves_the_kkt_system(seed):
    P, g, rows, rng = random_quadratic(seed)
    values, fixed = rng.standard_normal(3), rng.standard_normal(2)
    z, duals, free = np.zeros(9), np.zeros(3), np.arange(2, 9)
    z[:2] = fixed
    assert minimum_under_equations(P, g, free, rows, values, z, duals)
    np.testing.assert_array_equal(z[:2], fixed)
    np.testing.assert_allclose(rows @ z, values, atol=1e-13 * np.abs(rows * z).max())
    slope = (P @ z + g + rows.T @ duals)[2:]
    assert np.abs(slope).max() < 1e-12 * np.abs(rows.T @ duals).max()


def test_nearly_dependent_equations_are_met_to_rounding():
    P, g, rows, rng = random_quadratic(0, k=2)
    rows[1] = rows[0] + 1e-6 * rng.standard_normal(9)
    z, duals, values = np.zeros(9), np.zeros(2), np.array([1.0, 1.0 + 1e-6])
    assert minimum_under_equations(P, g, np.arange(9), rows, values, z, duals)
    np.testing.assert_allclose(rows @ z, values, atol=1e-13 * np.abs(rows * z).max())


@pytest.mark.parametrize("second", [1.0, 2.0])
def test_dependent_equations_are_refused(second):
    P, g, rows, _ = random_quadratic(0, k=2)
    rows[1] = rows[0]
    values = np.array([1.0, second])
    assert not minimum_under_equations(P, g, np.arange(9), rows, values, np.zeros(9), np.zeros(2))


def test_more_equations_than_unknowns_are_refused():
    P, g, rows, _ = random_quadratic(0, n=2, k=3)
    free = np.arange(2)
    assert not minimum_under_equations(P, g, free, rows, np.ones(3), np.zeros(2), np.zeros(3))


def test_an_indefinite_quadratic_is_refused():
    P, g, rows, _ = random_quadratic(0)
    free, values = np.arange(9), np.ones(3)
    indefinite, z, duals = P - np.eye(9), np.zeros(9), np.zeros(3)
    assert not minimum_under_equations(indefinite, g, free, rows, values, z, duals)
