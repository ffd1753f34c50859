"""Pairs of nearest points, the common result of all contact detectors, and their buffer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

class Proximities(NamedTuple):
    """Nearest points of two things that are near each other, one row a contact candidate.

    Attributes:
        first_points: Vertices of the first surface's triangle that holds the nearest point,
            shape (count, 3); repeated where a weight is zero.
        first_weights: Their barycentric weights, shape (count, 3).
        second_points: Same for the second surface; all -1 where the second is a shape,
            shape (count, 3).
        second_weights: Their barycentric weights, shape (count, 3).
        first_positions: Nearest point on the first [m], shape (count, 3).
        second_positions: Nearest point on the second [m], shape (count, 3).
        normals: Unit, from the second to the first (the direction in which the first must move
            to come free), shape (count, 3).
        gaps: Signed distance [m], negative where they overlap, shape (count,).
        keys: The same number for the same pair of features from step to step, int64,
            shape (count,).
    """

    first_points: np.ndarray
    first_weights: np.ndarray
    second_points: np.ndarray
    second_weights: np.ndarray
    first_positions: np.ndarray
    second_positions: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    keys: np.ndarray


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
