"""Edges of one surface that cross edges of another, apart or a little through each other.

Two edges have a local minimum of distance inside both where the common perpendicular n points out
of the second body (it lies between the normals of the two triangles there) and into the first.
Told by these normals and not by the vector between the edges, n does not flip when the edges pass
through each other, and the gap changes sign instead.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.geometry.broad_phase import cell_at, cell_of
from softrobot_twin.geometry.closed_surface import edge_normal
from softrobot_twin.geometry.pair_rows import write_row
from softrobot_twin.geometry.triangle_search import way_is_clear
from softrobot_twin.geometry.vector3 import cross, dot, minus, norm, plus, row, times
from softrobot_twin.geometry.vertex_triangle import CONE_TOLERANCE

# Edges at a smaller angle than this (its sine) count as parallel: their common perpendicular turns
# wildly, and their vertices do the work.
PARALLEL_SINE = 0.05
# Angle [rad] between two triangles under which the edge between them is none.
_FLAT_COSINE = np.cos(0.01)
# Product of the sums of the two normals at two edges, 4 where all are the same, above which the
# edges look the same way and cannot meet.
_SAME_WAY = 2.0
# Sine by which the normal of edges that overlap may lie outside the cones.
_OVERLAP_TOLERANCE = 0.02
# Sine of the elevation from which one edge looks out upon another.
_ELEVATION = 0.3


@njit(cache=True, nogil=True, error_model="numpy")
def find_ridges(x, edges, normals, ridges):
    """Mark the edges at which the surface is convex and not just flat.

    Returns:
        Half the length of the longest of them [m]: no overlap of edges is deeper.
    """
    for e in range(len(edges)):
        n, m = row(normals, edges[e, 2]), row(normals, edges[e, 3])
        start = row(x, edges[e, 0])
        ridges[e] = (
            dot(n, m) < _FLAT_COSINE and dot(minus(row(x, edges[e, 5]), start), n) < 0.0
        )  # fmt: skip
    return half_longest_ridge(x, edges, ridges)


@njit(cache=True, nogil=True, error_model="numpy")
def half_longest_ridge(x, edges, ridges):
    """Half the length of the longest ridge [m]: no overlap of edges is deeper."""
    longest = 0.0
    for e in range(len(edges)):
        if ridges[e]:
            along = minus(row(x, edges[e, 1]), row(x, edges[e, 0]))
            longest = max(longest, dot(along, along))
    return 0.5 * np.sqrt(longest)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def is_outside_cone(x, edges, e, normal, sine):
    """Whether a normal of edge e lies outside its cone by more than an angle."""
    start = row(x, edges[e, 0])
    along = minus(row(x, edges[e, 1]), start)
    scale = 1.0 / dot(along, along)
    for side in range(4, 6):
        into = minus(row(x, edges[e, side]), start)
        into = plus(into, along, -dot(into, along) * scale)
        height = dot(normal, into)
        if height > 0.0 and height * height > sine * sine * dot(into, into):
            return True
    return False


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def crossing(x, edges, e, y, others, f):
    """Where the common perpendicular of two lines meets them.

    Returns:
        Whether it meets both edges between their ends, fractions along them, unit perpendicular.
    """
    p, q = row(x, edges[e, 0]), row(y, others[f, 0])
    u, w = minus(row(x, edges[e, 1]), p), minus(row(y, others[f, 1]), q)
    n = cross(u, w)
    squared = dot(n, n)
    uu, ww = dot(u, u), dot(w, w)
    if squared <= PARALLEL_SINE * PARALLEL_SINE * uu * ww:
        return False, 0.5, 0.5, n
    between = minus(q, p)
    s = dot(cross(between, w), n) / squared
    t = dot(cross(between, u), n) / squared
    inside = 0.0 < s < 1.0 and 0.0 < t < 1.0
    return inside, s, t, times(n, 1.0 / np.sqrt(squared))


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def point_at(x, edges, e, s):
    """The point a fraction s along edge e."""
    start = row(x, edges[e, 0])
    return plus(start, minus(row(x, edges[e, 1]), start), s)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def depth_to_ends(x, edges, e, s):
    """Distance from a point of an edge to its nearer end [m]: deeper overlaps are its vertices'."""
    return min(s, 1.0 - s) * norm(minus(row(x, edges[e, 1]), row(x, edges[e, 0])))


@njit(cache=True, nogil=True, error_model="numpy")
def is_inside(side, start, end):
    """Whether the way from a point on the surface inwards to another stays inside."""
    frame, starts = side.grid.frame, side.grid.starts
    for axis in range(3):
        if end[axis] < frame[0, axis] or end[axis] > frame[1, axis]:
            return False
    cell = cell_at(frame, side.grid.counts, end)
    return way_is_clear(
        side.x, side.surface.links, side.grid.items, starts[cell], starts[cell + 1], start, end
    )


@njit(cache=True, nogil=True, error_model="numpy")
def looks_across(x, edges, normals, e, f, near):
    """Whether two edges of one surface are far apart, or have air between them."""
    _, s, t, _ = crossing(x, edges, e, x, edges, f)
    p = point_at(x, edges, e, min(max(s, 0.0), 1.0))
    q = point_at(x, edges, f, min(max(t, 0.0), 1.0))
    away = minus(p, q)
    distance = norm(away)
    if distance > near:
        return True
    return (
        dot(away, edge_normal(normals, edges[f, 2], edges[f, 3])) > _ELEVATION * distance
        and dot(away, edge_normal(normals, edges[e, 2], edges[e, 3])) < -_ELEVATION * distance
    )


@njit(cache=True, nogil=True, error_model="numpy")
def pair_edges(
    a, b, edge_grid, margin, depth, rest, rest_normals, near, first_key, rows, count
):
    """Pair ridges of surface a with ridges of surface b.

    Args:
        a: First surface, a `SurfaceSide`.
        b: Second surface.
        edge_grid: Ridges of b, boxes grown by the larger of margin and depth.
        margin: Gap up to which pairs count [m].
        depth: Depth up to which they do [m].
        rest: Points at rest where both are one surface [m]; of length 0 where not.
        rest_normals: Normals at rest.
        near: Distance at rest under which edges need air between them [m].
        first_key: Key of the first pair.
        rows: What is found, from row `count` on.
        count: Rows already written.

    Returns:
        Rows written; more than there is room for means that some were not.
    """
    same = len(rest) > 0
    low = np.empty(3, dtype=np.int64)
    high = np.empty(3, dtype=np.int64)
    x, edges, normals, ridges = a.x, a.surface.edges, a.normals, a.ridges
    y, others, other_normals = b.x, b.surface.edges, b.normals
    boxes, items, starts = edge_grid.boxes, edge_grid.items, edge_grid.starts
    frame, counts = edge_grid.frame, edge_grid.counts
    integers, reals = rows.integers, rows.reals
    for e in range(len(edges)):
        if not ridges[e] or not cells_of_edge(x, edges, e, frame, counts, low, high):
            continue
        out = plus(row(normals, edges[e, 2]), row(normals, edges[e, 3]), 1.0)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    cell = (i * counts[1] + j) * counts[2] + k
                    for place in range(starts[cell], starts[cell + 1]):
                        f = items[place]
                        if (same and f <= e) or not boxes_meet(x, edges, e, boxes, f):
                            continue
                        other_out = plus(
                            row(other_normals, others[f, 2]), row(other_normals, others[f, 3]), 1.0
                        )  # fmt: skip
                        if dot(out, other_out) > _SAME_WAY:
                            continue
                        if not first_shared_cell(frame, counts, boxes, f, low, i, j, k):
                            continue
                        near_by, s, t, n, gap = cross_edges(
                            x, edges, normals, e, y, others, other_normals, f, margin, depth
                        )
                        if not near_by or (same and share_a_point(edges, e, f)):
                            continue
                        if gap < 0.0 and not overlap(a, b, e, s, f, t):
                            continue
                        if same and not looks_across(rest, edges, rest_normals, e, f, near):
                            continue
                        key = first_key + e * len(others) + f
                        write_edges(
                            x, edges, e, s, y, others, f, t, n, gap, key, integers, reals, count
                        )  # fmt: skip
                        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cells_of_edge(x, edges, e, frame, counts, low, high):
    """First and last cell of an edge along each axis; false where it lies outside the grid."""
    for axis in range(3):
        p, q = x[edges[e, 0], axis], x[edges[e, 1], axis]
        if max(p, q) < frame[0, axis] or min(p, q) > frame[1, axis]:
            return False
        low[axis] = cell_of(frame, counts, axis, min(p, q))
        high[axis] = cell_of(frame, counts, axis, max(p, q))
    return True


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def first_shared_cell(frame, counts, boxes, f, low, i, j, k):
    """Whether cell (i, j, k) is the first that item f shares with a box: each pair counts once."""
    return (
        i == max(low[0], cell_of(frame, counts, 0, boxes[f, 0]))
        and j == max(low[1], cell_of(frame, counts, 1, boxes[f, 1]))
        and k == max(low[2], cell_of(frame, counts, 2, boxes[f, 2]))
    )


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def boxes_meet(x, edges, e, boxes, f):
    """Whether the box of edge e meets that of item f."""
    for axis in range(3):
        p, q = x[edges[e, 0], axis], x[edges[e, 1], axis]
        if max(p, q) < boxes[f, axis] or min(p, q) > boxes[f, axis + 3]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def share_a_point(edges, e, f):
    """Whether two edges of one surface meet."""
    return (
        edges[e, 0] == edges[f, 0] or edges[e, 0] == edges[f, 1]
        or edges[e, 1] == edges[f, 0] or edges[e, 1] == edges[f, 1]
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def cross_edges(x, edges, normals, e, y, others, other_normals, f, margin, depth):
    """Whether edges e and f cross near each other, fractions along them, normal and gap [m]."""
    inside, s, t, n = crossing(x, edges, e, y, others, f)
    gap = 0.0
    if inside:
        if dot(n, edge_normal(other_normals, others[f, 2], others[f, 3])) < 0.0:
            n = times(n, -1.0)
        gap = dot(minus(point_at(x, edges, e, s), point_at(y, others, f, t)), n)
        tolerance = CONE_TOLERANCE if gap >= 0.0 else _OVERLAP_TOLERANCE
        inside = (
            -depth <= gap < margin
            and dot(n, edge_normal(normals, edges[e, 2], edges[e, 3])) < 0.0
            and not is_outside_cone(y, others, f, n, tolerance)
            and not is_outside_cone(x, edges, e, times(n, -1.0), tolerance)
        )
    return inside, s, t, n, gap


@njit(cache=True, nogil=True, error_model="numpy")
def overlap(a, b, e, s, f, t):
    """Whether a point of edge e is inside b, one of f inside a, and neither deep for its edge."""
    p, q = point_at(a.x, a.surface.edges, e, s), point_at(b.x, b.surface.edges, f, t)
    deep = norm(minus(p, q))
    return (
        deep <= depth_to_ends(a.x, a.surface.edges, e, s)
        and deep <= depth_to_ends(b.x, b.surface.edges, f, t)
        and is_inside(b, q, p)
        and is_inside(a, p, q)
    )


@njit(cache=True, nogil=True, error_model="numpy")
def write_edges(
    x, edges, e, s, y, others, f, t, n, gap, key, integers, reals, place
):  # fmt: skip
    """Write a pair of edges."""
    start, end = edges[e, 0], edges[e, 1]
    first = ((start, end, end), (1.0 - s, s, 0.0), point_at(x, edges, e, s))
    start, end = others[f, 0], others[f, 1]
    second = ((start, end, end), (1.0 - t, t, 0.0), point_at(y, others, f, t))
    write_row(integers, reals, place, False, first, second, n, gap, key)
