"""The least of a strictly convex quadratic under a few equations, met to rounding."""

from __future__ import annotations

import numpy as np
from numba import njit

KERNEL = {"cache": True, "nogil": True, "error_model": "numpy"}

# What an equation may be missed by, in shares of its largest part.
ROUNDING = 1.0e-13
# Rounds that take away what rounding left in those before.
MOST_TURNS = 5
# A Hessian of unit diagonal whose pivots are less is left to others to judge.
DEFINITE = 1.0e-14
# An equation that is a combination of others but for less is left to others to judge.
DISTINCT = 1.0e-8


@njit(**KERNEL)
def least_under_equations(P, g, free, rows, wanted, z, duals):
    """Free unknowns of the least objective that meet the equations.

    In whitened unknowns: min ½‖y - y_0‖² with Y y = b, so y = y_0 - Yᵀ µ; and with Y = L Q, the
    rows of Q orthonormal, y = y_0 - Qᵀ t, µ = L⁻ᵀ t.

    Args:
        P: Hessian, shape (n, n).
        g: Gradient at zero, shape (n,).
        free: Numbers of the free unknowns, shape (f,).
        rows: Equations, shape (k, n).
        wanted: Their values, shape (k,).
        z: The other unknowns; free ones written, shape (n,).
        duals: µ, written, shape (k,).

    Returns:
        False where the Hessian is not clearly definite, or the equations are not clearly
        independent, or not met to rounding.
    """
    f, k = len(free), len(wanted)
    scale, factor, y = np.empty(f), np.empty((f, f)), np.empty(f)
    for a in range(f):
        i = free[a]
        scale[a] = 1.0 / np.sqrt(P[i, i])
        y[a] = -scale[a] * (g[i] + product(P[i], z))
        for b in range(a + 1):
            factor[a, b] = P[i, free[b]] * scale[a] * scale[b]
    if not _factorize(factor):
        return False
    _forward(factor, y)
    Q, L = np.empty((k, f)), np.zeros((k, k))
    for r in range(k):
        for a in range(f):
            Q[r, a] = rows[r, free[a]] * scale[a]
        _forward(factor, Q[r])
        length = np.sqrt(product(Q[r], Q[r]))
        # Twice, for what is left over may be short and have lost digits.
        for _ in range(2):
            for s in range(r):
                share = product(Q[r], Q[s])
                L[r, s] += share
                for a in range(f):
                    Q[r, a] -= share * Q[s, a]
        L[r, r] = np.sqrt(product(Q[r], Q[r]))
        if not L[r, r] > DISTINCT * length:
            return False
        for a in range(f):
            Q[r, a] /= L[r, r]
    left, step = np.empty(k), np.empty(f)
    for turn in range(MOST_TURNS):
        step[:] = y
        _backward(factor, step)
        for a in range(f):
            z[free[a]] = scale[a] * step[a]
        met = True
        for r in range(k):
            miss, size = -wanted[r], abs(wanted[r])
            for i in range(len(z)):
                part = rows[r, i] * z[i]
                miss += part
                size = max(size, abs(part))
            met = met and abs(miss) <= ROUNDING * size
            left[r] = miss
        if met and turn > 0:
            return True
        _forward(L, left)
        for r in range(k):
            for a in range(f):
                y[a] -= Q[r, a] * left[r]
        _backward(L, left)
        for r in range(k):
            duals[r] += left[r]
    return False


@njit(**KERNEL)
def product(a, b):
    """Sum of products."""
    total = 0.0
    for j in range(len(a)):
        total += a[j] * b[j]
    return total


@njit(**KERNEL)
def _factorize(matrix):
    """Lower triangle ← its Cholesky factor; False where it is not clearly positive definite."""
    n = len(matrix)
    for i in range(n):
        for j in range(i):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / matrix[j, j]
        value = matrix[i, i]
        for k in range(i):
            value -= matrix[i, k] * matrix[i, k]
        if not value > DEFINITE:
            return False
        matrix[i, i] = np.sqrt(value)
    return True


@njit(**KERNEL)
def _forward(factor, vector):
    """vector ← L⁻¹ vector."""
    for i in range(len(vector)):
        value = vector[i]
        for j in range(i):
            value -= factor[i, j] * vector[j]
        vector[i] = value / factor[i, i]


@njit(**KERNEL)
def _backward(factor, vector):
    """vector ← L⁻ᵀ vector."""
    for i in range(len(vector) - 1, -1, -1):
        value = vector[i]
        for j in range(i + 1, len(vector)):
            value -= factor[j, i] * vector[j]
        vector[i] = value / factor[i, i]
