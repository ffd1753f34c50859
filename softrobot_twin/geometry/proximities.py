"""Pairs of nearest points: what every detector of contacts hands on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


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
