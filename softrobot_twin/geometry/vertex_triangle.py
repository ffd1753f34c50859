"""Vertices of one surface that are near to, or behind, the triangles of another.

A vertex outside is paired with each feature at which its distance from the other surface has a
local minimum, as far as its own neighbours allow: they must not come closer still (local minimal
distance, Duriez 2013, "Real-time haptic simulation of medical procedures"). A vertex inside is
paired once, with the nearest triangle that does not look the same way as the vertex itself, and
must go out along that triangle's normal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.geometry.broad_phase import box_holds, cell_at, holds
from softrobot_twin.geometry.closed_surface import steepest_descent
from softrobot_twin.geometry.nearest_feature import (
    CORNER,
    EDGE,
    FACE,
    NONE,
    nearest_feature,
    way_is_clear,
)
from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.vector3 import dot, plus, row, unit

# Sine by which a neighbour may be closer than a vertex that still counts: the bodies turn by about
# as much within a step, and a pair more does no harm while they are apart.
CONE_TOLERANCE = 0.2
# Cosine between a vertex's normal and a triangle's beyond which neither can have come through the
# other: they look the same way.
_SAME_WAY = 0.3
# On one and the same surface, they must look at each other to have come through; and what looks
# about the same way is not even asked how near it is.
_AT_EACH_OTHER = -0.3
_NEIGHBOURLY = 0.7


class RestPairs(NamedTuple):
    """Vertices and triangles of one surface that must never be paired.

    Attributes:
        offsets: Where the triangles of each point start, shape (point_count + 1,); length 0 where
            the two surfaces are not the same.
        triangles: The triangles.
        touching: Whether the triangle holds the vertex or shares an edge with it.
        stamps: Work space, shape (triangle_count,).
    """

    offsets: np.ndarray
    triangles: np.ndarray
    touching: np.ndarray
    stamps: np.ndarray


def no_rest_pairs() -> RestPairs:
    """What two different surfaces have: every pair counts."""
    none = np.zeros(0, dtype=np.int64)
    return RestPairs(none, none, np.zeros(0, dtype=np.bool_), none)


def empty_rows(capacity: int) -> Proximities:
    """Work space for a number of pairs."""
    return Proximities(
        first_points=np.empty((capacity, 3), dtype=np.int64),
        first_weights=np.empty((capacity, 3)),
        second_points=np.empty((capacity, 3), dtype=np.int64),
        second_weights=np.empty((capacity, 3)),
        first_positions=np.empty((capacity, 3)),
        second_positions=np.empty((capacity, 3)),
        normals=np.empty((capacity, 3)),
        gaps=np.empty(capacity),
        keys=np.empty(capacity, dtype=np.int64),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def write_side(points, weights, positions, i, side):
    """One side (points, weights, position) of row i."""
    for c in range(3):
        points[i, c] = side[0][c]
        weights[i, c] = side[1][c]
        positions[i, c] = side[2][c]


@njit(cache=True, nogil=True, error_model="numpy")
def write_row(rows, i, swap, first, second, normal, gap, key):
    """Write row i if there is room; with `swap`, as seen from the second surface."""
    if i >= len(rows.gaps):
        return
    a, b, sign = (second, first, -1.0) if swap else (first, second, 1.0)
    write_side(rows.first_points, rows.first_weights, rows.first_positions, i, a)
    write_side(rows.second_points, rows.second_weights, rows.second_positions, i, b)
    for c in range(3):
        rows.normals[i, c] = sign * normal[c]
    rows.gaps[i] = gap
    rows.keys[i] = key


@njit(cache=True, nogil=True, error_model="numpy")
def mean_normal(surface, normals, v):
    """Unit mean of the normals around a vertex; coarse but quick."""
    total = (0.0, 0.0, 0.0)
    for k in range(surface.ring_offsets[v], surface.ring_offsets[v + 1]):
        total = plus(total, row(normals, surface.ring[k]), 1.0)
    return unit(total)


@njit(cache=True, nogil=True, error_model="numpy")
def stamp(rest, v):
    """Mark the triangles that vertex v must not be paired with: 2 v + 1, or 2 v + 2 if touching."""
    for k in range(rest.offsets[v], rest.offsets[v + 1]):
        rest.stamps[rest.triangles[k]] = 2 * v + (2 if rest.touching[k] else 1)


@njit(cache=True, nogil=True, error_model="numpy")
def is_barred(rest, surface, v, kind, feature):
    """Whether a vertex must not be paired with a feature: with no triangle at it, or touching."""
    if kind == FACE:
        return rest.stamps[feature] > 2 * v and rest.stamps[feature] <= 2 * v + 2
    first, last = 0, 2
    if kind == CORNER:
        first, last = surface.ring_offsets[feature], surface.ring_offsets[feature + 1]
    every = True
    for k in range(first, last):
        t = surface.ring[k] if kind == CORNER else surface.edge_triangles[feature, k]
        if rest.stamps[t] == 2 * v + 2:
            return True
        every = every and rest.stamps[t] == 2 * v + 1
    return every


@njit(cache=True, nogil=True, error_model="numpy")
def feature_number(surface, kind, feature):
    """One number for triangles, edges and points."""
    if kind == FACE:
        return feature
    if kind == EDGE:
        return len(surface.triangles) + feature
    return len(surface.triangles) + len(surface.edges) + feature


@njit(cache=True, nogil=True, error_model="numpy")
def pair_vertices(
    xa, a, normals_a, xb, b, normals_b, grid, region, margin, depth, rest, swap, first_key, rows,
    count,
):  # fmt: skip
    """Pair the vertices of surface a with features of surface b.

    Args:
        xa: Points of a [m].
        a: Surface a.
        normals_a: Its normals.
        xb: Points of b [m].
        b: Surface b.
        normals_b: Its normals.
        grid: Triangles of b, boxes grown by the larger of margin and depth.
        region: Box that a vertex must lie in.
        margin: Gap up to which pairs count [m].
        depth: Depth up to which they do [m].
        rest: Pairs of one surface that never count.
        swap: Whether a is the second surface.
        first_key: Key of the first pair.
        rows: What is found, from row `count` on.
        count: Rows already written.

    Returns:
        Rows written; more than there is room for means that some were not.
    """
    same = len(rest.offsets) > 0
    feature_count = len(b.triangles) + len(b.edges) + len(xb)
    limit = _AT_EACH_OTHER if same else _SAME_WAY
    for v in a.vertices:
        p = row(xa, v)
        if not holds(region, p):
            continue
        cell = cell_at(grid, p)
        first, last = grid.starts[cell], grid.starts[cell + 1]
        if first == last:
            continue
        outward = mean_normal(a, normals_a, v)
        if same:
            stamp(rest, v)
        one = ((v, v, v), (1.0, 0.0, 0.0), p)
        inmost = -depth
        found = False
        for k in range(first, last):
            t = grid.items[k]
            if not box_holds(grid.boxes, t, p):
                continue
            if same and (
                rest.stamps[t] == 2 * v + 2 or dot(outward, row(normals_b, t)) > _NEIGHBOURLY
            ):
                continue
            kind, feature, w, foot, n, gap = nearest_feature(
                p, xb, b, normals_b, t, max(margin, depth)
            )
            if kind == NONE or gap >= margin or gap < inmost:
                continue
            if same and is_barred(rest, b, v, kind, feature):
                continue
            other = ((b.triangles[t, 0], b.triangles[t, 1], b.triangles[t, 2]), w, foot)
            key = first_key + v * feature_count + feature_number(b, kind, feature)
            if gap >= 0.0:
                # Two vertices are found from both sides: they count from one.
                if kind == CORNER and (swap or (same and feature < v)):
                    continue
                if steepest_descent(xa, a, v, n) <= CONE_TOLERANCE:
                    write_row(rows, count, swap, one, other, n, gap, key)
                    count += 1
            elif dot(outward, n) < limit and way_is_clear(
                xb, b, grid.items, first, last, foot, p
            ):
                inmost = gap
                found = True
                best = (other, n, gap, key)
        if found:
            write_row(rows, count, swap, one, best[0], best[1], best[2], best[3])
            count += 1
    return count
