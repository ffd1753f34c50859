"""Points and triangles that are known ahead to meet, as across the notches of a tentacle."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.nearest_feature import closest_weights
from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.vector3 import cross, dot, minus, norm, row


@njit(cache=True, nogil=True, error_model="numpy")
def measure_pairs(x, points, triangles, margin, kept, weights, feet, normals, gaps):
    """Measure every pair; those nearer than the margin are put first, and counted."""
    count = 0
    for pair in range(len(points)):
        p = row(x, points[pair])
        a, b, c = row(x, triangles[pair, 0]), row(x, triangles[pair, 1]), row(x, triangles[pair, 2])
        outward = cross(minus(b, a), minus(c, a))
        doubled_area = norm(outward)
        if not doubled_area > 0.0:
            continue
        w = closest_weights(p, a, b, c)
        for i in range(3):
            weights[count, i] = w[i]
            feet[count, i] = w[0] * a[i] + w[1] * b[i] + w[2] * c[i]
            normals[count, i] = outward[i] / doubled_area
        gap = dot(minus(p, row(feet, count)), row(normals, count))
        if gap < margin:
            kept[count], gaps[count] = pair, gap
            count += 1
    return count


class FixedPairs:
    """Pairs of a point and a triangle of the same body, named in the scene.

    The gap is the height of the point over the triangle's plane along the outward normal, negative
    behind it, however deep: what was named is meant. The point that bears on the triangle is the
    closest one, so that no force lands outside it.
    """

    def __init__(self, point_index: np.ndarray, triangle_points: np.ndarray):
        """Take the pairs.

        Args:
            point_index: Point of each pair, shape (pair_count,).
            triangle_points: Corners of its triangle, outward normal, shape (pair_count, 3).

        Raises:
            MeshError: The shapes do not fit, an index is negative, a triangle names a point twice,
                or a point is a corner of its own triangle.
        """
        points = np.array(point_index, dtype=np.int64).reshape(-1)
        triangles = np.array(triangle_points, dtype=np.int64).reshape(-1, 3)
        if len(points) != len(triangles):
            counts = f"{len(points)} points are paired with {len(triangles)} triangles"
            raise MeshError(None, counts)
        four = np.sort(np.column_stack([points, triangles]), axis=1)
        if four.size and four.min() < 0:
            raise MeshError(None, f"a predefined pair names point {four.min()}")
        twice = np.flatnonzero((np.diff(four, axis=1) == 0).any(axis=1))
        if len(twice):
            raise MeshError(None, f"predefined pair {twice[0]} names a point twice")
        self._points, self._triangles = points, triangles
        self._thrice = np.column_stack([points, points, points])
        self._weights = np.tile([1.0, 0.0, 0.0], (len(points), 1))

    def detect(self, points: np.ndarray, margin: float) -> Proximities:
        """Finds the pairs that are nearer than a margin.

        Args:
            points: Points [m], shape (point_count, 3).
            margin: Largest gap of a pair [m].

        Returns:
            The pairs; the key is a pair's place in the list. A triangle of no area has no normal,
            and its pair is left out.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        room = len(self._points)
        kept, gaps = np.empty(room, dtype=np.int64), np.empty(room)
        weights, feet, normals = np.empty((room, 3)), np.empty((room, 3)), np.empty((room, 3))
        count = measure_pairs(
            points, self._points, self._triangles, float(margin), kept, weights, feet, normals, gaps
        )
        kept = kept[:count]
        return Proximities(
            first_points=self._thrice[kept],
            first_weights=self._weights[kept],
            second_points=self._triangles[kept],
            second_weights=weights[:count],
            first_positions=points[self._points[kept]],
            second_positions=feet[:count],
            normals=normals[:count],
            gaps=gaps[:count],
            keys=kept,
        )
