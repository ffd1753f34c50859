"""Gauss–Seidel sweeps over actuators and contacts, and the residual of what they found.

The motion δ of all rows is carried along: a block whose force changes adds the change times its
rows of W. So a block that stays as it is, an open contact above all, costs nothing, the inner loop
runs along memory, and the residual after a sweep needs no product with W.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.contact_cone import KERNEL, measure_contact, solve_contact

_SHARING_ROUNDS = 10
ROUND_OFF = 1.0e-14


@njit(**KERNEL)
def measure_contacts(W, actuator_count, friction, local):
    """`measure_contact` of all contacts; local has shape (contact_count, CONTACT_SIZE)."""
    for k in range(len(friction)):
        measure_contact(W, actuator_count + 3 * k, local[k])


@njit(**KERNEL)
def motion(W, violation, force, delta):
    """δ ← W λ + violation, shape (n,)."""
    for i in range(len(delta)):
        delta[i] = violation[i]
    for i in range(len(force)):
        if force[i] != 0.0:
            _add_row(W[i], force[i], delta)


@njit(**KERNEL)
def _add_row(row, factor, delta):
    for j in range(len(delta)):
        delta[j] += row[j] * factor


@njit(**KERNEL)
def _add_three_rows(W, first, a, b, c, delta):
    row_1, row_2, row_3 = W[first], W[first + 1], W[first + 2]
    for j in range(len(delta)):
        delta[j] += row_1[j] * a + row_2[j] * b + row_3[j] * c


@njit(**KERNEL)
def share(W, actuator_count, rows_per_contact, violation, force, delta):
    """Where no contact presses yet, let those that cross push back together, in a few rounds.

    A sweep would give everything to the first of many contacts that do the same. Here all answer
    at once, each by what the pressing ones make together, the Jacobi iteration that converges for
    any W. Force and delta in place.
    """
    for n in range(actuator_count, len(force), rows_per_contact):
        if force[n] != 0.0:
            return
    for _ in range(_SHARING_ROUNDS):
        for n in range(actuator_count, len(force), rows_per_contact):
            if force[n] > 0.0 or delta[n] < 0.0:
                together = 0.0
                for j in range(actuator_count, len(force), rows_per_contact):
                    if force[j] > 0.0 or delta[j] < 0.0:
                        together += abs(W[n, j])
                if together > 0.0:
                    force[n] = max(force[n] - delta[n] / together, 0.0)
        motion(W, violation, force, delta)


@njit(**KERNEL)
def admissible(lower, upper, friction, rows_per_contact, force):
    """Bring multipliers into bounds and cones, in place."""
    first = len(lower)
    for i in range(first):
        force[i] = min(max(force[i], lower[i]), upper[i])
    for k in range(len(friction)):
        n = first + rows_per_contact * k
        force[n] = max(force[n], 0.0)
        if rows_per_contact == 3:
            length = np.hypot(force[n + 1], force[n + 2])
            limit = friction[k] * force[n]
            # What is on the cone but for round-off is on it: so an answer is admissible to the bit.
            if length > limit * (1.0 + ROUND_OFF):
                force[n + 1] *= limit / length
                force[n + 2] *= limit / length


@njit(**KERNEL)
def sweep(W, lower, upper, friction, rows_per_contact, local, force, delta):
    """Solve block after block, each with all others held; force and delta in place."""
    actuators = len(lower)
    for i in range(actuators):
        _solve_single(W, i, lower[i], upper[i], force, delta)
    for k in range(len(friction)):
        if rows_per_contact == 1:
            _solve_single(W, actuators + k, 0.0, np.inf, force, delta)
        else:
            _solve_triple(W, actuators + 3 * k, friction[k], local[k], force, delta)


@njit(**KERNEL)
def _solve_single(W, i, lower, upper, force, delta):
    """A row whose multiplier has bounds."""
    if not W[i, i] > 0.0:
        return
    value = min(max(force[i] - delta[i] / W[i, i], lower), upper)
    if value != force[i]:
        _add_row(W[i], value - force[i], delta)
        force[i] = value


@njit(**KERNEL)
def _solve_triple(W, n, friction, local, force, delta):
    """A contact with friction."""
    f_n, f_1, f_2 = force[n], force[n + 1], force[n + 2]
    if not f_n > 0.0 and delta[n] >= 0.0:
        return
    q_n = delta[n] - (W[n, n] * f_n + W[n, n + 1] * f_1 + W[n, n + 2] * f_2)
    q_1 = delta[n + 1] - (W[n + 1, n] * f_n + W[n + 1, n + 1] * f_1 + W[n + 1, n + 2] * f_2)
    q_2 = delta[n + 2] - (W[n + 2, n] * f_n + W[n + 2, n + 1] * f_1 + W[n + 2, n + 2] * f_2)
    new_n, new_1, new_2 = solve_contact(local, friction, q_n, q_1, q_2)
    _add_three_rows(W, n, new_n - f_n, new_1 - f_1, new_2 - f_2, delta)
    force[n], force[n + 1], force[n + 2] = new_n, new_1, new_2


@njit(**KERNEL)
def residual(W, lower, upper, friction, rows_per_contact, force, delta):
    """Largest residual of the natural map, in metres and in newtons; see `ContactSolution`."""
    largest_gap = largest_force = 0.0
    actuators = len(lower)
    for i in range(actuators):
        w = W[i, i]
        gap = abs(w * force[i] - min(max(w * force[i] - delta[i], w * lower[i]), w * upper[i]))
        if w == 0.0 and lower[i] < upper[i]:  # nothing moves this row: is its motion allowed?
            gap = _at_bounds(force[i], delta[i], lower[i], upper[i])
        largest_gap, largest_force = _larger(largest_gap, largest_force, gap, w)
    for k in range(len(friction)):
        n = actuators + rows_per_contact * k
        gap = abs(min(W[n, n] * force[n], delta[n]))
        largest_gap, largest_force = _larger(largest_gap, largest_force, gap, W[n, n])
        if rows_per_contact == 3:
            w = 0.5 * (W[n + 1, n + 1] + W[n + 2, n + 2])
            z_1, z_2 = w * force[n + 1] - delta[n + 1], w * force[n + 2] - delta[n + 2]
            limit, length = friction[k] * w * force[n], np.hypot(z_1, z_2)
            ratio = limit / length if length > limit else 1.0
            gap = np.hypot(w * force[n + 1] - ratio * z_1, w * force[n + 2] - ratio * z_2)
            largest_gap, largest_force = _larger(largest_gap, largest_force, gap, w)
    return largest_gap, largest_force


@njit(**KERNEL)
def _at_bounds(force, delta, lower, upper):
    """Motion that a row's place between its bounds does not allow [m]."""
    if (force <= lower and delta >= 0.0) or (force >= upper and delta <= 0.0):
        return 0.0
    return abs(delta)


@njit(**KERNEL)
def _larger(largest_gap, largest_force, gap, w):
    """The larger residuals; NaN counts as largest."""
    if not gap <= largest_gap:
        largest_gap = gap
    if w > 0.0 and not gap / w <= largest_force:
        largest_force = gap / w
    return largest_gap, largest_force
