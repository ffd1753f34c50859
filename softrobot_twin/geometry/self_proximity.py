"""Detectors of contacts of a surface with itself: general, and for pairs named in advance.

Neighbouring features are always near each other and never collide. `SelfDetector` excludes a pair
of a vertex and a triangle, or of two edges, permanently if in the rest shape

- they touch, or
- they were near each other along the surface and did not face each other across a gap of air, as
  the two flanks of a notch do, or
- they were near each other through the body, as the two faces of a thin sheet are: later, a vertex
  at such a small distance behind a triangle would look like one that has passed through it. The way
  from the triangle to the vertex then begins inside the body, by the sign of `signed_distance`: for
  a feature at which the distance has a local minimum, this is the sign of its gap.

`FixedPairs` measures only the pairs that a scene names.

Arguments of the kernels here:
    grid: Grid of all triangles at rest.
    marked: Reason for excluding a pair, 0 for none, shape (vertex_count, triangle_count).
    rows, columns: Vertex and triangle of each excluded pair, shape (pair_count,).
Those of a surface are as in `closed_surface`, those of pairs are as in `proximities`.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from softrobot_twin.geometry.broad_phase import (
    CellGrid,
    bounding_box,
    cell_at,
    empty_grid,
    fill_grid,
    have_room,
)
from softrobot_twin.geometry.closed_surface import (
    ClosedSurface,
    compute_normals,
    mean_edge_length,
    mean_normal,
)
from softrobot_twin.geometry.closest_features import closest_weights, signed_distance
from softrobot_twin.geometry.proximities import Proximities, write_row
from softrobot_twin.geometry.surface_pairs import SurfacePairDetector
from softrobot_twin.geometry.triangle_pairs import (
    FACING_SINE,
    NEIGHBOUR,
    SURROUNDED,
    TOUCHING,
    ExcludedPairs,
)
from softrobot_twin.geometry.vector3 import (
    add_scaled,
    cross,
    divided,
    dot,
    norm,
    row,
    scaled,
    subtract,
)
from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit

# Default depth, in mean edge lengths.
_DEPTH_IN_EDGES = 0.5
# Strain may reduce the distance to features behind a triangle by no more than this factor.
_THROUGH_THE_BODY = 2.0
# Ratio of the length of a path along edges to that of a straight path over triangles, at most.
_DETOUR = 1.5
# Share of the way from a triangle to a vertex after which its side of the surface is looked up.
_BEGIN_OF_WAY = 1.0e-3
# Number of vertices handled at once, which bounds the memory.
_CHUNK = 256


@njit(**ONCE)
def _begins_inside(x, links, fans, normals, grid, reach, foot, away):
    """Whether the way from a point of the surface begins inside the body.

    Args:
        x: Points at rest [m].
        links: See `ClosedSurface`.
        fans: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        grid: Boxes enlarged by `reach`.
        reach: No less than the begin of the way [m].
        foot: The point of the surface [m].
        away: The way [m].
    """
    begin = add_scaled(foot, away, _BEGIN_OF_WAY)
    cell = cell_at(grid.frame, grid.counts, begin)
    distance = signed_distance(
        begin, x, links, fans, normals, grid.boxes, grid.items, grid.starts[cell],
        grid.starts[cell + 1], reach,
    )  # fmt: skip
    return distance < 0.0


@njit(**KERNEL)
def mark_excluded_pairs(x, links, normals, fans, grid, vertices, paths, along, through, marked):
    """Mark the excluded pairs of some vertices and all triangles.

    Args:
        x: Points at rest [m].
        links: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        fans: See `ClosedSurface`.
        grid: Boxes enlarged by `through`.
        vertices: The vertices.
        paths: Length of the shortest path along edges from each of these to each point [m],
            infinite if long, shape (len(vertices), point_count).
        along: Distance along the surface below which a pair must face each other across air [m],
            at least `through`.
        through: Distance through the body below which it must [m].
        marked: Output: reason for excluding a pair, 0 for none, shape (len(vertices),
            triangle_count).
    """
    for i in range(len(vertices)):
        v = vertices[i]
        p = row(x, v)
        outward = mean_normal(fans, normals, v)
        for t in range(len(links)):
            marked[i, t] = 0
            if links[t, 0] == v or links[t, 1] == v or links[t, 2] == v:
                marked[i, t] = TOUCHING
                continue
            n = row(normals, t)
            if abs(dot(p, n) - normals[t, 3]) > along:
                continue
            a, b, c = row(x, links[t, 0]), row(x, links[t, 1]), row(x, links[t, 2])
            w = closest_weights(p, a, b, c)
            foot = add_scaled(add_scaled(scaled(a, w[0]), b, w[1]), c, w[2])
            away = subtract(p, foot)
            distance = norm(away)
            if distance <= through and _begins_inside(x, links, fans, normals, grid, through, foot, away):
                marked[i, t] = NEIGHBOUR
                continue
            rise = dot(away, n)
            if rise > FACING_SINE * distance and dot(away, outward) < -FACING_SINE * distance:
                continue
            # The path to the triangle may end inside it, far from its corners.
            size = max(norm(subtract(b, a)), max(norm(subtract(c, b)), norm(subtract(a, c))))
            path = min(paths[i, links[t, 0]], min(paths[i, links[t, 1]], paths[i, links[t, 2]]))
            if distance <= along and path <= _DETOUR * along + size:
                marked[i, t] = NEIGHBOUR


@njit(**KERNEL)
def surrounded(links, fans, marked, rows, columns):
    """For some excluded pairs, whether all triangles that touch the triangle are excluded too."""
    result = np.ones(len(rows), dtype=np.int64)
    for k in range(len(rows)):
        for c in range(3):
            v = links[columns[k], c]
            for m in range(fans[v, 0]):
                if marked[rows[k], fans[v, 1 + 3 * m]] == 0:
                    result[k] = 0
    return result


@njit(**KERNEL)
def fill_whole(x, links, vertices, reach, every, grid):
    """Fill a grid with all triangles.

    Args:
        x: Points at rest [m].
        links: See `ClosedSurface`.
        vertices: See `ClosedSurface`.
        reach: Distance by which the boxes are enlarged [m].
        every: A mask of length 0.
        grid: Output.

    Returns:
        See `fill_grid`.
    """
    region = bounding_box(x, vertices)
    return fill_grid(x, links, 3, reach, region, every, grid)


def _grid_of(surface: ClosedSurface, points: np.ndarray, reach: float) -> CellGrid:
    """Grid of all triangles of a surface, boxes enlarged by `reach` [m]."""
    grids, every = [empty_grid(len(surface.links))], np.empty(0, np.bool_)
    while not have_room(grids, (fill_whole(
        points, surface.links, surface.vertices, float(reach), every, grids[0]
    ),)):  # fmt: skip
        pass  # With a longer list.
    return grids[0]


def find_excluded_pairs(
    surface: ClosedSurface, points: np.ndarray, alarm_distance: float, through: float
) -> ExcludedPairs:
    """Finds the excluded pairs of a surface.

    Args:
        surface: The surface.
        points: Its points at rest [m], shape (point_count, 3).
        alarm_distance: Distance along the surface below which a pair must face each other across
            air [m].
        through: Distance through the body below which it must [m].

    Returns:
        The pairs.
    """
    normals = np.empty((len(surface.links), 4))
    compute_normals(points, surface.links, normals)
    grid, along = _grid_of(surface, points, through), max(float(alarm_distance), through)
    starts, ends = surface.edges[:, 0], surface.edges[:, 1]
    lengths = np.linalg.norm(points[ends] - points[starts], axis=1)
    # Older versions of SciPy need 32-bit indices here.
    places = (starts.astype(np.int32), ends.astype(np.int32))
    graph = coo_array((lengths, places), shape=(len(points), len(points))).tocsr()
    longest = lengths.max(initial=0.0)
    counts = np.zeros(len(points), dtype=np.int64)
    triangles, codes = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for start in range(0, len(surface.vertices), _CHUNK):
        vertices = surface.vertices[start : start + _CHUNK]
        limit = _DETOUR * along + longest
        paths = dijkstra(graph, directed=False, indices=vertices, limit=limit)
        marked = np.empty((len(vertices), len(surface.links)), dtype=np.int8)
        mark_excluded_pairs(
            points, surface.links, normals, surface.fans, grid, vertices, paths, along, through,
            marked,
        )  # fmt: skip
        rows, columns = np.nonzero(marked)
        counts[vertices] = np.bincount(rows, minlength=len(vertices))
        triangles.append(columns)
        around = surrounded(surface.links, surface.fans, marked, rows, columns)
        codes.append(marked[rows, columns] + SURROUNDED * around)
    return ExcludedPairs(
        offsets=np.concatenate([[0], np.cumsum(counts)]),
        triangles=np.concatenate(triangles),
        codes=np.concatenate(codes).astype(np.int64),
        stamps=np.zeros(len(surface.links), dtype=np.int64),
        points=points,
        normals=normals,
        near=along,
    )


class SelfDetector(SurfacePairDetector):
    """Detects contacts and small overlaps of a surface with itself.

    Attributes:
        depth: Largest depth at which a vertex that has passed through the surface is found [m].
    """

    def __init__(self, triangles: np.ndarray, rest_points: np.ndarray, alarm_distance: float):
        """Finds the pairs that can never collide.

        Args:
            triangles: Point indices, outward normals, shape (triangle_count, 3).
            rest_points: Points at rest [m], shape (point_count, 3).
            alarm_distance: Distance along the surface below which features that do not face each
                other across air are neighbours [m]; at least the largest margin.

        Raises:
            MeshError: The surface is not closed or not consistently oriented.
        """
        points, count = np.array(rest_points, float), len(rest_points)
        super().__init__(triangles, count, triangles, count)
        surface = self._sides[0].surface
        self.depth = _DEPTH_IN_EDGES * mean_edge_length(surface, points)
        self._rest = find_excluded_pairs(surface, points, alarm_distance, _THROUGH_THE_BODY * self.depth)


@njit(**KERNEL)
def measure_pairs(x, points, triangles, reach, rows, span):
    """Measure all pairs, and write those that are near.

    Args:
        x: Points [m], shape (point_count, 3).
        points: Point of each pair, shape (pair_count,).
        triangles: Corners of the triangle of each pair, shape (pair_count, 3).
        reach: See `proximities.py`.
        rows: See `proximities.py`.
        span: See there.
    """
    count = span[0]
    for pair in range(len(points)):
        i, j, k = triangles[pair, 0], triangles[pair, 1], triangles[pair, 2]
        p, a, b, c = row(x, points[pair]), row(x, i), row(x, j), row(x, k)
        outward = cross(subtract(b, a), subtract(c, a))
        doubled_area = norm(outward)
        if not doubled_area > 0.0:
            continue
        normal, w = divided(outward, doubled_area), closest_weights(p, a, b, c)
        nearest = add_scaled(add_scaled(scaled(a, w[0]), b, w[1]), c, w[2])
        gap = dot(subtract(p, nearest), normal)
        if gap < reach[0]:
            first = ((points[pair], points[pair], points[pair]), (1.0, 0.0, 0.0), p)
            write_row(rows, count, False, first, ((i, j, k), w, nearest), normal, gap, pair)
            count += 1
    span[1] = count


class FixedPairs:
    """Detects contacts of given pairs of a point and a triangle of the same body.

    The gap is the height of the point above the plane of the triangle along the outward normal. It
    is negative behind the plane, without a limit on the depth. The force acts on the closest point
    of the triangle, so it never acts outside the triangle.
    """

    is_traceable = True

    def __init__(self, point_index: np.ndarray, triangle_points: np.ndarray):
        """Keeps the pairs.

        Args:
            point_index: Point of each pair, shape (pair_count,).
            triangle_points: Corners of the triangle of each pair, outward normal, shape
                (pair_count, 3).
        """
        self._points = np.array(point_index, dtype=np.int64).reshape(-1)
        self._triangles = np.array(triangle_points, dtype=np.int64).reshape(-1, 3)

    def write(self, x, _, reach, rows: Proximities, span: np.ndarray) -> None:
        """Write the pairs that are near; may be traced.

        The key is the index of a pair. A triangle without area has no normal, and its pair is omitted.

        Args:
            x: Points [m], shape (point_count, 3).
            _: The same, as the points of the other side.
            reach: See `proximities.py`.
            rows: See there.
            span: See there.
        """
        measure_pairs(x, self._points, self._triangles, reach, rows, span)
