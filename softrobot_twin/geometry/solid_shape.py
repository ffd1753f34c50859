"""Contacts between a rigid triangle surface and a sphere, a capsule or a cylinder.

Neither deforms, so a contact exists only where its direction lies in the normal cones of both
features. Coplanar neighbouring triangles act as one plane (`flat_regions`). Candidates are

- a sphere, an end of a capsule or the rim of a cylinder against a plane of the surface, including
  edges inside the plane,
- convex edges and vertices of the surface against the shape, see `surface_shape`.

Arguments of the kernels here:
    crests: Whether each vertex ends a ridge, shape (vertex_count,).
    extents: Extents of the shape [m], shape (3,).
    p: A point, three numbers [m].
    ridges: Indices of the edges that are ridges, shape (ridge_count,).
    vertices: Points that a triangle uses, ascending, shape (vertex_count,).
Those of a surface are as in `closed_surface`, those of pairs are as in `proximities`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.closed_surface import (
    apply_region_planes,
    closed_surface,
    compute_normals,
    flat_regions,
    is_outside_cone,
    steepest_descent,
)
from softrobot_twin.geometry.closest_features import (
    CORNER,
    EDGE,
    FACE,
    NONE,
    nearest_feature,
    out_of_reach,
    same_plane,
)
from softrobot_twin.geometry.shapes.distance_kernels import CAPSULE, place_frame
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.surface_shape import (
    CAP_STRIDE,
    KEY_STRIDE,
    PARALLEL_FACE,
    SurfaceShapeDetector,
    add_candidate,
    is_far,
    is_past_shape,
    missing_room,
    move_candidate,
    rim_numbers,
    rim_point,
    search_edges,
    search_vertices,
)
from softrobot_twin.geometry.vector3 import dot, row, scaled
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit

# Sine by which a direction may lie outside the cone of an edge or a vertex: for round shapes, which
# roll over it, and for flat caps, which stand on the border of a face.
ROUND_CONE, CAP_CONE = 1.0e-4, 0.02


@njit(**ONCE)
def keep_within_rigid_cones(x, fans, edges, crests, ridges, cone, count, found):
    """Keep the candidates at crests and ridges whose direction lies in the cone of their feature.

    Args:
        x: Points of the surface [m].
        fans: See `ClosedSurface`.
        edges: See `ClosedSurface`.
        crests: Whether each vertex ends a ridge.
        ridges: Indices of the edges that were searched.
        cone: Sine by which a direction may lie outside its cone.
        count: Number of candidates found.
        found: The candidates; those that are kept move to the front.

    Returns:
        Number of candidates kept.
    """
    kept, vertex_count = 0, len(crests)
    for i in range(count):
        feature = found.keys[i] // KEY_STRIDE
        n = row(found.normals, i)
        if feature < vertex_count:
            if not crests[feature] or steepest_descent(x, fans, feature, n) > cone:
                continue
        elif is_outside_cone(x, edges, ridges[feature - vertex_count], scaled(n, -1.0), cone):
            continue
        move_candidate(found, i, kept)
        kept += 1
    return kept


@njit(**INNER)
def _plane_under(p, x, links, edges, fans, normals, t, reach):
    """Nearest feature of triangle t if it is part of a plane of the surface.

    An edge inside a flat region is part of the plane, a convex edge is not.

    Returns:
        As `nearest_feature`; kind NONE if the feature is not part of a plane or beyond `reach`.
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


@njit(**INLINED)
def _face_key(first_key, kind, feature, triangle_count, edge_count, point):
    """Key of the pair of a point of the shape and a feature within a plane."""
    number = feature
    if kind != FACE:
        number += triangle_count
    if kind == CORNER:
        number += edge_count
    return first_key + KEY_STRIDE * number + point


@njit(**ONCE)
def search_ball(p, radius, end, x, links, edges, fans, normals, margin, first_key, found, count):
    """Find the candidates of a ball of the shape against the planes of the surface.

    A centre inside the surface has one candidate: the nearest plane.

    Args:
        p: Centre of the ball [m].
        radius: Its radius [m].
        end: Number of the ball: 0, or 1 for the second end of a capsule.
        x: Points of the surface in the frame of the shape [m].
        links: See `ClosedSurface`.
        edges: See `ClosedSurface`.
        fans: See `ClosedSurface`.
        normals: Normals of the flat regions.
        margin: Gap below which a pair is a candidate [m].
        first_key: First key.
        found: Buffer of candidates.
        count: Number of candidates found before.

    Returns:
        Number of candidates.
    """
    reach = radius + max(margin, radius)
    nearest, nearest_inside = np.inf, -1
    for t in range(len(links)):
        height = dot(p, row(normals, t)) - normals[t, 3]
        corners = (links[t, 0], links[t, 1], links[t, 2])
        if abs(height) > reach or out_of_reach(x, *corners, p, reach):
            continue
        kind, feature, w, _, n, gap = nearest_feature(p, x, links, fans, normals, t, reach)
        if kind == NONE or abs(gap) > reach:
            continue
        if abs(gap) < nearest:
            nearest, nearest_inside = abs(gap), t if gap < 0.0 else -1
        kind = _plane_under(p, x, links, edges, fans, normals, t, reach)[0]
        if kind == NONE or gap < 0.0 or gap - radius >= margin:
            continue
        key = _face_key(first_key, kind, feature, len(links), len(edges), end)
        count = add_candidate(found, count, key, corners, w, gap - radius, scaled(n, -1.0))
    if nearest_inside >= 0:
        t = nearest_inside
        kind, feature, w, _, n, gap = nearest_feature(p, x, links, fans, normals, t, reach)
        key = _face_key(first_key, kind, feature, len(links), len(edges), end)
        corners = (links[t, 0], links[t, 1], links[t, 2])
        count = add_candidate(found, count, key, corners, w, gap - radius, scaled(n, -1.0))
    return count


@njit(**ONCE)
def _search_rim_point(form, p, point, x, links, edges, fans, normals, t, margin, first_key, found, count):
    """Add a point p of the rim of a cylinder against the plane at triangle t, if it is near."""
    reach = max(margin, min(form[1][0], form[1][1]))
    if out_of_reach(x, links[t, 0], links[t, 1], links[t, 2], p, reach):
        return count
    touched, feature, w, foot, n, gap = _plane_under(p, x, links, edges, fans, normals, t, reach)
    if touched == NONE or gap >= margin:
        return count
    # A point below the plane has penetrated only if its foot point is not past the shape.
    if gap < 0.0 and is_past_shape(form, foot, gap):
        return count
    key = _face_key(first_key, touched, feature, len(links), len(edges), point)
    corners = (links[t, 0], links[t, 1], links[t, 2])
    return add_candidate(found, count, key, corners, w, gap, scaled(n, -1.0))


@njit(**ONCE)
def _search_rims(form, x, links, edges, fans, normals, margin, first_key, found, count):
    """Find the rim points nearest to each plane, or points all around a cap parallel to it."""
    extents = form[1]
    radius, half = extents[0], extents[1]
    reach = max(margin, min(radius, half))
    for t in range(len(links)):
        n = row(normals, t)
        across = np.sqrt(n[0] * n[0] + n[1] * n[1])
        # Height of the lowest point of the cylinder above the plane.
        if -normals[t, 3] - radius * across - half * abs(n[2]) > margin:
            continue
        for cap in range(2):
            up = 2.0 * cap - 1.0
            if up * n[2] > PARALLEL_FACE:
                continue
            for i in rim_numbers(across):
                p = rim_point(extents, n, across, up, i)
                if abs(dot(p, n) - normals[t, 3]) <= reach:
                    count = _search_rim_point(
                        form, p, CAP_STRIDE * cap + i, x, links, edges, fans, normals, t,
                        margin, first_key, found, count,
                    )  # fmt: skip
    return count


@njit(**KERNEL)
def _search_solid(
    form, width, frame_origin, frame_axes, origin, rotation, points, vertices, clusters, triangles,
    links, edges, fans, leaders, crests, ridges, ridge_points, ridge_sides, normals,
    reach, placed, x, distances, gradients, found,
):  # fmt: skip
    """Find all candidates of a rigid surface; returns what `missing_room` does."""
    place_frame(frame_origin, frame_axes, origin, rotation, placed)
    kind, extents = form
    margin, capacity = reach[0], len(found.gaps)
    if is_far(form, points, vertices, placed, margin):
        return missing_room(found, 0)
    count = search_vertices(
        form, points, vertices, clusters, placed, x, distances, gradients, margin, found, 0
    )
    first_key = KEY_STRIDE * len(vertices)
    count, _ = search_edges(
        form, width, x, distances, gradients, ridge_points, ridge_sides, triangles, margin, first_key, found, count,
    )  # fmt: skip
    if count > capacity:
        return missing_room(found, count)
    cone = ROUND_CONE if kind == CAPSULE else CAP_CONE
    count = keep_within_rigid_cones(x, fans, edges, crests, ridges, cone, count, found)
    compute_normals(x, links, normals)
    apply_region_planes(leaders, normals)
    first_key += KEY_STRIDE * len(ridges)
    if kind != CAPSULE:
        count = _search_rims(form, x, links, edges, fans, normals, margin, first_key, found, count)
        return missing_room(found, count)
    for end in range(2 if extents[1] > 0.0 else 1):
        p = (0.0, 0.0, extents[1] if end == 0 else -extents[1])
        count = search_ball(
            p, extents[0], end, x, links, edges, fans, normals, margin, first_key, found, count
        )
    return missing_room(found, count)


class SolidShapeDetector(SurfaceShapeDetector):
    """Detects contacts between a rigid triangle surface and a sphere, capsule or cylinder."""

    def __init__(self, triangles: np.ndarray, points: np.ndarray, shape: Shape):
        """Finds the flat regions, convex edges and convex vertices of the surface.

        Args:
            triangles: Point indices, counter-clockwise from outside, shape (triangle_count, 3).
            points: Points of the surface in any body-fixed frame [m], shape (point_count, 3).
            shape: The shape, in the frame of its carrier.

        Raises:
            MeshError: The surface is not closed or not consistently oriented.
        """
        super().__init__(triangles, shape)
        own = np.asarray(points, float)[self._vertices]
        surface = self._surface = closed_surface(self._triangles, len(own))
        regions = self._regions = flat_regions(surface, own)
        self._crests = np.zeros(len(own), dtype=np.bool_)
        self._crests[regions.crests] = True
        self._ridges = np.flatnonzero(regions.ridges)
        self._ridge_points = np.ascontiguousarray(surface.edges[self._ridges, :2])
        self._ridge_sides = np.ascontiguousarray(surface.edges[self._ridges, 2:4])
        self._normals = np.empty((len(surface.links), 4))

    def _search(self, points, origin, rotation, reach) -> int:
        surface = self._surface
        return _search_solid(
            self._form, self.shape.width, *self._frame, origin, rotation, points,
            self._vertices, self.clusters, self._triangles, surface.links, surface.edges,
            surface.fans, self._regions.leaders, self._crests, self._ridges, self._ridge_points,
            self._ridge_sides, self._normals, reach, self._placed, *self._work, self._found,
        )  # fmt: skip
