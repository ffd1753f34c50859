"""Facts of the optimum from a guess of the bounds that bind."""

import numpy as np
import pytest

from softrobot_twin.solvers.complementarity_problem import ComplementarityProblem
from softrobot_twin.solvers.guessed_bounds import optimum_by_guess
from softrobot_twin.solvers.complementarity_solution import Stationarity
from softrobot_twin.solvers.pivoting import solve_by_pivoting

ADMISSIBLE = 1.0e-9


def contiguous(problem):
    return ComplementarityProblem(*map(np.array, problem))


def guess(problem, touching, binding):
    return optimum_by_guess(*contiguous(problem), touching, binding)


def no_guess(problem):
    own = len(problem.g) - problem.contact_count
    return np.zeros(own + len(problem.row_lower), dtype=np.int64)


def is_at_a_corner(problem, z):
    return np.any((problem.forces(z) < 1e-7) & (problem.gaps(z) < 1e-9))


@pytest.mark.parametrize("seed", range(40))
def test_from_the_answer_s_own_bounds_it_is_the_answer_but_at_a_corner(robot_in_contact, seed):
    robot = robot_in_contact(seed)
    problem = robot.problem()
    answer = solve_by_pivoting(problem, robot.held, robot.touching)
    found = guess(problem, answer.touching, answer.binding)
    proved, z, objective, touching, binding, pivots = found
    assert proved != is_at_a_corner(problem, answer.unknowns)
    if proved:
        assert pivots == 0
        np.testing.assert_array_equal(touching, answer.touching)
        np.testing.assert_array_equal(binding, answer.binding)
        np.testing.assert_allclose(z, answer.unknowns, rtol=1e-6, atol=1e-6)
        assert objective == pytest.approx(answer.objective, rel=1e-10)


@pytest.mark.parametrize("what", ["a bound", "a contact"])
def test_a_wrong_guess_is_corrected_or_nothing_is_said(
    robot_in_contact, complementarity_residual, eliminated, what
):
    proofs = 0
    for seed in range(60):
        robot = robot_in_contact(seed, contacts=5)
        problem = robot.problem()
        answer = solve_by_pivoting(problem, robot.held, robot.touching)
        touching, binding = answer.touching.copy(), answer.binding.copy()
        if what == "a bound":
            binding[np.flatnonzero(binding)[0]] = 0
        else:
            touching[seed % 5] = not touching[seed % 5]
        proved, z, _, piece, bound, pivots = guess(problem, touching, binding)
        if not proved:
            continue
        proofs += 1
        assert pivots == np.count_nonzero(piece != touching)
        if what == "a bound":
            np.testing.assert_array_equal(bound, answer.binding)
        assert complementarity_residual(problem, z) < ADMISSIBLE
        assert np.all(z >= problem.lower) and np.all(z <= problem.upper)
        assert problem.row_excess(z).max() < 1e-12
        best = problem.objective(eliminated(problem, piece))
        assert problem.objective(z) == pytest.approx(best, rel=1e-9)
    assert proofs >= 8


@pytest.mark.parametrize("seed", range(20))
def test_the_search_gives_the_same_from_last_bounds_as_without(robot_in_contact, seed):
    """The target has moved on since."""
    robot = robot_in_contact(seed)
    last = solve_by_pivoting(robot.problem(), robot.held, robot.touching)
    system = robot.system._replace(effectors=1.02 * robot.system.effectors)
    moved = robot._replace(system=system)
    given = (moved.problem(), robot.held, robot.touching, last.touching)
    searched = solve_by_pivoting(*given)
    guessed = solve_by_pivoting(*given, binding=last.binding)
    assert guessed.solved and guessed.programs <= searched.programs
    np.testing.assert_array_equal(guessed.touching, searched.touching)
    np.testing.assert_allclose(guessed.unknowns, searched.unknowns, rtol=1e-6, atol=1e-6)


def test_what_may_not_be_spent_is_not_guessed(robot_in_contact):
    robot = robot_in_contact(0)
    last = solve_by_pivoting(robot.problem(), robot.held, robot.touching)
    given = (robot.problem(), robot.held, robot.touching, last.touching, 0, last.binding)
    answer = solve_by_pivoting(*given)
    assert not answer.solved and answer.stationarity is Stationarity.HELD
    np.testing.assert_array_equal(answer.unknowns, robot.held)


def one_contact(pull, force_max=np.inf):
    """min ½(u - pull)² + ½ λ² where gap = u + λ: pressed in by a negative pull."""
    return ComplementarityProblem(
        np.eye(2), np.array([-pull, 0.0]), np.array([-9.0, 0.0]), np.array([9.0, np.inf]),
        np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.ones((1, 2)), np.zeros(1),
        np.array([force_max]),
    )  # fmt: skip


@pytest.mark.parametrize("touching", [True, False])
@pytest.mark.parametrize("pull, presses", [(-1.0, True), (1.0, False)])
def test_a_contact_is_closed_or_let_go_as_the_pull_has_it(touching, pull, presses):
    problem = one_contact(pull)
    proved, z, _, piece, _, pivots = guess(problem, np.array([touching]), no_guess(problem))
    assert proved and piece.tolist() == [presses] and pivots == (touching != presses)
    np.testing.assert_allclose(z, [-0.5, 0.5] if presses else [1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("touching", [True, False])
def test_at_the_corner_of_two_pieces_nothing_is_said(touching):
    problem = one_contact(0.0)
    assert not guess(problem, np.array([touching]), no_guess(problem))[0]


def test_a_force_beyond_its_limit_is_left_to_the_search():
    problem = one_contact(-1.0, force_max=0.4)
    assert not guess(problem, np.array([True]), no_guess(problem))[0]


def test_contacts_there_twice_are_left_to_the_search(robot_in_contact):
    robot = robot_in_contact(1, contacts=3)
    twice = robot.with_contacts(np.tile(np.arange(3), 2))
    problem = twice.problem()
    assert not guess(problem, np.ones(6, dtype=bool), no_guess(problem))[0]


@pytest.mark.parametrize("field", ["g", "P", "A", "C", "d", "lower", "upper", "row_lower"])
def test_what_is_no_number_is_not_proved(robot_in_contact, field):
    robot = robot_in_contact(0)
    problem = robot.problem()
    answer = solve_by_pivoting(problem, robot.held, robot.touching)
    broken = getattr(problem, field).copy()
    broken.flat[0] = np.nan
    problem = problem._replace(**{field: broken})
    assert not guess(problem, answer.touching, answer.binding)[0]
