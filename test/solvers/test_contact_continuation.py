"""Facts of the continuation of contact forces by Newton's method."""

import numpy as np
import pytest

from softrobot_twin.solvers.contact_continuation import ContactContinuation
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem
from softrobot_twin.solvers.contact_proximal_newton import ContactProximalNewton

COUNT, FRICTION = 40, 0.4
TOLERANCE, SHARE = 1e-10, 1e-8


def problem_of(seed: int) -> ContactProblem:
    """Contacts of full rank that press, slide and stay open, with two actuators before them."""
    random = np.random.default_rng(seed)
    n = 2 + 3 * COUNT
    factor = random.normal(size=(n, n)) / np.sqrt(n) + 2.0 * np.eye(n)
    violation = 1e-3 * random.normal(size=n)
    return ContactProblem(
        1e-3 * factor @ factor.T, violation, np.zeros(2), np.array([np.inf, 1.0]),
        np.full(COUNT, FRICTION), 3,
    )  # fmt: skip


def solved(problem: ContactProblem) -> np.ndarray:
    """Its multipliers, by another solver."""
    exact = ContactProximalNewton(1e-13, 1e-11).solve(problem, np.zeros(len(problem.W)))
    assert exact.converged
    return exact.multipliers


@pytest.mark.parametrize("draw", range(5))
def test_forces_are_found_from_a_near_guess(draw, drawn_seed):
    problem = problem_of(drawn_seed)
    exact = solved(problem)
    guess = exact * (1.0 + 1e-3 * np.random.default_rng(drawn_seed + 1).normal(size=len(exact)))
    found = ContactContinuation(TOLERANCE, SHARE).solve(problem, guess, np.zeros(len(exact)))
    assert found.converged
    np.testing.assert_allclose(found.multipliers, exact, rtol=0, atol=1e-6 * exact.max())


@pytest.mark.parametrize("draw", range(5))
def test_an_open_contact_that_closes_is_found(draw, drawn_seed):
    problem = problem_of(drawn_seed)
    exact = solved(problem)
    guess = exact.copy()
    guess[2 + 3 * int(np.argmax(exact[2::3])) + np.arange(3)] = 0.0
    found = ContactContinuation(TOLERANCE, SHARE).solve(problem, guess, guess)
    if found.converged:
        np.testing.assert_allclose(found.multipliers, exact, rtol=0, atol=1e-6 * exact.max())
    judged = ContactGaussSeidel(TOLERANCE, 0).solve(problem, found.multipliers)
    assert judged.gap_residual == pytest.approx(found.gap_residual, rel=1e-3, abs=1e-13)


@pytest.mark.parametrize("draw", range(5))
def test_a_solution_reported_as_solved_is_one_from_any_guess(draw, drawn_seed):
    problem = problem_of(drawn_seed)
    guess = np.abs(np.random.default_rng(drawn_seed + 1).normal(size=len(problem.W)))
    found = ContactContinuation(TOLERANCE, SHARE).solve(problem, guess, 10.0 * guess)
    judged = ContactGaussSeidel(TOLERANCE, 0).solve(problem, found.multipliers)
    largest = np.abs(found.multipliers).max()
    exact = judged.gap_residual <= 1.01 * TOLERANCE
    exact &= judged.force_residual <= 1.01 * SHARE * largest
    assert exact or not found.converged


def test_forces_are_zero_where_all_contacts_open():
    problem = problem_of(6)
    problem.violation[2::3] = 1.0
    problem.violation[:2] = 1.0
    found = ContactContinuation(TOLERANCE, SHARE).solve(problem, *2 * [np.ones(len(problem.W))])
    assert found.converged and not found.multipliers.any()


def test_a_non_finite_problem_is_not_solved():
    problem = problem_of(7)
    problem.violation[5] = np.nan
    guess = np.ones(len(problem.W))
    found = ContactContinuation(TOLERANCE, SHARE).solve(problem, guess, guess)
    assert not found.converged and np.isfinite(found.multipliers).all()


def test_redundant_contacts_share_a_load():
    one = problem_of(8)
    rows = np.concatenate([np.arange(len(one.W)), np.arange(2, len(one.W))])
    twice = one._replace(
        W=one.W[np.ix_(rows, rows)], violation=one.violation[rows],
        friction=np.full(2 * COUNT, FRICTION),
    )  # fmt: skip
    exact = solved(one)
    half = np.concatenate([exact[:2], 0.5 * exact[2:], 0.5 * exact[2:]])
    found = ContactContinuation(1e-9, 1e-6).solve(twice, 1.001 * half, half * 1.002)
    assert found.converged
    together = found.multipliers[2 : len(one.W)] + found.multipliers[len(one.W) :]
    np.testing.assert_allclose(together, exact[2:], rtol=0, atol=1e-5 * exact.max())


@pytest.mark.parametrize("draw", range(5))
def test_a_load_that_moves_to_a_neighbouring_contact_is_found(draw, drawn_seed):
    """A node's contact opens and an edge's contact almost at the same place takes its force."""
    one = problem_of(drawn_seed)
    exact = solved(one)
    k = 2 + 3 * int(np.argmax(exact[2::3]))
    n = len(one.W)
    rows = np.concatenate([np.arange(n), np.arange(k, k + 3)])
    W = one.W[np.ix_(rows, rows)].copy()
    W[n:, n:] *= 1.0 + 1e-6
    violation = one.violation[rows].copy()
    violation[k] += 1e-6
    problem = one._replace(W=W, violation=violation, friction=np.full(COUNT + 1, FRICTION))
    guess = np.concatenate([exact, np.zeros(3)])
    found = ContactContinuation(1e-9, 1e-6).solve(problem, guess, guess)
    assert found.converged and found.multipliers[k] == 0.0
    exact[k : k + 3], moved = 0.0, exact[k : k + 3].copy()
    np.testing.assert_allclose(found.multipliers[n:], moved, rtol=0, atol=1e-3 * moved[0])
