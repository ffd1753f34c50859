"""Quadratic programs in whitened unknowns, solved by DAQP."""

import numpy as np
import pytest

from softrobot_twin.solvers.inverse_problem import Bounds, InverseSystem, build_inverse_problem
from softrobot_twin.solvers.quadratic_program import DAQPSolver, whiten

pytestmark = pytest.mark.libraries


def random_robot(seed, n=4, rows=3):
    """Compliances with the wide spread of curvature that real robots have."""
    rng = np.random.default_rng(seed)
    Y = rng.standard_normal((n + rows, n + rows)) * np.logspace(0, -1.5, n + rows)[:, None]
    W = 1e-3 * Y.T @ Y
    bounds = Bounds(np.full(n, -1e-3), np.full(n, 2e-2), np.zeros(n), np.full(n, rng.uniform(2, 30)))
    return W[:n, :n], W[n:, :n], 1e-2 * rng.standard_normal(rows), 1e-3 * rng.random(n), bounds


def inverse_program(robot, energy_weight=1e-6, weights=None):
    W_aa, W_ea, effector, actuator, bounds = robot
    weights = np.ones(len(W_ea)) if weights is None else weights
    system = InverseSystem.without_contacts(W_ea, W_aa, effector, actuator)
    return build_inverse_problem(system, weights, energy_weight, bounds)


def solve(robot, energy_weight=1e-6, weights=None):
    problem = whiten(inverse_program(robot, energy_weight, weights))
    return problem, DAQPSolver().solve(problem)


@pytest.mark.parametrize("seed", range(25))
def test_solution_meets_the_kkt_conditions(seed):
    problem, solution = solve(random_robot(seed))
    assert solution.solved, solution.reason
    z = np.linalg.solve(problem.T, solution.unknowns)
    value = problem.C @ z
    stationarity = z + problem.q + problem.C.T @ solution.duals
    assert np.abs(stationarity).max() < 1e-6
    assert np.all(value >= problem.lower - 1e-6)
    assert np.all(value <= problem.upper + 1e-6)
    gap = np.where(solution.duals > 0, problem.upper - value, value - problem.lower)
    assert np.abs(solution.duals * np.where(solution.duals == 0, 0, gap)).max() < 1e-6


@pytest.mark.parametrize("seed", range(10))
def test_the_whitened_objective_is_the_program_s_own(seed):
    program = inverse_program(random_robot(seed), energy_weight=1e-3)
    whitened = whiten(program)
    first, second = np.random.default_rng(seed).random((2, 4))

    def objective(z):
        w = np.linalg.solve(whitened.T, z)
        return 0.5 * w @ w + whitened.q @ w

    ratio = (program.objective(first) - program.objective(second)) / (objective(first) - objective(second))
    assert ratio == pytest.approx(program.objective(first) / objective(first), rel=1e-6)


def test_more_actuators_than_directions_have_one_answer():
    robot = random_robot(3, n=8, rows=1)
    first, second = (solve(robot)[1].unknowns for _ in range(2))
    np.testing.assert_array_equal(first, second)
    moved = list(robot)
    moved[2] = robot[2] + 1e-5
    near = solve(moved)[1].unknowns
    assert np.abs(near - first).max() < 1e-2 * np.abs(first).max() + 1e-3


def test_the_same_cable_twice_shares_its_tension():
    W_aa, W_ea, effector, actuator, _ = random_robot(1, n=3)
    twice = [0, 0, 1, 2]
    W_aa, W_ea, actuator = W_aa[np.ix_(twice, twice)], W_ea[:, twice], actuator[twice]
    bounds = Bounds(np.full(4, -1.0), np.full(4, 1.0), np.full(4, -50.0), np.full(4, 50.0))
    _, solution = solve((W_aa, W_ea, effector, actuator, bounds), energy_weight=1e-4)
    assert solution.solved
    assert solution.unknowns[0] == pytest.approx(solution.unknowns[1], rel=1e-2)


def test_contradicting_bounds_are_reported_as_unsolved():
    W_aa, W_ea, effector, actuator, bounds = random_robot(2)
    impossible = bounds._replace(
        displacement_min=np.full(4, 0.5), displacement_max=np.full(4, 0.6),
        effort_max=np.full(4, 1e-3),
    )
    _, solution = solve((W_aa, W_ea, effector, actuator, impossible))
    assert not solution.solved
    assert np.all(np.isnan(solution.unknowns))
