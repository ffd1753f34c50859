"""The exact answer of a whitened QP, by which other solvers are judged."""

from __future__ import annotations

from itertools import combinations, product

import daqp
import numpy as np

from softrobot_twin.solvers.quadratic_program import WhitenedQP

# Every set of active rows is tried up to this many unknowns.
MOST_ENUMERATED = 4
_TOLERANCE = 1.0e-9


def exact_multipliers(problem: WhitenedQP) -> np.ndarray | None:
    """λ that meets the optimality conditions to rounding.

    The Hessian is the identity, so the conditions have one solution and whoever meets them is it.
    Few unknowns: all sets of active rows are tried. Many: DAQP names the set at a tight tolerance,
    and its equations are solved and checked here.

    Args:
        problem: The QP.

    Returns:
        λ [N], shape (n,); None when no set meets the conditions.
    """
    if len(problem.q) <= MOST_ENUMERATED:
        return enumerated(problem)
    return certified(problem)


def enumerated(problem: WhitenedQP) -> np.ndarray | None:
    """λ by trying all sets of active rows, few first."""
    rows, n = problem.C.shape
    for count in range(n + 1):
        for active in combinations(range(rows), count):
            for upper in product((False, True), repeat=count):
                z = _meets_conditions(problem, np.array(active, int), np.array(upper, bool))
                if z is not None:
                    return problem.T @ z
    return None


def certified(problem: WhitenedQP) -> np.ndarray | None:
    """λ on the active set that DAQP finds, if it meets the conditions."""
    rows, n = problem.C.shape
    _, _, exit_flag, info = daqp.solve(
        np.eye(n), problem.q, problem.C, np.minimum(problem.upper, 1e30),
        np.maximum(problem.lower, -1e30), np.zeros(rows, dtype=np.intc), primal_tol=1e-11)
    if exit_flag < 1:
        return None
    duals = np.asarray(info["lam"])
    active = np.flatnonzero(duals)
    z = _meets_conditions(problem, active, duals[active] > 0.0)
    return None if z is None else problem.T @ z


def _meets_conditions(
    problem: WhitenedQP, active: np.ndarray, upper: np.ndarray
) -> np.ndarray | None:
    """z with these rows at these bounds, if the duals have the right sign and no bound breaks."""
    C, q = problem.C[active], problem.q
    bounds = np.where(upper, problem.upper[active], problem.lower[active])
    if not np.all(np.isfinite(bounds)):
        return None
    # z = -q - Cᵀμ and C z = bounds.
    duals = np.linalg.lstsq(C @ C.T, -(bounds + C @ q), rcond=None)[0]
    if np.any(np.where(upper, duals, -duals) < -_TOLERANCE):
        return None
    z = -q - C.T @ duals
    # Rows that hang together may contradict each other: least squares then miss some.
    if np.any(np.abs(C @ z - bounds) > _TOLERANCE):
        return None
    values = problem.C @ z
    breaks = np.any(values < problem.lower - _TOLERANCE) or np.any(
        values > problem.upper + _TOLERANCE)
    return None if breaks else z
