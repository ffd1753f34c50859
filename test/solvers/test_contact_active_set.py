"""Facts of contact without friction solved by an active set."""

import numpy as np
import pytest

from softrobot_twin.solvers.compliance import Compliance
from softrobot_twin.solvers.contact_active_set import solve_by_active_set
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem

FAR = 5.0e-4


def problem(seed, actuators=4, contacts=12, rank=None):
    rng = np.random.default_rng(seed)
    n = actuators + contacts
    H = 0.03 * rng.standard_normal((n, n if rank is None else rank))
    violation = 2.0e-3 * rng.standard_normal(n)
    lower, upper = np.zeros(actuators), rng.uniform(0.5, 2.0, actuators)
    return ContactProblem(H @ H.T, violation, lower, upper, np.zeros(contacts), 1)


def residual(contact_problem, multipliers):
    return ContactGaussSeidel(1e-9, 0).solve(contact_problem, multipliers).gap_residual


@pytest.mark.parametrize("seed", range(20))
def test_it_solves_the_problem_to_rounding_from_any_guess(seed):
    posed = problem(seed)
    for guess in (np.zeros(16), np.ones(16)):
        multipliers = solve_by_active_set(posed, guess, FAR)
        assert residual(posed, multipliers) < 1e-11
        assert np.all(multipliers >= 0.0) and np.all(multipliers[:4] <= posed.upper)


@pytest.mark.parametrize("share", [0.49, 0.5, 0.51])
def test_two_almost_identical_contacts_are_distinguished(share):
    """Sweeps take long to move the load from one to the other."""
    posed = problem(3, contacts=2)
    W, violation = posed.W.copy(), posed.violation.copy()
    W[5], W[5, 5] = W[4] * (1.0 + 1e-5), W[4, 4] * (1.0 + 1e-4)
    W[:, 5] = W[5]
    violation[4:] = -1.0e-3 - 1e-7 * np.array([share, 1.0 - share])
    posed = posed._replace(W=W, violation=violation)
    multipliers = solve_by_active_set(posed, np.zeros(6), FAR)
    assert residual(posed, multipliers) < 1e-12


@pytest.mark.parametrize("seed", range(10))
def test_duplicate_contacts_share_the_force_of_one(seed):
    once = problem(seed, contacts=4)
    of = np.concatenate([np.arange(8), np.arange(4, 8)])
    twice = once._replace(W=once.W[np.ix_(of, of)].copy(), violation=once.violation[of], friction=np.zeros(8))
    alone = solve_by_active_set(once, np.zeros(8), FAR)
    shared = solve_by_active_set(twice, np.ones(12), FAR)
    assert residual(twice, shared) < 1e-9
    np.testing.assert_allclose(shared[4:8] + shared[8:], alone[4:], atol=1e-5)


def test_an_omitted_contact_is_added_when_its_gap_becomes_negative():
    """One cable, shortened by 3 mm, pulls against a wall given twice, 2 mm away; open in the guess.
    """
    W = 1.0e-3 * np.array([[2.0, -1.0, -1.0], [-1.0, 2.0, 2.0], [-1.0, 2.0, 2.0]])
    posed = ContactProblem(W, np.array([-3e-3, 1e-3, 1e-3]), np.zeros(1), np.full(1, 9.0), np.zeros(2), 1)
    far = posed._replace(violation=np.array([-3e-3, 1.0, 1.0]))
    free = solve_by_active_set(far, np.zeros(3), FAR)
    assert (W @ free + posed.violation)[1] < 0.0
    multipliers = solve_by_active_set(posed, np.zeros(3), FAR)
    assert residual(posed, multipliers) < 1e-9
    assert multipliers[1] == pytest.approx(multipliers[2], rel=1e-5) and multipliers[1] > 0.1


def test_rows_can_be_omitted_from_a_system():
    W, of = np.arange(25.0).reshape(5, 5), [0, 3, 4]
    np.testing.assert_array_equal(Compliance(W).without(1, 3).W, W[np.ix_(of, of)])
