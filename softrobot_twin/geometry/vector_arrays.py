"""Sums and comparisons of whole arrays, as kernels: what a traced stage does between its terms.

Arguments of the kernels here:
    gathered: Vectors that are written, one for each place.
    left, right: Matrices, shape (row_count, n).
    product: What is written, shape (n, n) or (1,).
    vectors, first, second: Vectors, shape (count, 3).
    differences, sums, copies: Vectors that are written, same shape.
"""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit


@njit(**KERNEL)
def are_same(first, second):
    """Whether two arrays of vectors are equal in all components; NaN never is."""
    if len(first) != len(second):
        return False
    for k in range(len(first)):
        for i in range(3):
            if not first[k, i] == second[k, i]:
                return False
    return True


@njit(**KERNEL)
def write_differences(first, second, differences):
    """Write what each vector differs by."""
    for k in range(len(first)):
        for i in range(3):
            differences[k, i] = first[k, i] - second[k, i]


@njit(**KERNEL)
def add_vectors(vectors, sums):
    """Add vectors to others."""
    for k in range(len(vectors)):
        for i in range(3):
            sums[k, i] += vectors[k, i]


@njit(**KERNEL)
def add_numbers(numbers, sums):
    """Add numbers, shape (count,), to the first of others, shape (count or more,)."""
    for k in range(len(numbers)):
        sums[k] += numbers[k]


@njit(**KERNEL)
def copy_vectors(vectors, copies):
    """Copy vectors."""
    for k in range(len(vectors)):
        for i in range(3):
            copies[k, i] = vectors[k, i]


@njit(**KERNEL)
def gather_vectors(vectors, places, gathered):
    """Copy the vectors at some places, shape (place_count,), to an array of shape (place_count, 3)."""
    for k in range(len(places)):
        for i in range(3):
            gathered[k, i] = vectors[places[k], i]


@njit(**KERNEL)
def multiply_transposed(left, right, product):
    """Write leftᵀ right, shape (n, n), of matrices of shape (row_count, n)."""
    np.dot(left.T, right, product)


@njit(**KERNEL)
def write_product(first, second, product):
    """Write the sum of all products of two arrays of numbers, shape (count,), into one of shape (1,)."""
    product[0] = np.vdot(first, second)


@njit(**KERNEL)
def make_unknown(vectors):
    """Set vectors to NaN: then they are the same as none."""
    for k in range(len(vectors)):
        for i in range(3):
            vectors[k, i] = math.nan
