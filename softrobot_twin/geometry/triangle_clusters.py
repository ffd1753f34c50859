"""Triangles of a surface in clusters of neighbours, so that whole clusters can be ruled out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Triangles in a cluster at most.
CLUSTER_SIZE = 40


class Clusters(NamedTuple):
    """The vertices of each cluster's triangles; clusters share those on their border.

    Attributes:
        vertices: Of one cluster after the other, int64, shape (sum of vertex counts,).
        ends: Where each cluster's vertices end, int64, shape (cluster_count,).
    """

    vertices: np.ndarray
    ends: np.ndarray


def cluster_triangles(points: np.ndarray, triangles: np.ndarray) -> Clusters:
    """Halve a surface across its longest direction until its parts are small.

    Args:
        points: Where its vertices are [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        The clusters; each triangle has all its vertices in one of them.
    """
    centres = points[triangles].mean(axis=1)
    parts, found = [np.arange(len(triangles))], []
    while parts:
        part = parts.pop()
        if len(part) <= CLUSTER_SIZE:
            found.append(np.unique(triangles[part]))
            continue
        axis = np.argmax(np.ptp(centres[part], axis=0))
        order = part[np.argsort(centres[part, axis], kind="stable")]
        parts += np.array_split(order, 2)
    ends = np.cumsum([len(vertices) for vertices in found])
    return Clusters(np.concatenate(found).astype(np.int64), ends.astype(np.int64))
