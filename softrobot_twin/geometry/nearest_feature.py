"""The feature of a triangle, face, edge or corner, that is nearest to a point; and clear ways."""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.closed_surface import edge_in_triangle, edge_normal, vertex_normal
from softrobot_twin.geometry.vector3 import cross, dot, minus, norm, plus, row, times

# A barycentric weight below this is none: the point lies on the opposite edge.
_NO_WEIGHT = 1.0e-9
# What a feature's neighbours may claim before it is not the nearest; above _NO_WEIGHT, so that a
# point over the seam of two features belongs to one at least.
_NEIGHBOUR_CLAIM = 1.0e-8
# Closer than this [m] the difference of two points has no direction.
_NO_DISTANCE = 1.0e-9

FACE, EDGE, CORNER, NONE = 0, 1, 2, 3


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def without_round_off(w):
    """The weights with those that are none set to zero, and how many are left."""
    a = w[0] if w[0] > _NO_WEIGHT else 0.0
    b = w[1] if w[1] > _NO_WEIGHT else 0.0
    c = w[2] if w[2] > _NO_WEIGHT else 0.0
    scale = 1.0 / (a + b + c)
    left = (1 if a > 0.0 else 0) + (1 if b > 0.0 else 0) + (1 if c > 0.0 else 0)
    return (a * scale, b * scale, c * scale), left


@njit(cache=True, nogil=True, error_model="numpy")
def edge_is_nearest(x, surface, e, foot, away):
    """Whether neither triangle at edge e comes nearer than the edge's point `foot` does."""
    along = minus(row(x, surface.edges[e, 1]), row(x, surface.edges[e, 0]))
    squared = dot(along, along)
    for side in range(2):
        into = minus(row(x, surface.edge_apexes[e, side]), foot)
        into = plus(into, along, -dot(into, along) / squared)
        if dot(away, into) > _NEIGHBOUR_CLAIM * dot(into, into):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def corner_is_nearest(x, surface, v, away):
    """Whether nothing around vertex v comes nearer than the vertex does."""
    p = row(x, v)
    for k in range(surface.ring_offsets[v], surface.ring_offsets[v + 1]):
        c = (surface.ring_corners[k] + 1) % 3
        into = minus(row(x, surface.triangles[surface.ring[k], c]), p)
        if dot(away, into) > _NEIGHBOUR_CLAIM * dot(into, into):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def direction_and_gap(away, outward):
    """Unit normal and signed distance from a feature whose outward direction is known."""
    distance = norm(away)
    if distance <= _NO_DISTANCE:
        return outward, dot(away, outward)
    if dot(away, outward) >= 0.0:
        return times(away, 1.0 / distance), distance
    return times(away, -1.0 / distance), -distance


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_feature(p, x, surface, normals, t, reach):
    """The feature of triangle t that is the surface's nearest thereabouts to p.

    An edge or a corner is given by the first triangle at it only, and only where none of the
    others comes nearer: so each is found once, and where the distance has a local minimum.

    Args:
        p: Point [m].
        x: Points of the surface [m].
        surface: The surface.
        normals: Its unit normals.
        t: Triangle.
        reach: Distance beyond which nothing is found [m].

    Returns:
        Kind (FACE, EDGE, CORNER or NONE), index of the triangle, edge or point, weights of the
        triangle's corners, foot point [m], unit normal (outwards), signed distance [m].
    """
    i, j, k = surface.triangles[t, 0], surface.triangles[t, 1], surface.triangles[t, 2]
    a, b, c = row(x, i), row(x, j), row(x, k)
    n = row(normals, t)
    nothing = (NONE, -1, (0.0, 0.0, 0.0), a, n, np.inf)
    height = dot(minus(p, a), n)
    if abs(height) > reach or (n[0] == 0.0 and n[1] == 0.0 and n[2] == 0.0):
        return nothing
    w, left = without_round_off(closest_weights(p, a, b, c))
    foot = plus(plus(times(a, w[0]), b, w[1]), c, w[2])
    if left == 3:
        return (FACE, t, w, foot, n, height)
    away = minus(p, foot)
    if dot(away, away) > reach * reach:
        return nothing
    if left == 2:
        start = i if w[0] > 0.0 else j
        end = k if w[2] > 0.0 else j
        e = edge_in_triangle(surface, t, start, end)
        if surface.edge_triangles[e, 0] != t or not edge_is_nearest(x, surface, e, foot, away):
            return nothing
        normal, gap = direction_and_gap(away, edge_normal(surface, normals, e))
        return (EDGE, e, w, foot, normal, gap)
    v = i if w[0] > 0.0 else (j if w[1] > 0.0 else k)
    if surface.ring[surface.ring_offsets[v]] != t or not corner_is_nearest(x, surface, v, away):
        return nothing
    normal, gap = direction_and_gap(away, vertex_normal(x, surface, normals, v))
    return (CORNER, v, w, foot, normal, gap)


@njit(cache=True, nogil=True, error_model="numpy")
def crosses(start, way, a, b, c):
    """Whether the open stretch from `start` along `way` goes through triangle abc."""
    ab, ac = minus(b, a), minus(c, a)
    q = cross(way, ac)
    determinant = dot(ab, q)
    if determinant == 0.0:
        return False
    scale = 1.0 / determinant
    s = minus(start, a)
    u = dot(s, q) * scale
    r = cross(s, ab)
    v = dot(way, r) * scale
    if u < -_NO_WEIGHT or v < -_NO_WEIGHT or u + v > 1.0 + _NO_WEIGHT:
        return False
    fraction = dot(ac, r) * scale
    return 1.0e-6 < fraction < 1.0 - 1.0e-6


@njit(cache=True, nogil=True, error_model="numpy")
def way_is_clear(x, surface, items, first, last, start, end):
    """Whether none of some triangles lies between two points.

    A point behind a triangle is inside the body only if the way there from the triangle meets no
    other triangle: else it has come out on another side.

    Args:
        x: Points of the surface [m].
        surface: The surface.
        items: Triangles that may lie there, from place `first` to before `last`.
        first: See items.
        last: See items.
        start: Point on the surface [m]; triangles that touch it there do not count.
        end: Other point [m]; neither do those that touch it.
    """
    way = minus(end, start)
    for k in range(first, last):
        corners = surface.triangles[items[k]]
        if crosses(start, way, row(x, corners[0]), row(x, corners[1]), row(x, corners[2])):
            return False
    return True
