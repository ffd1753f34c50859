"""Vertices of one surface that are near to, or behind, the triangles of another.

A vertex outside is paired with each feature at which its distance from the other surface has a
local minimum, as far as its own neighbours allow: they must not come closer still (local minimal
distances, Johnson and Willemsen 2003). A vertex inside is
paired once, with the nearest feature that does not look the same way as the vertex itself, and must
go out along that feature's normal.
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
    vertex_normal,
)
from softrobot_twin.geometry.nearest_feature import (
    CORNER,
    EDGE,
    FACE,
    NO_DISTANCE,
    NONE,
    ROUND_OFF,
    nearest_feature,
)
from softrobot_twin.geometry.pair_rows import write_row
from softrobot_twin.geometry.rest_pairs import is_barred, stamp, stamps_of_surrounded
from softrobot_twin.geometry.triangle_search import near_triangles, signed_distance, way_is_clear
from softrobot_twin.geometry.vector3 import dot, row

# Sine by which a neighbour may be closer than a vertex that still counts: the bodies turn by about
# as much within a step, and a pair more does no harm while they are apart.
CONE_TOLERANCE = 0.2
# The same for a vertex that keeps its shape, against an edge or a corner: then the direction is
# that from point to point and turns as they pass each other. Outside the cone it would act along
# the surface.
RIGID_CONE_TOLERANCE = 0.02
# Cosine between a vertex's normal and a feature's above which they look the same way: neither can
# have come upon the other, be it from outside or from within.
_SAME_WAY = 0.3
# Cosine below which they look at each other. A vertex that is inside with the nearest way out along
# its own surface is left to those deeper in, or it would be pushed aside.
_AT_EACH_OTHER = -0.25
# On one and the same surface, what looks about the same way is not even asked how near it is.
_NEIGHBOURLY = 0.97


class SurfaceSide(NamedTuple):
    """One surface as it is now.

    Attributes:
        x: Points [m].
        surface: The surface.
        normals: Its unit normals and plane offsets, shape (triangle_count, 4).
        ridges: Whether an edge sticks out, shape (edge_count,).
        grid: Its triangles.
        leaders: See `FlatRegions`; of length 0 where the surface deforms.
        crests: Points that may touch: those of `FlatRegions`, or all.
    """

    x: np.ndarray
    surface: ClosedSurface
    normals: np.ndarray
    ridges: np.ndarray
    grid: CellGrid
    leaders: np.ndarray
    crests: np.ndarray


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
def bearing_points(links, t, w):
    """Corners of triangle t, one that bears something in place of those that bear nothing."""
    i = 0 if w[0] > 0.0 else (1 if w[1] > 0.0 else 2)
    one = links[t, i]
    return (
        one,
        links[t, 1] if w[1] > 0.0 else one,
        links[t, 2] if w[2] > 0.0 else one,
    )


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
        # The far side of a thin body is no local minimum either.
        if dot(outward, n) > _SAME_WAY:
            continue
        tolerance = RIGID_CONE_TOLERANCE if kind != FACE and len(a.leaders) else CONE_TOLERANCE
        if steepest_descent(a.x, a.surface.fans, v, n) > tolerance:
            continue
        one = ((v, v, v), (1.0, 0.0, 0.0), p)
        other = (bearing_points(b.surface.links, t, w), w, foot)
        key = first_key + feature_number(b, kind, feature)
        write_row(rows.integers, rows.reals, count, swap, one, other, n, gap, key)
        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def pair_inside(
    a, b, v, near, first, last, depth, rest, swap, first_key, rows, count
):  # fmt: skip
    """Pair a vertex that is inside b with the nearest way out; returns the rows written.

    `near` is how many triangles `rows.found` lists, `first` and `last` the places of those in the
    grid that may bar the way; for the rest see `pair_vertices`.
    """
    same = len(rest.offsets) > 0
    limit = _AT_EACH_OTHER if same else _SAME_WAY
    p = row(a.x, v)
    outward = vertex_normal(a.x, a.surface.fans, a.normals, v)
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
    if dot(outward, n) >= _AT_EACH_OTHER:
        return count
    one = ((v, v, v), (1.0, 0.0, 0.0), p)
    other = (bearing_points(b.surface.links, best, w), w, foot)
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
    stamps, found, features = rest.stamps, rows.found, feature_count(b)
    for v in a.crests:
        p = row(own, v)
        if not holds(region, p):
            continue
        cell = cell_at(frame, counts, p)
        first, last = starts[cell], starts[cell + 1]
        front, behind, limit, outward = margin, depth, _NEIGHBOURLY, (0.0, 0.0, 0.0)
        if same:
            outward = mean_normal(own_fans, own_normals, v)
            stamp(rest, v)
        else:
            distance = signed_distance(
                p, x, links, fans, normals, boxes, items, first, last, reach
            )  # fmt: skip
            if distance >= margin:
                continue
            # Acute edges turn their back to what is beside them. Inside, the nearest feature is
            # nearly always the one.
            front, behind = margin, margin
            if distance < 0.0:
                front, behind = 0.0, min(depth, ROUND_OFF * -distance + NO_DISTANCE)
        near = near_triangles(
            p, outward, limit, stamps, stamps_of_surrounded(v), x, links, normals, boxes, items,
            first, last, reach, front, behind, found,
        )  # fmt: skip
        if near == 0:
            continue
        key = first_key + v * features
        if not same:
            outward = mean_normal(own_fans, own_normals, v)
        if same or distance >= 0.0:
            count = pair_outside(a, b, v, outward, near, margin, rest, swap, key, rows, count)
        if same or distance < 0.0:
            before = count
            count = pair_inside(a, b, v, near, first, last, depth, rest, swap, key, rows, count)
            if not same and count == before:
                near = near_triangles(
                    p, outward, _SAME_WAY, stamps,
                    stamps_of_surrounded(v), x, links, normals, boxes,
                    items, first, last, reach, front, depth, found,
                )  # fmt: skip
                count = pair_inside(
                    a, b, v, near, first, last, depth, rest, swap, key, rows, count
                )  # fmt: skip
    return count
