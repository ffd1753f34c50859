"""One contact alone: Signorini and Coulomb with a 3×3 compliance, solved to round-off.

With the motion q [m] that all else brings, the contact's force is one of three:

    none       the gap q_n stays open
    sticking   λ = -W⁻¹ q, if that lies in the cone
    sliding    δ_n = 0 and δ_t = -s λ_t on the cone's surface. Eliminating λ_n leaves
               (S + s) λ_t = -c with S = W_tt - W_tn W_nt / W_nn, c = q_t - W_tn q_n / W_nn,
               and ‖λ_t(s)‖ - µ λ_n(s) falls from positive to negative on the way from s = 0 to ∞:
               a root is always there, found by Newton's method between bounds.
"""

from __future__ import annotations

import numpy as np
from numba import njit

KERNEL = {"cache": True, "nogil": True, "error_model": "numpy"}

# What `measure_contact` writes of each contact, in this order.
NORMAL, SHEAR_1, SHEAR_2, STIFF_1, STIFF_2, COSINE, SINE = range(7)
CONTACT_SIZE = 7
# Least tangential compliance relative to the contact's largest entry: keeps sticking solvable.
_LEAST = 1.0e-13
_MOST_STEPS = 60
_ROUND_OFF = 4.0e-16


@njit(**KERNEL)
def measure_contact(W, first, local):
    """Principal axes of a contact's tangential compliance with the normal eliminated.

    Args:
        W: Compliance [m/N], shape (n, n).
        first: Row of the contact's normal; the tangents follow.
        local: What `solve_contact` needs, written, shape (CONTACT_SIZE,).
    """
    normal = W[first, first]
    a, b = W[first, first + 1], W[first, first + 2]
    inverse = 1.0 / normal if normal > 0.0 else 0.0
    s11 = W[first + 1, first + 1] - a * a * inverse
    s22 = W[first + 2, first + 2] - b * b * inverse
    s12 = W[first + 1, first + 2] - a * b * inverse
    half, mean = 0.5 * (s11 - s22), 0.5 * (s11 + s22)
    radius = np.hypot(half, s12)
    angle = 0.5 * np.arctan2(s12, half)
    cosine, sine = np.cos(angle), np.sin(angle)
    least = _LEAST * max(normal, W[first + 1, first + 1], W[first + 2, first + 2])
    local[NORMAL] = normal
    local[SHEAR_1], local[SHEAR_2] = cosine * a + sine * b, cosine * b - sine * a
    local[STIFF_1], local[STIFF_2] = max(mean + radius, least), max(mean - radius, least)
    local[COSINE], local[SINE] = cosine, sine


@njit(**KERNEL)
def solve_contact(local, friction, q_n, q_1, q_2):
    """Force of one contact.

    Args:
        local: From `measure_contact`, shape (CONTACT_SIZE,).
        friction: µ.
        q_n: Gap without the contact's force [m].
        q_1: First tangential motion without it [m].
        q_2: Second one [m].

    Returns:
        Normal force and the two tangential ones [N].
    """
    normal = local[NORMAL]
    if not q_n < 0.0 or not normal > 0.0:
        return 0.0, 0.0, 0.0
    if friction == 0.0:
        return -q_n / normal, 0.0, 0.0
    cosine, sine, w_1, w_2 = local[COSINE], local[SINE], local[SHEAR_1], local[SHEAR_2]
    c_1 = cosine * q_1 + sine * q_2 - w_1 * q_n / normal
    c_2 = cosine * q_2 - sine * q_1 - w_2 * q_n / normal
    s_1, s_2 = local[STIFF_1], local[STIFF_2]
    f_1, f_2 = -c_1 / s_1, -c_2 / s_2
    f_n = -(q_n + w_1 * f_1 + w_2 * f_2) / normal
    if np.hypot(f_1, f_2) > friction * f_n:
        f_n, f_1, f_2 = _slide(normal, friction, q_n, w_1, w_2, c_1, c_2, s_1, s_2)
    return f_n, cosine * f_1 - sine * f_2, sine * f_1 + cosine * f_2


@njit(**KERNEL)
def _slide(normal, friction, q_n, w_1, w_2, c_1, c_2, s_1, s_2):
    """Force on the cone's surface, tangents along the principal axes."""
    size = np.hypot(c_1, c_2)
    low, high = 0.0, size * (normal / friction + np.hypot(w_1, w_2)) / -q_n
    # With equal compliances and no shear this is the root.
    s = max(size * normal / (friction * -q_n) - 0.5 * (s_1 + s_2), 0.0)
    f_n = f_1 = f_2 = 0.0
    for _ in range(_MOST_STEPS):
        f_1, f_2 = -c_1 / (s_1 + s), -c_2 / (s_2 + s)
        f_n = -(q_n + w_1 * f_1 + w_2 * f_2) / normal
        f_t, limit = np.hypot(f_1, f_2), friction * f_n
        excess = f_t - limit
        if abs(excess) <= _ROUND_OFF * f_t:
            break
        if excess > 0.0:
            low = s
        else:
            high = s
        step_1, step_2 = -f_1 / (s_1 + s), -f_2 / (s_2 + s)
        slope_t = (f_1 * step_1 + f_2 * step_2) / f_t
        slope_limit = -friction * (w_1 * step_1 + w_2 * step_2) / normal
        # 1/‖λ_t‖ is nearly linear in s, as in trust-region methods.
        slope = slope_limit / (limit * limit) - slope_t / (f_t * f_t) if limit > 0.0 else 0.0
        following = s - (1.0 / f_t - 1.0 / limit) / slope if slope > 0.0 else high
        if not low < following < high:
            following = np.sqrt(low * high) if low > 0.0 else 0.1 * high
        if abs(following - s) <= _ROUND_OFF * s:
            break
        s = following
    f_n = max(f_n, 0.0)
    f_t = np.hypot(f_1, f_2)
    ratio = friction * f_n / f_t if f_t > 0.0 else 0.0
    return f_n, ratio * f_1, ratio * f_2
