"""Pairs of nearest points, the common result of all contact detectors.

Detectors write their pairs into arrays with room for all pairs of a scene. There

    rows: `Proximities` with more rows than there are pairs,
    span: first row that a detector may write, and the row behind its last one, shape (2,). The
        detector writes the second number; where it is beyond the room, it writes no row.
    reach: gap below which pairs are found [m], shape (1,).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import INNER, njit


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


def empty_proximities(capacity: int) -> Proximities:
    """Room for a number of pairs.

    Args:
        capacity: How many pairs there is room for.
    """
    return Proximities(
        np.zeros((capacity, 3), np.int64), np.zeros((capacity, 3)),
        np.zeros((capacity, 3), np.int64), *np.zeros((4, capacity, 3)), np.zeros(capacity),
        np.zeros(capacity, np.int64),
    )  # fmt: skip


def found_by(write: Callable, *places: np.ndarray, margin: float) -> Proximities:
    """The pairs that a detector writes, in arrays of their own.

    Args:
        write: Takes places, reach, rows and span.
        places: Points and poses [m], as `write` takes them.
        margin: Gap below which pairs are found [m].
    """
    reach, span, rows = np.array([float(margin)]), np.zeros(2, np.int64), empty_proximities(0)
    write(*places, reach, rows, span)
    if span[1]:
        rows = empty_proximities(span[1])
        write(*places, reach, rows, span)
    return rows


def put_pairs(near: Proximities, rows: Proximities, span: np.ndarray) -> None:
    """Write pairs that a detector returned.

    Args:
        near: The pairs that were found.
        rows: Room for the pairs of all detectors; written where there is enough of it.
        span: First row of these pairs, and the row after the last, which is written, shape (2,).
    """
    first, end = span[0], span[0] + len(near.gaps)
    span[1] = end
    if end <= len(rows.gaps):
        for part, own in zip(rows, near, strict=True):
            part[first:end] = own


@njit(**INNER)
def write_row(rows, i, swap, first, second, normal, gap, key):
    """Write row i if there is room for it.

    Args:
        rows: See above.
        i: Row.
        swap: Whether `first` belongs to the second surface.
        first: Points, their weights and the position [m] on one surface.
        second: The same on the other surface.
        normal: Unit vector from `second` to `first`, shape (3,).
        gap: Signed distance [m].
        key: Key of the pair.
    """
    if i >= len(rows.gaps):
        return
    a, b, sign = (second, first, -1.0) if swap else (first, second, 1.0)
    for c in range(3):
        rows.first_points[i, c], rows.second_points[i, c] = a[0][c], b[0][c]
        rows.first_weights[i, c], rows.second_weights[i, c] = a[1][c], b[1][c]
        rows.first_positions[i, c], rows.second_positions[i, c] = a[2][c], b[2][c]
        rows.normals[i, c] = sign * normal[c]
    rows.gaps[i], rows.keys[i] = gap, key
