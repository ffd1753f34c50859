"""Distances between points and triangles: kernels of the narrow phase.

Three levels build on each other: a point against one triangle; the feature of a triangle (face,
edge or corner) that is nearest to a point, with its outward normal; and searches over the
triangles that the broad phase lists near a point.

The search kernels run for every vertex. They take arrays as arguments and use plain numbers in
their loops, because numba counts references for each array that is passed on, which costs more
than the geometry itself.
"""

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
from softrobot_twin.geometry.vector3 import cross, dot, minus, norm, plus, row, times

@njit(cache=True, nogil=True, error_model="numpy")
def triangle_normal(x, a, b, c):
    """Unit normal of a triangle of points x, zero where it is flat."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    if size == 0.0:
        return 0.0, 0.0, 0.0
    return nx / size, ny / size, nz / size


@njit(cache=True, nogil=True, error_model="numpy")
def plane_weights(x, a, b, c, px, py, pz):
    """Barycentric weights of a point's projection onto the plane of a triangle that is not flat."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    wx, wy, wz = px - x[a, 0], py - x[a, 1], pz - x[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    second = (wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz
    third = (uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz
    second /= square
    third /= square
    return 1.0 - second - third, second, third


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distance_to_edge(x, a, b, px, py, pz):
    """Squared distance of a point to the stretch between two points of x."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    wx, wy, wz = px - x[a, 0], py - x[a, 1], pz - x[a, 2]
    square = ux * ux + uy * uy + uz * uz
    along = (wx * ux + wy * uy + wz * uz) / square if square > 0.0 else 0.0
    along = min(max(along, 0.0), 1.0)
    wx, wy, wz = wx - along * ux, wy - along * uy, wz - along * uz
    return wx * wx + wy * wy + wz * wz


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distance_to_triangle(x, a, b, c, px, py, pz):
    """Squared distance of a point to a triangle of points x; a flat one is its edges."""
    nx, ny, nz = triangle_normal(x, a, b, c)
    if nx != 0.0 or ny != 0.0 or nz != 0.0:
        first, second, third = plane_weights(x, a, b, c, px, py, pz)
        if first >= 0.0 and second >= 0.0 and third >= 0.0:
            height = (px - x[a, 0]) * nx + (py - x[a, 1]) * ny + (pz - x[a, 2]) * nz
            return height * height
    return min(
        squared_distance_to_edge(x, a, b, px, py, pz),
        squared_distance_to_edge(x, b, c, px, py, pz),
        squared_distance_to_edge(x, c, a, px, py, pz),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def out_of_reach(x, a, b, c, px, py, pz, reach):
    """Whether a triangle's bounding box is farther than a reach from a point along some axis."""
    p = (px, py, pz)
    for i in range(3):
        low = min(x[a, i], x[b, i], x[c, i])
        high = max(x[a, i], x[b, i], x[c, i])
        if low > p[i] + reach or high < p[i] - reach:
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy")
def is_nearest_triangle(x, triangles, chosen, px, py, pz, distance):
    """Whether no other triangle is nearer to a point than the chosen one is.

    Args:
        x: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).
        chosen: Index of the chosen triangle.
        px: Point [m], likewise py and pz.
        distance: Its distance from the chosen triangle [m].

    Returns:
        True or False; neighbours equally near to rounding do not count as nearer.
    """
    reach = distance * (1.0 - 1.0e-9)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if t == chosen or out_of_reach(x, a, b, c, px, py, pz, reach):
            continue
        if squared_distance_to_triangle(x, a, b, c, px, py, pz) < reach * reach:
            return False
    return True


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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def box_of(boxes, t):
    """Box of item t as six numbers."""
    return (boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3], boxes[t, 4], boxes[t, 5])


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def is_beyond(p, box, slack):
    """Whether p lies outside a box made smaller by a slack."""
    # One axis a line: the compiler computes all of a long condition before it decides.
    if p[0] < box[0] + slack or p[0] > box[3] - slack:
        return True
    if p[1] < box[1] + slack or p[1] > box[4] - slack:
        return True
    return p[2] < box[2] + slack or p[2] > box[5] - slack


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distance(p, a, b, c):
    """Squared distance of p from triangle abc."""
    w = closest_weights(p, a, b, c)
    away = plus(plus(plus(p, a, -w[0]), b, -w[1]), c, -w[2])
    return dot(away, away)


@njit(cache=True, nogil=True, error_model="numpy")
def signed_distance(p, x, links, fans, normals, boxes, items, first, last, reach):
    """Signed distance of p from the surface [m], negative inside, or `reach` if beyond that.

    Args:
        p: Point [m].
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        fans: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        boxes: Boxes of the triangles, grown by `reach`.
        items: Triangles in question, from place `first` to before `last`.
        first: See items.
        last: See items.
        reach: Distance [m].
    """
    least, nearest = reach, reach
    for k in range(first, last):
        t = items[k]
        if is_beyond(p, box_of(boxes, t), reach - least):
            continue
        if abs(dot(p, row(normals, t)) - normals[t, 3]) > least:
            continue
        a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
        least = min(least, np.sqrt(squared_distance(p, a, b, c)))
    if least == reach:
        return reach
    # Only now, for the few that are nearest, ask for the feature and with it the sign.
    least = ROUND_OFF * least + NO_DISTANCE
    for k in range(first, last):
        t = items[k]
        if is_beyond(p, box_of(boxes, t), reach - least):
            continue
        if abs(dot(p, row(normals, t)) - normals[t, 3]) > least:
            continue
        gap = nearest_feature(p, x, links, fans, normals, t, least)[5]
        if abs(gap) < abs(nearest):
            nearest = gap
    return nearest


@njit(cache=True, nogil=True, error_model="numpy")
def near_triangles(
    p, outward, limit, stamps, skipped, x, links, normals, boxes, items, first, last, reach, front,
    behind, found,
):  # fmt: skip
    """List the triangles that p is in front of or behind and near.

    Args:
        p: Point [m].
        outward: Normal at that point.
        limit: Cosine of its angle with a triangle's normal above which that does not count.
        stamps: What `stamp` has marked, or of length 0.
        skipped: First and last stamp of triangles that do not count.
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        boxes: Boxes of the triangles, grown by `reach`.
        items: Triangles in question, from place `first` to before `last`.
        first: See items.
        last: See items.
        reach: Distance [m].
        front: Distance up to which triangles count whose front is turned to p [m].
        behind: Same for those whose back is [m].
        found: Gets the triangles.

    Returns:
        Their number.
    """
    stamped = len(stamps) > 0
    count = 0
    for k in range(first, last):
        t = items[k]
        if is_beyond(p, box_of(boxes, t), reach - max(front, behind)):
            continue
        if stamped and skipped[0] <= stamps[t] <= skipped[1]:
            continue
        n = row(normals, t)
        if dot(outward, n) > limit:
            continue
        height = dot(p, n) - normals[t, 3]
        if height > front or height < -behind:
            continue
        a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
        far = front if height >= 0.0 else behind
        if squared_distance(p, a, b, c) <= ROUND_OFF * far * far:
            found[count] = t
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
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
    if u < -NO_WEIGHT or v < -NO_WEIGHT or u + v > 1.0 + NO_WEIGHT:
        return False
    fraction = dot(ac, r) * scale
    return 1.0e-6 < fraction < 1.0 - 1.0e-6


@njit(cache=True, nogil=True, error_model="numpy")
def way_is_clear(x, links, items, first, last, start, end):
    """Whether none of some triangles lies between two points.

    A point behind a triangle is inside the body only if the way there from the triangle meets no
    other triangle: else it has come out on another side.

    Args:
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        items: Triangles that may lie there, from place `first` to before `last`.
        first: See items.
        last: See items.
        start: Point on the surface [m]; triangles that touch it there do not count.
        end: Other point [m]; neither do those that touch it.
    """
    way = minus(end, start)
    if dot(way, way) <= NO_DISTANCE * NO_DISTANCE:
        return True
    for k in range(first, last):
        t = items[k]
        a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
        if crosses(start, way, a, b, c):
            return False
    return True
