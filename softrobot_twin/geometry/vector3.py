"""Vectors of three numbers as tuples: no array is made inside a kernel."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def row(x, i):
    """Row i of x as a vector."""
    return (x[i, 0], x[i, 1], x[i, 2])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def minus(a, b):
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def plus(a, b, factor):
    """a + factor b."""
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def times(a, factor):
    """factor a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def dot(a, b):
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cross(a, b):
    """a × b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def norm(a):
    """‖a‖."""
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def unit(a):
    """a/‖a‖, or zero where a is zero."""
    length = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    scale = 1.0 / length if length > 0.0 else 0.0
    return (a[0] * scale, a[1] * scale, a[2] * scale)
