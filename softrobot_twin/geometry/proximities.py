"""Pairs of nearest points, the common result of all contact detectors, and their buffer."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import INNER, njit


class Proximities(NamedTuple):
    """Nearest points of two bodies that are near each other; each row is a contact candidate.

    Attributes:
        first_points: Corners of the triangle of the first surface that holds the nearest point,
            shape (count, 3); one of them is repeated where a weight is zero.
        first_weights: Their barycentric weights, shape (count, 3).
        second_points: The same for the second surface; -1 if the second is a shape, shape
            (count, 3).
        second_weights: Their barycentric weights, shape (count, 3).
        first_positions: Nearest point on the first [m], shape (count, 3).
        second_positions: Nearest point on the second [m], shape (count, 3).
        normals: Unit vectors from the second to the first, along which the first must move to
            separate, shape (count, 3).
        gaps: Signed distance [m], negative in overlap, shape (count,).
        keys: Number that identifies the pair of features from step to step, int64, shape
            (count,).
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
    """Buffer into which kernels write pairs.

    Attributes:
        integers: Points of the first, of the second, key, shape (capacity, 7).
        reals: Weights and position of the first, of the second, normal, gap, shape (capacity, 16).
        found: Triangles near a vertex, shape (triangle_capacity,).
    """

    integers: np.ndarray
    reals: np.ndarray
    found: np.ndarray


def empty_rows(capacity: int, triangle_count: int) -> PairRows:
    """Allocates a buffer for a number of pairs."""
    return PairRows(
        integers=np.empty((capacity, 7), dtype=np.int64),
        reals=np.empty((capacity, 16)),
        found=np.empty(triangle_count, dtype=np.int64),
    )


def proximities(rows: PairRows, count: int) -> Proximities:
    """Copies the first rows of a buffer."""
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


@njit(**INNER)
def write_row(integers, reals, i, swap, first, second, normal, gap, key):
    """Write row i if the buffer has that many rows.

    Args:
        integers: See `PairRows`, shape (capacity, 7).
        reals: See `PairRows`, shape (capacity, 16).
        i: Row.
        swap: Whether `first` belongs to the second surface.
        first: Points, their weights and the position [m] on one surface.
        second: The same on the other surface.
        normal: Unit vector from `second` to `first`.
        gap: Signed distance [m].
        key: Key of the pair.
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
