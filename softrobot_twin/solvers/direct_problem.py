"""The direct problem: efforts of commanded actuators (Coevoet 2017, eq. 16, with slack allowed).

A cable pulls and never pushes: where its path is shorter than its length, the cable is slack. Hence
its displacement is at least the commanded one, its effort is at least zero, and one of the two
inequalities is an equation:

    0 ≤ λ  ⊥  W λ + δ_free - δ_wound ≥ 0

These are the optimality conditions of min ½ λᵀWλ + (δ_free - δ_wound)ᵀλ over λ ≥ 0, a strictly
convex problem, solved exactly by the dual active-set method of DAQP.
"""

from __future__ import annotations

from ctypes import c_int

import daqp
import numpy as np

from softrobot_twin.solvers.inverse_problem import MOVES_NOTHING, Bounds

# Two cables on one path make W singular; with this share of its diagonal they share the load.
SHARING = 1.0e-10
INFINITY = 1.0e30
ROUND_OFF = 1.0e-12


def compliance_scale(W: np.ndarray) -> np.ndarray:
    """Scale 1/√W_ii of each actuator [√(N/m)]; one where an actuator moves nothing."""
    diagonal = np.diag(W)
    least = MOVES_NOTHING * max(diagonal.max(initial=0.0), np.finfo(float).tiny)
    return np.where(diagonal > least, 1.0 / np.sqrt(np.maximum(diagonal, least)), 1.0)


def solve_direct(
    W: np.ndarray,
    free_violation: np.ndarray,
    wound: np.ndarray,
    effort_min: np.ndarray,
    effort_max: np.ndarray,
) -> np.ndarray | None:
    """Efforts that hold actuators at their commanded displacements.

    Args:
        W: Displacement by effort [m/N], shape (n, n).
        free_violation: Displacement after free motion δ_free [m], shape (n,).
        wound: Commanded displacement δ_wound of each actuator [m], shape (n,).
        effort_min: Least effort [N], shape (n,).
        effort_max: Greatest effort, at which the displacement is reduced [N], shape (n,).

    Returns:
        Efforts [N], shape (n,), or None when the solver finds none.
    """
    scale = compliance_scale(W)
    gradient = scale * (free_violation - wound)
    no_rows = np.zeros((0, len(scale)))
    return _solve(W, scale, gradient, no_rows, effort_min, effort_max, (), ())


def solve_towards(
    W: np.ndarray, free_violation: np.ndarray, tensions: np.ndarray, bounds: Bounds
) -> np.ndarray | None:
    """Efforts nearest to commanded ones, min ½ (λ - λ*)ᵀW(λ - λ*), within bounds on both sides.

    Args:
        W: Displacement by effort [m/N], shape (n, n).
        free_violation: Shortening after free motion [m], shape (n,).
        tensions: Commanded efforts λ* [N], shape (n,).
        bounds: Bounds on displacements [m] and efforts [N].

    Returns:
        Efforts [N], shape (n,), or None when the solver finds none.
    """
    scale = compliance_scale(W)
    rows = W * np.outer(scale, scale)
    return _solve(
        W,
        scale,
        -rows @ (tensions / scale) - SHARING * (tensions / scale),
        rows,
        bounds.effort_min,
        bounds.effort_max,
        scale * (bounds.displacement_min - free_violation),
        scale * (bounds.displacement_max - free_violation),
    )


def _solve(
    W, scale, gradient, rows, effort_min, effort_max, row_min, row_max
) -> np.ndarray | None:
    """min ½ zᵀPz + gradientᵀz in scaled unknowns z = λ / scale, by DAQP."""
    count = len(scale)
    if count == 0:
        return np.zeros(0)
    P = W * np.outer(scale, scale)
    P[np.diag_indices_from(P)] += SHARING
    # DAQP's tolerances are absolute and displacements are millimetres: scale the problem to one.
    size = np.abs(gradient).max() or 1.0
    if not np.isfinite(size) or not np.all(np.isfinite(P)):
        return None
    upper = np.minimum(np.concatenate([effort_max / scale, row_max]) / size, INFINITY)
    lower = np.maximum(np.concatenate([effort_min / scale, row_min]) / size, -INFINITY)
    z, _, exit_flag, _ = daqp.solve(
        P, gradient / size, rows, upper, lower, np.zeros(len(upper), dtype=c_int)
    )
    if exit_flag < 1:
        return None
    # The effort of a slack cable is its bound, without the solver's round-off.
    at_bound = z <= lower[:count] + ROUND_OFF
    return np.where(at_bound, effort_min, np.clip(scale * size * z, effort_min, effort_max))
