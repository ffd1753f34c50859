"""Contacts without friction beside those with friction, as rows with the bounds 0 and ∞."""

import numpy as np
import pytest

from softrobot_twin.solvers.contact_continuation import ContactContinuation
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.contact_problem import ContactProblem, with_frictionless_contacts
from softrobot_twin.solvers.contact_proximal_newton import ContactProximalNewton

TOLERANCE, FORCE_SHARE = 1e-9, 1e-6
ACTUATORS, SMOOTH, ROUGH = 3, 9, 6


def problems(seed, rank=None):
    """One problem in both forms, and where the rows of the second are among those of the first."""
    rng = np.random.default_rng(seed)
    n = ACTUATORS + 3 * (SMOOTH + ROUGH)
    Yt = 0.03 * rng.standard_normal((n, rank or 2 * n))
    violation = Yt @ (Yt.T @ rng.standard_normal(n)) - 2e-2 * rng.random(n)
    friction = np.r_[np.zeros(SMOOTH), rng.uniform(0.2, 0.6, ROUGH)]
    lower, upper = np.zeros(ACTUATORS), np.full(ACTUATORS, 5.0)
    three = ContactProblem(None, violation, lower, upper, friction, 3, Yt)
    first = ACTUATORS + 3 * SMOOTH
    kept = np.r_[:ACTUATORS, ACTUATORS:first:3, first:n]
    mixed = with_frictionless_contacts(three._replace(Yt=Yt[kept], violation=violation[kept]))
    return three, mixed, kept


def by_sweeps(problem, guess):
    return ContactGaussSeidel(TOLERANCE, 1000, FORCE_SHARE).solve(problem.with_matrix(), guess)


def by_newton(problem, guess):
    return ContactProximalNewton(TOLERANCE, FORCE_SHARE).solve(problem, guess)


def by_continuation(problem, guess):
    solver = ContactContinuation(TOLERANCE, FORCE_SHARE)
    return solver.solve(problem.with_matrix(), guess, guess)


@pytest.mark.parametrize("solve", [by_sweeps, by_newton, by_continuation])
@pytest.mark.parametrize("rank", [None, 18])
@pytest.mark.parametrize("seed", range(10))
def test_forces_of_one_row_solve_the_problem_of_three_rows_with_a_coefficient_of_zero(seed, rank, solve):
    three, mixed, kept = problems(seed, rank)
    found = solve(mixed, np.zeros(len(kept)))
    assert found.converged and np.count_nonzero(found.multipliers[ACTUATORS:] > 0.0) > 3
    everywhere = np.zeros(len(three.violation))
    everywhere[kept] = found.multipliers
    judged = ContactGaussSeidel(TOLERANCE, 0).solve(three.with_matrix(), everywhere)
    np.testing.assert_array_equal(judged.multipliers, everywhere)
    assert judged.converged
    assert judged.force_residual <= 1.01 * FORCE_SHARE * np.abs(everywhere).max()
