"""The inverse problem as a small quadratic program (Coevoet 2017, eq. 17-18).

    min ½ ‖Q^½ (W_ea λ + δ_e)‖² + ½ ε s λᵀ W_aa λ
    s.t.  δ_min ≤ W_aa λ + δ_a ≤ δ_max,   λ_min ≤ λ ≤ λ_max

Each unknown is scaled by 1/√W_ii and the objective by s, the mean curvature of its first part, so
that ε is a pure number and the solver sees entries near one whatever the robot's size. Building
and solving are apart: a problem can be looked at without solving it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class BoxedQP(NamedTuple):
    """min ½ zᵀPz + qᵀz, l ≤ Cz ≤ u, in scaled unknowns z = λ / scale.

    Attributes:
        P: Positive semi-definite Hessian, shape (n, n).
        q: Gradient at zero, shape (n,).
        C: Constraint rows, W_aa above the identity, both scaled, shape (2 n, n).
        lower: Lower bounds, shape (2 n,).
        upper: Upper bounds, shape (2 n,).
        scale: Newtons in one unit of each unknown, 1/√W_ii, shape (n,).
    """

    P: np.ndarray
    q: np.ndarray
    C: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray


class Bounds(NamedTuple):
    """Bounds of the actuators in this step.

    Attributes:
        shortening_min: Least shortening δ_min [m], shape (n,).
        shortening_max: Greatest shortening δ_max [m], shape (n,).
        tension_min: Least tension λ_min [N], shape (n,).
        tension_max: Greatest tension λ_max [N], shape (n,).
    """

    shortening_min: np.ndarray
    shortening_max: np.ndarray
    tension_min: np.ndarray
    tension_max: np.ndarray


def compliance_scale(W_aa: np.ndarray) -> np.ndarray:
    """Scale 1/√W_ii of each actuator; one where an actuator moves nothing."""
    diagonal = np.diag(W_aa)
    least = 1.0e-14 * max(diagonal.max(initial=0.0), np.finfo(float).tiny)
    return np.where(diagonal > least, 1.0 / np.sqrt(np.maximum(diagonal, least)), 1.0)


def build_qp(
    W_ea: np.ndarray,
    W_aa: np.ndarray,
    effector_violation: np.ndarray,
    actuator_violation: np.ndarray,
    effector_weights: np.ndarray,
    energy_weight: float,
    bounds: Bounds,
) -> BoxedQP:
    """Stack the inverse problem.

    Args:
        W_ea: Effector motion by tension [m/N], shape (effector_row_count, n).
        W_aa: Shortening by tension [m/N], shape (n, n).
        effector_violation: δ_e after free motion [m], shape (effector_row_count,).
        actuator_violation: δ_a after free motion [m], shape (n,).
        effector_weights: Weight of each effector row, shape (effector_row_count,).
        energy_weight: ε, relative to the mean curvature of the tracking term.
        bounds: Bounds on shortening [m] and tension [N].

    Returns:
        The scaled problem.
    """
    scale = compliance_scale(W_aa)
    count = len(scale)
    weighted = W_ea * effector_weights[:, None]
    tracking = (W_ea.T @ weighted) * np.outer(scale, scale)
    energy = W_aa * np.outer(scale, scale)
    curvature = np.trace(tracking) / count
    if not curvature > 0.0:
        # Nothing to track: the energy term alone decides.
        curvature, energy_weight = 1.0, 1.0
    P = tracking / curvature + energy_weight * energy
    q = scale * (weighted.T @ effector_violation) / curvature
    row_scale = scale
    C = np.vstack([row_scale[:, None] * W_aa * scale[None, :], np.eye(count)])
    lower = np.concatenate(
        [row_scale * (bounds.shortening_min - actuator_violation), bounds.tension_min / scale]
    )
    upper = np.concatenate(
        [row_scale * (bounds.shortening_max - actuator_violation), bounds.tension_max / scale]
    )
    return BoxedQP(0.5 * (P + P.T), q, C, lower, upper, scale)
