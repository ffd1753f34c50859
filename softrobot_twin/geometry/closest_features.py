"""Distances between points and triangles: kernels of the narrow phase.

Three levels build on each other: a point against one triangle; the feature of a triangle (face,
edge or corner) that is nearest to a point, with its outward normal; and searches over the
triangles that the broad phase lists near a point.

The search kernels run for every vertex. They take arrays as arguments and use plain numbers in
their loops, because numba counts references for each array that is passed on, which costs more
than the geometry itself.

Arguments of the kernels here:
    a, b, c: Corners of a triangle: rows of x or, where there is no x, points, three numbers [m].
    box: Lower and upper corner of a box, six numbers [m].
    boxes: Those of all items [m], shape (item_count, 6).
    found: Indices of triangles, shape (triangle_capacity,).
    items: Items of all cells, concatenated, shape (item_capacity,).
    p: A point, three numbers [m].
    s, t: Two triangles, rows of `normals`.
    skipped: First and last mark, two numbers.
    stamps: Marks of the triangles, shape (triangle_count,) or (0,).
    w: Barycentric weights, three numbers.
Those of a surface are as in `closed_surface`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.closed_surface import (
    ACROSS,
    EDGES,
    FAR_CORNERS,
    FIRST_AT,
    edge_normal,
    vertex_normal,
)
from softrobot_twin.geometry.vector3 import (
    add_scaled,
    cross,
    divided,
    dot,
    is_zero,
    norm,
    row,
    scaled,
    subtract,
)
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, ONCE, njit


@njit(**KERNEL)
def triangle_normal(x, a, b, c):
    """Unit normal of the triangle of points a, b and c of x; zero if it has no area."""
    start = row(x, a)
    n = cross(subtract(row(x, b), start), subtract(row(x, c), start))
    size = norm(n)
    if size == 0.0:
        return (0.0, 0.0, 0.0)
    return divided(n, size)


@njit(**KERNEL)
def plane_weights(x, a, b, c, p):
    """Barycentric weights of the projection of p onto the plane of a triangle with an area."""
    start = row(x, a)
    u, v = subtract(row(x, b), start), subtract(row(x, c), start)
    w, n = subtract(p, start), cross(u, v)
    square = dot(n, n)
    second = dot(cross(w, v), n) / square
    third = dot(cross(u, w), n) / square
    return (1.0 - second - third, second, third)


@njit(**INNER)
def height_above(x, a, normal, p):
    """Distance of p from the plane through point a of x along the normal [m]."""
    return dot(subtract(p, row(x, a)), normal)


@njit(**INLINED)
def out_of_reach(x, a, b, c, p, reach):
    """Whether the bounding box of a triangle is farther than `reach` from p along some axis."""
    for i in range(3):
        low = min(x[a, i], x[b, i], x[c, i])
        high = max(x[a, i], x[b, i], x[c, i])
        if low > p[i] + reach or high < p[i] - reach:
            return True
    return False

# A barycentric weight below this counts as zero: the point lies on the opposite edge.
NO_WEIGHT = 1.0e-9
# Relative advantage of a neighbour above which a feature is not the nearest one. It exceeds
# NO_WEIGHT, so that a point above the border of two features belongs to at least one of them.
_NEIGHBOUR_MARGIN = 1.0e-8
# Below this share of a triangle's edge, or of the reach of a search, the difference of two points
# has no usable direction.
NO_DISTANCE = 1.0e-7

# Slightly more than 1: comparisons must not depend on round-off.
ROUND_OFF = 1.000001

FACE, EDGE, CORNER, NONE = 0, 1, 2, 3


@njit(**INLINED)
def closest_weights(p, a, b, c):
    """Weights of the corners at the point of triangle abc that is closest to p.

    Areas are those along the normal. As differences of scalar products, which are shorter, they
    lose the digits of the square of a needle's length over its width, not of that ratio.

    Source: Ericson 2005, section 5.1.5.
    """
    ab, ac, ap = subtract(b, a), subtract(c, a), subtract(p, a)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return (1.0, 0.0, 0.0)
    bp = subtract(p, b)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return (0.0, 1.0, 0.0)
    n = cross(ab, ac)
    vc = dot(cross(ab, ap), n)
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return (1.0 - t, t, 0.0)
    cp = subtract(p, c)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return (0.0, 0.0, 1.0)
    vb = dot(cross(ap, ac), n)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return (1.0 - t, 0.0, t)
    square = dot(n, n)
    if vb + vc >= square and d4 >= d3 and d5 >= d6:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (0.0, 1.0 - t, t)
    scale = 1.0 / square
    return (1.0 - (vb + vc) * scale, vb * scale, vc * scale)


@njit(**ONCE)
def _without_round_off(w):
    """Weights with the negligible ones set to zero, and the number of the others."""
    a = w[0] if w[0] > NO_WEIGHT else 0.0
    b = w[1] if w[1] > NO_WEIGHT else 0.0
    c = w[2] if w[2] > NO_WEIGHT else 0.0
    scale = 1.0 / (a + b + c)
    left = (1 if a > 0.0 else 0) + (1 if b > 0.0 else 0) + (1 if c > 0.0 else 0)
    return (a * scale, b * scale, c * scale), left


@njit(**INLINED)
def _neighbour_is_nearer(start, along, corner, away):
    """Whether the triangle between an edge and a corner has a point nearer than the foot point.

    `away` is the vector from the foot point, on the edge, to the query point.
    """
    into = subtract(corner, start)
    into = add_scaled(into, along, -dot(into, along) / dot(along, along))
    return dot(away, into) > _NEIGHBOUR_MARGIN * dot(into, into)


@njit(**ONCE)
def _corner_is_nearest(x, fans, v, away):
    """Whether no edge at vertex v leads nearer to the query point, which lies `away` from v."""
    p = row(x, v)
    for k in range(fans[v, 0]):
        into = subtract(row(x, fans[v, 2 + 3 * k]), p)
        if dot(away, into) > _NEIGHBOUR_MARGIN * dot(into, into):
            return False
    return True


@njit(**INLINED)
def _direction_and_gap(away, outward, edge):
    """Unit normal and signed distance [m] from a feature with a known outward direction.

    `edge` is a vector along an edge of the feature [m].
    """
    distance = norm(away)
    if distance <= NO_DISTANCE * norm(edge):
        return outward, dot(away, outward)
    if dot(away, outward) >= 0.0:
        return scaled(away, 1.0 / distance), distance
    return scaled(away, -1.0 / distance), -distance


@njit(**INLINED)
def same_plane(normals, t, s):
    """Whether two triangles have identical normals, as in a flat region."""
    return (
        normals[t, 0] == normals[s, 0]
        and normals[t, 1] == normals[s, 1]
        and normals[t, 2] == normals[s, 2]
    )


@njit(**INNER)
def nearest_feature(p, x, links, fans, normals, t, reach):
    """Feature of triangle t at which the distance of p from the surface has a local minimum.

    An edge or a corner is returned only for the first of its triangles, and only if no other of
    them is nearer. So each feature is found once.

    Args:
        p: Point [m].
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        fans: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        t: Triangle.
        reach: Largest distance of an edge or a corner [m].

    Returns:
        Kind (FACE, EDGE, CORNER or NONE), index of the triangle, edge or point, weights of the
        triangle corners, foot point [m], outward unit normal, signed distance [m].
    """
    a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
    n = row(normals, t)
    nothing = (NONE, -1, (0.0, 0.0, 0.0), a, n, np.inf)
    if is_zero(n):
        return nothing
    w, left = _without_round_off(closest_weights(p, a, b, c))
    if left == 3:
        height = dot(subtract(p, a), n)
        return (FACE, t, w, add_scaled(p, n, -height), n, height)
    foot = add_scaled(add_scaled(scaled(a, w[0]), b, w[1]), c, w[2])
    away = subtract(p, foot)
    if dot(away, away) > reach * reach:
        return nothing
    if left == 2:
        i = 1 if w[0] == 0.0 else (2 if w[1] == 0.0 else 0)
        other = links[t, ACROSS + i]
        start, corner = row(x, links[t, i]), row(x, links[t, (i + 2) % 3])
        along = subtract(row(x, links[t, (i + 1) % 3]), start)
        if (
            other < t
            or _neighbour_is_nearer(start, along, corner, away)
            or _neighbour_is_nearer(start, along, row(x, links[t, FAR_CORNERS + i]), away)
        ):
            return nothing
        if same_plane(normals, t, other):
            return (EDGE, links[t, EDGES + i], w, foot, n, dot(away, n))
        normal, gap = _direction_and_gap(away, edge_normal(normals, t, other), along)
        return (EDGE, links[t, EDGES + i], w, foot, normal, gap)
    i = 0 if w[0] > 0.0 else (1 if w[1] > 0.0 else 2)
    v = links[t, i]
    if not links[t, FIRST_AT + i] or not _corner_is_nearest(x, fans, v, away):
        return nothing
    flat = True
    for k in range(fans[v, 0]):
        flat = flat and same_plane(normals, t, fans[v, 1 + 3 * k])
    if flat:
        return (CORNER, v, w, foot, n, dot(away, n))
    normal, gap = _direction_and_gap(away, vertex_normal(x, fans, normals, v), subtract(b, a))
    return (CORNER, v, w, foot, normal, gap)


@njit(**INLINED)
def _box_of(boxes, t):
    """Bounding box of item t: three smallest, then three largest coordinates [m]."""
    return (boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3], boxes[t, 4], boxes[t, 5])


@njit(**INLINED)
def is_beyond(p, box, slack):
    """Whether p lies outside a box that is shrunk by `slack` on every side."""
    # One condition for each axis: for one long condition the compiler evaluates all terms first.
    if p[0] < box[0] + slack or p[0] > box[3] - slack:
        return True
    if p[1] < box[1] + slack or p[1] > box[4] - slack:
        return True
    return p[2] < box[2] + slack or p[2] > box[5] - slack


@njit(**KERNEL, forceinline=True)
def squared_distance(p, a, b, c):
    """Squared distance of p from triangle abc [m²]."""
    w = closest_weights(p, a, b, c)
    away = add_scaled(add_scaled(add_scaled(p, a, -w[0]), b, -w[1]), c, -w[2])
    return dot(away, away)


@njit(**INNER)
def signed_distance(p, x, links, fans, normals, boxes, items, first, last, reach):
    """Signed distance of p from the surface [m], negative inside; `reach` if it is larger.

    Args:
        p: Point [m].
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        fans: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        boxes: Boxes of the triangles, grown by `reach`.
        items: Indices of the candidate triangles, at positions `first` to `last` - 1.
        first: See `items`.
        last: See `items`.
        reach: Distance [m].
    """
    least, nearest = reach, reach
    for k in range(first, last):
        t = items[k]
        if is_beyond(p, _box_of(boxes, t), reach - least):
            continue
        if abs(dot(p, row(normals, t)) - normals[t, 3]) > least:
            continue
        a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
        least = min(least, np.sqrt(squared_distance(p, a, b, c)))
    if least == reach:
        return reach
    # The nearest feature, which gives the sign, is computed only for the few nearest triangles.
    least = ROUND_OFF * least + NO_DISTANCE * reach
    for k in range(first, last):
        t = items[k]
        if is_beyond(p, _box_of(boxes, t), reach - least):
            continue
        if abs(dot(p, row(normals, t)) - normals[t, 3]) > least:
            continue
        gap = nearest_feature(p, x, links, fans, normals, t, least)[5]
        if abs(gap) < abs(nearest):
            nearest = gap
    return nearest


@njit(**INNER)
def near_triangles(
    p, outward, limit, stamps, skipped, x, links, normals, boxes, items, first, last, reach, front,
    behind, found,
):  # fmt: skip
    """List the triangles near p, in front of p or behind it.

    Args:
        p: Point [m].
        outward: Outward unit normal at p.
        limit: Triangles are skipped if the cosine between their normal and `outward` exceeds it.
        stamps: Marks written by `stamp`, or of length 0.
        skipped: First and last mark of triangles to skip.
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        boxes: Boxes of the triangles, grown by `reach`.
        items: Indices of the candidate triangles, at positions `first` to `last` - 1.
        first: See `items`.
        last: See `items`.
        reach: Distance [m].
        front: Largest distance from triangles whose front faces p [m].
        behind: Largest distance from triangles whose back faces p [m].
        found: Output: indices of the triangles.

    Returns:
        Number of triangles found.
    """
    stamped = len(stamps) > 0
    count = 0
    for k in range(first, last):
        t = items[k]
        if is_beyond(p, _box_of(boxes, t), reach - max(front, behind)):
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


@njit(**INLINED)
def crosses(start, along, a, b, c):
    """Whether the open segment from `start` to `start + along` passes through triangle abc.

    A segment that is negligible beside the triangle does not. Source: Möller and Trumbore 1997.
    """
    ab, ac = subtract(b, a), subtract(c, a)
    if dot(along, along) <= NO_DISTANCE * NO_DISTANCE * dot(ab, ab):
        return False
    q = cross(along, ac)
    determinant = dot(ab, q)
    if determinant == 0.0:
        return False
    scale = 1.0 / determinant
    s = subtract(start, a)
    u = dot(s, q) * scale
    r = cross(s, ab)
    v = dot(along, r) * scale
    if u < -NO_WEIGHT or v < -NO_WEIGHT or u + v > 1.0 + NO_WEIGHT:
        return False
    fraction = dot(ac, r) * scale
    return 1.0e-6 < fraction < 1.0 - 1.0e-6


@njit(**INNER)
def segment_is_clear(x, links, items, first, last, start, end):
    """Whether the segment between two points passes through none of the given triangles.

    A point behind a triangle is inside the body only if the segment from the triangle to the point
    meets no other triangle. Otherwise the point is outside again, on another side of the body.

    Args:
        x: Points of the surface [m].
        links: See `ClosedSurface`.
        items: Indices of the candidate triangles, at positions `first` to `last` - 1.
        first: See `items`.
        last: See `items`.
        start: Point on the surface [m]; triangles that touch the segment here do not count.
        end: Other end [m]; triangles that touch the segment here do not count either.
    """
    along = subtract(end, start)
    for k in range(first, last):
        t = items[k]
        a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
        if crosses(start, along, a, b, c):
            return False
    return True
