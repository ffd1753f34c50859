"""Where the kernels that search a surface put what they find."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

# Keys of one feature's candidates run from KEY_STRIDE times the feature's number on.
KEY_STRIDE = 32
# What lengths rule out is ruled out with this factor to spare, for round-off.
SURELY = 1.0 + 1.0e-9


class Found(NamedTuple):
    """Room for candidates. Points are the surface's vertices, vectors are in the shape's frame.

    Attributes:
        points: Vertices of the triangle touched, int64, shape (room, 3).
        weights: Their barycentric weights, shape (room, 3).
        normals: Unit, the way out of the shape, shape (room, 3).
        gaps: Signed distances [m], shape (room,).
        keys: Which feature, and which of its candidates, int64, shape (room,).
    """

    points: np.ndarray
    weights: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    keys: np.ndarray


def make_room(size: int) -> Found:
    """Room for a number of candidates."""
    return Found(
        np.empty((size, 3), np.int64), np.empty((size, 3)), np.empty((size, 3)),
        np.empty(size), np.empty(size, np.int64),
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def put(found, count, key, points, weights, gap, normal):
    """Write a candidate where there is room for it, and count it in any case."""
    if count < len(found.gaps):
        for i in range(3):
            found.points[count, i] = points[i]
            found.weights[count, i] = weights[i]
            found.normals[count, i] = normal[i]
        found.gaps[count] = gap
        found.keys[count] = key
    return count + 1


@njit(cache=True, nogil=True, error_model="numpy")
def move(found, i, to):
    """Move a candidate up to an earlier row."""
    for k in range(3):
        found.points[to, k] = found.points[i, k]
        found.weights[to, k] = found.weights[i, k]
        found.normals[to, k] = found.normals[i, k]
    found.gaps[to], found.keys[to] = found.gaps[i], found.keys[i]
