"""The feature of a triangle, face, edge or corner, that is nearest to a point."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.closed_surface import (
    ACROSS,
    EDGES,
    FAR_CORNERS,
    FIRST_AT,
    edge_normal,
    vertex_normal,
)
from softrobot_twin.geometry.vector3 import dot, minus, norm, plus, row, times

# A barycentric weight below this is none: the point lies on the opposite edge.
NO_WEIGHT = 1.0e-9
# What a feature's neighbours may claim before it is not the nearest; above NO_WEIGHT, so that a
# point over the seam of two features belongs to one at least.
_NEIGHBOUR_CLAIM = 1.0e-8
# Closer than this [m] the difference of two points has no direction.
NO_DISTANCE = 1.0e-9

# A hair more than 1, so that round-off decides nothing.
ROUND_OFF = 1.000001

FACE, EDGE, CORNER, NONE = 0, 1, 2, 3


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def closest_weights(p, a, b, c):
    """Weights of the corners at the point of triangle abc that is closest to p.

    The regions are told apart as in Ericson, Real-Time Collision Detection (2005), 5.1.5.
    """
    ab, ac, ap = minus(b, a), minus(c, a), minus(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return (1.0, 0.0, 0.0)
    bp = minus(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return (0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return (1.0 - t, t, 0.0)
    cp = minus(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return (0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return (1.0 - t, 0.0, t)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (0.0, 1.0 - t, t)
    scale = 1.0 / (va + vb + vc)
    return (1.0 - (vb + vc) * scale, vb * scale, vc * scale)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def without_round_off(w):
    """The weights with those that are none set to zero, and how many are left."""
    a = w[0] if w[0] > NO_WEIGHT else 0.0
    b = w[1] if w[1] > NO_WEIGHT else 0.0
    c = w[2] if w[2] > NO_WEIGHT else 0.0
    scale = 1.0 / (a + b + c)
    left = (1 if a > 0.0 else 0) + (1 if b > 0.0 else 0) + (1 if c > 0.0 else 0)
    return (a * scale, b * scale, c * scale), left


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def claims(start, along, corner, foot, away):
    """Whether the triangle from an edge to a corner comes nearer than the edge's point `foot`."""
    into = minus(corner, start)
    into = plus(into, along, -dot(into, along) / dot(along, along))
    return dot(away, into) > _NEIGHBOUR_CLAIM * dot(into, into)


@njit(cache=True, nogil=True, error_model="numpy")
def corner_is_nearest(x, fans, v, away):
    """Whether nothing around vertex v comes nearer than the vertex does."""
    p = row(x, v)
    for k in range(fans[v, 0]):
        into = minus(row(x, fans[v, 2 + 3 * k]), p)
        if dot(away, into) > _NEIGHBOUR_CLAIM * dot(into, into):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def direction_and_gap(away, outward):
    """Unit normal and signed distance from a feature whose outward direction is known."""
    distance = norm(away)
    if distance <= NO_DISTANCE:
        return outward, dot(away, outward)
    if dot(away, outward) >= 0.0:
        return times(away, 1.0 / distance), distance
    return times(away, -1.0 / distance), -distance


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def same_plane(normals, t, s):
    """Whether two triangles have one and the same normal, as those of a flat region do."""
    return (
        normals[t, 0] == normals[s, 0]
        and normals[t, 1] == normals[s, 1]
        and normals[t, 2] == normals[s, 2]
    )


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_feature(p, x, links, fans, normals, t, reach):
    """The feature of triangle t that is the surface's nearest thereabouts to p.

    An edge or a corner is given by the first triangle at it only, and only where none of the
    others comes nearer: so each is found once, and where the distance has a local minimum.

    Args:
        p: Point [m].
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        fans: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        t: Triangle.
        reach: Distance beyond which nothing is found [m].

    Returns:
        Kind (FACE, EDGE, CORNER or NONE), index of the triangle, edge or point, weights of the
        triangle's corners, foot point [m], unit normal (outwards), signed distance [m].
    """
    a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
    n = row(normals, t)
    nothing = (NONE, -1, (0.0, 0.0, 0.0), a, n, np.inf)
    if n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0:
        return nothing
    w, left = without_round_off(closest_weights(p, a, b, c))
    if left == 3:
        height = dot(minus(p, a), n)
        return (FACE, t, w, plus(p, n, -height), n, height)
    foot = plus(plus(times(a, w[0]), b, w[1]), c, w[2])
    away = minus(p, foot)
    if dot(away, away) > reach * reach:
        return nothing
    if left == 2:
        i = 1 if w[0] == 0.0 else (2 if w[1] == 0.0 else 0)
        other = links[t, ACROSS + i]
        start, corner = row(x, links[t, i]), row(x, links[t, (i + 2) % 3])
        along = minus(row(x, links[t, (i + 1) % 3]), start)
        if (
            other < t
            or claims(start, along, corner, foot, away)
            or claims(start, along, row(x, links[t, FAR_CORNERS + i]), foot, away)
        ):
            return nothing
        if same_plane(normals, t, other):
            return (EDGE, links[t, EDGES + i], w, foot, n, dot(away, n))
        normal, gap = direction_and_gap(away, edge_normal(normals, t, other))
        return (EDGE, links[t, EDGES + i], w, foot, normal, gap)
    i = 0 if w[0] > 0.0 else (1 if w[1] > 0.0 else 2)
    v = links[t, i]
    if not links[t, FIRST_AT + i] or not corner_is_nearest(x, fans, v, away):
        return nothing
    flat = True
    for k in range(fans[v, 0]):
        flat = flat and same_plane(normals, t, fans[v, 1 + 3 * k])
    if flat:
        return (CORNER, v, w, foot, n, dot(away, n))
    normal, gap = direction_and_gap(away, vertex_normal(x, fans, normals, v))
    return (CORNER, v, w, foot, normal, gap)
