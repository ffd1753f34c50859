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


# Of 200 robots the mean shares are 0.985, 0.943, 0.968 and 0.989, with deviations of 0.011, 0.052,
# 0.058 and 0.033. The bars are six standard errors of 20 robots below.
@pytest.mark.parametrize("n, least", [(4, 0.969), (8, 0.873), (12, 0.89), (24, 0.945)])
def test_the_last_active_set_suffices_in_most_steps(n, least, drawn_rng):
    answered = []
    for seed in drawn_rng.integers(2**32, size=20):
        solver = InverseSolver()
        for problem in circle_problems(n, seed):
            answered.append(solver.solve(problem, np.zeros(n)).solver)
    assert set(answered) <= {"warm start", "DAQP"}
    assert answered.count("warm start") >= least * len(answered)


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


@pytest.mark.parametrize("seed", range(5))
def test_with_contacts_the_branches_are_searched_again_only_where_some_meet(robot_in_contact, seed):
    robot = robot_in_contact(seed)
    problem, solver = robot.problem(), InverseSolver()
    found = solver.solve(problem, robot.held, robot.touching)
    assert found.solved and found.solver == "pivoting"
    again = solver.solve(problem, robot.held, robot.touching, found.touching)
    z = found.unknowns
    meet = np.any((problem.forces(z) < 1e-7) & (problem.gaps(z) < 1e-9))
    assert again.solver == ("pivoting" if meet else "warm start")
    np.testing.assert_allclose(again.unknowns, found.unknowns, rtol=1e-6, atol=1e-6)


def test_an_exact_solver_searches_branches_also_with_a_single_branch():
    exact = InverseSolver(is_exact=True)
    usual = InverseSolver()
    usual.qp_solver = DAQPSolver(tolerance=1e-12)
    for problem in circle_problems(4, 0):
        held = np.zeros(len(problem.g))
        found, expected = exact.solve(problem, held), usual.solve(problem, held)
        assert found.solved and found.solver in ("pivoting", "warm start")
        np.testing.assert_allclose(found.unknowns, expected.unknowns, rtol=1e-6, atol=1e-7)
