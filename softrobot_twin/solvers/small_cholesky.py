"""Cholesky factorization of matrices of a few rows, and products of their rows, within kernels."""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INNER, njit


@njit(**INNER)
def dot_product(a, b):
    """Sum of the products of the numbers of a and b, the first to the last, shape (n,)."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@njit(**INNER)
def factorize(matrix, least):
    """Lower triangle ← its Cholesky factor.

    Args:
        matrix: Symmetric, of which the lower triangle is read and written, shape (n, n).
        least: Least square of a pivot of a matrix that counts as positive definite.

    Returns:
        Whether the matrix is positive definite.
    """
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
        if not value > least:
            return False
        matrix[i, i] = np.sqrt(value)
    return True


@njit(**INNER)
def forward(factor, vector):
    """vector ← L⁻¹ vector; L in the lower triangle of `factor`, shape (n, n); vector, shape (n,)."""
    for i in range(len(vector)):
        value = vector[i]
        for j in range(i):
            value -= factor[i, j] * vector[j]
        vector[i] = value / factor[i, i]


@njit(**INNER)
def backward(factor, vector):
    """vector ← L⁻ᵀ vector, shape (n,); L in the lower triangle of `factor`, shape (n, n)."""
    for i in range(len(vector) - 1, -1, -1):
        value = vector[i]
        for j in range(i + 1, len(vector)):
            value -= factor[j, i] * vector[j]
        vector[i] = value / factor[i, i]
