"""Actuators and contacts without friction, solved exactly by an active set.

Robots that follow targets past obstacles need it: their inverse problem begins from the contacts
that press. With sweeps to exact forces in its place, 16 of 840 pursuits of a beam beside a rod ended
5 mm or more farther from their targets; with the active set and other last digits, 2 of 1008.

Without friction the problem states the optimality conditions of min ½ λᵀWλ + λᵀ violation within
bounds. The active set of the guess is tried first (`warm_start`). Otherwise the convex program is
solved over the few rows that may carry a force; contacts that would then penetrate are added.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.solvers.contact_problem import ContactProblem
from softrobot_twin.solvers.direct_problem import solve_by_daqp
from softrobot_twin.solvers.warm_start import optimum_from_active_set


def solve_by_active_set(problem: ContactProblem, guess: np.ndarray, clearance: float) -> np.ndarray | None:
    """Multipliers of a problem without friction.

    Args:
        problem: The problem, of one row a contact.
        guess: Multipliers that may be far from the solution [N], shape (n,).
        clearance: Contacts with a greater gap under the guess are not expected to press [m].

    Returns:
        Multipliers [N], shape (n,), or None where the solver gives no answer.
    """
    W, violation, count = problem.W, problem.violation, len(problem.lower)
    lower = np.concatenate([problem.lower, np.zeros(len(problem.friction))])
    upper = np.concatenate([problem.upper, np.full(len(problem.friction), np.inf)])
    proved, exact = _by_guess(problem, guess, lower, upper)
    if proved:
        return exact
    near = (guess > 0.0) | (W @ guess + violation <= clearance)
    near[:count] = True
    while True:
        rows = near.nonzero()[0]
        found = solve_by_daqp(W[np.ix_(rows, rows)], violation[rows], lower[rows], upper[rows])
        if found is None:
            return None
        multipliers = np.zeros(len(near))
        multipliers[rows] = found
        crossed = ~near & (W @ multipliers + violation < 0.0)
        if not crossed.any():
            return multipliers
        near |= crossed


def _by_guess(problem: ContactProblem, guess, lower, upper) -> tuple[bool, np.ndarray]:
    """The solution where nearly the same bounds are active as in the guess; see `warm_start`."""
    active = (guess >= upper).astype(np.int64) - (guess <= lower)
    none, no_rows = np.empty(0), np.empty((0, len(guess)))
    proved, multipliers, *_ = optimum_from_active_set(
        problem.W, problem.violation, lower, upper, no_rows, none, none, no_rows, none, none,
        np.empty(0, dtype=bool), active,
    )  # fmt: skip
    return proved, multipliers
