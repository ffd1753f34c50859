"""Edges of one surface that cross edges of another, apart or a little through each other.

Two edges have a local minimum of distance inside both where the common perpendicular n points out
of the second body (it lies between the normals of the two triangles there) and into the first.
Told by these normals and not by the vector between the edges, n does not flip when the edges pass
through each other, and the gap changes sign instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.geometry.broad_phase import CellGrid, cell_at, cell_of, holds
from softrobot_twin.geometry.closed_surface import edge_normal
from softrobot_twin.geometry.nearest_feature import way_is_clear
from softrobot_twin.geometry.vector3 import cross, dot, minus, norm, plus, row, times
from softrobot_twin.geometry.vertex_triangle import CONE_TOLERANCE, write_row

# Edges at a smaller angle than this (its sine) count as parallel: their common perpendicular turns
# wildly, and their vertices do the work.
PARALLEL_SINE = 0.05
# Angle [rad] between two triangles under which the edge between them is none.
_FLAT_COSINE = np.cos(0.01)
# Sine by which the normal of edges that overlap may lie outside the cones.
_OVERLAP_TOLERANCE = 0.02
# Sine of the elevation from which one edge looks out upon another.
_ELEVATION = 0.3


class EdgeSide(NamedTuple):
    """One surface, as the search for edges needs it.

    Attributes:
        x: Points [m].
        surface: The surface.
        normals: Its unit normals.
        ridges: Whether an edge sticks out, shape (edge_count,).
        grid: Its triangles.
    """

    x: np.ndarray
    surface: tuple
    normals: np.ndarray
    ridges: np.ndarray
    grid: CellGrid


@njit(cache=True, nogil=True, error_model="numpy")
def find_ridges(x, surface, normals, ridges):
    """Edges at which the surface is convex, and not just flat."""
    for e in range(len(surface.edges)):
        n = row(normals, surface.edge_triangles[e, 0])
        m = row(normals, surface.edge_triangles[e, 1])
        across = minus(row(x, surface.edge_apexes[e, 1]), row(x, surface.edges[e, 0]))
        ridges[e] = dot(n, m) < _FLAT_COSINE and dot(across, n) < 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def outside_cone(x, surface, e, normal):
    """Sine of the angle by which a normal of edge e lies outside its cone, ≤ 0 inside."""
    start = row(x, surface.edges[e, 0])
    along = minus(row(x, surface.edges[e, 1]), start)
    squared = dot(along, along)
    worst = -1.0
    for side in range(2):
        into = minus(row(x, surface.edge_apexes[e, side]), start)
        into = plus(into, along, -dot(into, along) / squared)
        height = norm(into)
        if height > 0.0:
            worst = max(worst, dot(normal, into) / height)
    return worst


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def depth_to_ends(x, surface, e, s):
    """Distance from a point of an edge to its nearer end [m]: deeper overlaps are its vertices'."""
    length = norm(minus(row(x, surface.edges[e, 1]), row(x, surface.edges[e, 0])))
    return min(s, 1.0 - s) * length


@njit(cache=True, nogil=True, error_model="numpy")
def is_inside(side, start, end):
    """Whether the way from a point on the surface inwards to another stays inside."""
    box = side.grid.frame
    region = (box[0, 0], box[0, 1], box[0, 2], box[1, 0], box[1, 1], box[1, 2])
    if not holds(region, end):
        return False
    cell = cell_at(side.grid, end)
    first, last = side.grid.starts[cell], side.grid.starts[cell + 1]
    return way_is_clear(side.x, side.surface, side.grid.items, first, last, start, end)


@njit(cache=True, nogil=True, error_model="numpy")
def looks_across(rest, surface, normals, e, f, near):
    """Whether two edges of one surface were at rest far apart, or had air between them."""
    _, s, t, _ = crossing(rest, surface.edges, e, rest, surface.edges, f)
    s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
    p, q = row(rest, surface.edges[e, 0]), row(rest, surface.edges[f, 0])
    p = plus(p, minus(row(rest, surface.edges[e, 1]), p), s)
    q = plus(q, minus(row(rest, surface.edges[f, 1]), q), t)
    away = minus(p, q)
    distance = norm(away)
    if distance > near:
        return True
    return (
        dot(away, edge_normal(surface, normals, f)) > _ELEVATION * distance
        and dot(away, edge_normal(surface, normals, e)) < -_ELEVATION * distance
    )


@njit(cache=True, nogil=True, error_model="numpy")
def pair_edges(
    a, b, edge_grid, margin, depth, rest, rest_normals, near, first_key, rows, count
):
    """Pair ridges of surface a with ridges of surface b.

    Args:
        a: First surface, an `EdgeSide`.
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
    for e in range(len(a.surface.edges)):
        if not a.ridges[e] or not cells_of_edge(a.x, a.surface.edges, e, edge_grid, low, high):
            continue
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    cell = (i * edge_grid.counts[1] + j) * edge_grid.counts[2] + k
                    for place in range(edge_grid.starts[cell], edge_grid.starts[cell + 1]):
                        f = edge_grid.items[place]
                        if same and f <= e:
                            continue
                        if not first_shared_cell(edge_grid, f, low, i, j, k):
                            continue
                        if not boxes_meet(a.x, a.surface.edges, e, edge_grid.boxes, f):
                            continue
                        count = pair_edge(
                            a, b, e, f, margin, depth, rest, rest_normals, near, first_key,
                            rows, count,
                        )  # fmt: skip
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def cells_of_edge(x, edges, e, grid, low, high):
    """First and last cell of an edge along each axis; false where it lies outside the grid."""
    for axis in range(3):
        p, q = x[edges[e, 0], axis], x[edges[e, 1], axis]
        if max(p, q) < grid.frame[0, axis] or min(p, q) > grid.frame[1, axis]:
            return False
        low[axis] = cell_of(grid, axis, min(p, q))
        high[axis] = cell_of(grid, axis, max(p, q))
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def first_shared_cell(grid, f, low, i, j, k):
    """Whether cell (i, j, k) is the first that item f shares with a box: each pair counts once."""
    return (
        i == max(low[0], cell_of(grid, 0, grid.boxes[f, 0]))
        and j == max(low[1], cell_of(grid, 1, grid.boxes[f, 1]))
        and k == max(low[2], cell_of(grid, 2, grid.boxes[f, 2]))
    )


@njit(cache=True, nogil=True, error_model="numpy")
def boxes_meet(x, edges, e, boxes, f):
    """Whether the box of edge e meets that of item f."""
    for axis in range(3):
        p, q = x[edges[e, 0], axis], x[edges[e, 1], axis]
        if max(p, q) < boxes[f, axis] or min(p, q) > boxes[f, axis + 3]:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def pair_edge(
    a, b, e, f, margin, depth, rest, rest_normals, near, first_key, rows, count
):  # fmt: skip
    """Pair edge e of a with edge f of b where they are near; returns the rows written."""
    ends, others = a.surface.edges[e], b.surface.edges[f]
    same = len(rest) > 0
    if same and (
        ends[0] == others[0] or ends[0] == others[1]
        or ends[1] == others[0] or ends[1] == others[1]
    ):  # fmt: skip
        return count
    inside, s, t, n = crossing(a.x, a.surface.edges, e, b.x, b.surface.edges, f)
    if not inside:
        return count
    out = edge_normal(b.surface, b.normals, f)
    if dot(n, out) < 0.0:
        n = times(n, -1.0)
    p0, q0 = row(a.x, ends[0]), row(b.x, others[0])
    p = plus(p0, minus(row(a.x, ends[1]), p0), s)
    q = plus(q0, minus(row(b.x, others[1]), q0), t)
    gap = dot(minus(p, q), n)
    if gap >= margin or gap < -depth or dot(n, edge_normal(a.surface, a.normals, e)) >= 0.0:
        return count
    tolerance = CONE_TOLERANCE if gap >= 0.0 else _OVERLAP_TOLERANCE
    if (
        outside_cone(b.x, b.surface, f, n) > tolerance
        or outside_cone(a.x, a.surface, e, times(n, -1.0)) > tolerance
    ):
        return count
    if gap < 0.0 and not (
        -gap <= depth_to_ends(a.x, a.surface, e, s)
        and -gap <= depth_to_ends(b.x, b.surface, f, t)
        and is_inside(b, q, p)
        and is_inside(a, p, q)
    ):
        return count
    if same and not looks_across(rest, a.surface, rest_normals, e, f, near):
        return count
    first = ((ends[0], ends[1], ends[1]), (1.0 - s, s, 0.0), p)
    second = ((others[0], others[1], others[1]), (1.0 - t, t, 0.0), q)
    key = first_key + e * len(b.surface.edges) + f
    write_row(rows, count, False, first, second, n, gap, key)
    return count + 1
