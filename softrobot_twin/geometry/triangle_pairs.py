"""Contact pairs between the features of two triangle surfaces: vertex-triangle and edge-edge.

A vertex outside the other surface is paired with each feature at which its distance has a local
minimum. The neighbours of the vertex must not come closer still (local minimal distances, Johnson
and Willemsen 2003). A vertex inside is paired once, with the nearest feature whose normal does not
point in the same direction as the normal of the vertex, and is separated along the normal of that
feature.

Two edges have a local minimum of distance inside both where their common perpendicular n points
out of the second body (it lies between the normals of the two triangles there) and into the first
body. The orientation of n follows from these normals and not from the vector between the edges, so
n does not flip when the edges pass through each other; the gap changes its sign instead.

Arguments of the kernels here:
    a, b: The first and the second surface, each a `SurfaceSide`.
    boxes: Lower and upper corner of the box of each item [m], shape (item_count, 6).
    e, f: An edge of the first, and of the second surface.
    end: A point, three numbers [m].
    frame: Lower corner [m], upper corner [m] and cells per length [1/m], shape (3, 3).
    low, high: First and last cell along each axis, shape (3,).
    others: Edges of the other surface, shape (other_edge_count, 6).
    rest: Excluded pairs of one surface, see `ExcludedPairs`.
    s, t: Fractions along these, 0 to 1.
    side: A `SurfaceSide`.
    stamps: Marks of the triangles, shape (triangle_count,).
    start: A point, three numbers [m].
    w: Barycentric weights, three numbers.
    y: Points of the other surface [m], shape (other_point_count, 3).
Those of a surface are as in `closed_surface`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.broad_phase import CellGrid, cell_at, cell_of, holds
from softrobot_twin.geometry.closed_surface import (
    ClosedSurface,
    edge_normal,
    is_outside_cone,
    mean_normal,
    steepest_descent,
    vertex_normal,
)
from softrobot_twin.geometry.closest_features import (
    CORNER,
    EDGE,
    FACE,
    NO_DISTANCE,
    NONE,
    ROUND_OFF,
    near_triangles,
    nearest_feature,
    segment_is_clear,
    signed_distance,
)
from softrobot_twin.geometry.proximities import write_row
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, norm, row, scaled, subtract
from softrobot_twin.kernels.compilation import INLINED, INNER, ONCE, njit

# Reasons for excluding a pair of a vertex and a triangle, in `ExcludedPairs.codes`: they are
# neighbours, or the vertex is a corner of the triangle. SURROUNDED is added where all triangles
# around that triangle are excluded as well.
NEIGHBOUR, TOUCHING, SURROUNDED = 1, 2, 2
# All codes are smaller than this.
_CODE_COUNT = 8


class ExcludedPairs(NamedTuple):
    """Pairs of a vertex and a triangle of one surface that can never collide.

    Attributes:
        offsets: Start of the triangles of each point, shape (point_count + 1,); length 0 for two
            different surfaces.
        triangles: The excluded triangles of all points, concatenated.
        codes: Reason for each of them.
        stamps: Work array, shape (triangle_count,).
        points: Points at rest [m], shape (point_count, 3).
        normals: Normals at rest, see `SurfaceSide`.
        near: Distance at rest below which two edges must face each other across air [m].
    """

    offsets: np.ndarray
    triangles: np.ndarray
    codes: np.ndarray
    stamps: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    near: float


def no_excluded_pairs() -> ExcludedPairs:
    """No excluded pairs, for two different surfaces."""
    none = np.zeros(0, dtype=np.int64)
    return ExcludedPairs(none, none, none, none, np.empty((0, 3)), np.empty((0, 4)), 0.0)


@njit(**INNER)
def stamp(rest, v):
    """Mark the triangles excluded for vertex v."""
    for k in range(rest.offsets[v], rest.offsets[v + 1]):
        rest.stamps[rest.triangles[k]] = _CODE_COUNT * v + rest.codes[k]


@njit(**INLINED)
def _stamps_of_fully_excluded(v):
    """First and last mark of the triangles all of whose features are excluded for vertex v."""
    return (_CODE_COUNT * v + SURROUNDED + 1, _CODE_COUNT * v + _CODE_COUNT - 1)


@njit(**INLINED)
def _code_of(stamps, v, t):
    """Reason for excluding vertex v and triangle t as a pair, 0 for none; call `stamp` before."""
    code = stamps[t] - _CODE_COUNT * v
    return code if 0 < code < _CODE_COUNT else 0


@njit(**INNER)
def _is_excluded(stamps, surface, v, kind, feature):
    """Whether a feature is excluded for vertex v: all its triangles are, or one touches v."""
    if kind == FACE:
        return _code_of(stamps, v, feature) > 0
    every = True
    for k in range(2 if kind == EDGE else surface.fans[feature, 0]):
        t = surface.edges[feature, 2 + k] if kind == EDGE else surface.fans[feature, 1 + 3 * k]
        code = _code_of(stamps, v, t)
        if code == TOUCHING or code == TOUCHING + SURROUNDED:
            return True
        every = every and code > 0
    return every


# Sine by which a direction may lie outside a normal cone: bodies rotate by about this angle in one
# step, and additional pairs do no harm while the bodies are apart.
CONE_TOLERANCE = 0.2
# The same for a vertex of a rigid surface against an edge or a corner: the direction is the vector
# between the two points, and outside the cone it would point along the surface.
RIGID_CONE_TOLERANCE = 0.02
# Cosine between the normals of a vertex and a feature above which they point in the same direction
# and cannot collide, from outside or from inside.
_SAME_DIRECTION = 0.3
# Cosine below which they face each other. A vertex inside whose shortest direction out lies along
# its own surface is skipped: it would be pushed sideways, and deeper vertices separate the bodies.
_FACING = -0.25
# Within one surface, the distance is not computed if this cosine is exceeded.
_NEARLY_PARALLEL = 0.97


class SurfaceSide(NamedTuple):
    """Current state of one surface.

    Attributes:
        x: Points [m].
        surface: The surface.
        normals: Its unit normals and plane offsets, shape (triangle_count, 4).
        grid: Grid of its triangles.
        leaders: See `FlatRegions`; of length 0 if the surface deforms.
        ridges: Whether an edge is convex, shape (edge_count,).
        crests: Points that may touch: those of `FlatRegions`, or all.
    """

    x: np.ndarray
    surface: ClosedSurface
    normals: np.ndarray
    grid: CellGrid
    leaders: np.ndarray
    ridges: np.ndarray
    crests: np.ndarray


@njit(**INLINED)
def feature_count(b):
    """Number of features of a surface."""
    return len(b.surface.links) + len(b.surface.edges) + len(b.x)


@njit(**INLINED)
def _feature_number(b, kind, feature):
    """Number of a feature among triangles, then edges, then points."""
    if kind == FACE:
        return feature
    if kind == EDGE:
        return len(b.surface.links) + feature
    return len(b.surface.links) + len(b.surface.edges) + feature


@njit(**INLINED)
def _bearing_points(links, t, w):
    """Corners of triangle t; those with zero weight are replaced by one with a weight."""
    i = 0 if w[0] > 0.0 else (1 if w[1] > 0.0 else 2)
    one = links[t, i]
    return (
        one,
        links[t, 1] if w[1] > 0.0 else one,
        links[t, 2] if w[2] > 0.0 else one,
    )


@njit(**ONCE)
def _pair_outside(a, b, v, outward, near, margin, rest, swap, first_key, rows, count):
    """Pair a vertex outside b with the features of b near it; returns the rows written.

    `b.grid.near` lists `near` triangles; for the other arguments see `pair_vertices`.
    """
    same = len(rest.offsets) > 0
    p = row(a.x, v)
    for k in range(near):
        t = b.grid.near[k]
        kind, feature, w, foot, n, gap = nearest_feature(
            p, b.x, b.surface.links, b.surface.fans, b.normals, t, margin
        )
        if kind == NONE or gap >= margin or gap < 0.0:
            continue
        # A pair of two vertices is found from both sides and must count once.
        if kind == CORNER and (swap or (same and feature < v)):
            continue
        if same and _is_excluded(rest.stamps, b.surface, v, kind, feature):
            continue
        # The far side of a thin body is not a local minimum.
        if dot(outward, n) > _SAME_DIRECTION:
            continue
        tolerance = RIGID_CONE_TOLERANCE if kind != FACE and len(a.leaders) else CONE_TOLERANCE
        if steepest_descent(a.x, a.surface.fans, v, n) > tolerance:
            continue
        one = ((v, v, v), (1.0, 0.0, 0.0), p)
        other = (_bearing_points(b.surface.links, t, w), w, foot)
        key = first_key + _feature_number(b, kind, feature)
        write_row(rows, count, swap, one, other, n, gap, key)
        count += 1
    return count


@njit(**INNER)
def _pair_inside(a, b, v, near, first, last, depth, rest, swap, first_key, rows, count):
    """Pair a vertex inside b with the nearest feature to leave through; returns the rows written.

    `b.grid.near` lists `near` triangles, and positions `first` to `last` - 1 of the grid list the
    triangles that may lie in between; for the other arguments see `pair_vertices`.
    """
    same = len(rest.offsets) > 0
    limit = _FACING if same else _SAME_DIRECTION
    p = row(a.x, v)
    outward = vertex_normal(a.x, a.surface.fans, a.normals, v)
    best = -1
    inmost = -depth
    for k in range(near):
        t = b.grid.near[k]
        kind, feature, _, foot, n, gap = nearest_feature(
            p, b.x, b.surface.links, b.surface.fans, b.normals, t, -inmost
        )
        if kind == NONE or gap >= 0.0 or gap <= inmost or dot(outward, n) >= limit:
            continue
        if same and _is_excluded(rest.stamps, b.surface, v, kind, feature):
            continue
        if segment_is_clear(b.x, b.surface.links, b.grid.items, first, last, foot, p):
            best, inmost = t, gap
    if best < 0:
        return count
    kind, feature, w, foot, n, gap = nearest_feature(
        p, b.x, b.surface.links, b.surface.fans, b.normals, best, 2.0 * depth
    )
    if dot(outward, n) >= _FACING:
        return count
    one = ((v, v, v), (1.0, 0.0, 0.0), p)
    other = (_bearing_points(b.surface.links, best, w), w, foot)
    key = first_key + _feature_number(b, kind, feature)
    write_row(rows, count, swap, one, other, n, gap, key)
    return count + 1


@njit(**INNER)
def pair_vertices(a, b, region, margin, depth, rest, swap, first_key, rows, count):
    """Pair the vertices of surface a with features of surface b.

    Args:
        a: Surface whose vertices they are, a `SurfaceSide`.
        b: Surface whose triangles they are; its boxes reach as far as margin and depth.
        region: Box that contains all vertices to pair.
        margin: Largest gap of a pair [m].
        depth: Largest depth of a pair [m].
        rest: Excluded pairs of one surface.
        swap: Whether a is the second surface.
        first_key: Key of the first pair.
        rows: Output, from row `count` on.
        count: Rows written before.

    Returns:
        End of the rows; those beyond the room were not written.
    """
    same = len(rest.offsets) > 0
    reach = max(margin, depth)
    x, links, fans, normals = b.x, b.surface.links, b.surface.fans, b.normals
    items, boxes, starts = b.grid.items, b.grid.boxes, b.grid.starts
    frame, counts = b.grid.frame, b.grid.counts
    own, own_fans, own_normals = a.x, a.surface.fans, a.normals
    stamps, found, features = rest.stamps, b.grid.near, feature_count(b)
    for v in a.crests:
        p = row(own, v)
        if not holds(region, p):
            continue
        cell = cell_at(frame, counts, p)
        first, last = starts[cell], starts[cell + 1]
        front, behind, limit, outward = margin, depth, _NEARLY_PARALLEL, (0.0, 0.0, 0.0)
        if same:
            outward = mean_normal(own_fans, own_normals, v)
            stamp(rest, v)
        else:
            distance = signed_distance(p, x, links, fans, normals, boxes, items, first, last, reach)
            if distance >= margin:
                continue
            # Near an acute edge a vertex may be behind a triangle and still outside. For a vertex
            # inside, the nearest feature is nearly always the right one.
            front, behind = margin, margin
            if distance < 0.0:
                # Where a vertex touches, round-off decides on which side of a triangle it is.
                front = NO_DISTANCE * reach
                behind = min(depth, ROUND_OFF * -distance + front)
        near = near_triangles(
            p, outward, limit, stamps, _stamps_of_fully_excluded(v), x, links, normals, boxes,
            items, first, last, reach, front, behind, found,
        )  # fmt: skip
        if near == 0:
            continue
        key = first_key + v * features
        if not same:
            outward = mean_normal(own_fans, own_normals, v)
        if same or distance >= 0.0:
            count = _pair_outside(a, b, v, outward, near, margin, rest, swap, key, rows, count)
        if same or distance < 0.0:
            before = count
            count = _pair_inside(a, b, v, near, first, last, depth, rest, swap, key, rows, count)
            if not same and count == before:
                near = near_triangles(
                    p, outward, _SAME_DIRECTION, stamps,
                    _stamps_of_fully_excluded(v), x, links, normals, boxes,
                    items, first, last, reach, front, depth, found,
                )  # fmt: skip
                count = _pair_inside(a, b, v, near, first, last, depth, rest, swap, key, rows, count)
    return count


# Sine of the angle below which two edges count as parallel: their common perpendicular is then
# ill-conditioned, and their vertices carry the contact.
PARALLEL_SINE = 0.05
# Cosine of the angle between two triangles below which the edge between them counts as flat.
_FLAT_COSINE = np.cos(0.01)
# Scalar product of the sums of the two normals at two edges, at most 4, above which the normals
# point in the same direction and the edges cannot collide.
_SAME_SUM = 2.0
# Sine by which the normal of two overlapping edges may lie outside their cones.
_OVERLAP_TOLERANCE = 0.02
# Sine of the elevation above which two features face each other.
FACING_SINE = 0.3


@njit(**ONCE)
def find_ridges(x, edges, normals, ridges):
    """Mark the convex edges, except nearly flat ones.

    Returns:
        Half the length of the longest of them [m]: no overlap of edges is deeper.
    """
    for e in range(len(edges)):
        n, m = row(normals, edges[e, 2]), row(normals, edges[e, 3])
        start = row(x, edges[e, 0])
        ridges[e] = (dot(n, m) < _FLAT_COSINE and dot(subtract(row(x, edges[e, 5]), start), n) < 0.0)
    return half_longest_ridge(x, edges, ridges)


@njit(**INNER)
def half_longest_ridge(x, edges, ridges):
    """Half the length of the longest ridge [m]: no overlap of edges is deeper."""
    longest = 0.0
    for e in range(len(edges)):
        if ridges[e]:
            along = subtract(row(x, edges[e, 1]), row(x, edges[e, 0]))
            longest = max(longest, dot(along, along))
    return 0.5 * np.sqrt(longest)


@njit(**INLINED)
def crossing(x, edges, e, y, others, f):
    """Foot points of the common perpendicular of two edges.

    Returns:
        Whether both foot points lie between the ends, their fractions along the edges, and the
        unit perpendicular.
    """
    p, q = row(x, edges[e, 0]), row(y, others[f, 0])
    u, w = subtract(row(x, edges[e, 1]), p), subtract(row(y, others[f, 1]), q)
    n = cross(u, w)
    squared = dot(n, n)
    uu, ww = dot(u, u), dot(w, w)
    if squared <= PARALLEL_SINE * PARALLEL_SINE * uu * ww:
        return False, 0.5, 0.5, n
    between = subtract(q, p)
    s = dot(cross(between, w), n) / squared
    t = dot(cross(between, u), n) / squared
    inside = 0.0 < s < 1.0 and 0.0 < t < 1.0
    return inside, s, t, scaled(n, 1.0 / np.sqrt(squared))


@njit(**INLINED)
def _point_at(x, edges, e, s):
    """Point at fraction s of edge e [m]."""
    start = row(x, edges[e, 0])
    return add_scaled(start, subtract(row(x, edges[e, 1]), start), s)


@njit(**INLINED)
def _depth_to_ends(x, edges, e, s):
    """Distance from a point of an edge to its nearer end [m]: vertices handle deeper overlaps."""
    return min(s, 1.0 - s) * norm(subtract(row(x, edges[e, 1]), row(x, edges[e, 0])))


@njit(**INNER)
def is_inside(side, start, end):
    """Whether the segment from a point on the surface to a point behind it stays inside."""
    frame, starts = side.grid.frame, side.grid.starts
    for axis in range(3):
        if end[axis] < frame[0, axis] or end[axis] > frame[1, axis]:
            return False
    cell = cell_at(frame, side.grid.counts, end)
    return segment_is_clear(
        side.x, side.surface.links, side.grid.items, starts[cell], starts[cell + 1], start, end
    )


@njit(**ONCE)
def _face_across_air(rest, edges, e, f):
    """Whether two edges of one surface are far apart, or face each other across air."""
    x, normals = rest.points, rest.normals
    _, s, t, _ = crossing(x, edges, e, x, edges, f)
    p = _point_at(x, edges, e, min(max(s, 0.0), 1.0))
    q = _point_at(x, edges, f, min(max(t, 0.0), 1.0))
    away = subtract(p, q)
    distance = norm(away)
    if distance > rest.near:
        return True
    return (
        dot(away, edge_normal(normals, edges[f, 2], edges[f, 3])) > FACING_SINE * distance
        and dot(away, edge_normal(normals, edges[e, 2], edges[e, 3])) < -FACING_SINE * distance
    )


@njit(**ONCE)
def pair_edges(a, b, edge_grid, margin, depth, rest, first_key, rows, count):
    """Pair ridges of surface a with ridges of surface b.

    Args:
        a: First surface, a `SurfaceSide`.
        b: Second surface.
        edge_grid: Grid of the ridges of b, boxes enlarged by the larger of margin and depth.
        margin: Largest gap of a pair [m].
        depth: Largest depth of a pair [m].
        rest: Excluded pairs of one surface.
        first_key: Key of the first pair.
        rows: Output, from row `count` on.
        count: Rows written before.

    Returns:
        End of the rows; those beyond the room were not written.
    """
    same = len(rest.offsets) > 0
    low = np.empty(3, dtype=np.int64)
    high = np.empty(3, dtype=np.int64)
    x, edges, normals, ridges = a.x, a.surface.edges, a.normals, a.ridges
    y, others, other_normals = b.x, b.surface.edges, b.normals
    boxes, items, starts = edge_grid.boxes, edge_grid.items, edge_grid.starts
    frame, counts = edge_grid.frame, edge_grid.counts
    for e in range(len(edges)):
        if not ridges[e] or not _cells_of_edge(x, edges, e, frame, counts, low, high):
            continue
        out = add_scaled(row(normals, edges[e, 2]), row(normals, edges[e, 3]), 1.0)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    cell = (i * counts[1] + j) * counts[2] + k
                    for place in range(starts[cell], starts[cell + 1]):
                        f = items[place]
                        if (same and f <= e) or not _boxes_meet(x, edges, e, boxes, f):
                            continue
                        other_out = add_scaled(
                            row(other_normals, others[f, 2]), row(other_normals, others[f, 3]), 1.0
                        )  # fmt: skip
                        if dot(out, other_out) > _SAME_SUM:
                            continue
                        if not _first_shared_cell(frame, counts, boxes, f, low, i, j, k):
                            continue
                        near_by, s, t, n, gap = _cross_edges(
                            x, edges, normals, e, y, others, other_normals, f, margin, depth
                        )
                        if not near_by or (same and _share_a_point(edges, e, f)):
                            continue
                        if gap < 0.0 and not overlap(a, b, e, s, f, t):
                            continue
                        if same and not _face_across_air(rest, edges, e, f):
                            continue
                        key = first_key + e * len(others) + f
                        _write_edges(x, edges, e, s, y, others, f, t, n, gap, key, rows, count)
                        count += 1
    return count


@njit(**ONCE)
def _cells_of_edge(x, edges, e, frame, counts, low, high):
    """Find the first and last cell of an edge along each axis; false if it is outside the grid."""
    for axis in range(3):
        p, q = x[edges[e, 0], axis], x[edges[e, 1], axis]
        if max(p, q) < frame[0, axis] or min(p, q) > frame[1, axis]:
            return False
        low[axis] = cell_of(frame, counts, axis, min(p, q))
        high[axis] = cell_of(frame, counts, axis, max(p, q))
    return True


@njit(**ONCE)
def _first_shared_cell(frame, counts, boxes, f, low, i, j, k):
    """Whether cell (i, j, k) is the first that item f shares with a box: pairs count once."""
    return (
        i == max(low[0], cell_of(frame, counts, 0, boxes[f, 0]))
        and j == max(low[1], cell_of(frame, counts, 1, boxes[f, 1]))
        and k == max(low[2], cell_of(frame, counts, 2, boxes[f, 2]))
    )


@njit(**ONCE)
def _boxes_meet(x, edges, e, boxes, f):
    """Whether the box of edge e intersects that of item f."""
    for axis in range(3):
        p, q = x[edges[e, 0], axis], x[edges[e, 1], axis]
        if max(p, q) < boxes[f, axis] or min(p, q) > boxes[f, axis + 3]:
            return False
    return True


@njit(**ONCE)
def _share_a_point(edges, e, f):
    """Whether two edges of one surface have a common end."""
    return (
        edges[e, 0] == edges[f, 0] or edges[e, 0] == edges[f, 1]
        or edges[e, 1] == edges[f, 0] or edges[e, 1] == edges[f, 1]
    )  # fmt: skip


@njit(**ONCE)
def _cross_edges(x, edges, normals, e, y, others, other_normals, f, margin, depth):
    """Whether edges e and f cross near each other; fractions along them, normal and gap [m]."""
    inside, s, t, n = crossing(x, edges, e, y, others, f)
    gap = 0.0
    if inside:
        if dot(n, edge_normal(other_normals, others[f, 2], others[f, 3])) < 0.0:
            n = scaled(n, -1.0)
        gap = dot(subtract(_point_at(x, edges, e, s), _point_at(y, others, f, t)), n)
        tolerance = CONE_TOLERANCE if gap >= 0.0 else _OVERLAP_TOLERANCE
        inside = (
            -depth <= gap < margin
            and dot(n, edge_normal(normals, edges[e, 2], edges[e, 3])) < 0.0
            and not is_outside_cone(y, others, f, n, tolerance)
            and not is_outside_cone(x, edges, e, scaled(n, -1.0), tolerance)
        )
    return inside, s, t, n, gap


@njit(**INLINED)
def _is_behind(normals, edges, e, away, most):
    """Whether a way from a convex edge is behind both of its triangles, or above by `most` [m]."""
    return dot(away, row(normals, edges[e, 2])) <= most and dot(away, row(normals, edges[e, 3])) <= most


@njit(**ONCE)
def overlap(a, b, e, s, f, t):
    """Whether the foot point on e is inside b and that on f inside a, neither too deep."""
    p, q = _point_at(a.x, a.surface.edges, e, s), _point_at(b.x, b.surface.edges, f, t)
    away = subtract(p, q)
    deep = norm(away)
    return (
        _is_behind(b.normals, b.surface.edges, f, away, _OVERLAP_TOLERANCE * deep)
        and _is_behind(a.normals, a.surface.edges, e, scaled(away, -1.0), _OVERLAP_TOLERANCE * deep)
        and deep <= _depth_to_ends(a.x, a.surface.edges, e, s)
        and deep <= _depth_to_ends(b.x, b.surface.edges, f, t)
        and is_inside(b, q, p)
        and is_inside(a, p, q)
    )


@njit(**ONCE)
def _write_edges(x, edges, e, s, y, others, f, t, n, gap, key, rows, place):
    """Write a pair of edges as a row."""
    start, end = edges[e, 0], edges[e, 1]
    first = ((start, end, end), (1.0 - s, s, 0.0), _point_at(x, edges, e, s))
    start, end = others[f, 0], others[f, 1]
    second = ((start, end, end), (1.0 - t, t, 0.0), _point_at(y, others, f, t))
    write_row(rows, place, False, first, second, n, gap, key)
