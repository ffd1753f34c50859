"""Quadrature: points in a cell's reference coordinates, and the weight of each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Coordinate of the four points of the rule of degree two.
_FAR = (5.0 - np.sqrt(5.0)) / 20.0
# The rule of degree five: barycentric coordinates with one that differs, its weight; and with two
# pairs (Walkington 2000).
_ONE_DIFFERS = ((0.3108859192633006, 0.1126879257180159), (0.0927352503108912, 0.0734930431163619))
_TWO_PAIRS, _TWO_PAIRS_WEIGHT = 0.0455037041256497, 0.0425460207770815


class Quadrature(NamedTuple):
    """A rule that integrates over a reference cell.

    Attributes:
        points: Reference coordinates, shape (point_count, 3).
        weights: Their sum is the volume of the reference cell, shape (point_count,).
    """

    points: np.ndarray
    weights: np.ndarray


def barycentric_coordinates(points: np.ndarray) -> np.ndarray:
    """All four barycentric coordinates of points of a tetrahedron.

    Args:
        points: Reference coordinates, which are the last three of them, shape (point_count, 3).

    Returns:
        Rows of sum 1, shape (point_count, 4).
    """
    points = np.asarray(points, dtype=float)
    return np.column_stack([1.0 - points.sum(axis=1), points])


def tetrahedron_rule(degree: int) -> Quadrature:
    """A rule on the tetrahedron that is exact for polynomials up to a degree.

    Args:
        degree: 1 (one point), 2 (four points) or up to 5 (fourteen points).

    Returns:
        The smallest rule known here; its weights sum to 1/6.
    """
    if degree <= 1:
        corners, shares = np.full((1, 4), 0.25), np.ones(1)
    elif degree == 2:
        corners, shares = _one_differs(_FAR), np.full(4, 0.25)
    else:
        corners, shares = _fourteen_points()
    return Quadrature(np.ascontiguousarray(corners[:, 1:]), shares / 6.0)


def hexahedron_rule(order: int) -> Quadrature:
    """Gauss's rule on the cube from -1 to 1, exact to degree 2 n - 1 in each coordinate.

    Args:
        order: Points n along each axis.

    Returns:
        n³ points; their weights sum to 8.
    """
    places, shares = np.polynomial.legendre.leggauss(order)
    points = np.stack(np.meshgrid(places, places, places, indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.einsum("i,j,k->ijk", shares, shares, shares).ravel()
    return Quadrature(points, weights)


def _one_differs(coordinate: float) -> np.ndarray:
    """The four points with three equal coordinates, shape (4, 4)."""
    return np.full((4, 4), coordinate) + (1.0 - 4.0 * coordinate) * np.eye(4)


def _fourteen_points() -> tuple[np.ndarray, np.ndarray]:
    rows = [_one_differs(coordinate) for coordinate, _ in _ONE_DIFFERS]
    shares = [np.full(4, share) for _, share in _ONE_DIFFERS]
    first, second = np.triu_indices(4, 1)
    pairs = np.full((6, 4), 0.5 - _TWO_PAIRS)
    pairs[np.arange(6), first] = pairs[np.arange(6), second] = _TWO_PAIRS
    return (
        np.vstack([*rows, pairs]),
        np.concatenate([*shares, np.full(6, _TWO_PAIRS_WEIGHT)]),
    )
