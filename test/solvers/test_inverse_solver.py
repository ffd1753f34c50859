"""The inverse solver: how often the last active set suffices, and how exact its optimum is."""

import numpy as np
import pytest

from softrobot_twin.solvers.inverse_problem import Bounds, InverseSystem, build_inverse_problem
from softrobot_twin.solvers.inverse_solver import InverseSolver
from softrobot_twin.solvers.quadratic_program import DAQPSolver, whiten

STEPS = 100


def circle_problems(n, seed, twice=False, energy_weight=1e-6):
    """A random robot whose target moves on a circle, partly out of reach."""
    rng = np.random.default_rng((n, seed))
    different = n // 2 if twice else n
    size = different + 3
    Q = np.linalg.qr(rng.standard_normal((size, size)))[0]
    W = 1e-3 * (Q * np.logspace(0.0, -3.0, size)) @ Q.T
    of = np.tile(np.arange(different), 2) if twice else np.arange(n)
    W_aa, W_ea = W[np.ix_(of, of)], W[different:, :different][:, of]
    efforts = rng.uniform(0.0, 4.0, n)
    reach, wound = np.abs(W_ea @ efforts).max(), W_aa @ efforts
    room = 0.5 * np.abs(wound).max()
    bounds = Bounds(wound - room, wound + room, np.zeros(n), np.full(n, 10.0))
    first, second = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
    for angle in np.linspace(0.0, 2.0 * np.pi, STEPS, endpoint=False):
        target = 0.6 * reach * (np.cos(angle) * first + np.sin(angle) * second)
        system = InverseSystem.without_contacts(W_ea, W_aa, -W_ea @ efforts - target, np.zeros(n))
        yield build_inverse_problem(system, np.ones(3), energy_weight, bounds)


@pytest.mark.parametrize("n", [4, 8, 12])
def test_the_warm_start_finds_the_optimum_of_an_exact_solver(n):
    """Compared in the norm of the Hessian: along what only costs energy digits are lost by DAQP."""
    bound = 0
    for seed in range(4):
        solver, exact = InverseSolver(), DAQPSolver(tolerance=1e-13)
        for problem in circle_problems(n, seed):
            found, expected = solver.solve(problem, np.zeros(n)), exact.solve(whiten(problem))
            assert found.solved and expected.solved
            apart = found.unknowns - expected.unknowns
            size = expected.unknowns @ problem.P @ expected.unknowns
            assert np.sqrt(apart @ problem.P @ apart) <= 1e-9 * np.sqrt(size)
            bound += np.count_nonzero(found.active)
    assert bound > STEPS


def test_a_failed_guess_is_answered_by_a_general_solver(drawn_rng):
    """Each actuator is given twice: dependent bounds are not proved.

    They never become active with one robot of 30. The general solver is as exact as its own tests
    say; its answer is taken as it is, within the bounds.
    """
    answered = set()
    for seed in drawn_rng.integers(2**32, size=6):
        solver, general = InverseSolver(), DAQPSolver()
        for problem in circle_problems(8, seed, twice=True):
            found = solver.solve(problem, np.zeros(8))
            answered.add(found.solver)
            if found.solver == "warm start":
                continue
            expected = general.solve(whiten(problem))
            assert found.solved and found.solver == expected.solver
            np.testing.assert_array_equal(
                found.unknowns, np.clip(expected.unknowns, problem.lower, problem.upper)
            )
    assert answered == {"warm start", "DAQP"}


def test_bounds_are_never_exceeded():
    solver = InverseSolver()
    for problem in circle_problems(8, 1, twice=True):
        z = solver.solve(problem, np.zeros(8)).unknowns
        assert np.all(z >= problem.lower) and np.all(z <= problem.upper)


@pytest.mark.parametrize("field", ["g", "P", "row_lower"])
def test_an_infeasible_problem_is_unsolved_and_held(field):
    problem = next(circle_problems(4, 0))
    if field == "row_lower":
        wrong = problem._replace(
            row_lower=problem.row_upper + 1.0, row_upper=problem.row_upper + 2.0,
            upper=np.full(4, 1e-3),
        )  # fmt: skip
    else:
        broken = getattr(problem, field).copy()
        broken.flat[0] = np.nan
        wrong = problem._replace(**{field: broken})
    held = np.full(4, 0.5)
    found = InverseSolver().solve(wrong, held)
    assert not found.solved and found.solver == ""
    np.testing.assert_array_equal(found.unknowns, held)
