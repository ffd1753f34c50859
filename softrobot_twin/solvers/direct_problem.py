"""Tensions of cables that are commanded (Coevoet 2017, eq. 16, with slack allowed).

A cable pulls, it never pushes: where the body comes closer than the cable is long, the cable hangs
slack. So its shortening is at least the wound one, its tension at least zero, and one of the two
holds with equality:

    0 ≤ λ  ⊥  W λ + δ_free - δ_wound ≥ 0

These are the optimality conditions of min ½ λᵀWλ + (δ_free - δ_wound)ᵀλ over λ ≥ 0, a strictly
convex problem, solved exactly by the dual active-set method of DAQP.
"""

from __future__ import annotations

from ctypes import c_int

import daqp
import numpy as np

from softrobot_twin.solvers.inverse_qp import Bounds, compliance_scale

# Two cables on one path make W singular; this share of its diagonal lets them divide the load.
SHARING = 1.0e-10
INFINITY = 1.0e30
ROUND_OFF = 1.0e-12


def solve_direct(
    W: np.ndarray,
    free_violation: np.ndarray,
    wound: np.ndarray,
    effort_min: np.ndarray,
    effort_max: np.ndarray,
) -> np.ndarray | None:
    """Tensions that hold cables at their wound shortenings.

    Args:
        W: Shortening by tension [m/N], shape (n, n).
        free_violation: Shortening after free motion δ_free [m], shape (n,).
        wound: Wound shortening of each cable [m], shape (n,).
        tension_min: Least tension [N], shape (n,).
        tension_max: Greatest tension, where a winch slips [N], shape (n,).

    Returns:
        Tensions [N], shape (n,), or None when the solver gives no answer.
    """
    scale = compliance_scale(W)
    gradient = scale * (free_violation - wound)
    no_rows = np.zeros((0, len(scale)))
    return _solve(W, scale, gradient, no_rows, effort_min, effort_max, (), ())


def solve_towards(
    W: np.ndarray, free_violation: np.ndarray, tensions: np.ndarray, bounds: Bounds
) -> np.ndarray | None:
    """Tensions nearest to asked ones, min ½ (λ - λ*)ᵀW(λ - λ*), within bounds on both sides.

    Args:
        W: Shortening by tension [m/N], shape (n, n).
        free_violation: Shortening after free motion [m], shape (n,).
        tensions: Asked tensions λ* [N], shape (n,).
        bounds: Bounds on shortening [m] and tension [N].

    Returns:
        Tensions [N], shape (n,), or None when the solver gives no answer.
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
    # DAQP's tolerances are absolute and shortenings are millimetres: bring the problem to size 1.
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
    # A slack cable's tension is its bound, not the solver's round-off beside it.
    at_bound = z <= lower[:count] + ROUND_OFF
    return np.where(at_bound, effort_min, np.clip(scale * size * z, effort_min, effort_max))
