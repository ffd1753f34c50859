"""A local minimum in contact from a guess of the piece and of the bounds that bind, with a proof.

A piece is strictly convex: what meets its conditions of optimality is its one optimum, however it
was found; and where all its contacts press or are open clearly, that is a local minimum. Unknowns
at a bound are put there, rows at a bound and closed gaps become equations, the rest is solved for,
and all conditions are looked at. A bound that is broken then binds, one whose dual has the wrong
sign does not; where that is settled and a single contact pulls or is crossed, it chooses otherwise,
as single pivoting would have it; and it is solved anew. From the last answer's guess once is mostly
enough. Where no proof is found soon, nothing is said: the search of `pivoting` is for that.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.least_under_equations import (
    KERNEL,
    least_under_equations,
    product,
)

# Guesses after which the search is left to others.
MOST_GUESSES = 6
# A force or a gap of a lesser share of the largest may be at the corner of two pieces.
CLEAR = 1.0e-6
# What a slope may be off by, in shares of its largest part.
LEVEL = 1.0e-12


@njit(**KERNEL)
def optimum_by_guess(
    P, g, lower, upper, A, row_lower, row_upper, C, d, force_max, touching, binding
):
    """The optimum of a piece near the guessed one, where it is found and proved soon.

    Args:
        P: This and the next nine: see `ComplementarityProblem`, contiguous.
        g: See there, as to `force_max`.
        lower: See there.
        upper: See there.
        A: See there.
        row_lower: See there.
        row_upper: See there.
        C: See there.
        d: See there.
        force_max: See there.
        touching: Contacts that touch by the guess, shape (contact_count,).
        binding: Bounds that bind by it, of unknowns besides contact forces, then of rows: -1 at
            the lower one, 1 at the upper, 0 at neither, shape (n - contact_count + m,).

    Returns:
        Whether it is proved; z, shape (n,), and its objective; contacts that touch and bounds
        that bind then; and how many contacts changed.
    """
    n, count = len(g), len(d)
    own, binding, touching = n - count, binding.copy(), touching.copy()
    z, pivots = np.zeros(n), 0
    for _ in range(MOST_GUESSES):
        free = _put_at_bounds(z, lower, upper, touching, binding, own)
        rows, wanted = _equations(A, row_lower, row_upper, C, d, touching, binding[own:])
        duals = np.zeros(len(wanted))
        if not least_under_equations(P, g, free, rows, wanted, z, duals):
            break
        slopes, is_level = _slopes(P, g, rows, z, duals, free, own)
        changed = _change_unknowns(z, lower, upper, slopes, binding[:own])
        changed |= _change_rows(z, A, row_lower, row_upper, duals, binding[own:])
        if changed:
            continue
        wrong, contact = _wrong_contacts(z, C, d, force_max, touching)
        if wrong == 0:
            return is_level, z, _objective(P, g, z), touching, binding, pivots
        if wrong > 1:
            break
        touching[contact] = not touching[contact]
        pivots += 1
    return False, z, np.nan, touching, binding, pivots


@njit(**KERNEL)
def _put_at_bounds(z, lower, upper, touching, binding, own):
    """Unknowns at their bounds, in place, the others zero; numbers of those that are free."""
    free, k = np.empty(len(z), dtype=np.int64), 0
    for i in range(len(z)):
        z[i] = 0.0
        if i < own and (binding[i] != 0 or lower[i] == upper[i]):
            z[i] = lower[i] if binding[i] < 0 else upper[i]
        elif i < own or touching[i - own]:
            free[k] = i
            k += 1
    return free[:k]


@njit(**KERNEL)
def _equations(A, row_lower, row_upper, C, d, touching, binding):
    """Rows that are equations, those of A first, and their values."""
    m, n = A.shape
    rows, wanted, k = np.empty((m + len(C), n)), np.empty(m + len(C)), 0
    for i in range(m):
        if binding[i] != 0 or row_lower[i] == row_upper[i]:
            rows[k] = A[i]
            wanted[k] = row_lower[i] if binding[i] < 0 else row_upper[i]
            k += 1
    for i in range(len(C)):
        if touching[i]:
            rows[k], wanted[k] = C[i], -d[i]
            k += 1
    return rows[:k], wanted[:k]


@njit(**KERNEL)
def _slopes(P, g, rows, z, duals, free, own):
    """Slope of the objective with the equations' duals along unknowns besides contact forces,
    shape (own,); and whether it is level along all that is free."""
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
    is_level = True
    for i in free:
        is_level = is_level and abs(slopes[i]) <= LEVEL * sizes[i]
    return slopes[:own], is_level


@njit(**KERNEL)
def _change_unknowns(z, lower, upper, slopes, binding):
    """Let unknowns go that would rather be inside, and stop those that left; whether any did."""
    changed = False
    for i in range(len(binding)):
        if lower[i] == upper[i]:
            continue
        if not lower[i] < upper[i]:
            # No number: never proved.
            return True
        elif binding[i] != 0:
            if not binding[i] * slopes[i] <= 0.0:
                binding[i], changed = 0, True
        elif not lower[i] <= z[i] <= upper[i]:
            binding[i], changed = -1 if z[i] < lower[i] else 1, True
    return changed


@njit(**KERNEL)
def _change_rows(z, A, row_lower, row_upper, duals, binding):
    """The same for rows; duals are those of the rows that bind, in their order."""
    changed, k = False, 0
    for i in range(len(A)):
        if row_lower[i] == row_upper[i]:
            k += 1
        elif not row_lower[i] < row_upper[i]:
            return True
        elif binding[i] != 0:
            if not binding[i] * duals[k] >= 0.0:
                binding[i], changed = 0, True
            k += 1
        else:
            value = product(A[i], z)
            if not row_lower[i] <= value <= row_upper[i]:
                binding[i], changed = -1 if value < row_lower[i] else 1, True
    return changed


@njit(**KERNEL)
def _wrong_contacts(z, C, d, force_max, touching):
    """How many contacts do not press, or are not open, clearly and as far as they may; and one."""
    first = len(z) - len(d)
    most, widest = 0.0, 0.0
    for k in range(len(d)):
        most, widest = max(most, z[first + k]), max(widest, abs(d[k]))
    wrong, contact = 0, -1
    for k in range(len(d)):
        force, gap = z[first + k], d[k] + product(C[k], z)
        if touching[k] and CLEAR * most < force <= force_max[k]:
            continue
        if not touching[k] and gap > CLEAR * widest:
            continue
        # One that is at the corner, or presses too hard, is for the search to judge.
        is_beyond = force < -CLEAR * most if touching[k] else gap < -CLEAR * widest
        wrong, contact = wrong + (1 if is_beyond else 2), k
    return wrong, contact


@njit(**KERNEL)
def _objective(P, g, z):
    """½ zᵀPz + gᵀz."""
    total = 0.0
    for i in range(len(z)):
        if z[i] != 0.0:
            total += z[i] * (0.5 * product(P[i], z) + g[i])
    return total
