"""How often the local minimum of pivoting is the global one, of all 2^n pieces."""

import itertools

import numpy as np
import pytest

from softrobot_twin.solvers.pivoting import solve_by_pivoting


def least_of_all_pieces(problem, eliminated) -> float:
    """The global optimum, by another method: contact forces eliminated from every branch."""
    pieces = itertools.product((False, True), repeat=problem.contact_count)
    answers = (eliminated(problem, np.array(piece)) for piece in pieces)
    return min(problem.objective(answer) for answer in answers if answer is not None)


def compare_with_all_pieces(robots, eliminated):
    """Shares of what could be gained over holding that are lost."""
    lost = []
    for robot in robots:
        problem = robot.problem()
        answer = solve_by_pivoting(problem, robot.held, robot.touching)
        least = least_of_all_pieces(problem, eliminated)
        lost.append((answer.objective - least) / (problem.objective(robot.held) - least))
    return np.array(lost)


def tell(contacts, lost):
    missed = lost[lost > 1e-6]
    print(
        f"{contacts} contacts: global in {np.mean(lost < 1e-6):.1%} of {len(lost)}, "
        f"else {missed.mean() if len(missed) else 0.0:.1%} of the gain lost in the mean, "
        f"{lost.max():.1%} at most"
    )


@pytest.mark.parametrize("contacts", [1, 3, 5])
def test_the_local_minimum_is_nearly_always_the_global_one(robot_in_contact, eliminated, contacts):
    lost = compare_with_all_pieces(
        [robot_in_contact(seed, contacts) for seed in range(40)], eliminated
    )
    tell(contacts, lost)
    # No answer is below the enumerated optimum: it is one.
    assert lost.min() > -1e-6
    assert np.mean(lost < 1e-6) >= 0.8


@pytest.mark.exhaustive
@pytest.mark.parametrize("contacts, problems", [(2, 60), (4, 60), (6, 60), (8, 30), (10, 20)])
def test_at_least_eight_of_ten_local_minima_are_global(robot_in_contact, eliminated, contacts, problems):
    lost = compare_with_all_pieces(
        [robot_in_contact(seed, contacts) for seed in range(problems)], eliminated
    )
    tell(contacts, lost)
    assert lost.min() > -1e-6
    assert np.mean(lost < 1e-6) >= 0.8
