"""The law of contact: Signorini and Coulomb, and bounds of actuators.

    actuator   lower ≤ λ ≤ upper ⊥ δ
    contact    0 ≤ λ_n ⊥ δ_n ≥ 0,  ‖λ_t‖ ≤ µ λ_n,  sliding against the force on the cone's surface

It is stated in three forms. `solve_contact` solves one contact alone with a 3×3 compliance, to
round-off. `law` is explicit: around a centre λ̄ each row gets a stiffness ρ, and the force follows
from the motion,

    actuator    λ = λ̄ - ρ δ within its bounds
    contact     λ_n = max(0, λ̄_n - ρ δ_n)
                λ_t = λ̄_t - ρ δ_t projected onto the disc of radius µ λ_n

Coulomb's cone is exact in it; where λ = λ̄ the compliance has no part, and the law holds without
any compliance. `natural_residual` measures how far forces and motions are from the law.

One contact alone, with the motion q [m] that all other forces cause, is in one of three states:

    open       the gap q_n stays open
    sticking   λ = -W⁻¹ q, if it lies in the cone
    sliding    δ_n = 0 and δ_t = -s λ_t on the cone's surface. Eliminating λ_n leaves
               (S + s) λ_t = -c with S = W_tt - W_tn W_nt / W_nn, c = q_t - W_tn q_n / W_nn,
               and ‖λ_t(s)‖ - µ λ_n(s) falls from positive to negative between s = 0 and ∞:
               a root always exists, and Newton's method between bounds finds it.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit

# Relative excess over the cone that is round-off.
ROUND_OFF = 1.0e-14
# What `measure_contact` writes of each contact, in this order.
NORMAL, SHEAR_1, SHEAR_2, STIFF_1, STIFF_2, COSINE, SINE = range(7)
CONTACT_SIZE = 7
# Least tangential compliance relative to the contact's largest entry: keeps sticking solvable.
_LEAST = 1.0e-13
_MOST_STEPS = 60
_ROUND_OFF = 4.0e-16


@njit(**INNER)
def copy_into(target, source):
    """Copy `source` into `target`, shape (n,) each; see `compilation`."""
    for i in range(len(target)):
        target[i] = source[i]


@njit(**KERNEL)
def admissible(lower, upper, friction, rows_per_contact, force):
    """Bring multipliers into bounds and cones, in place.

    Args:
        lower: Least multiplier of each actuator [N], shape (actuator_count,).
        upper: Greatest multiplier of each actuator [N], same shape.
        friction: Coefficient µ of each contact, shape (contact_count,).
        rows_per_contact: Rows of a contact, 1 or 3.
        force: λ [N], shape (n,); changed.
    """
    first = len(lower)
    for i in range(first):
        force[i] = min(max(force[i], lower[i]), upper[i])
    for k in range(len(friction)):
        n = first + rows_per_contact * k
        force[n] = max(force[n], 0.0)
        if rows_per_contact == 3:
            length = np.hypot(force[n + 1], force[n + 2])
            limit = friction[k] * force[n]
            # Within round-off of the cone counts as on it: admissible forces stay to the bit.
            if length > limit * (1.0 + ROUND_OFF):
                force[n + 1] *= limit / length
                force[n + 2] *= limit / length


@njit(**KERNEL, inline="always")
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


@njit(**KERNEL, inline="always")
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


@njit(**ONCE)
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


@njit(**KERNEL)
def law(delta, centre, stiffness, lower, upper, friction, per_contact, force, slope):
    """Forces by motions, and how they change.

    Args:
        delta: δ of every row [m], shape (n,).
        centre: λ̄ [N], shape (n,).
        stiffness: ρ of every row [N/m], the same for both tangents of a contact, shape (n,).
        lower: Least multiplier of each actuator [N].
        upper: Greatest one [N].
        friction: µ of each contact.
        per_contact: Rows of a contact, 1 or 3.
        force: λ, written, shape (n,).
        slope: -dλ/dδ, written: of a row by itself in column 0. Of a contact with friction, of all
            three rows by the normal in column 0, of both tangents by the first and the second one
            in columns 1 and 2. Shape (n, 3).
    """
    actuators = len(lower)
    slope[:] = 0.0
    for i in range(actuators):
        z = centre[i] - stiffness[i] * delta[i]
        force[i] = min(max(z, lower[i]), upper[i])
        if lower[i] < z < upper[i]:
            slope[i, 0] = stiffness[i]
    for k in range(len(friction)):
        n = actuators + per_contact * k
        z = centre[n] - stiffness[n] * delta[n]
        if not z > 0.0:
            force[n : n + per_contact] = 0.0
            continue
        force[n], slope[n, 0] = z, stiffness[n]
        if per_contact == 3:
            _friction_force(n, friction[k], delta, centre, stiffness, force, slope)


@njit(**ONCE)
def _friction_force(n, friction, delta, centre, stiffness, force, slope):
    """Tangential force of a contact that presses, and its slopes."""
    rho, limit = stiffness[n + 1], friction * force[n]
    z_1, z_2 = centre[n + 1] - rho * delta[n + 1], centre[n + 2] - rho * delta[n + 2]
    length = np.hypot(z_1, z_2)
    if length <= limit:
        force[n + 1], force[n + 2] = z_1, z_2
        slope[n + 1, 1] = slope[n + 2, 2] = rho
        return
    d_1, d_2 = z_1 / length, z_2 / length
    force[n + 1], force[n + 2] = limit * d_1, limit * d_2
    slope[n + 1, 0], slope[n + 2, 0] = friction * slope[n, 0] * d_1, friction * slope[n, 0] * d_2
    turning = rho * limit / length
    slope[n + 1, 1], slope[n + 2, 2] = turning * d_2 * d_2, turning * d_1 * d_1
    slope[n + 1, 2] = slope[n + 2, 1] = -turning * d_1 * d_2


@njit(**KERNEL)
def natural_residual(own, delta, lower, upper, friction, per_contact, force):
    """Largest residual of the natural map, see `ContactSolution`; NaN counts as largest.

    Args:
        own: From `own_compliance` [m/N], shape (n,).
        delta: δ of every row [m], shape (n,).
        lower: See `law`, as are upper, friction and per_contact.
        upper: See lower.
        friction: See lower.
        per_contact: See lower.
        force: λ [N], shape (n,).

    Returns:
        The largest in metres, and in newtons.
    """
    gap = newtons = 0.0
    actuators = len(lower)
    for i in range(actuators):
        w = own[i]
        error = abs(w * force[i] - min(max(w * force[i] - delta[i], w * lower[i]), w * upper[i]))
        if w == 0.0 and lower[i] < upper[i]:
            # No multiplier moves this row: is its motion allowed?
            low, high = force[i] <= lower[i], force[i] >= upper[i]
            error = 0.0 if low and delta[i] >= 0.0 or high and delta[i] <= 0.0 else abs(delta[i])
        gap, newtons = _larger(gap, newtons, error, w)
    for k in range(len(friction)):
        n = actuators + per_contact * k
        gap, newtons = _larger(gap, newtons, abs(min(own[n] * force[n], delta[n])), own[n])
        if per_contact == 3 and own[n + 1] > 0.0:
            w = own[n + 1]
            z_1, z_2 = w * force[n + 1] - delta[n + 1], w * force[n + 2] - delta[n + 2]
            limit, length = friction[k] * w * force[n], np.hypot(z_1, z_2)
            share = limit / length if length > limit else 1.0
            error = np.hypot(w * force[n + 1] - share * z_1, w * force[n + 2] - share * z_2)
            gap, newtons = _larger(gap, newtons, error, w)
    return gap, newtons


@njit(**INNER)
def _larger(gap, newtons, error, w):
    """The larger residuals; NaN counts as largest."""
    if not error <= gap:
        gap = error
    if w > 0.0 and not error / w <= newtons:
        newtons = error / w
    return gap, newtons


@njit(**INNER)
def own_compliance(W, actuators, per_contact):
    """W_ii of every row, for both tangents of a contact their mean [m/N], shape (n,).

    Args:
        W: Compliance [m/N], shape (n, n).
        actuators: Number of actuators, whose rows come first.
        per_contact: Rows of a contact, 1 or 3.
    """
    own = np.empty(len(W))
    for i in range(len(W)):
        own[i] = W[i, i]
    average_tangents(own, actuators, per_contact)
    return own


@njit(**INNER)
def average_tangents(own, actuators, per_contact):
    """Give both tangents of each contact the mean of their own compliances.

    Args:
        own: Compliance of each row by itself [m/N], shape (row_count,); changed.
        actuators: Rows of actuators, before those of contacts.
        per_contact: Rows of a contact, 1 or 3.
    """
    if per_contact == 3:
        for n in range(actuators, len(own), 3):
            own[n + 1] = own[n + 2] = 0.5 * (own[n + 1] + own[n + 2])
