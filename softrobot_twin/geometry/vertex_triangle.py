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

from softrobot_twin.geometry.broad_phase import CellGrid, cell_at, holds
from softrobot_twin.geometry.closed_surface import (
    ClosedSurface,
    mean_normal,
    steepest_descent,
)
from softrobot_twin.geometry.nearest_feature import (
    CORNER,
    EDGE,
    FACE,
    NONE,
    near_triangles,
    nearest_feature,
    signed_distance,
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


class SurfaceSide(NamedTuple):
    """One surface as it is now.

    Attributes:
        x: Points [m].
        surface: The surface.
        normals: Its unit normals and plane offsets, shape (triangle_count, 4).
        ridges: Whether an edge sticks out, shape (edge_count,).
        grid: Its triangles.
    """

    x: np.ndarray
    surface: ClosedSurface
    normals: np.ndarray
    ridges: np.ndarray
    grid: CellGrid


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


class PairRows(NamedTuple):
    """Work space for pairs.

    Attributes:
        integers: Points of the first, of the second, key, shape (capacity, 7).
        reals: Weights and position of the first, of the second, normal, gap, shape (capacity, 16).
        found: Triangles near a vertex, shape (triangle_capacity,).
    """

    integers: np.ndarray
    reals: np.ndarray
    found: np.ndarray


def empty_rows(capacity: int, triangle_count: int) -> PairRows:
    """Work space for a number of pairs."""
    return PairRows(
        integers=np.empty((capacity, 7), dtype=np.int64),
        reals=np.empty((capacity, 16)),
        found=np.empty(triangle_count, dtype=np.int64),
    )


def proximities(rows: PairRows, count: int) -> Proximities:
    """The first rows, as arrays of their own."""
    integers, reals = rows.integers[:count], rows.reals[:count]
    return Proximities(
        first_points=integers[:, 0:3].copy(),
        first_weights=reals[:, 0:3].copy(),
        second_points=integers[:, 3:6].copy(),
        second_weights=reals[:, 6:9].copy(),
        first_positions=reals[:, 3:6].copy(),
        second_positions=reals[:, 9:12].copy(),
        normals=reals[:, 12:15].copy(),
        gaps=reals[:, 15].copy(),
        keys=integers[:, 6].copy(),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def write_row(integers, reals, i, swap, first, second, normal, gap, key):
    """Write row i if there is room; with `swap`, as seen from the second surface.

    A side is its points, their weights, and the position.
    """
    if i >= len(integers):
        return
    a, b, sign = (second, first, -1.0) if swap else (first, second, 1.0)
    for c in range(3):
        integers[i, c] = a[0][c]
        integers[i, 3 + c] = b[0][c]
        reals[i, c] = a[1][c]
        reals[i, 3 + c] = a[2][c]
        reals[i, 6 + c] = b[1][c]
        reals[i, 9 + c] = b[2][c]
        reals[i, 12 + c] = sign * normal[c]
    reals[i, 15] = gap
    integers[i, 6] = key


@njit(cache=True, nogil=True, error_model="numpy")
def stamp(rest, v):
    """Mark the triangles that vertex v must not be paired with: 2 v + 1, or 2 v + 2 if touching."""
    for k in range(rest.offsets[v], rest.offsets[v + 1]):
        rest.stamps[rest.triangles[k]] = 2 * v + (2 if rest.touching[k] else 1)


@njit(cache=True, nogil=True, error_model="numpy")
def is_barred(stamps, surface, v, kind, feature):
    """Whether a vertex must not be paired with a feature: with no triangle at it, or touching."""
    if kind == FACE:
        return stamps[feature] == 2 * v + 1 or stamps[feature] == 2 * v + 2
    every = True
    for k in range(2 if kind == EDGE else surface.fans[feature, 0]):
        t = surface.edges[feature, 2 + k] if kind == EDGE else surface.fans[feature, 1 + 3 * k]
        if stamps[t] == 2 * v + 2:
            return True
        every = every and stamps[t] == 2 * v + 1
    return every


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def feature_count(b):
    """How many numbers `feature_number` gives out."""
    return len(b.surface.links) + len(b.surface.edges) + len(b.x)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def feature_number(b, kind, feature):
    """One number for triangles, edges and points."""
    if kind == FACE:
        return feature
    if kind == EDGE:
        return len(b.surface.links) + feature
    return len(b.surface.links) + len(b.surface.edges) + feature


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def corners_of(links, t):
    """Points of triangle t."""
    return (links[t, 0], links[t, 1], links[t, 2])


@njit(cache=True, nogil=True, error_model="numpy")
def pair_outside(a, b, v, outward, near, margin, rest, swap, first_key, rows, count):
    """Pair a vertex with features of b that it is outside of and near; returns the rows written.

    `near` is how many triangles `rows.found` lists; for the rest see `pair_vertices`.
    """
    same = len(rest.offsets) > 0
    p = row(a.x, v)
    for k in range(near):
        t = rows.found[k]
        kind, feature, w, foot, n, gap = nearest_feature(
            p, b.x, b.surface.links, b.surface.fans, b.normals, t, margin
        )
        if kind == NONE or gap >= margin or gap < 0.0:
            continue
        # Two vertices are found from both sides: they count from one.
        if kind == CORNER and (swap or (same and feature < v)):
            continue
        if same and is_barred(rest.stamps, b.surface, v, kind, feature):
            continue
        if steepest_descent(a.x, a.surface.fans, v, n) > CONE_TOLERANCE:
            continue
        one = ((v, v, v), (1.0, 0.0, 0.0), p)
        other = (corners_of(b.surface.links, t), w, foot)
        key = first_key + feature_number(b, kind, feature)
        write_row(rows.integers, rows.reals, count, swap, one, other, n, gap, key)
        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def pair_inside(
    a, b, v, outward, near, first, last, depth, rest, swap, first_key, rows, count
):  # fmt: skip
    """Pair a vertex that is inside b with the nearest way out; returns the rows written.

    `near` is how many triangles `rows.found` lists, `first` and `last` the places of those in the
    grid that may bar the way; for the rest see `pair_vertices`.
    """
    same = len(rest.offsets) > 0
    limit = _AT_EACH_OTHER if same else _SAME_WAY
    p = row(a.x, v)
    best = -1
    inmost = -depth
    for k in range(near):
        t = rows.found[k]
        kind, feature, _, foot, n, gap = nearest_feature(
            p, b.x, b.surface.links, b.surface.fans, b.normals, t, -inmost
        )
        if kind == NONE or gap >= 0.0 or gap <= inmost or dot(outward, n) >= limit:
            continue
        if same and is_barred(rest.stamps, b.surface, v, kind, feature):
            continue
        if way_is_clear(b.x, b.surface.links, b.grid.items, first, last, foot, p):
            best, inmost = t, gap
    if best < 0:
        return count
    kind, feature, w, foot, n, gap = nearest_feature(
        p, b.x, b.surface.links, b.surface.fans, b.normals, best, 2.0 * depth
    )
    one = ((v, v, v), (1.0, 0.0, 0.0), p)
    other = (corners_of(b.surface.links, best), w, foot)
    key = first_key + feature_number(b, kind, feature)
    write_row(rows.integers, rows.reals, count, swap, one, other, n, gap, key)
    return count + 1


@njit(cache=True, nogil=True, error_model="numpy")
def pair_vertices(a, b, region, margin, depth, rest, swap, first_key, rows, count):
    """Pair the vertices of surface a with features of surface b.

    Args:
        a: Surface whose vertices they are, a `SurfaceSide`.
        b: Surface whose triangles they are; its boxes reach as far as margin and depth.
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
    reach = max(margin, depth)
    x, links, fans, normals = b.x, b.surface.links, b.surface.fans, b.normals
    items, boxes, starts = b.grid.items, b.grid.boxes, b.grid.starts
    frame, counts = b.grid.frame, b.grid.counts
    own, own_fans, own_normals = a.x, a.surface.fans, a.normals
    found, features = rows.found, feature_count(b)
    for v in a.surface.vertices:
        p = row(own, v)
        if not holds(region, p):
            continue
        cell = cell_at(frame, counts, p)
        first, last = starts[cell], starts[cell + 1]
        front, behind, limit, outward = margin, depth, _NEIGHBOURLY, (0.0, 0.0, 0.0)
        if same:
            outward = mean_normal(own_fans, own_normals, v)
        else:
            distance = signed_distance(
                p, x, links, fans, normals, boxes, items, first, last, reach
            )  # fmt: skip
            if distance >= margin:
                continue
            # Acute edges turn their back to what is beside them.
            front, behind = (margin, margin) if distance >= 0.0 else (0.0, depth)
        near = near_triangles(
            p, outward, limit, x, links, normals, boxes, items, first, last, reach, front, behind,
            found,
        )  # fmt: skip
        if near == 0:
            continue
        key = first_key + v * features
        if same:
            stamp(rest, v)
        if same or distance >= 0.0:
            count = pair_outside(a, b, v, outward, near, margin, rest, swap, key, rows, count)
        if same or distance < 0.0:
            outward = mean_normal(own_fans, own_normals, v)
            count = pair_inside(
                a, b, v, outward, near, first, last, depth, rest, swap, key, rows, count
            )  # fmt: skip
    return count
