"""Bounds on contact force, and the order in which bounds are relaxed."""

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog

from softrobot_twin.solvers.direct_problem import solve_direct
from softrobot_twin.solvers.inverse_problem import Bounds
from softrobot_twin.solvers.pivoting import solve_by_pivoting
from softrobot_twin.solvers.polyhedron_projection import SLACK_COST
from softrobot_twin.solvers.qpcc import MARGIN


def solve(robot, problem=None, **options):
    problem = robot.problem() if problem is None else problem
    return solve_by_pivoting(problem, robot.held, robot.touching, **options)


def leaning(robot_in_contact, seed, contacts=4, actuators=4):
    """A robot that obstacles press on."""
    robot = robot_in_contact(seed, contacts=contacts, actuators=actuators, moves=0)
    robot = robot._replace(system=robot.system._replace(gaps=robot.system.gaps - 2e-3))
    path = robot.system.W_aa @ robot.tensions + robot.system.W_ac @ robot.held[actuators:]
    bounds = robot.bounds._replace(displacement_min=path - 3e-3, displacement_max=path + 3e-3)
    return robot._replace(bounds=bounds)


def least_in_piece(problem, touching, slope, most=np.inf):
    """The least of slope · z in a piece, by a linear program, with no force above a bound [N]."""
    n, count = len(slope), problem.contact_count
    forces = np.arange(n - count, n)
    lower, upper = problem.lower.copy(), problem.upper.copy()
    upper[forces] = np.where(touching, np.minimum(upper[forces], most), 0.0)
    return linprog(
        slope, A_eq=1e3 * problem.C[touching], b_eq=-1e3 * problem.d[touching],
        A_ub=1e3 * np.vstack([-problem.C[~touching], problem.A, -problem.A]),
        b_ub=1e3 * np.concatenate([problem.d[~touching], problem.row_upper, -problem.row_lower]),
        bounds=np.column_stack([lower, upper]), method="highs-ds",
        options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
    )  # fmt: skip


def check_that_the_excess_is_the_least(robot, problem, answer):
    """Half the sum of squared excesses is convex: its slope leads nowhere within the piece.

    With it the search minimises c/2 of the squared way from the held state, in unknowns w that
    displace all rows alike. So the slope gains at most c (w - w_held)·(w' - w) by going on to any
    w'. The way there is no shorter than that of the search, before it looked at the objective.
    """
    z, excess, count = answer.unknowns, answer.force_excess, problem.contact_count
    slope = np.zeros(len(z))
    slope[-count:] = excess
    found = least_in_piece(problem, answer.touching, slope)
    assert found.status == 0, found.message
    reach = np.linalg.norm(np.vstack([problem.A, problem.C]), axis=0)
    way, other = (np.linalg.norm((to - robot.held) * reach) for to in (z, found.x))
    allowed = SLACK_COST / reach[-count:].min() ** 2 * way * (way + other)
    widened = 2.0 * MARGIN * max(robot.held[-count:].max(), problem.force_max.max())
    assert slope @ z - found.fun <= allowed + widened * excess.sum()


@pytest.mark.parametrize("case", range(12))
def test_contact_forces_keep_their_bound_where_feasible(
    robot_in_contact, complementarity_residual, drawn_rng, case
):
    robot = leaning(robot_in_contact, int(drawn_rng.integers(2**32)))
    free = solve(robot)
    limit = 0.97 * free.unknowns[4:].max()
    gentle = robot.with_force_max(limit)
    problem = gentle.problem()
    answer = solve(gentle, problem)
    assert answer.solved
    assert complementarity_residual(problem, answer.unknowns) < 1e-6
    check_that_the_excess_is_the_least(gentle, problem, answer)
    assert answer.row_excess.max() < 1e-9


@pytest.mark.parametrize("case", range(6))
def test_an_unavoidable_excess_is_the_least_and_is_named(
    robot_in_contact, complementarity_residual, drawn_rng, case
):
    robot = leaning(robot_in_contact, int(drawn_rng.integers(2**32)))
    held = robot.held[4:]
    gentle = robot.with_force_max(0.0)
    problem = gentle.problem()
    answer = solve(gentle, problem)
    assert answer.solved
    assert complementarity_residual(problem, answer.unknowns) < 1e-6
    assert np.linalg.norm(answer.force_excess) <= np.linalg.norm(held) * (1.0 + 1e-9)
    np.testing.assert_array_equal(answer.force_excess > 0.0, answer.unknowns[4:] > 0.0)
    check_that_the_excess_is_the_least(gentle, problem, answer)
    assert answer.row_excess.max() < 1e-9
    assert np.all(answer.unknowns >= problem.lower) and np.all(answer.unknowns <= problem.upper)


def test_the_target_gives_way_before_the_force_bound(robot_in_contact):
    """Where the last solution's contacts can keep the bound, which a linear program tells."""
    raised = 0
    for seed in range(20):
        robot = leaning(robot_in_contact, seed)
        free = solve(robot)
        for share in (0.9, 0.8):
            most = share * free.unknowns[4:].max()
            gentle = robot.with_force_max(most)
            problem = gentle.problem()
            nothing = np.zeros(len(problem.g))
            if least_in_piece(problem, free.touching, nothing, most).status != 0:
                continue
            answer = solve(gentle, problem, last=free.touching)
            assert answer.force_excess.max() < 1e-9
            if np.array_equal(answer.touching, free.touching):
                assert answer.objective >= free.objective - 1e-12 * abs(free.objective)
                raised += answer.objective > free.objective
    assert raised > 0


def test_the_force_bound_gives_way_before_the_lengths(robot_in_contact):
    """Lengths are held, so that nothing can be done about the force but to tell of it."""
    robot = leaning(robot_in_contact, 1)
    path = robot.system.W_aa @ robot.tensions + robot.system.W_ac @ robot.held[4:]
    bounds = robot.bounds._replace(displacement_min=path, displacement_max=path)
    robot = robot._replace(bounds=bounds)
    gentle = robot.with_force_max(0.5 * robot.held[4:].max())
    answer = solve(gentle)
    assert answer.solved
    assert answer.row_excess.max() < 1e-9
    np.testing.assert_allclose(answer.unknowns, gentle.held, atol=1e-4 * gentle.held.max())
    assert answer.force_excess.max() > 0.4 * robot.held[4:].max()


def test_lengths_give_way_last_and_tensions_never(robot_in_contact):
    """Lengths that need more than the greatest tensions are prescribed."""
    robot = leaning(robot_in_contact, 1)
    path = robot.system.W_aa @ robot.tensions + robot.system.W_ac @ robot.held[4:]
    shorter = robot.bounds._replace(displacement_min=path + 1.0, displacement_max=path + 1.1)
    answer = solve(robot._replace(bounds=shorter))
    assert answer.solved
    assert np.all(answer.row_excess > 0.0)
    assert np.all(answer.unknowns[:4] <= 10.0) and np.all(answer.unknowns[:4] >= 0.0)
    assert np.linalg.norm(answer.row_excess) < np.linalg.norm(np.full(4, 1.0))


def answers_along(robots):
    """Answers one after the other, each started as the last one ended."""
    answers, last = [], None
    for robot in robots:
        answers.append(solve(robot, last=last))
        assert answers[-1].solved
        last = answers[-1].touching
    return answers


def largest_change(answers):
    return np.abs(np.diff([answer.unknowns for answer in answers], axis=0)).max()


def pressed(robot_in_contact, seed):
    """The first robot in every fifth seed whose contact forces cannot all vanish."""
    robots = (leaning(robot_in_contact, other) for other in itertools.count(seed, 5))
    return next(robot for robot in robots if solve(robot.with_force_max(0.0)).force_excess.any())


def force_excess(answer):
    return answer.force_excess.max()


def where_it_becomes_infeasible(make, excess=force_excess) -> float:
    """The share, between 0 and 1, at which a bound cannot be kept any more."""
    low, high = 0.0, 1.0
    assert excess(solve(make(low))) == 0.0 < excess(solve(make(high)))
    for _ in range(40):
        middle = 0.5 * (low + high)
        if excess(solve(make(middle))) > 0.0:
            high = middle
        else:
            low = middle
    return high


@pytest.mark.parametrize("rows", ["forces", "lengths"])
@pytest.mark.parametrize("seed", [8, 131, 215, None])
def test_just_beyond_a_bound_there_is_a_solution(robot_in_contact, drawn_rng, seed, rows):
    """What keeps the least excess is nearly a point there, which a program may miss."""
    robot = pressed(robot_in_contact, int(drawn_rng.integers(2**32)) if seed is None else seed)
    limit = (1.5 if rows == "forces" else 0.5) * robot.held[4:].max()
    path = robot.system.W_aa @ robot.tensions + robot.system.W_ac @ robot.held[4:]

    def beyond(share):
        if rows == "forces":
            return robot.with_force_max((1.0 - share) * limit)
        wanted = path + share * np.array([1.0, -1.0, 1.0, -1.0])
        bounds = Bounds(wanted - 1e-4, wanted + 1e-4, *robot.bounds[2:])
        return robot._replace(bounds=bounds).with_force_max(limit)

    there = where_it_becomes_infeasible(
        # Lengths of 1e-12 m are rounding.
        beyond, force_excess if rows == "forces" else lambda answer: answer.row_excess.max() // 1e-12
    )
    assert all(solve(beyond(there + further)).solved for further in np.logspace(-7.0, -3.0, 9))


@pytest.mark.parametrize("seed", range(5))
def test_a_force_is_continuous_as_its_bound_becomes_infeasible(robot_in_contact, seed):
    robot = pressed(robot_in_contact, seed)
    most = 1.5 * robot.held[4:].max()

    def lowered(share):
        return robot.with_force_max((1.0 - share) * most)

    check_that_it_is_continuous(lowered)


@pytest.mark.parametrize("seed", range(5))
def test_a_force_is_continuous_as_an_obstacle_comes_too_close(robot_in_contact, seed):
    """The held state itself goes from within the force bound to beyond it."""
    robot = leaning(robot_in_contact, seed)
    limit = 1.5 * solve(robot).unknowns[4:].max()

    def closer(share):
        gaps = robot.system.gaps - share * 20e-3
        return robot._replace(system=robot.system._replace(gaps=gaps)).with_force_max(limit)

    check_that_it_is_continuous(closer)


def check_that_it_is_continuous(make):
    """Near the point where a bound is relaxed, steps ten times finer change forces ten times less.
    """
    there = where_it_becomes_infeasible(make)
    changes = []
    for width in (1e-4, 1e-5):
        shares = there + width * np.linspace(-1.0, 1.0, 20)
        answers = answers_along(make(share) for share in shares)
        excesses = [answer.force_excess.max() for answer in answers]
        assert excesses[0] == 0.0 < excesses[-1]
        changes.append(largest_change(answers))
    round_off = 1e-9 * max(np.abs(answer.unknowns).max() for answer in answers)
    assert changes[1] < max(0.2 * changes[0], round_off)


def test_two_programs_that_differ_by_rounding_have_one_answer(robot_in_contact):
    robot = leaning(robot_in_contact, 0)
    limit = 0.3 * robot.held[4:].max()
    for share, more in itertools.pairwise((1.0, 1.0 + 1e-9, 1.0 - 1e-9)):
        first = solve(robot.with_force_max(limit * share)).unknowns
        second = solve(robot.with_force_max(limit * more)).unknowns
        np.testing.assert_allclose(first, second, atol=1e-5)


def test_forces_at_held_actuation_are_those_of_the_direct_problem(robot_in_contact):
    robot = leaning(robot_in_contact, 0)
    forces = robot.held[4:]
    gaps = robot.problem().gaps(robot.held)
    assert np.abs(np.minimum(1e-3 * forces, gaps)).max() < 1e-9
    zero = np.zeros(4)
    again = solve_direct(robot.system.W_cc, gaps, zero, zero, np.full(4, np.inf))
    assert np.abs(again).max() < 1e-6 * forces.max()
