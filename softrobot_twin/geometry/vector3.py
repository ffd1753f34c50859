"""Algebra of vectors of three numbers, as tuples, for kernels: no array is allocated.

All functions are inlined into the kernel that calls them.

Arguments of the kernels here:
    a, b: Vectors, three numbers.
    x: An array, shape (n, 3).
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit


@njit(**INLINED)
def row(x, i):
    """Row i of an array of shape (n, 3) as a vector."""
    return (x[i, 0], x[i, 1], x[i, 2])


@njit(**INLINED)
def set_row(x, i, a):
    """Write vector a into row i of an array of shape (n, 3)."""
    x[i, 0], x[i, 1], x[i, 2] = a


@njit(**INLINED)
def add(a, b):
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@njit(**INLINED)
def subtract(a, b):
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@njit(**INLINED)
def add_scaled(a, b, factor):
    """a + factor b."""
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


@njit(**INLINED)
def scaled(a, factor):
    """factor a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


@njit(**INLINED)
def divided(a, divisor):
    """a / divisor."""
    return (a[0] / divisor, a[1] / divisor, a[2] / divisor)


@njit(**INLINED)
def negated(a):
    """-a."""
    return (-a[0], -a[1], -a[2])


@njit(**INLINED)
def dot(a, b):
    """a · b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**INLINED)
def cross(a, b):
    """a × b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@njit(**KERNEL, forceinline=True)
def norm(a):
    """‖a‖."""
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@njit(**INLINED)
def unit(a):
    """a/‖a‖, or zero where a is zero."""
    length = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    scale = 1.0 / length if length > 0.0 else 0.0
    return (a[0] * scale, a[1] * scale, a[2] * scale)


@njit(**INLINED)
def is_zero(a):
    """Whether all three numbers are zero."""
    return a[0] == 0.0 and a[1] == 0.0 and a[2] == 0.0


@njit(**INLINED)
def lower(a, b):
    """The smaller of a and b in each coordinate."""
    return (min(a[0], b[0]), min(a[1], b[1]), min(a[2], b[2]))


@njit(**INLINED)
def upper(a, b):
    """The larger of a and b in each coordinate."""
    return (max(a[0], b[0]), max(a[1], b[1]), max(a[2], b[2]))
