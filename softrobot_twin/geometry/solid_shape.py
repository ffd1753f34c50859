"""Nearest points of a rigid triangle surface and a round shape.

Both keep their shape, so contacts are looked for only where both can touch: the direction of each
lies in the normal cone of the surface's feature and in that of the shape's. Flat neighbouring
triangles act as one plane (`flat_regions`):

- a ball, an end of a capsule or the rim of a cylinder against a plane of the surface, seams within
  the plane included,
- edges and vertices that stick out against the shape, see `surface_shape`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.closed_surface import (
    closed_surface,
    compute_normals,
    flat_regions,
    is_outside_cone,
    steepest_descent,
    take_leaders_planes,
)
from softrobot_twin.geometry.closest_features import (
    CORNER,
    EDGE,
    FACE,
    NONE,
    nearest_feature,
    same_plane,
)
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE, place_frame
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.surface_shape import (
    KEY_STRIDE,
    PARALLEL_FACE,
    RIM_POINTS,
    SurfaceShapeDetector,
    has_left_shape,
    is_far,
    move,
    put,
    search_edges,
    search_vertices,
)
from softrobot_twin.geometry.vector3 import dot, row, times

# Sine by which a direction may lie outside the cone of an edge or a vertex. A round shape rolls
# over it; a cap that is parallel to a face stands on its border.
ROUND_CONE, CAP_CONE = 1.0e-4, 0.02


@njit(cache=True, nogil=True, error_model="numpy")
def keep_in_cones(x, fans, edges, ridges, cone, vertex_count, begin, count, found):
    """Keep of the vertices and edges found those whose direction lies in their own cone.

    Args:
        x: Points of the surface [m].
        fans: See `ClosedSurface`.
        edges: See `ClosedSurface`.
        ridges: Indices of the edges that were searched.
        cone: Sine by which a direction may lie outside.
        vertex_count: Number of points: keys of edges begin after theirs.
        begin: First row in question.
        count: Rows found.
        found: The rows; those that are kept move up.

    Returns:
        Number of rows kept.
    """
    kept = begin
    for i in range(begin, count):
        feature = found.keys[i] // KEY_STRIDE
        n = row(found.normals, i)
        if feature < vertex_count:
            if steepest_descent(x, fans, feature, n) > cone:
                continue
        elif is_outside_cone(x, edges, ridges[feature - vertex_count], times(n, -1.0), cone):
            continue
        move(found, i, kept)
        kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def keep_crests(crests, found, count):
    """Keep of the vertices found those that are marked; gives their number."""
    kept = 0
    for i in range(count):
        if crests[found.points[i, 0]]:
            move(found, i, kept)
            kept += 1
    return kept


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def is_beside(x, links, t, p, reach):
    """Whether the box of triangle t is farther than a reach from p along some axis."""
    for i in range(3):
        a, b, c = x[links[t, 0], i], x[links[t, 1], i], x[links[t, 2], i]
        if p[i] < min(a, b, c) - reach or p[i] > max(a, b, c) + reach:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def plane_under(p, x, links, edges, fans, normals, t, reach):
    """The surface's plane at triangle t as the nearest to p thereabouts.

    A seam inside a flat region belongs to the plane; an edge that sticks out does not.

    Returns:
        As `nearest_feature`; kind NONE where the nearest is no plane or beyond the reach.
    """
    kind, feature, w, foot, n, gap = nearest_feature(p, x, links, fans, normals, t, reach)
    if kind == EDGE and not same_plane(normals, edges[feature, 2], edges[feature, 3]):
        kind = NONE
    if kind == CORNER:
        for k in range(fans[feature, 0]):
            if not same_plane(normals, t, fans[feature, 1 + 3 * k]):
                kind = NONE
    if abs(gap) > reach:
        kind = NONE
    return kind, feature, w, foot, n, gap


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def face_key(first_key, kind, feature, triangle_count, edge_count, point):
    """Key of a point of the shape against a feature within a plane."""
    number = feature
    if kind != FACE:
        number += triangle_count
    if kind == CORNER:
        number += edge_count
    return first_key + KEY_STRIDE * number + point


@njit(cache=True, nogil=True, error_model="numpy")
def search_ball(
    p, radius, end, x, links, edges, fans, normals, margin, first_key, found, count
):  # fmt: skip
    """A ball of the shape against the surface's planes; gives the number of candidates.

    A centre that is behind the surface comes out at the nearest plane, and only there.
    """
    reach = radius + max(margin, radius)
    nearest, inmost = np.inf, -1
    for t in range(len(links)):
        height = dot(p, row(normals, t)) - normals[t, 3]
        if abs(height) > reach or is_beside(x, links, t, p, reach):
            continue
        kind, feature, w, _, n, gap = nearest_feature(p, x, links, fans, normals, t, reach)
        if kind == NONE or abs(gap) > reach:
            continue
        if abs(gap) < nearest:
            nearest, inmost = abs(gap), t if gap < 0.0 else -1
        kind = plane_under(p, x, links, edges, fans, normals, t, reach)[0]
        if kind == NONE or gap < 0.0 or gap - radius >= margin:
            continue
        key = face_key(first_key, kind, feature, len(links), len(edges), end)
        corners = (links[t, 0], links[t, 1], links[t, 2])
        count = put(found, count, key, corners, w, gap - radius, times(n, -1.0))
    if inmost >= 0:
        t = inmost
        kind, feature, w, _, n, gap = nearest_feature(p, x, links, fans, normals, t, reach)
        key = face_key(first_key, kind, feature, len(links), len(edges), end)
        corners = (links[t, 0], links[t, 1], links[t, 2])
        count = put(found, count, key, corners, w, gap - radius, times(n, -1.0))
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def search_rim_point(
    kind, extents, p, point, x, links, edges, fans, normals, t, margin, first_key, found, count
):
    """A point of a cylinder's rim against the plane at triangle t."""
    reach = max(margin, min(extents[0], extents[1]))
    if is_beside(x, links, t, p, reach):
        return count
    touched, feature, w, foot, n, gap = plane_under(
        p, x, links, edges, fans, normals, t, reach
    )  # fmt: skip
    if touched == NONE or gap >= margin:
        return count
    # It has run into the surface if its foot has not left the shape on the other side.
    if gap < 0.0 and has_left_shape(kind, extents, foot, gap):
        return count
    key = face_key(first_key, touched, feature, len(links), len(edges), point)
    corners = (links[t, 0], links[t, 1], links[t, 2])
    return put(found, count, key, corners, w, gap, times(n, -1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def search_rims(
    kind, extents, x, links, edges, fans, normals, margin, first_key, found, count
):  # fmt: skip
    """The rims' points nearest to each plane; points all round a cap parallel to it."""
    radius, half = extents[0], extents[1]
    reach = max(margin, min(radius, half))
    for t in range(len(links)):
        n = row(normals, t)
        across = np.sqrt(n[0] * n[0] + n[1] * n[1])
        # Lowest point of the whole cylinder over the plane.
        if -normals[t, 3] - radius * across - half * abs(n[2]) > margin:
            continue
        for cap in range(2):
            up = 2.0 * cap - 1.0
            if up * n[2] > PARALLEL_FACE:
                continue
            if across > PARALLEL_FACE:
                p = (-radius * n[0] / across, -radius * n[1] / across, up * half)
                if abs(dot(p, n) - normals[t, 3]) <= reach:
                    count = search_rim_point(
                        kind, extents, p, 16 * cap, x, links, edges, fans, normals, t, margin,
                        first_key, found, count,
                    )  # fmt: skip
                continue
            for i in range(RIM_POINTS):
                angle = 2.0 * np.pi * i / RIM_POINTS
                p = (radius * np.cos(angle), radius * np.sin(angle), up * half)
                if abs(dot(p, n) - normals[t, 3]) <= reach:
                    count = search_rim_point(
                        kind, extents, p, 16 * cap + 1 + i, x, links, edges, fans, normals, t,
                        margin, first_key, found, count,
                    )  # fmt: skip
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def search_solid(
    kind, extents, frame_origin, frame_axes, origin, rotation, points, vertices, clusters,
    triangles, links, edges, fans, leaders, crests, ridges, ridge_points, ridge_sides, normals,
    margin, placed, x, distances, gradients, found,
):  # fmt: skip
    """Count, and as far as there is room write, all candidates of a rigid surface."""
    place_frame(frame_origin, frame_axes, origin, rotation, placed)
    if is_far(kind, extents, points, vertices, placed, margin):
        return 0
    room = len(found.gaps)
    count = search_vertices(
        kind, extents, points, vertices, clusters, placed, x, distances, gradients, margin, found, 0
    )
    if count > room:
        return count
    count = keep_crests(crests, found, count)
    first_key = KEY_STRIDE * len(vertices)
    count, _ = search_edges(
        kind, extents, x, distances, gradients, ridge_points, ridge_sides, triangles, margin,
        first_key, found, count,
    )  # fmt: skip
    if count > room:
        return count
    cone = ROUND_CONE if kind == CAPSULE else CAP_CONE
    count = keep_in_cones(x, fans, edges, ridges, cone, len(vertices), 0, count, found)
    compute_normals(x, links, normals)
    take_leaders_planes(leaders, normals)
    first_key += KEY_STRIDE * len(ridges)
    if kind != CAPSULE:
        return search_rims(
            kind, extents, x, links, edges, fans, normals, margin, first_key, found, count
        )
    for end in range(2 if extents[1] > 0.0 else 1):
        p = (0.0, 0.0, extents[1] if end == 0 else -extents[1])
        count = search_ball(
            p, extents[0], end, x, links, edges, fans, normals, margin, first_key, found, count
        )
    return count


class SolidShapeDetector(SurfaceShapeDetector):
    """Detects where a rigid triangle surface is near a ball, a capsule or a cylinder."""

    def __init__(self, triangles: np.ndarray, points: np.ndarray, shape: Shape):
        """Find what of the surface can touch.

        Args:
            triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
            points: Points of the surface in any frame that it is rigid in [m], shape
                (point_count, 3).
            shape: The shape, in the frame of its carrier.

        Raises:
            MeshError: The surface is not closed or not consistently oriented.
        """
        super().__init__(triangles, len(points), shape)
        own = np.asarray(points, float)[self._vertices]
        surface = self._surface = closed_surface(self._triangles, len(own))
        regions = self._regions = flat_regions(surface, own)
        self._crests = np.zeros(len(own), dtype=np.bool_)
        self._crests[regions.crests] = True
        self._ridges = np.flatnonzero(regions.ridges)
        self._ridge_points = np.ascontiguousarray(surface.edges[self._ridges, :2])
        self._ridge_sides = np.ascontiguousarray(surface.edges[self._ridges, 2:4])
        self._normals = np.empty((len(surface.links), 4))

    def _search(self, points, margin) -> int:
        surface = self._surface
        return search_solid(
            self.shape.kind, self._extents, *self._frame, self._origin, self._rotation, points,
            self._vertices, self._clusters, self._triangles, surface.links, surface.edges,
            surface.fans, self._regions.leaders, self._crests, self._ridges, self._ridge_points,
            self._ridge_sides, self._normals, margin, self._placed, *self._work, self._found,
        )  # fmt: skip
