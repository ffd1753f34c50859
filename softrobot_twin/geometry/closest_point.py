"""The point of a triangle that lies closest to a given point."""

from __future__ import annotations

import numpy as np


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Finds, pair by pair, the closest point of a triangle.

    The closest point is the projection onto the triangle's plane where that falls inside the
    triangle, else the closest of the points found on the three edges.

    Args:
        points: Points [m], shape (pair_count, 3).
        corners: Triangle corners [m], shape (pair_count, 3, 3).

    Returns:
        Weights of the three corners at the closest points, all ≥ 0 with sum 1, shape
        (pair_count, 3).
    """
    pairs = np.arange(len(points))
    edge_weights = np.zeros((3, len(points), 3))
    distances = np.empty((3, len(points)))
    for edge in range(3):
        start, end = corners[:, edge], corners[:, (edge + 1) % 3]
        along = end - start
        fraction = np.einsum("pi,pi->p", points - start, along)
        squared_length = np.einsum("pi,pi->p", along, along)
        fraction /= np.where(squared_length > 0.0, squared_length, 1.0)
        fraction = np.clip(fraction, 0.0, 1.0)
        edge_weights[edge, :, edge] = 1.0 - fraction
        edge_weights[edge, :, (edge + 1) % 3] = fraction
        distances[edge] = np.linalg.norm(points - start - fraction[:, None] * along, axis=1)
    weights = edge_weights[distances.argmin(axis=0), pairs]

    plane_weights, inside = _projections(points, corners)
    weights[inside] = plane_weights[inside]
    return weights


def _projections(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the projections onto the triangles' planes, and which lie inside."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0]
    normal = np.cross(u, v)
    squared_normal = np.einsum("pi,pi->p", normal, normal)
    proper = squared_normal > 0.0
    scale = np.where(proper, squared_normal, 1.0)
    second = np.einsum("pi,pi->p", np.cross(offset, v), normal) / scale
    third = np.einsum("pi,pi->p", np.cross(u, offset), normal) / scale
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    inside = proper & (weights >= 0.0).all(axis=1)
    weights[~inside] = 0.0
    return weights, inside
