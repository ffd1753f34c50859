"""Which of many triangles are near a point, on which side of them it is, and what lies between.

These run for every vertex: they take arrays once and work on plain numbers inside their loops,
because numba counts references for each array handed on, at more cost than the geometry.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.nearest_feature import (
    NO_DISTANCE,
    NO_WEIGHT,
    ROUND_OFF,
    closest_weights,
    nearest_feature,
)
from softrobot_twin.geometry.vector3 import cross, dot, minus, plus, row


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
