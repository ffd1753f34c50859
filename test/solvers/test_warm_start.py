"""The optimum from a guess of the active set: proved or not claimed."""

import itertools

import numpy as np
import pytest

from softrobot_twin.solvers.pivoting import solve_by_pivoting
from softrobot_twin.solvers.qpcc import QPCC
from softrobot_twin.solvers.warm_start import optimum_from_active_set

ADMISSIBLE = 1.0e-9


def contiguous(problem):
    return QPCC(*map(np.array, problem))


def guess(problem, touching, active):
    return optimum_from_active_set(*contiguous(problem), touching, active)


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
