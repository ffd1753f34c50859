"""Where kernels write the pairs they find."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.geometry.proximities import Proximities


class PairRows(NamedTuple):
    """Work space for pairs.

    Attributes:
        integers: Points of the first, of the second, key, shape (capacity, 7).
        reals: Weights and position of the first, of the second, normal, gap, shape (capacity, 16).
        found: Triangles near a vertex, shape (triangle_capacity,).
    """

    integers: np.ndarray
    reals: np.ndarray
    found: np.ndarray


def empty_rows(capacity: int, triangle_count: int) -> PairRows:
    """Work space for a number of pairs."""
    return PairRows(
        integers=np.empty((capacity, 7), dtype=np.int64),
        reals=np.empty((capacity, 16)),
        found=np.empty(triangle_count, dtype=np.int64),
    )


def proximities(rows: PairRows, count: int) -> Proximities:
    """The first rows, as arrays of their own."""
    integers, reals = rows.integers[:count], rows.reals[:count]
    return Proximities(
        first_points=integers[:, 0:3].copy(),
        first_weights=reals[:, 0:3].copy(),
        second_points=integers[:, 3:6].copy(),
        second_weights=reals[:, 6:9].copy(),
        first_positions=reals[:, 3:6].copy(),
        second_positions=reals[:, 9:12].copy(),
        normals=reals[:, 12:15].copy(),
        gaps=reals[:, 15].copy(),
        keys=integers[:, 6].copy(),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def write_row(integers, reals, i, swap, first, second, normal, gap, key):
    """Write row i if there is room; with `swap`, as seen from the second surface.

    A side is its points, their weights, and the position.
    """
    if i >= len(integers):
        return
    a, b, sign = (second, first, -1.0) if swap else (first, second, 1.0)
    for c in range(3):
        integers[i, c] = a[0][c]
        integers[i, 3 + c] = b[0][c]
        reals[i, c] = a[1][c]
        reals[i, 3 + c] = a[2][c]
        reals[i, 6 + c] = b[1][c]
        reals[i, 9 + c] = b[2][c]
        reals[i, 12 + c] = sign * normal[c]
    reals[i, 15] = gap
    integers[i, 6] = key
