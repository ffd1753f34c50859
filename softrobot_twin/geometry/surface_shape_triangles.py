"""Insides of a surface's triangles against a convex shape.

The signed distance is convex on a triangle. It has a minimum inside the triangle only opposite a
point of the shape's own: a ball's centre, an end of a capsule's axis, the point of a cylinder's
rim or the corner of a box that reaches farthest towards the triangle. Corners and rim points are
measured along the triangle's outward normal, from outside through contact into overlap; all
others by the shape's distance at their projection.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.closest_features import (
    is_nearest_triangle,
    plane_weights,
    triangle_normal,
)
from softrobot_twin.geometry.shapes.distance_kernels import (
    BOX,
    CAPSULE,
    CYLINDER,
    shape_distance,
)
from softrobot_twin.geometry.surface_shape_found import KEY_STRIDE, SURELY, put

# Sine of the angle up to which a triangle counts as parallel to an axis, a cap or a face.
PARALLEL = 0.1
# Weights below this mean a point on an edge, which has its own candidates.
ON_EDGE = 1.0e-6
# Points of a cylinder's rim that stand on a triangle parallel to the cap.
RIM_POINTS = 8
CAP_STRIDE = 16
THROUGH = 31
# Nearer to the axis than this part of the radius there is no way out to tell from others.
ON_AXIS = 1.0e-9
# Distances below this share of a shape's largest extent are round-off.
ROUND_OFF = 1.0e-9


@njit(cache=True, nogil=True, error_model="numpy")
def has_left_shape(kind, extents, foot, height):
    """Whether the foot of a point below a plane lies outside the shape, on its other side.

    Args:
        kind: Kind of the shape.
        extents: Its extents [m].
        foot: Projection of the shape's point onto the plane [m].
        height: Height of the shape's point above the plane [m], negative.
    """
    round_off = ROUND_OFF * max(extents[0], extents[1], extents[2])
    above = shape_distance(kind, extents, foot[0], foot[1], foot[2])[0]
    # Round-off alone would end the contact of a shape that touches the plane exactly.
    return above > round_off - 2.0 * PARALLEL * height


@njit(cache=True, nogil=True, error_model="numpy")
def lies_inside(weights):
    """Whether a projection falls inside a triangle, off its edges."""
    return weights[0] > ON_EDGE and weights[1] > ON_EDGE and weights[2] > ON_EDGE


@njit(cache=True, nogil=True, error_model="numpy")
def beside(x, a, b, c, i, p, n):
    """Whether a projection's coordinate i misses that of a triangle not nearly square to i."""
    if n * n > 0.5:
        return False
    return p < min(x[a, i], x[b, i], x[c, i]) or p > max(x[a, i], x[b, i], x[c, i])


@njit(cache=True, nogil=True, error_model="numpy")
def misses(x, a, b, c, normal, corner, margin):
    """Whether a corner is too high above a triangle's plane, or surely beside the triangle."""
    px, py, pz = corner
    nx, ny, nz = normal
    height = (px - x[a, 0]) * nx + (py - x[a, 1]) * ny + (pz - x[a, 2]) * nz
    return (
        height >= margin
        or beside(x, a, b, c, 2, pz - height * nz, nz)
        or beside(x, a, b, c, 0, px - height * nx, nx)
        or beside(x, a, b, c, 1, py - height * ny, ny)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def against_corner(kind, extents, x, triangles, t, normal, corner, margin, key, found, count):
    """A corner or rim point of the shape that points towards a triangle.

    Behind the triangle it has run into the body if no other triangle is nearer, and if its
    projection has not left the shape on the other side.
    """
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    px, py, pz = corner
    nx, ny, nz = normal
    height = (px - x[a, 0]) * nx + (py - x[a, 1]) * ny + (pz - x[a, 2]) * nz
    if height >= margin:
        return count
    weights = plane_weights(x, a, b, c, px, py, pz)
    if not lies_inside(weights):
        return count
    if height < 0.0:
        foot = (px - height * nx, py - height * ny, pz - height * nz)
        if has_left_shape(kind, extents, foot, height):
            return count
        if not is_nearest_triangle(x, triangles, t, px, py, pz, -height):
            return count
    return put(found, count, key, (a, b, c), weights, height, (-nx, -ny, -nz))


@njit(cache=True, nogil=True, error_model="numpy")
def against_axis_point(kind, extents, x, triangle, normal, z, margin, key, found, count):
    """The triangle's point opposite a point of the axis, at the shape's distance from it."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    weights = plane_weights(x, a, b, c, 0.0, 0.0, z)
    if not lies_inside(weights):
        return count
    nx, ny, nz = normal
    height = (z - x[a, 2]) * nz - x[a, 0] * nx - x[a, 1] * ny
    px, py, pz = -height * nx, -height * ny, z - height * nz
    d, gx, gy, gz = shape_distance(kind, extents, px, py, pz)
    if d >= margin:
        return count
    if abs(height) <= ON_AXIS * extents[0]:
        gx, gy, gz = -nx, -ny, -nz
    return put(found, count, key, (a, b, c), weights, d, (gx, gy, gz))


@njit(cache=True, nogil=True, error_model="numpy")
def pierced_by_axis(kind, extents, x, triangle, normal, margin, key, found, count):
    """Where the axis runs through a triangle deeper than the radius: out to the side."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    nx, ny, nz = normal
    if nz == 0.0:
        return count
    z = x[a, 2] + (x[a, 0] * nx + x[a, 1] * ny) / nz
    radius, half = extents[0], extents[1]
    if not abs(z) < (half if kind == CAPSULE else half - radius):
        return count
    weights = plane_weights(x, a, b, c, 0.0, 0.0, z)
    if -radius >= margin or not lies_inside(weights):
        return count
    # Of all ways out, which are square to the axis, the one most against the outward normal.
    size = np.sqrt(nx * nx + ny * ny)
    across = (-nx / size, -ny / size, 0.0) if size > ON_AXIS else (1.0, 0.0, 0.0)
    return put(found, count, key, (a, b, c), weights, -radius, across)


@njit(cache=True, nogil=True, error_model="numpy")
def search_capsule(extents, x, triangle, normal, margin, key, found, count):
    """The ends of the axis: the nearer one, both where the triangle is parallel to the axis.

    An axis that runs through the triangle's plane is nearest there, not at an end.
    """
    half = extents[1]
    if half == 0.0:
        return against_axis_point(
            CAPSULE, extents, x, triangle, normal, 0.0, margin, key, found, count
        )
    a = triangle[0]
    middle = -(x[a, 0] * normal[0] + x[a, 1] * normal[1] + x[a, 2] * normal[2])
    low, high = middle - half * normal[2], middle + half * normal[2]
    parallel = abs(normal[2]) <= PARALLEL
    one_side = low * high >= 0.0
    if parallel or one_side and abs(low) <= abs(high):
        count = against_axis_point(
            CAPSULE, extents, x, triangle, normal, -half, margin, key, found, count
        )
    if parallel or one_side and abs(high) < abs(low):
        count = against_axis_point(
            CAPSULE, extents, x, triangle, normal, half, margin, key + 1, found, count
        )
    return pierced_by_axis(
        CAPSULE, extents, x, triangle, normal, margin, key + THROUGH, found, count
    )


@njit(cache=True, nogil=True, error_model="numpy")
def search_cylinder(extents, x, triangles, t, normal, margin, key, found, count):
    """The rims' points nearest the triangle; points all round a cap parallel to it."""
    radius, half = extents[0], extents[1]
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    across = np.sqrt(normal[0] ** 2 + normal[1] ** 2)
    for cap in range(2):
        up = 2.0 * cap - 1.0
        if -up * normal[2] < -PARALLEL:
            continue
        k = key + CAP_STRIDE * cap
        if across > PARALLEL:
            rim = (-radius * normal[0] / across, -radius * normal[1] / across, up * half)
            if not misses(x, a, b, c, normal, rim, margin):
                count = against_corner(
                    CYLINDER, extents, x, triangles, t, normal, rim, margin, k, found, count
                )
            continue
        for i in range(RIM_POINTS):
            angle = 2.0 * np.pi * i / RIM_POINTS
            rim = (radius * np.cos(angle), radius * np.sin(angle), up * half)
            if not misses(x, a, b, c, normal, rim, margin):
                count = against_corner(
                    CYLINDER, extents, x, triangles, t, normal, rim, margin, k + 1 + i, found, count
                )
    for i in range(2):
        # The axis is far from most triangles.
        if min(x[a, i], x[b, i], x[c, i]) > 0.0 or max(x[a, i], x[b, i], x[c, i]) < 0.0:
            return count
    return pierced_by_axis(
        CYLINDER, extents, x, triangles[t], normal, margin, key + THROUGH, found, count
    )


@njit(cache=True, nogil=True, error_model="numpy")
def search_box(extents, x, triangles, t, normal, margin, key, found, count):
    """The corner nearest the triangle; more where an edge or a face is parallel to it."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    nx, ny, nz = normal
    offset = nx * x[a, 0] + ny * x[a, 1] + nz * x[a, 2]
    for corner in range(8):
        px = extents[0] if corner & 1 else -extents[0]
        py = extents[1] if corner & 2 else -extents[1]
        pz = extents[2] if corner & 4 else -extents[2]
        if max(
            nx if corner & 1 else -nx, ny if corner & 2 else -ny, nz if corner & 4 else -nz
        ) > PARALLEL:
            continue
        height = px * nx + py * ny + pz * nz - offset
        if (
            height >= margin
            or beside(x, a, b, c, 0, px - height * nx, nx)
            or beside(x, a, b, c, 1, py - height * ny, ny)
            or beside(x, a, b, c, 2, pz - height * nz, nz)
        ):
            continue
        count = against_corner(
            BOX, extents, x, triangles, t, normal, (px, py, pz), margin, key + corner, found, count
        )
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def lower_bound(x, distances, gradients, a, b, c):
    """Lowest distance that a triangle can have, by the tangent at its vertex a."""
    to_b, to_c = 0.0, 0.0
    for j in range(3):
        to_b += gradients[a, j] * (x[b, j] - x[a, j])
        to_c += gradients[a, j] * (x[c, j] - x[a, j])
    return distances[a] + min(0.0, to_b, to_c)


@njit(cache=True, nogil=True, error_model="numpy")
def search_triangles(
    kind, extents, x, distances, gradients, triangles, margin, longest, first_key, found, count
):
    """Candidates inside all triangles, none of whose edges is longer than `longest`."""
    # No point of a triangle is farther from a vertex of it, so its distance is no smaller.
    surely_apart = margin + SURELY * longest
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if max(distances[a], distances[b], distances[c]) > surely_apart:
            continue
        if (
            lower_bound(x, distances, gradients, a, b, c) >= margin
            or lower_bound(x, distances, gradients, b, c, a) >= margin
            or lower_bound(x, distances, gradients, c, a, b) >= margin
        ):
            continue
        normal = triangle_normal(x, a, b, c)
        if normal[0] == 0.0 and normal[1] == 0.0 and normal[2] == 0.0:
            continue
        key = first_key + KEY_STRIDE * t
        if kind == BOX:
            count = search_box(extents, x, triangles, t, normal, margin, key, found, count)
        elif kind == CYLINDER:
            count = search_cylinder(extents, x, triangles, t, normal, margin, key, found, count)
        else:
            count = search_capsule(
                extents, x, triangles[t], normal, margin, key, found, count
            )
    return count
