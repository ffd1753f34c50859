"""A Newton step of actuators and contacts: their states are fixed, all active rows solved at once.

Robots with few contacts that rub need it between sweeps, and the continuation needs it: without it
the contacts of the Grasper and of the Octoleg take 2.5 times as long.

Sweeps soon find which contacts are open, sticking or sliding, but then converge slowly where W
couples the rows strongly: a stiff object between soft fingers, a taut cable. With known states, a
system of equations remains, with one unknown for each active row:

    actuator off its bounds    δ = 0
    contact that presses       δ_n = 0
    sticking                   δ_t = 0, both directions
    sliding along -d           λ_t = µ λ_n d, and d turns with δ_t: τ·δ_t + s τ·λ_t = 0 with
                               τ ⊥ d, s = ‖δ_t‖ / (µ λ_n)

This is the semi-smooth Newton step of Alart and Curnier 1991 with d eliminated. The states follow
from the natural map. A proximal share of the diagonal makes redundant contacts share their load.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit


PLAIN, TURNING = 0, 1


@njit(**KERNEL)
def active_rows(W, lower, upper, friction, rows_per_contact, force, delta, rows, kinds, frame):
    """Which rows are solved for, by the natural map.

    Args:
        W: Compliance [m/N], shape (n, n).
        lower: Least multiplier of each actuator [N].
        upper: Greatest one [N].
        friction: µ of each contact.
        rows_per_contact: 1 or 3.
        force: λ, shape (n,); rows that are not active go to their bound, sliding ones to the
            cone's surface, as the change `frame[:, 3]`.
        delta: δ, shape (n,).
        rows: Active rows, written, shape (n,).
        kinds: `PLAIN` or `TURNING` of each, written, shape (n,).
        frame: By row: for a normal the direction d and the limit µ; for a turning row its τ and
            s; then the change of force made beforehand; written, shape (n, 4).

    Returns:
        Number of active rows.
    """
    count, actuators = 0, len(lower)
    frame[:] = 0.0
    for i in range(actuators):
        z = force[i] - delta[i] / W[i, i] if W[i, i] > 0.0 else lower[i]
        if lower[i] < z < upper[i]:
            rows[count], kinds[count] = i, PLAIN
            count += 1
        else:
            frame[i, 3] = min(max(z, lower[i]), upper[i]) - force[i]
    for k in range(len(friction)):
        n = actuators + rows_per_contact * k
        z_n = force[n] - delta[n] / W[n, n] if W[n, n] > 0.0 else 0.0
        if not z_n > 0.0:
            for i in range(n, n + rows_per_contact):
                frame[i, 3] = -force[i]
            continue
        rows[count], kinds[count] = n, PLAIN
        count += 1
        if rows_per_contact == 3 and friction[k] > 0.0:
            count = _tangents(
                W, n, friction[k], z_n, force, delta, rows, kinds, frame, count
            )  # fmt: skip
    return count


@njit(**ONCE)
def _tangents(W, n, friction, z_n, force, delta, rows, kinds, frame, count):
    """Active rows of a pressing contact's tangents."""
    w = 0.5 * (W[n + 1, n + 1] + W[n + 2, n + 2])
    if not w > 0.0:
        return count
    z_1, z_2 = force[n + 1] - delta[n + 1] / w, force[n + 2] - delta[n + 2] / w
    length = np.hypot(z_1, z_2)
    limit = friction * (force[n] if force[n] > 0.0 else z_n)
    if length <= limit:
        for i in (n + 1, n + 2):
            rows[count], kinds[count] = i, PLAIN
            count += 1
        return count
    d_1, d_2 = z_1 / length, z_2 / length
    frame[n, 0], frame[n, 1], frame[n, 2] = d_1, d_2, friction
    frame[n + 1, 0], frame[n + 1, 1] = -d_2, d_1
    frame[n + 1, 2] = w * (length - limit) / limit
    excess = d_1 * force[n + 1] + d_2 * force[n + 2] - friction * force[n]
    frame[n + 1, 3], frame[n + 2, 3] = -excess * d_1, -excess * d_2
    rows[count], kinds[count] = n + 1, TURNING
    return count + 1


@njit(**KERNEL)
def fill_system(W, force, delta, rows, kinds, frame, count, proximal, matrix, right):
    """Matrix and right-hand side of the active rows.

    Args:
        W: Compliance [m/N].
        force: λ after the change of force made beforehand.
        delta: δ after the change of force made beforehand.
        rows: From `active_rows`, as are kinds and frame.
        kinds: See rows.
        frame: See rows.
        count: Number of active rows m.
        proximal: Share of each row's own compliance that is added to the diagonal.
        matrix: Written, shape (m, m) at least.
        right: Written, shape (m,) at least.
    """
    fill_right_side(force, delta, rows, kinds, frame, count, right)
    fill_matrix(W, rows, kinds, frame, count, matrix)
    for a in range(count):
        matrix[a, a] += proximal * W[rows[a], rows[a]]


@njit(**INNER)
def fill_matrix(W, rows, kinds, frame, count, matrix):
    """Matrix of the active rows without a share of their compliance.

    Args:
        W, rows, kinds, frame, count: See `fill_system`.
        matrix: Written, shape (count, count) at least.
    """
    for a in range(count):
        i = rows[a]
        if kinds[a] == PLAIN:
            for b in range(count):
                matrix[a, b] = system_entry(W[i], rows[b], kinds[b], frame)
            continue
        t_1, t_2 = frame[i, 0], frame[i, 1]
        for b in range(count):
            first = system_entry(W[i], rows[b], kinds[b], frame)
            second = system_entry(W[i + 1], rows[b], kinds[b], frame)
            matrix[a, b] = t_1 * first + t_2 * second
        matrix[a, a] += frame[i, 2]


@njit(**KERNEL)
def fill_right_side(force, delta, rows, kinds, frame, count, right):
    """Right-hand side of the active rows alone; see `fill_system`.

    Args:
        force: λ after the change of force made beforehand [N], shape (n,).
        delta: δ after that change [m], shape (n,).
        rows: Active rows, shape (count,) or longer.
        kinds: `PLAIN` or `TURNING` of each active row, same shape.
        frame: See `active_rows`, shape (n, 4).
        count: Number of active rows.
        right: Written, shape (count,) or longer.
    """
    for a in range(count):
        i = rows[a]
        if kinds[a] == PLAIN:
            right[a] = -delta[i]
        else:
            t_1, t_2 = frame[i, 0], frame[i, 1]
            along = t_1 * force[i] + t_2 * force[i + 1]
            right[a] = -(t_1 * delta[i] + t_2 * delta[i + 1] + frame[i, 2] * along)


@njit(**INNER)
def system_entry(row, j, kind, frame):
    """Motion of a row by an unknown: its force, with the friction it brings when sliding.

    Args:
        row: Row of W [m/N], shape (n,).
        j: Row of the unknown.
        kind: `PLAIN` or `TURNING`.
        frame: See `active_rows`, shape (n, 4).
    """
    if kind == TURNING:
        return row[j] * frame[j, 0] + row[j + 1] * frame[j, 1]
    if frame[j, 2] != 0.0:
        return row[j] + frame[j, 2] * (row[j + 1] * frame[j, 0] + row[j + 2] * frame[j, 1])
    return row[j]


@njit(**KERNEL)
def solve_system(matrix, right, count):
    """right ← matrix⁻¹ right by elimination with row pivoting; False if it is singular.

    Args:
        matrix: The matrix, in the first `count` rows and columns; overwritten, shape (count, count)
            or larger.
        right: The right-hand side; takes the solution, shape (count,) or longer.
        count: Number of unknowns.
    """
    for k in range(count):
        pivot = k
        for i in range(k + 1, count):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(k, count):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        inverse = 1.0 / matrix[k, k]
        above = matrix[k, k + 1 : count]
        for i in range(k + 1, count):
            factor = matrix[i, k] * inverse
            if factor != 0.0:
                below = matrix[i, k + 1 : count]
                for j in range(len(below)):
                    below[j] -= factor * above[j]
                right[i] -= factor * right[k]
    for k in range(count - 1, -1, -1):
        value = right[k]
        for j in range(k + 1, count):
            value -= matrix[k, j] * right[j]
        right[k] = value / matrix[k, k]
        if not np.isfinite(right[k]):
            return False
    return True


@njit(**KERNEL)
def apply_step(rows, kinds, frame, count, x, force):
    """Add the step x to the multipliers.

    Args:
        rows: Active rows, shape (count,) or longer.
        kinds: `PLAIN` or `TURNING` of each active row, same shape.
        frame: See `active_rows`, shape (n, 4).
        count: Number of active rows.
        x: Change of each unknown [N], shape (count,) or longer.
        force: λ [N], shape (n,); changed.
    """
    for a in range(count):
        i = rows[a]
        if kinds[a] == TURNING:
            force[i] += frame[i, 0] * x[a]
            force[i + 1] += frame[i, 1] * x[a]
        else:
            force[i] += x[a]
            if frame[i, 2] != 0.0:
                force[i + 1] += frame[i, 2] * frame[i, 0] * x[a]
                force[i + 2] += frame[i, 2] * frame[i, 1] * x[a]
