"""Facts of the quadratic program with complementarity, solved by single pivoting."""

import numpy as np
import pytest
from scipy.optimize import nnls

from softrobot_twin.solvers.pivoting import MUCH_LOWER, solve_by_pivoting
from softrobot_twin.solvers.quadratic_program import DAQPSolver, whiten

from .test_force_bounds import solve

ADMISSIBLE = 1.0e-9


@pytest.mark.parametrize("seed", range(25))
def test_an_answer_is_admissible_and_no_worse_than_holding(robot_in_contact, complementarity_residual, seed):
    robot = robot_in_contact(seed)
    problem = robot.problem()
    answer = solve(robot, problem)
    assert answer.solved
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert np.all(answer.unknowns >= problem.lower) and np.all(answer.unknowns <= problem.upper)
    assert answer.row_excess.max() < 1e-12
    held = problem.objective(robot.held)
    assert answer.objective <= held + 1e-12 * abs(held)


def test_without_contacts_it_is_the_quadratic_program(robot_in_contact):
    robot = robot_in_contact(0, contacts=0, moves=0)
    assert (expected := DAQPSolver().solve(whiten(robot.problem(1e-3)))).solved
    # From efforts of round-off too.
    for size in (1.0, 1e-7, 1e-8, 1e-9, 1e-10, 1e-14):
        answer = solve_by_pivoting(robot.problem(1e-3), size * robot.held, robot.touching)
        np.testing.assert_allclose(answer.unknowns, expected.unknowns, atol=1e-5)


def test_a_contact_opens_where_opening_lowers_the_objective(robot_in_contact):
    # One cable pulls towards a wall and another away from it; the target is away.
    robot = robot_in_contact(0, contacts=1, actuators=2, moves=0, rows=1)
    eye = 1e-3 * np.eye(1)
    system = robot.system._replace(
        W_ea=np.array([[1e-3, -1e-3]]), W_ec=eye, W_aa=2e-3 * np.eye(2),
        W_ac=np.array([[1e-3], [-1e-3]]), W_cc=eye, G_e=np.zeros((1, 0)),
        G_a=np.zeros((2, 0)), G_c=np.zeros((1, 0)), effectors=np.array([-3e-3]),
        actuators=np.zeros(2), gaps=np.zeros(1),
    )  # fmt: skip
    limits = robot.contact_bounds._replace(move_min=np.zeros(0), move_max=np.zeros(0))
    free = np.full(2, np.inf)
    robot = robot._replace(
        system=system, contact_bounds=limits, tensions=np.array([0.0, 1.0]),
        bounds=robot.bounds._replace(displacement_min=-free, displacement_max=free),
    )  # fmt: skip
    answer = solve(robot)
    assert robot.touching.tolist() == [True] and answer.touching.tolist() == [False]
    assert answer.pivots == 1
    assert answer.unknowns[2] == 0.0
    assert answer.unknowns[0] == pytest.approx(3.0, rel=1e-3)
    assert robot.problem().gaps(answer.unknowns)[0] == pytest.approx(3e-3, rel=1e-3)


def from_all_open(robot, problem, options=None):
    """The answers of one search, and of two of which the second begins with all contacts open."""
    first, asked = solve(robot, problem, **options or {}), []

    def second_start(z):
        asked.append(z)
        return np.zeros(robot.contacts, dtype=bool)

    both = solve(robot, problem, second_start=second_start, **options or {})
    np.testing.assert_array_equal(asked, [first.unknowns])
    return first, both


def reached_without_contact(robot, seed):
    """The robot with a target that it reaches where all its contacts are open."""
    random, system, bounds = np.random.default_rng(seed), robot.system, robot.bounds
    tensions = random.uniform(0.0, 1.0, len(robot.tensions))
    gaps = -system.W_ac.T @ tensions + random.uniform(0.0, 1e-4, robot.contacts)
    width = np.full(len(tensions), np.inf)
    return robot._replace(
        system=system._replace(effectors=-system.W_ea @ tensions, gaps=gaps),
        bounds=bounds._replace(displacement_min=-width, displacement_max=width),
        tensions=np.zeros(len(tensions)),
    )  # fmt: skip


def test_a_second_start_gives_the_first_answer_or_a_much_lower_one(
    robot_in_contact, complementarity_residual
):
    lower = 0
    for seed in range(60):
        robot = reached_without_contact(robot_in_contact(seed, contacts=4, actuators=3), seed)
        problem = robot.problem()
        first, both = from_all_open(robot, problem)
        unbound = problem.objective(np.linalg.solve(problem.P, -problem.g))
        if np.array_equal(first.unknowns, both.unknowns):
            assert both._replace(programs=first.programs).objective == first.objective
            continue
        lower += 1
        assert both.objective - unbound < MUCH_LOWER * (first.objective - unbound)
        assert both.row_excess.max() < 1e-12
        assert complementarity_residual(problem, both.unknowns) < ADMISSIBLE
    print(f"{lower} of 60 local minima were left")
    assert lower > 0


@pytest.mark.parametrize("seed", range(20))
def test_duplicate_contacts_neither_cycle_nor_change_the_motion(
    robot_in_contact, complementarity_residual, eliminated, seed
):
    once = robot_in_contact(seed, contacts=5)
    twice = once.with_contacts(np.tile(np.arange(5), 2))
    problem = twice.problem()
    answer = solve(twice, problem)
    assert answer.solved and answer.programs < 50
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert answer.objective <= problem.objective(twice.held)
    if not np.array_equal(answer.touching[:5], answer.touching[5:]):
        return
    expected = eliminated(once.problem(), answer.touching[:5])
    if expected is not None:
        motion = np.concatenate([problem.gaps(answer.unknowns)[:5], problem.A @ answer.unknowns])
        of_one = np.concatenate([once.problem().gaps(expected), once.problem().A @ expected])
        np.testing.assert_allclose(motion, of_one, atol=3e-5)


def test_contacts_on_a_rigid_face_share_the_load(robot_in_contact, complementarity_residual, drawn_rng):
    """Six contacts whose compliance has rank three: what they bear together is determined."""
    robot = robot_in_contact(int(drawn_rng.integers(2**32)), contacts=3)
    mix, of_face = drawn_rng.dirichlet(np.ones(3), 6), robot.system
    of_face = of_face._replace(gaps=of_face.gaps - 5e-3)
    system = of_face._replace(
        W_ec=of_face.W_ec @ mix.T, W_ac=of_face.W_ac @ mix.T, W_cc=mix @ of_face.W_cc @ mix.T,
        G_c=mix @ of_face.G_c, gaps=mix @ of_face.gaps,
    )  # fmt: skip
    limits = robot.contact_bounds._replace(force_max=np.full(6, np.inf))
    robot = robot._replace(system=system, contact_bounds=limits)
    path = system.W_aa @ robot.tensions + system.W_ac @ robot.held[9:]
    robot = robot._replace(
        bounds=robot.bounds._replace(displacement_min=path - 3e-3, displacement_max=path + 3e-3)
    )
    problem = robot.problem()
    answer = solve(robot, problem)
    assert answer.solved
    assert complementarity_residual(problem, answer.unknowns) < 1e-8
    # min ½ λᵀ W λ + λᵀ δ over λ ≥ 0, with W = (L mixᵀ)ᵀ L mixᵀ.
    L = np.linalg.cholesky(of_face.W_cc).T
    gaps = of_face.W_ac.T @ answer.unknowns[:8] + of_face.G_c @ answer.unknowns[8:9] + of_face.gaps
    expected, _ = nnls(L @ mix.T, -np.linalg.solve(L.T, gaps))
    load = mix.T @ expected
    np.testing.assert_allclose(mix.T @ answer.unknowns[9:], load, atol=1e-6 * (1.0 + load.sum()))


@pytest.mark.parametrize("field", ["g", "P", "C", "d", "upper", "force_max"])
def test_a_problem_with_nan_is_rejected(robot_in_contact, field):
    robot = robot_in_contact(0)
    problem = robot.problem()
    broken = getattr(problem, field).copy()
    broken.flat[0] = np.nan
    answer = solve(robot, problem._replace(**{field: broken}))
    assert not answer.solved
    np.testing.assert_array_equal(answer.unknowns, robot.held)


@pytest.mark.parametrize("most", [0, 1, 2])
@pytest.mark.parametrize("seed", range(8))
def test_an_exhausted_budget_gives_an_admissible_answer(
    robot_in_contact, complementarity_residual, seed, most
):
    robot = robot_in_contact(seed)
    problem = robot.problem()
    answer = solve(robot, problem, most_programs=most)
    assert answer.programs <= most and answer.solved == (most > 0)
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert answer.objective <= problem.objective(robot.held)


def test_the_deadline_is_checked_before_each_program(robot_in_contact):
    robot = next(r for r in map(robot_in_contact, range(50)) if solve(r).programs > 2)
    asked = []

    def expired():
        asked.append(True)
        return len(asked) > 1

    answer = solve(robot, expired=expired)
    assert answer.solved and answer.programs == 1
    assert not solve(robot, expired=lambda: True).solved
