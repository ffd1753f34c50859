"""Nearest points of a triangle surface and a shape, by local minimal distance.

Every vertex within the margin is given. An edge or a triangle's inside is given where the
distance to the shape has its minimum on it, off its border; features that are parallel give
enough points to carry a moment. See `surface_shape_edges` and `surface_shape_triangles`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import triangle_fans
from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.shapes.distance_kernels import BOX, HALF_SPACE
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.surface_shape_cones import edges_with_apexes, keep_fitting
from softrobot_twin.geometry.surface_shape_edges import search_edges
from softrobot_twin.geometry.surface_shape_found import KEY_STRIDE, make_room
from softrobot_twin.geometry.surface_shape_triangles import search_triangles
from softrobot_twin.geometry.surface_shape_vertices import (
    is_far,
    place_found,
    place_frame,
    search_vertices,
)
from softrobot_twin.geometry.triangle_clusters import Clusters, cluster_triangles


@njit(cache=True, nogil=True, error_model="numpy")
def search_surface(
    kind, extents, frame_origin, frame_axes, origin, rotation, points, vertices, clusters, edges,
    sides, triangles, fans, apexes, margin, placed, x, distances, gradients, found,
):  # fmt: skip
    """Count, and as far as there is room write, all candidates of a surface."""
    place_frame(frame_origin, frame_axes, origin, rotation, placed)
    if is_far(kind, extents, points, vertices, placed, margin):
        return 0
    count = search_vertices(
        kind, extents, points, vertices, clusters, placed, x, distances, gradients, margin, found, 0
    )
    if kind == HALF_SPACE:
        # Its distance is linear: lowest at vertices, and where it is level they are enough.
        return count
    first_key = KEY_STRIDE * len(vertices)
    count, longest = search_edges(
        kind, extents, x, distances, gradients, edges, sides, triangles, margin, first_key,
        found, count,
    )  # fmt: skip
    if len(fans) > 0 and kind == BOX and count <= len(found.gaps):
        count = keep_fitting(extents, x, fans, apexes, triangles, margin, count, found)
    first_key += KEY_STRIDE * len(edges)
    return search_triangles(
        kind, extents, x, distances, gradients, triangles, margin, longest, first_key, found, count
    )


def room_for_shape(count: int) -> Proximities:
    """Room for a number of pairs whose second is a shape: it has no points of its own."""
    return Proximities(
        np.empty((count, 3), np.int64), np.empty((count, 3)), *_no_points(count),
        np.empty((count, 3)), np.empty((count, 3)), np.empty((count, 3)),
        np.empty(count), np.empty(count, np.int64),
    )  # fmt: skip


@lru_cache(maxsize=256)
def _no_points(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of a side that has none; shared, so not to be written."""
    return np.full((count, 3), -1, np.int64), np.zeros((count, 3))


NOTHING = room_for_shape(0)


class SurfaceShapeDetector:
    """Detects where a triangle surface, of a deforming or a rigid body, is near a shape.

    A detector keeps room for its work: use one by one thread at a time.
    """

    def __init__(
        self, triangles: np.ndarray, point_count: int, shape: Shape, deforms: bool = False
    ):
        """Find the surface's vertices and edges.

        Args:
            triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
            point_count: Number of points that will be given.
            shape: The shape, in the frame of its carrier.
            deforms: Whether it is the surface of a deforming body.

        Raises:
            MeshError: There are no triangles, or one names a point that will not be given.
        """
        triangles = np.array(triangles, np.int64)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
            raise MeshError(None, f"triangles have shape {triangles.shape}, not (n, 3) with n > 0")
        if triangles.min() < 0 or triangles.max() >= point_count:
            raise MeshError(
                None,
                f"triangles name points {triangles.min()} to {triangles.max()}, "
                f"but there are {point_count} points",
            )
        self.shape = shape
        self.point_count = point_count
        self._vertices, own = np.unique(triangles, return_inverse=True)
        self._triangles = own.reshape(-1, 3).astype(np.int64)
        self._edges, self._sides = edges_and_sides(self._triangles)
        self._fans, self._apexes = np.empty((0, 1), np.int64), np.empty((0, 6), np.int64)
        if deforms and shape.kind == BOX:
            self._fans = triangle_fans(self._triangles, len(self._vertices))
            self._apexes = edges_with_apexes(self._edges, self._sides, self._triangles)
        # Copies that may be written: for read-only arrays the kernels would be compiled anew.
        self._frame = tuple(np.array(array, float, order="C") for array in shape.frame())
        self._origin, self._rotation = np.empty(3), np.empty((3, 3))
        self._extents = np.array(shape.extents(), float)
        count = len(self._vertices)
        self._placed = np.empty((4, 3))
        self._work = (np.empty((count, 3)), np.empty(count), np.empty((count, 3)))
        self._found = make_room(2 * count + 64)
        self._has_placed = False
        # Neighbours are told by where they are at the first look, and stay neighbours.
        self._clusters: Clusters | None = None

    def detect(
        self, points: np.ndarray, origin: np.ndarray, rotation: np.ndarray, margin: float
    ) -> Proximities:
        """Finds the pairs of nearest points whose gap is below a margin.

        The gap of a vertex is its signed distance. So is that of an edge or a triangle outside
        the shape; in overlap it is the shortest way apart of the features that meet.

        Args:
            points: Points of the surface [m], shape (point_count, 3).
            origin: Origin of the shape's carrier in the world [m], shape (3,).
            rotation: Its axes as columns, shape (3, 3).
            margin: Pairs with a gap below it are given [m].

        Returns:
            The pairs: first the vertices, then the edges, then the triangles, each in the order
            of the surface.

        Raises:
            MeshError: The points are not as many as was said.
        """
        points = np.ascontiguousarray(points, float)
        if not points.flags.writeable:
            points = points.copy()
        if points.shape != (self.point_count, 3):
            raise MeshError(
                None, f"points have shape {points.shape}, not ({self.point_count}, 3)"
            )
        if self._clusters is None:
            self._clusters = cluster_triangles(points[self._vertices], self._triangles)
        self._origin[:], self._rotation[:] = origin, rotation
        count = self._search(points, float(margin))
        if count == 0 and self._has_placed:
            return NOTHING
        # The first time there may be nothing to place: it is compiled then, not at a touch.
        self._has_placed = True
        if count > len(self._found.gaps):
            self._found = make_room(2 * count)
            self._search(points, float(margin))
        found = room_for_shape(count)
        place_found(
            self._found, points, self._vertices, self._placed, found.first_points,
            found.first_weights, found.first_positions, found.second_positions,
            found.normals, found.gaps, found.keys,
        )  # fmt: skip
        return found

    def _search(self, points, margin) -> int:
        return search_surface(
            self.shape.kind, self._extents, *self._frame, self._origin, self._rotation, points,
            self._vertices, self._clusters, self._edges, self._sides, self._triangles,
            self._fans, self._apexes, margin, self._placed, *self._work, self._found,
        )  # fmt: skip


def edges_and_sides(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each edge of a surface once, and the triangles on its sides.

    Args:
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Point indices, lower first, int64, shape (edge_count, 2), and two of the triangles that
        share the edge, -1 where there is but one, int64, shape (edge_count, 2).
    """
    both = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges, index = np.unique(np.sort(both, axis=1), axis=0, return_inverse=True)
    sides = np.full((len(edges), 2), -1, np.int64)
    for place, edge in enumerate(index.ravel()):
        free = np.flatnonzero(sides[edge] < 0)
        if len(free):
            sides[edge, free[0]] = place % len(triangles)
    return edges.astype(np.int64), sides
