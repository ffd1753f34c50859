"""Detectors of contacts of a surface with itself: general, and for pairs named in advance.

Neighbouring features are always near each other and never collide. `SelfDetector` excludes a pair
of a vertex and a triangle, or of two edges, permanently if in the rest shape

- they touch, or
- they were near each other along the surface and did not face each other across a gap of air, as
  the two flanks of a notch do, or
- they were near each other through the body, as the two faces of a thin sheet are: later, a vertex
  at such a small distance behind a triangle would look like one that has passed through it.

`FixedPairs` measures only the pairs that a scene names.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.broad_phase import bounding_box, empty_grid, fill_grid, with_capacity
from softrobot_twin.geometry.closed_surface import (
    ClosedSurface,
    closed_surface,
    compute_normals,
    mean_edge_length,
    mean_normal,
)
from softrobot_twin.geometry.closest_features import closest_weights
from softrobot_twin.geometry.proximities import Proximities, empty_rows, proximities
from softrobot_twin.geometry.surface_pairs import checked_points
from softrobot_twin.geometry.triangle_pairs import (
    FACING_SINE,
    NEIGHBOUR,
    SURROUNDED,
    TOUCHING,
    ExcludedPairs,
    SurfaceSide,
    feature_count,
    find_ridges,
    pair_edges,
    pair_vertices,
)
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, norm, row, scaled, subtract

_FIRST_CAPACITY = 256
# Default depth, in mean edge lengths.
_DEPTH_IN_EDGES = 0.5
# Strain may bring what lies behind a triangle nearer to it, by no more than this.
_THROUGH_THE_BODY = 2.0
# A way along edges is longer than the straight one over the triangles by no more than this.
_DETOUR = 1.5
# Vertices whose ways are found at once: bounds the memory.
_CHUNK = 256


@njit(cache=True, nogil=True, error_model="numpy")
def mark_excluded_pairs(x, links, normals, fans, vertices, ways, alarm, through, listed):
    """List the pairs of some vertices and all triangles that must never count.

    Args:
        x: Points at rest [m].
        links: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        fans: See `ClosedSurface`.
        vertices: The vertices.
        ways: Length of the way along edges from each of these to each point [m], infinite where
            long, shape (len(vertices), point_count).
        alarm: Distance along the surface under which a pair needs air between [m].
        through: Distance through the body under which it does [m].
        listed: Gets why a pair does not count, 0 if it does, shape (len(vertices),
            triangle_count).
    """
    for i in range(len(vertices)):
        v = vertices[i]
        p = row(x, v)
        outward = mean_normal(fans, normals, v)
        for t in range(len(links)):
            listed[i, t] = 0
            if links[t, 0] == v or links[t, 1] == v or links[t, 2] == v:
                listed[i, t] = TOUCHING
                continue
            n = row(normals, t)
            if abs(dot(p, n) - normals[t, 3]) > max(alarm, through):
                continue
            a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
            w = closest_weights(p, a, b, c)
            away = subtract(p, add_scaled(add_scaled(scaled(a, w[0]), b, w[1]), c, w[2]))
            distance = norm(away)
            rise = dot(away, n)
            if rise > FACING_SINE * distance and dot(away, outward) < -FACING_SINE * distance:
                continue
            # The way to the triangle may end inside it, far from its corners.
            size = max(norm(subtract(b, a)), max(norm(subtract(c, b)), norm(subtract(a, c))))
            way = min(ways[i, links[t, 0]], min(ways[i, links[t, 1]], ways[i, links[t, 2]]))
            near_along = distance <= alarm and way <= _DETOUR * alarm + size
            if near_along or (distance <= through and rise <= 0.0):
                listed[i, t] = NEIGHBOUR


@njit(cache=True, nogil=True, error_model="numpy")
def surrounded(links, fans, listed, rows, columns):
    """Whether all triangles that touch a listed one are listed too, for each of some pairs."""
    result = np.ones(len(rows), dtype=np.int64)
    for k in range(len(rows)):
        for c in range(3):
            v = links[columns[k], c]
            for m in range(fans[v, 0]):
                if listed[rows[k], fans[v, 1 + 3 * m]] == 0:
                    result[k] = 0
    return result


def find_excluded_pairs(
    surface: ClosedSurface, points: np.ndarray, alarm_distance: float, through: float
) -> ExcludedPairs:
    """Finds the pairs of a surface that must never count.

    Args:
        surface: The surface.
        points: Its points at rest [m], shape (point_count, 3).
        alarm_distance: Distance along the surface under which a pair needs air between [m].
        through: Distance through the body under which it does [m].

    Returns:
        The pairs.
    """
    normals = np.empty((len(surface.links), 4))
    compute_normals(points, surface.links, normals)
    starts, ends = surface.edges[:, 0], surface.edges[:, 1]
    lengths = np.linalg.norm(points[ends] - points[starts], axis=1)
    # Older SciPy finds ways only where indices are of 32 bits.
    places = (starts.astype(np.int32), ends.astype(np.int32))
    graph = coo_array((lengths, places), shape=(len(points), len(points))).tocsr()
    longest = lengths.max(initial=0.0)
    counts = np.zeros(len(points), dtype=np.int64)
    triangles, codes = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for start in range(0, len(surface.vertices), _CHUNK):
        vertices = surface.vertices[start : start + _CHUNK]
        limit = _DETOUR * alarm_distance + longest
        ways = dijkstra(graph, directed=False, indices=vertices, limit=limit)
        listed = np.empty((len(vertices), len(surface.links)), dtype=np.int8)
        mark_excluded_pairs(
            points, surface.links, normals, surface.fans, vertices, ways, float(alarm_distance),
            float(through), listed,
        )  # fmt: skip
        rows, columns = np.nonzero(listed)
        counts[vertices] = np.bincount(rows, minlength=len(vertices))
        triangles.append(columns)
        around = surrounded(surface.links, surface.fans, listed, rows, columns)
        codes.append(listed[rows, columns] + SURROUNDED * around)
    return ExcludedPairs(
        offsets=np.concatenate([[0], np.cumsum(counts)]),
        triangles=np.concatenate(triangles),
        codes=np.concatenate(codes).astype(np.int64),
        stamps=np.zeros(len(surface.links), dtype=np.int64),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def pair_surface_with_itself(
    side, edge_grid, margin, depth, rest, rest_points, rest_normals, near, rows
):  # fmt: skip
    """All pairs of one surface with itself.

    Args:
        side: The surface, a `SurfaceSide`.
        edge_grid: Work space for its edges.
        margin: Gap up to which pairs count [m].
        depth: Depth up to which they do [m].
        rest: Pairs that never count.
        rest_points: Points at rest [m].
        rest_normals: Normals at rest.
        near: Distance at rest under which edges need air between them [m].
        rows: What is found.

    Returns:
        Rows found, and the places that the grids of the triangles and of the edges need. Where one
        of these is more than there is room for, the rows are not complete.
    """
    x, surface = side.x, side.surface
    region = bounding_box(x, surface.vertices)
    compute_normals(x, surface.links, side.normals)
    edge_depth = min(depth, find_ridges(x, surface.edges, side.normals, side.ridges))
    need = fill_grid(
        x, surface.links, 3, max(margin, depth), region, side.ridges[:0], side.grid
    )  # fmt: skip
    need_edges = fill_grid(
        x, surface.edges, 2, max(margin, edge_depth), region, side.ridges, edge_grid
    )  # fmt: skip
    if need > len(side.grid.items) or need_edges > len(edge_grid.items):
        return 0, need, need_edges
    count = pair_vertices(side, side, region, margin, depth, rest, False, 0, rows, 0)
    key = len(x) * feature_count(side)
    count = pair_edges(
        side, side, edge_grid, margin, edge_depth, rest_points, rest_normals, near, key, rows,
        count,
    )  # fmt: skip
    return count, need, need_edges


class SelfDetector:
    """Finds where a surface comes near itself, or has come a little through itself.

    Attributes:
        depth: Depth up to which a vertex that has come through is found [m].
    """

    def __init__(
        self,
        triangles: np.ndarray,
        rest_points: np.ndarray,
        alarm_distance: float,
        depth: float | None = None,
    ):
        """Find what can never meet.

        Args:
            triangles: Point indices, outward normals, shape (triangle_count, 3).
            rest_points: Points at rest [m], shape (point_count, 3).
            alarm_distance: Distance along the surface under which what does not look at each other
                across air is a neighbour [m]; no less than the margins asked for later.
            depth: Depth up to which overlaps are found [m]; by default half the mean edge length.

        Raises:
            MeshError: The surface is not closed or not consistently oriented, or the points have
                another shape.
        """
        rest_points = np.ascontiguousarray(rest_points, dtype=np.float64)
        if rest_points.ndim != 2:
            raise MeshError(None, f"surface points have shape {rest_points.shape}, not (n, 3)")
        self._rest_points = checked_points(rest_points, len(rest_points)).copy()
        surface = self._surface = closed_surface(triangles, len(rest_points))
        if depth is None:
            depth = _DEPTH_IN_EDGES * mean_edge_length(surface, rest_points)
        self.depth = depth
        self._near = max(float(alarm_distance), _THROUGH_THE_BODY * depth)
        self._rest = find_excluded_pairs(surface, rest_points, alarm_distance, _THROUGH_THE_BODY * depth)
        self._normals = np.empty((len(surface.links), 4))
        self._rest_normals = np.empty_like(self._normals)
        compute_normals(self._rest_points, surface.links, self._rest_normals)
        self._ridges = np.empty(len(surface.edges), dtype=np.bool_)
        self._no_leaders = np.empty(0, dtype=np.int64)
        self._grids = [empty_grid(len(surface.links)), empty_grid(len(surface.edges))]
        self._rows = empty_rows(_FIRST_CAPACITY, len(surface.links))

    def detect(self, points: np.ndarray, margin: float) -> Proximities:
        """Finds the pairs that are nearer than a margin.

        Args:
            points: Points now [m], shape (point_count, 3).
            margin: Largest gap of a pair [m].

        Returns:
            The pairs; first and second index the same points.

        Raises:
            MeshError: The points have another shape.
        """
        x = checked_points(points, len(self._rest_points))
        while True:
            side = SurfaceSide(
                x, self._surface, self._normals, self._ridges, self._grids[0], self._no_leaders,
                self._surface.vertices,
            )  # fmt: skip
            count, *needed = pair_surface_with_itself(
                side, self._grids[1], float(margin), float(self.depth), self._rest,
                self._rest_points, self._rest_normals, self._near, self._rows,
            )  # fmt: skip
            grids = [with_capacity(grid, n) for grid, n in zip(self._grids, needed, strict=True)]
            if all(new is old for new, old in zip(grids, self._grids, strict=True)):
                if count <= len(self._rows.reals):
                    return proximities(self._rows, count)
                self._rows = empty_rows(2 * count, len(self._surface.links))
            self._grids = grids


@njit(cache=True, nogil=True, error_model="numpy")
def measure_pairs(x, points, triangles, margin, kept, weights, feet, normals, gaps):
    """Measure every pair; those nearer than the margin are put first, and counted."""
    count = 0
    for pair in range(len(points)):
        p = row(x, points[pair])
        a, b, c = row(x, triangles[pair, 0]), row(x, triangles[pair, 1]), row(x, triangles[pair, 2])
        outward = cross(subtract(b, a), subtract(c, a))
        doubled_area = norm(outward)
        if not doubled_area > 0.0:
            continue
        w = closest_weights(p, a, b, c)
        for i in range(3):
            weights[count, i] = w[i]
            feet[count, i] = w[0] * a[i] + w[1] * b[i] + w[2] * c[i]
            normals[count, i] = outward[i] / doubled_area
        gap = dot(subtract(p, row(feet, count)), row(normals, count))
        if gap < margin:
            kept[count], gaps[count] = pair, gap
            count += 1
    return count


class FixedPairs:
    """Pairs of a point and a triangle of the same body, named in the scene.

    The gap is the height of the point over the triangle's plane along the outward normal, negative
    behind it, however deep: what was named is meant. The point that bears on the triangle is the
    closest one, so that no force lands outside it.
    """

    def __init__(self, point_index: np.ndarray, triangle_points: np.ndarray):
        """Take the pairs.

        Args:
            point_index: Point of each pair, shape (pair_count,).
            triangle_points: Corners of its triangle, outward normal, shape (pair_count, 3).

        Raises:
            MeshError: The shapes do not fit, an index is negative, a triangle names a point twice,
                or a point is a corner of its own triangle.
        """
        points = np.array(point_index, dtype=np.int64).reshape(-1)
        triangles = np.array(triangle_points, dtype=np.int64).reshape(-1, 3)
        if len(points) != len(triangles):
            counts = f"{len(points)} points are paired with {len(triangles)} triangles"
            raise MeshError(None, counts)
        four = np.sort(np.column_stack([points, triangles]), axis=1)
        if four.size and four.min() < 0:
            raise MeshError(None, f"a predefined pair names point {four.min()}")
        twice = np.flatnonzero((np.diff(four, axis=1) == 0).any(axis=1))
        if len(twice):
            raise MeshError(None, f"predefined pair {twice[0]} names a point twice")
        self._points, self._triangles = points, triangles
        self._thrice = np.column_stack([points, points, points])
        self._weights = np.tile([1.0, 0.0, 0.0], (len(points), 1))

    def detect(self, points: np.ndarray, margin: float) -> Proximities:
        """Finds the pairs that are nearer than a margin.

        Args:
            points: Points [m], shape (point_count, 3).
            margin: Largest gap of a pair [m].

        Returns:
            The pairs; the key is a pair's place in the list. A triangle of no area has no normal,
            and its pair is left out.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        room = len(self._points)
        kept, gaps = np.empty(room, dtype=np.int64), np.empty(room)
        weights, feet, normals = np.empty((room, 3)), np.empty((room, 3)), np.empty((room, 3))
        count = measure_pairs(
            points, self._points, self._triangles, float(margin), kept, weights, feet, normals, gaps
        )
        kept = kept[:count]
        return Proximities(
            first_points=self._thrice[kept],
            first_weights=self._weights[kept],
            second_points=self._triangles[kept],
            second_weights=weights[:count],
            first_positions=points[self._points[kept]],
            second_positions=feet[:count],
            normals=normals[:count],
            gaps=gaps[:count],
            keys=kept,
        )
