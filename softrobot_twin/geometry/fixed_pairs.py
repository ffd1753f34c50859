"""Points and triangles that are known ahead to meet, as across the notches of a tentacle."""

from __future__ import annotations

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closest_point import closest_on_triangles
from softrobot_twin.geometry.proximities import Proximities


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
            raise MeshError(None, f"{len(points)} points are paired with {len(triangles)} triangles")
        four = np.sort(np.column_stack([points, triangles]), axis=1)
        if four.size and four.min() < 0:
            raise MeshError(None, f"a predefined pair names point {four.min()}")
        twice = np.flatnonzero((np.diff(four, axis=1) == 0).any(axis=1))
        if len(twice):
            raise MeshError(None, f"predefined pair {twice[0]} names a point twice")
        self._points = np.column_stack([points, points, points])
        self._triangles = triangles
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
        points = np.asarray(points, dtype=np.float64)
        corners = points[self._triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        doubled_areas = np.linalg.norm(normals, axis=1)
        normals /= np.where(doubled_areas > 0.0, doubled_areas, 1.0)[:, None]
        positions = points[self._points[:, 0]]
        weights = closest_on_triangles(positions, corners)
        feet = np.einsum("pc,pci->pi", weights, corners)
        gaps = np.einsum("pi,pi->p", positions - feet, normals)
        kept = np.flatnonzero((gaps < margin) & (doubled_areas > 0.0))
        return Proximities(
            first_points=self._points[kept],
            first_weights=self._weights[kept],
            second_points=self._triangles[kept],
            second_weights=weights[kept],
            first_positions=positions[kept],
            second_positions=feet[kept],
            normals=normals[kept],
            gaps=gaps[kept],
            keys=kept.astype(np.int64),
        )
