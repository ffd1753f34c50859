"""Facts of actuators and contacts with friction solved as one problem."""

from ctypes import c_int

import daqp
import numpy as np
import pytest

from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem

NONE = np.zeros(0)
STEP = 4.0e-3
GRAVITY = 9.81
WEIGHT = GRAVITY * 1.0  # of the block of `block_on_slope` [N]


def compliance(seed, n, rank=None):
    Y = np.random.default_rng(seed).standard_normal((rank or 2 * n, n))
    return 1e-3 * Y.T @ Y


def random_problem(seed, actuators=3, contacts=5, rows=3, rank=None, friction=0.6):
    rng = np.random.default_rng(1000 + seed)
    n = actuators + rows * contacts
    W = compliance(seed, n, rank)
    return ContactProblem(
        W, W @ rng.standard_normal(n) - 2e-2 * rng.random(n), np.zeros(actuators),
        np.full(actuators, 5.0), np.full(contacts, friction), rows,
    )  # fmt: skip


def block_on_slope(tangent, friction, points):
    """A block of 1 kg, 100 × 100 × 50 mm, at rest on a slope in the first step of 4 ms."""
    side = np.array([0.1, 0.1, 0.05])
    inertia = np.array([1.0] * 3 + list((np.sum(side**2) - side**2) / 12.0))
    H = np.zeros((3 * len(points), 6))
    for k, (x, y) in enumerate(points):
        H[3 * k : 3 * k + 3, :3] = np.roll(np.eye(3), 1, axis=0)
        H[3 * k : 3 * k + 3, 3:] = np.cross([x, y, -0.5 * side[2]], H[3 * k : 3 * k + 3, :3])
    angle = np.arctan(tangent)
    fall = np.array([np.sin(angle), 0.0, -np.cos(angle), 0.0, 0.0, 0.0]) * GRAVITY * STEP**2
    return ContactProblem(
        H @ np.diag(STEP**2 / inertia) @ H.T, H @ fall, NONE, NONE,
        np.full(len(points), friction), 3,
    )  # fmt: skip


def solved(problem, guess=None, **options):
    guess = np.zeros(len(problem.violation)) if guess is None else guess
    solution = ContactGaussSeidel(**options).solve(problem, guess)
    delta = problem.W @ solution.multipliers + problem.violation
    first = len(problem.lower)
    force, motion = (
        rows[first:].reshape(-1, problem.rows_per_contact) for rows in (solution.multipliers, delta)
    )
    return solution, delta, force, motion


@pytest.mark.parametrize("seed", range(20))
def test_without_friction_forces_are_those_of_the_exact_active_set_method(seed):
    problem = random_problem(seed, actuators=0, contacts=12, rows=1)
    solution, *_ = solved(problem, tolerance=1e-13)
    exact, _, flag, _ = daqp.solve(
        problem.W, problem.violation.copy(), np.zeros((0, 12)), np.full(12, 1e30), np.zeros(12),
        np.zeros(12, dtype=c_int),
    )  # fmt: skip
    assert flag == 1 and solution.converged
    np.testing.assert_allclose(solution.multipliers, exact, atol=1e-8 * np.abs(exact).max())


@pytest.mark.parametrize("friction, least", [(0.0, 50), (0.3, 50), (1.0, 50), (10.0, 35)])
def test_signorini_and_coulomb_hold_or_the_solver_says_that_they_do_not(drawn_rng, friction, least):
    """The page of limits says how often it does not converge at a great friction."""
    converged = 0
    for seed in drawn_rng.integers(2**32, size=50):
        problem = random_problem(int(seed), friction=friction)
        solution, _, force, motion = solved(problem, tolerance=1e-12)
        converged += solution.converged
        assert solution.converged == (solution.gap_residual <= 1e-12)
        if solution.converged:
            check_contact_law(friction, force, motion)
    assert converged >= least


def check_contact_law(friction, force, motion):
    assert np.all(force[:, 0] >= 0.0)
    assert motion[:, 0].min() >= -1e-11
    assert np.abs(force[:, 0] * motion[:, 0]).max() < 1e-10
    limit = friction * force[:, 0]
    pull = np.hypot(force[:, 1], force[:, 2])
    assert np.all(pull <= limit * (1.0 + 1e-12))
    sliding = (force[:, 0] > 0.0) & (np.hypot(motion[:, 1], motion[:, 2]) > 1e-8)
    np.testing.assert_allclose(pull[sliding], limit[sliding], atol=1e-7 * force[:, 0].max())


@pytest.mark.parametrize("tangent", [0.0, 0.3, 0.49, 0.51])
def test_two_hundred_parallel_contacts_carry_the_weight_together(tangent):
    points = np.random.default_rng(1).uniform(-0.05, 0.05, (200, 2))
    solution, delta, force, _ = solved(block_on_slope(tangent, 0.5, points))
    assert solution.converged
    assert np.isfinite(solution.multipliers).all() and np.isfinite(delta).all()
    normal = WEIGHT * np.cos(np.arctan(tangent))
    np.testing.assert_allclose(force[:, 0].sum(), normal, rtol=1e-4)
    assert force[:, 0].max() < 0.05 * normal


@pytest.mark.parametrize("seed", range(20))
def test_an_actuator_is_at_a_bound_or_has_its_prescribed_motion(seed):
    problem = random_problem(seed, actuators=6, contacts=3)
    solution, delta, *_ = solved(problem, tolerance=1e-12)
    force, delta = solution.multipliers[:6], delta[:6]
    assert solution.converged
    assert np.all((force >= problem.lower) & (force <= problem.upper))
    assert np.all(delta[force > problem.lower] < 1e-11)
    assert np.all(delta[force < problem.upper] > -1e-11)


def test_a_failure_to_converge_is_reported():
    problem = random_problem(7, contacts=20, rank=30)
    solution, _, force, _ = solved(problem, tolerance=1e-14, most_sweeps=1)
    assert not solution.converged
    assert solution.sweeps == 1
    assert solution.gap_residual > 1e-14
    assert np.all(np.hypot(force[:, 1], force[:, 2]) <= 0.6 * force[:, 0] * (1 + 1e-12))


def test_a_row_without_compliance_is_not_reported_as_solved():
    problem = ContactProblem(np.zeros((3, 3)), np.array([-1e-3, 0, 0]), NONE, NONE, np.ones(1), 3)
    solution, *_ = solved(problem)
    assert not solution.converged
    assert solution.gap_residual == pytest.approx(1e-3)
    assert np.isfinite(solution.multipliers).all()


def test_an_infeasible_frictionless_problem_is_not_reported_as_solved():
    # One body between two walls that are 1 mm too close to each other.
    W = 1e-3 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    problem = ContactProblem(W, np.full(2, -1e-3), NONE, NONE, np.zeros(2), 1)
    solution, *_ = solved(problem)
    assert not solution.converged
    assert np.isfinite(solution.multipliers).all()
    assert solution.gap_residual > 1e-4


@pytest.mark.parametrize("where", ["W", "violation", "guess"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_non_finite_problem_has_no_solution_and_a_finite_answer(where, value):
    problem, guess = random_problem(2), np.full(18, 0.25)
    if where == "guess":
        guess[4] = value
    else:
        broken = getattr(problem, where).copy()
        broken[4] = value
        problem = problem._replace(**{where: broken})
    solution, *_ = solved(problem, guess)
    assert not solution.converged
    expected = np.full(18, 0.25)
    expected[4] = 0.0 if where == "guess" else 0.25
    np.testing.assert_array_equal(solution.multipliers, expected)


def test_a_taut_cable_and_the_contacts_it_presses_are_solved_together():
    # W of a cable that is a thousand times stiffer than the contacts, nearly dependent on them.
    rng = np.random.default_rng(0)
    Y = rng.standard_normal((12, 31))
    Y[:, 0] = 0.03 * (Y[:, 1] + Y[:, 4]) + 1e-3 * Y[:, 0]
    W = 1e-3 * Y.T @ Y
    violation = W @ np.r_[4.0, np.zeros(30)] - 1e-3 * rng.random(31)
    violation[0] = -1e-3
    problem = ContactProblem(W, violation, np.zeros(1), np.array([1e4]), np.full(10, 0.5), 3)
    solution, delta, *_ = solved(problem, tolerance=1e-11, most_sweeps=2000)
    assert solution.converged
    assert 0.0 < solution.multipliers[0] < 1e4
    assert abs(delta[0]) < 1e-11


@pytest.mark.parametrize("draw", range(4))
def test_forces_converge_to_a_share_of_the_largest_on_request(draw, drawn_rng):
    random = drawn_rng
    factor = random.normal(size=(30, 30)) / 6.0 + 2.0 * np.eye(30)
    problem = ContactProblem(
        1e-3 * factor @ factor.T, 1e-3 * random.normal(size=30), np.zeros(0), np.zeros(0),
        np.full(10, 0.4), 3,
    )  # fmt: skip
    guess = np.zeros(30)
    rough = ContactGaussSeidel(1e-6, 60).solve(problem, guess)
    ended = ContactGaussSeidel(1e-6, 60, 1e-9).solve(problem, guess)
    assert rough.converged and ended.converged
    assert ended.gap_residual <= rough.gap_residual
    assert ended.force_residual <= max(1e-3 * rough.force_residual, 1e-9 * ended.multipliers.max())
