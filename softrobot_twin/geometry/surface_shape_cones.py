"""Which candidates of a deforming surface against a box lie within the surface's own normal cone.

Where the nearest point of a box lies on an edge or a corner of it, the direction is that from one
point to the other. Beside a flat stretch of the surface it would point along the surface, and hold
back what slides over it: there the box's edge is met by the surface's own edges and triangles, and
not by that vertex. A fold of the surface around the box's edge has no cone; it keeps the direction
as long as it looks that way.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.closed_surface import steepest_descent
from softrobot_twin.geometry.edge_edge import is_outside_cone
from softrobot_twin.geometry.surface_shape_found import KEY_STRIDE, move
from softrobot_twin.geometry.vector3 import cross, dot, minus, plus, row, times, unit

# Sine by which a direction may lie outside the cone.
CONE = 0.02
# Sine of the angle at which the surface around a vertex or an edge counts as a fold.
FOLD = 0.1
# Cosine between the surface's normal and a direction it looks in.
LOOKS_THERE = 0.5
# The same for a way out of the box that does not lead along the surface.
LOOKS_AGAINST = 0.2


@njit(cache=True, nogil=True, error_model="numpy")
def area_normal(x, fans, v):
    """Unit area-weighted normal at a vertex."""
    total, p = (0.0, 0.0, 0.0), row(x, v)
    for k in range(fans[v, 0]):
        a, b = minus(row(x, fans[v, 2 + 3 * k]), p), minus(row(x, fans[v, 3 + 3 * k]), p)
        total = plus(total, cross(a, b), 1.0)
    return unit(total)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def faces_beyond(extents, x, v):
    """How many pairs of a box's faces a vertex lies outside of."""
    count = 0
    for i in range(3):
        count += abs(x[v, i]) > extents[i]
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def faces(x, fans, v, normal, way_out):
    """Whether a vertex looks against a way out: it lies in the vertex's cone, or nearly so."""
    return (
        dot(way_out, normal) <= -LOOKS_AGAINST
        or steepest_descent(x, fans, v, way_out) <= CONE
    )


@njit(cache=True, nogil=True, error_model="numpy")
def turn_inside(extents, x, fans, v, normal, margin, i, found):
    """Give a vertex inside a box the nearest way out that is against the surface's own normal.

    Near an edge of the box the nearest way of all may lead along the surface.
    """
    if faces(x, fans, v, normal, row(found.normals, i)):
        return
    best, axis = margin, -1
    for k in range(3):
        depth = extents[k] - abs(x[v, k])
        out = 1.0 if x[v, k] >= 0.0 else -1.0
        way_out = (out if k == 0 else 0.0, out if k == 1 else 0.0, out if k == 2 else 0.0)
        if depth < best and faces(x, fans, v, normal, way_out):
            best, axis = depth, k
    if axis < 0:
        return
    for k in range(3):
        found.normals[i, k] = 0.0
    found.normals[i, axis] = 1.0 if x[v, axis] >= 0.0 else -1.0
    found.gaps[i] = -best


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_fits(extents, x, fans, v, margin, i, found):
    """Whether the direction at a vertex fits; inside the box it is made to fit."""
    beyond = faces_beyond(extents, x, v)
    if beyond == 1:
        return True
    normal = area_normal(x, fans, v)
    if beyond == 0:
        turn_inside(extents, x, fans, v, normal, margin, i, found)
        return True
    way_out = row(found.normals, i)
    if steepest_descent(x, fans, v, way_out) <= CONE:
        return True
    # A fold rises around the vertex.
    rise = steepest_descent(x, fans, v, times(normal, -1.0))
    return rise > FOLD and dot(way_out, normal) <= -LOOKS_THERE


@njit(cache=True, nogil=True, error_model="numpy")
def edge_fits(x, edges, triangles, e, i, found):
    """Whether the direction at an edge fits."""
    n = row(found.normals, i)
    if max(abs(n[0]), abs(n[1]), abs(n[2])) >= 1.0 - 1.0e-12 or edges[e, 3] < 0:
        return True
    out = times(n, -1.0)
    if not is_outside_cone(x, edges, e, out, CONE):
        return True
    normal, start = (0.0, 0.0, 0.0), row(x, edges[e, 0])
    fold = False
    for side in range(2):
        t = edges[e, 2 + side]
        a = row(x, triangles[t, 0])
        own = unit(cross(minus(row(x, triangles[t, 1]), a), minus(row(x, triangles[t, 2]), a)))
        normal = plus(normal, own, 1.0)
        other = minus(row(x, edges[e, 5 - side]), start)
        height = dot(other, own)
        fold = fold or (height > 0.0 and height * height > FOLD * FOLD * dot(other, other))
    return fold and dot(out, unit(normal)) >= LOOKS_THERE


@njit(cache=True, nogil=True, error_model="numpy")
def keep_fitting(extents, x, fans, edges, triangles, margin, count, found):
    """Keep of the vertices and edges found against a box those whose direction fits.

    Args:
        extents: Half the box's sides [m].
        x: Points of the surface in the box's frame [m].
        fans: See `ClosedSurface`.
        edges: See `ClosedSurface`; -1 where there is no second triangle.
        triangles: The surface.
        margin: Overlap up to which another way out is looked for [m].
        count: Rows found.
        found: The rows; those that are kept move up.

    Returns:
        Number of rows kept.
    """
    kept = 0
    for i in range(count):
        feature = found.keys[i] // KEY_STRIDE
        if feature < len(x):
            fits = vertex_fits(extents, x, fans, feature, margin, i, found)
        else:
            fits = edge_fits(x, edges, triangles, feature - len(x), i, found)
        if not fits:
            continue
        move(found, i, kept)
        kept += 1
    return kept


def edges_with_apexes(
    edges: np.ndarray, sides: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Columns of `ClosedSurface.edges` for a surface that need not be closed.

    Args:
        edges: Point indices, shape (edge_count, 2).
        sides: Triangles on both sides, -1 for none, shape (edge_count, 2).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        Shape (edge_count, 6).
    """
    corners = triangles[sides]
    off = (corners != edges[:, None, :1]) & (corners != edges[:, None, 1:])
    apexes = np.take_along_axis(corners, off.argmax(axis=2)[..., None], axis=2)[..., 0]
    apexes[sides < 0] = -1
    return np.ascontiguousarray(np.hstack([edges, sides, apexes]))
