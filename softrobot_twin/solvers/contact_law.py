"""Signorini and Coulomb made explicit by a small compliance around a centre.

Around a centre λ̄ each row is given a stiffness ρ. Then its law says the force by the motion:

    actuator    λ = λ̄ - ρ δ within its bounds
    contact     λ_n = max(0, λ̄_n - ρ δ_n),  λ_t = λ̄_t - ρ δ_t brought into the disc of radius µ λ_n

Coulomb's cone is exact. Where λ = λ̄ the compliance has no part, and this is the natural map: the
law without any compliance holds.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.contact_cone import KERNEL


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
            _rub(n, friction[k], delta, centre, stiffness, force, slope)


@njit(**KERNEL)
def _rub(n, friction, delta, centre, stiffness, force, slope):
    """Tangential force of a contact that presses."""
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
    """Residual of the natural map, see `ContactSolution`, from each row's own compliance.

    Args:
        own: W_ii, for both tangents of a contact their mean [m/N], shape (n,).
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
        z = min(max(w * force[i] - delta[i], w * lower[i]), w * upper[i]) if w > 0.0 else 0.0
        error = abs(w * force[i] - z)
        if w == 0.0 and lower[i] < upper[i]:
            # Nothing moves this row: is its motion allowed?
            low, high = force[i] <= lower[i], force[i] >= upper[i]
            error = 0.0 if low and delta[i] >= 0.0 or high and delta[i] <= 0.0 else abs(delta[i])
        gap = max(gap, error)
        newtons = max(newtons, error / w if w > 0.0 else 0.0)
    for k in range(len(friction)):
        n = actuators + per_contact * k
        error = abs(min(own[n] * force[n], delta[n]))
        gap = max(gap, error)
        newtons = max(newtons, error / own[n] if own[n] > 0.0 else 0.0)
        if per_contact == 3 and own[n + 1] > 0.0:
            w = own[n + 1]
            z_1, z_2 = w * force[n + 1] - delta[n + 1], w * force[n + 2] - delta[n + 2]
            limit, length = friction[k] * w * force[n], np.hypot(z_1, z_2)
            share = limit / length if length > limit else 1.0
            error = np.hypot(w * force[n + 1] - share * z_1, w * force[n + 2] - share * z_2)
            gap, newtons = max(gap, error), max(newtons, error / w)
    return gap, newtons
