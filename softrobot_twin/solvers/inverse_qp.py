"""The inverse problem as a small quadratic program (Coevoet 2017, eq. 17-18).

    min ½ ‖Q^½ (W_ea λ + δ_e)‖² + ½ ε s λᵀ W_aa λ
    s.t.  δ_min ≤ W_aa λ + δ_a ≤ δ_max,   λ_min ≤ λ ≤ λ_max

Its curvature spans six decades: some directions move the effector, others only spend energy. So it
is posed in unknowns z in which the Hessian is the identity, λ = T z, with constraint rows of unit
length and a gradient of unit length: what is left to the solver is the projection of a point onto
a polyhedron. ε is a pure number, relative to the mean curvature s of the tracking term.
Building and solving are apart: a problem can be looked at without solving it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Share of each cable's own compliance that is added to W in the energy term, as if it stretched a
# little: two cables on one path then divide the load.
CABLE_COMPLIANCE = 1.0e-3
# What has a lesser share of the largest compliance, or way, moves nothing.
MOVES_NOTHING = 1.0e-14

# Least ε that can be counted on. The tracking term is rounded at some 1e-16 of s. Along what only
# spends energy the curvature is as small as ε times CABLE_COMPLIANCE: with a smaller ε it is
# noise, and so is T. This ε costs a billionth of a way in tracking.
LEAST_ENERGY_WEIGHT = float(np.sqrt(np.finfo(float).eps))


class WhitenedQP(NamedTuple):
    """min ½ zᵀz + qᵀz, lower ≤ C z ≤ upper, with λ = T z.

    Attributes:
        q: Gradient at zero, of unit length, shape (n,).
        C: Unit rows of the bounds on shortening, then on tension, shape (2 n, n).
        lower: Lower bounds, shape (2 n,).
        upper: Upper bounds, shape (2 n,).
        T: Newtons by unit unknown [N], shape (n, n).
    """

    q: np.ndarray
    C: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    T: np.ndarray


class Bounds(NamedTuple):
    """Bounds of the actuators in this step.

    Attributes:
        displacement_min: Least displacement δ_min [m], shape (n,).
        displacement_max: Greatest displacement δ_max [m], shape (n,).
        effort_min: Least effort λ_min [N], shape (n,).
        effort_max: Greatest effort λ_max [N], shape (n,).
    """

    displacement_min: np.ndarray
    displacement_max: np.ndarray
    effort_min: np.ndarray
    effort_max: np.ndarray


def compliance_scale(W_aa: np.ndarray) -> np.ndarray:
    """Scale 1/√W_ii of each actuator [√(N/m)]; one where an actuator moves nothing."""
    diagonal = np.diag(W_aa)
    least = MOVES_NOTHING * max(diagonal.max(initial=0.0), np.finfo(float).tiny)
    return np.where(diagonal > least, 1.0 / np.sqrt(np.maximum(diagonal, least)), 1.0)


def hessian(
    W_ea: np.ndarray, W_aa: np.ndarray, effector_weights: np.ndarray, energy_weight: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Curvature of the objective in unknowns scaled by 1/√W_ii.

    Args:
        W_ea: Effector motion by tension [m/N], shape (effector_row_count, n).
        W_aa: Shortening by tension [m/N], shape (n, n).
        effector_weights: Weight of each effector row, shape (effector_row_count,).
        energy_weight: ε.

    Returns:
        The Hessian over the mean curvature s of the tracking term, shape (n, n); the scale,
        shape (n,); and s.
    """
    scale = compliance_scale(W_aa)
    outer = np.outer(scale, scale)
    tracking = (W_ea.T @ (W_ea * effector_weights[:, None])) * outer
    curvature = np.trace(tracking) / len(scale)
    if not curvature > 0.0:
        # Nothing to track: the energy term alone decides.
        curvature, energy_weight = 1.0, 1.0
    P = tracking / curvature + energy_weight * (W_aa * outer)
    P[np.diag_indices_from(P)] += energy_weight * CABLE_COMPLIANCE
    return 0.5 * (P + P.T), scale, curvature


def build_qp(
    W_ea: np.ndarray,
    W_aa: np.ndarray,
    effector_violation: np.ndarray,
    actuator_violation: np.ndarray,
    effector_weights: np.ndarray,
    energy_weight: float,
    bounds: Bounds,
    last: np.ndarray | None = None,
    steadiness: float = 0.0,
) -> WhitenedQP:
    """Stack the inverse problem.

    Args:
        W_ea: Effector motion by tension [m/N], shape (effector_row_count, n).
        W_aa: Shortening by tension [m/N], shape (n, n).
        effector_violation: δ_e after free motion [m], shape (effector_row_count,).
        actuator_violation: δ_a after free motion [m], shape (n,).
        effector_weights: Weight of each effector row, shape (effector_row_count,).
        energy_weight: ε, relative to the mean curvature of the tracking term.
        bounds: Bounds on shortening [m] and tension [N].
        last: Tensions to stay near [N], shape (n,); needed with a steadiness.
        steadiness: Weight of the energy of λ - last, by that of λ itself.

    Returns:
        The whitened problem.

    Raises:
        numpy.linalg.LinAlgError: W is not finite or not positive semi-definite.
    """
    if not W_ea[effector_weights > 0.0].any():
        # Nothing to track: the energy alone decides, and at once.
        steadiness = 0.0
    share = energy_weight * (1.0 + steadiness)
    P, scale, curvature = hessian(W_ea, W_aa, effector_weights, share)
    # P = L Lᵀ and z = Lᵀ (λ / scale): the Hessian by z is the identity.
    T = scale[:, None] * np.linalg.inv(np.linalg.cholesky(P)).T
    q = T.T @ (W_ea.T @ (effector_weights * effector_violation)) / curvature
    if steadiness:
        pull = W_aa @ last + CABLE_COMPLIANCE * last / (scale * scale)
        q -= energy_weight * steadiness * (T.T @ pull)
    size = np.linalg.norm(q) or 1.0
    T = T * size
    C = np.vstack([W_aa @ T, T])
    lengths = np.linalg.norm(C, axis=1)
    lengths[lengths == 0.0] = 1.0
    lower = np.concatenate([bounds.displacement_min - actuator_violation, bounds.effort_min])
    upper = np.concatenate([bounds.displacement_max - actuator_violation, bounds.effort_max])
    return WhitenedQP(q / size, C / lengths[:, None], lower / lengths, upper / lengths, T)
