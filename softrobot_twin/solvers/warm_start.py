"""Warm start: the optimum of a program from a guess of its active set, with a proof.

A branch of the problem (see `qpcc`) is strictly convex: a point that meets its optimality
conditions is its only optimum, however it was found. Where all contacts of this branch clearly
press or are clearly open, this point is a local minimum of the whole problem; without contacts it
is the global one.

From a guess of the active bounds and of the touching contacts, one system of equations (KKT) gives
the point and its duals: unknowns at a bound are set to it, rows at a bound and closed gaps are
equations. Then *all* optimality conditions are checked. A bound that is exceeded becomes active,
one whose dual has the wrong sign becomes inactive, and the system is solved again. Once the bounds
are settled, a single contact that pulls or penetrates changes its choice, as in single pivoting.
The active set of the last step mostly needs one system. Where no proof is found soon, nothing is
claimed, and the callers use their general solver.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.solvers.small_cholesky import backward, dot_product, factorize, forward

# Active sets that are tried before the caller's general solver is used.
MOST_GUESSES = 6
# A force or a gap below this share of the largest may be zero: two branches meet there.
CLEAR = 1.0e-6
# Largest error of stationarity, in shares of its largest summand.
STATIONARY = 1.0e-12
# Largest error of an equation, in shares of its largest summand.
ROUNDING = 1.0e-13
# Rounds of iterative refinement.
MOST_REFINEMENTS = 5
# A Hessian of unit diagonal with a smaller pivot is not clearly positive definite.
DEFINITE = 1.0e-14
# An equation depends on the others if less than this share of it is independent.
DISTINCT = 1.0e-8


@njit(**KERNEL)
def optimum_from_active_set(P, g, lower, upper, A, row_lower, row_upper, C, d, force_max, touching, active):
    """The optimum of the guessed branch or one near it, with a proof.

    Args:
        P: This and the next nine: see `QPCC`, contiguous.
        g: See there, as to `force_max`.
        lower: See there.
        upper: See there.
        A: See there.
        row_lower: See there.
        row_upper: See there.
        C: See there.
        d: See there.
        force_max: See there.
        touching: Contacts that touch in the guess, shape (contact_count,).
        active: Active bounds in the guess, see `QPCCSolution.active`,
            shape (n - contact_count + m,).

    Returns:
        Whether it is proved; z, shape (n,), and its objective; the contacts that touch and the
        active bounds there; and how many contacts changed.
    """
    n, count = len(g), len(d)
    own, active, touching = n - count, active.copy(), touching.copy()
    z, pivots = np.zeros(n), 0
    _leave_infinite_bounds(lower, upper, active[:own])
    _leave_infinite_bounds(row_lower, row_upper, active[own:])
    for _ in range(MOST_GUESSES):
        free = _set_to_bounds(z, lower, upper, touching, active, own)
        rows, values = _equations(A, row_lower, row_upper, C, d, touching, active[own:])
        duals = np.zeros(len(values))
        if not minimum_under_equations(P, g, free, rows, values, z, duals):
            break
        slopes, is_stationary = _stationarity(P, g, rows, z, duals, free, own)
        changed = _update_unknowns(z, lower, upper, slopes, active[:own])
        changed |= _update_rows(z, A, row_lower, row_upper, duals, active[own:])
        if changed:
            continue
        wrong, contact = _wrong_contacts(z, C, d, force_max, touching)
        if wrong == 0:
            return is_stationary, z, objective_at(P, g, z), touching, active, pivots
        if wrong > 1:
            break
        touching[contact] = not touching[contact]
        pivots += 1
    return False, z, np.nan, touching, active, pivots


@njit(**INNER)
def _leave_infinite_bounds(lower, upper, active):
    """Deactivate bounds that the program of the guess had and this one has not."""
    for i in range(len(active)):
        if np.isinf(lower[i] if active[i] < 0 else upper[i]):
            active[i] = 0


@njit(**ONCE)
def _set_to_bounds(z, lower, upper, touching, active, own):
    """Set unknowns to their active bounds, the others to zero; numbers of the free unknowns."""
    free, k = np.empty(len(z), dtype=np.int64), 0
    for i in range(len(z)):
        z[i] = 0.0
        if i < own and (active[i] != 0 or lower[i] == upper[i]):
            z[i] = lower[i] if active[i] < 0 else upper[i]
        elif i < own or touching[i - own]:
            free[k] = i
            k += 1
    return free[:k]


@njit(**ONCE)
def _equations(A, row_lower, row_upper, C, d, touching, active):
    """Rows that are equations, those of A first, and their right-hand sides."""
    m, n = A.shape
    rows, values, k = np.empty((m + len(C), n)), np.empty(m + len(C)), 0
    for i in range(m):
        if active[i] != 0 or row_lower[i] == row_upper[i]:
            for j in range(n):
                rows[k, j] = A[i, j]
            values[k] = row_lower[i] if active[i] < 0 else row_upper[i]
            k += 1
    for i in range(len(C)):
        if touching[i]:
            for j in range(n):
                rows[k, j] = C[i, j]
            values[k] = -d[i]
            k += 1
    return rows[:k], values[:k]


@njit(**ONCE)
def _stationarity(P, g, rows, z, duals, free, own):
    """Derivative of the Lagrangian by the unknowns besides contact forces, shape (own,); and
    whether it vanishes, to rounding, for all free unknowns."""
    slopes, sizes = np.zeros(len(z)), np.zeros(len(z))
    for i in range(len(z)):
        slopes[i], sizes[i] = g[i], abs(g[i])
        for j in range(len(z)):
            part = P[i, j] * z[j]
            slopes[i] += part
            sizes[i] = max(sizes[i], abs(part))
        for r in range(len(duals)):
            part = rows[r, i] * duals[r]
            slopes[i] += part
            sizes[i] = max(sizes[i], abs(part))
    is_stationary = True
    for i in free:
        is_stationary = is_stationary and abs(slopes[i]) <= STATIONARY * sizes[i]
    return slopes[:own], is_stationary


@njit(**ONCE)
def _update_unknowns(z, lower, upper, slopes, active):
    """Deactivate bounds whose dual has the wrong sign, activate exceeded ones; whether any was."""
    changed = False
    for i in range(len(active)):
        if lower[i] == upper[i]:
            continue
        if not lower[i] < upper[i]:
            # NaN: never proved.
            return True
        elif active[i] != 0:
            if not active[i] * slopes[i] <= 0.0:
                active[i], changed = 0, True
        elif not lower[i] <= z[i] <= upper[i]:
            active[i], changed = -1 if z[i] < lower[i] else 1, True
    return changed


@njit(**ONCE)
def _update_rows(z, A, row_lower, row_upper, duals, active):
    """The same for rows; `duals` are those of the active rows, in their order."""
    changed, k = False, 0
    for i in range(len(A)):
        if row_lower[i] == row_upper[i]:
            k += 1
        elif not row_lower[i] < row_upper[i]:
            return True
        elif active[i] != 0:
            if not active[i] * duals[k] >= 0.0:
                active[i], changed = 0, True
            k += 1
        else:
            value = dot_product(A[i], z)
            if not row_lower[i] <= value <= row_upper[i]:
                active[i], changed = -1 if value < row_lower[i] else 1, True
    return changed


@njit(**ONCE)
def _wrong_contacts(z, C, d, force_max, touching):
    """Number of contacts that are not clearly as their choice says; and one of them.

    A contact that may be at the corner of two branches, or exceeds its limit, counts as two: the
    general solver must judge it.
    """
    first = len(z) - len(d)
    most, widest = 0.0, 0.0
    for k in range(len(d)):
        most, widest = max(most, z[first + k]), max(widest, abs(d[k]))
    wrong, contact = 0, -1
    for k in range(len(d)):
        force, gap = z[first + k], d[k] + dot_product(C[k], z)
        if touching[k] and CLEAR * most < force <= force_max[k]:
            continue
        if not touching[k] and gap > CLEAR * widest:
            continue
        is_beyond = force < -CLEAR * most if touching[k] else gap < -CLEAR * widest
        wrong, contact = wrong + (1 if is_beyond else 2), k
    return wrong, contact


@njit(**KERNEL)
def objective_at(P, g, z):
    """½ zᵀPz + gᵀz.

    Args:
        P: Hessian, shape (n, n).
        g: Gradient at zero, shape (n,).
        z: The unknowns, shape (n,).
    """
    total = 0.0
    for i in range(len(z)):
        if z[i] != 0.0:
            total += z[i] * (0.5 * dot_product(P[i], z) + g[i])
    return total


@njit(**KERNEL, inline="always")
def minimum_under_equations(P, g, free, rows, values, z, duals):
    """Minimum of a strictly convex quadratic under a few equations, met to rounding.

    In whitened unknowns: min ½‖y - y_0‖² with Y y = b, hence y = y_0 - Yᵀ µ; and with Y = L Q, the
    rows of Q orthonormal, y = y_0 - Qᵀ t, µ = L⁻ᵀ t.

    Args:
        P: Hessian, shape (n, n).
        g: Gradient at zero, shape (n,).
        free: Numbers of the free unknowns, shape (f,).
        rows: Equations, shape (k, n).
        values: Their right-hand sides, shape (k,).
        z: The unknowns; free ones are written, shape (n,).
        duals: µ, written, shape (k,).

    Returns:
        False where the Hessian is not clearly definite, or the equations are not clearly
        independent, or not met to rounding.
    """
    f, k = len(free), len(values)
    scale, factor, y = np.empty(f), np.empty((f, f)), np.empty(f)
    for a in range(f):
        i = free[a]
        scale[a] = 1.0 / np.sqrt(P[i, i])
        y[a] = -scale[a] * (g[i] + dot_product(P[i], z))
        for b in range(a + 1):
            factor[a, b] = P[i, free[b]] * scale[a] * scale[b]
    if not factorize(factor, DEFINITE):
        return False
    forward(factor, y)
    Q, L = np.empty((k, f)), np.zeros((k, k))
    for r in range(k):
        for a in range(f):
            Q[r, a] = rows[r, free[a]] * scale[a]
        forward(factor, Q[r])
        length = np.sqrt(dot_product(Q[r], Q[r]))
        # Twice: the remainder may be short and have lost digits.
        for _ in range(2):
            for s in range(r):
                share = dot_product(Q[r], Q[s])
                L[r, s] += share
                for a in range(f):
                    Q[r, a] -= share * Q[s, a]
        L[r, r] = np.sqrt(dot_product(Q[r], Q[r]))
        if not L[r, r] > DISTINCT * length:
            return False
        for a in range(f):
            Q[r, a] /= L[r, r]
    left, step = np.empty(k), np.empty(f)
    for turn in range(MOST_REFINEMENTS):
        for a in range(f):
            step[a] = y[a]
        backward(factor, step)
        for a in range(f):
            z[free[a]] = scale[a] * step[a]
        met = True
        for r in range(k):
            miss, size = -values[r], abs(values[r])
            for i in range(len(z)):
                part = rows[r, i] * z[i]
                miss += part
                size = max(size, abs(part))
            met = met and abs(miss) <= ROUNDING * size
            left[r] = miss
        if met and turn > 0:
            return True
        forward(L, left)
        for r in range(k):
            for a in range(f):
                y[a] -= Q[r, a] * left[r]
        backward(L, left)
        for r in range(k):
            duals[r] += left[r]
    return False
