"""Detector of contacts between two closed triangle surfaces that move and deform.

Arguments of the kernels here that tell of pairs are as in `proximities`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.broad_phase import (
    bounding_box,
    empty_grid,
    fill_grid,
    have_room,
    is_empty,
    shared_box,
)
from softrobot_twin.geometry.closed_surface import (
    ClosedSurface,
    FlatRegions,
    apply_region_planes,
    closed_surface,
    compute_normals,
    flat_regions,
    mean_edge_length,
)
from softrobot_twin.geometry.proximities import Proximities
from softrobot_twin.geometry.triangle_pairs import (
    SurfaceSide,
    feature_count,
    find_ridges,
    half_longest_ridge,
    no_excluded_pairs,
    pair_edges,
    pair_vertices,
)
from softrobot_twin.kernels.compilation import INNER, KERNEL, njit

# Default depth, in mean edge lengths of the coarser surface.
_DEPTH_IN_EDGES = 2.0


@njit(**KERNEL)
def are_apart(x, vertices, y, others, margin):
    """Whether the bounding boxes of two sets of points are farther apart than the margin [m].

    Args:
        x: Points [m], shape (point_count, 3).
        vertices: Some of them, shape (count,).
        y: Other points [m], shape (other_point_count, 3).
        others: Some of these, shape (other_count,).
        margin: The distance [m].
    """
    return is_empty(shared_box(bounding_box(x, vertices), bounding_box(y, others), margin))


@njit(**INNER)
def find_features(side):
    """Compute normals and ridges of a `SurfaceSide`, `side`; returns half the longest ridge [m]."""
    compute_normals(side.x, side.surface.links, side.normals)
    if len(side.leaders) == 0:
        return find_ridges(side.x, side.surface.edges, side.normals, side.ridges)
    apply_region_planes(side.leaders, side.normals)
    return half_longest_ridge(side.x, side.surface.edges, side.ridges)


@njit(**KERNEL)
def pair_surfaces(first, second, edge_grid, reach, depth, rest, rows, span):
    """Find all pairs of two surfaces, or of one with itself.

    Args:
        first: First surface, a `SurfaceSide`.
        second: Second surface; the first again if pairs of it are excluded.
        edge_grid: Grid for the edges of the second.
        reach: See `proximities.py`.
        depth: Largest depth of a pair [m].
        rest: Excluded pairs of one surface; `no_excluded_pairs` for two.
        rows: See `proximities.py`.
        span: See there.

    Returns:
        The capacities that the grids of the first surface, of the second and of the edges need. If
        one of these exceeds what is allocated, no row is written.
    """
    margin, same = reach[0], len(rest.offsets) > 0
    if same:
        second = first
    x, a, y, b = first.x, first.surface, second.x, second.surface
    box, other = bounding_box(x, a.vertices), bounding_box(y, b.vertices)
    region, other_region = shared_box(other, box, margin), shared_box(box, other, margin)
    half_edge = find_features(first)
    if not same:
        half_edge = min(half_edge, find_features(second))
    far = max(margin, depth)
    edge_depth = min(depth, half_edge)
    every = first.ridges[:0]
    need_first = fill_grid(x, a.links, 3, far, other_region, every, first.grid)
    need_second = 0
    if not same:
        need_second = fill_grid(y, b.links, 3, far, region, every, second.grid)
    need_edges = fill_grid(y, b.edges, 2, max(margin, edge_depth), region, second.ridges, edge_grid)
    if (
        need_first > len(first.grid.items)
        or need_second > len(second.grid.items)
        or need_edges > len(edge_grid.items)
    ):
        return need_first, need_second, need_edges
    count = pair_vertices(first, second, region, margin, depth, rest, False, 0, rows, span[0])
    key = len(x) * feature_count(second)
    if not same:
        count = pair_vertices(second, first, other_region, margin, depth, rest, True, key, rows, count)
        key += len(y) * feature_count(first)
    span[1] = pair_edges(first, second, edge_grid, margin, edge_depth, rest, key, rows, count)
    return need_first, need_second, need_edges


class SurfacePairDetector:
    """Detects contacts between two closed surfaces, deforming or rigid.

    Vertices are paired with triangles and edges with edges, each where the distance has a local
    minimum. A vertex inside the other body has a negative gap, and a normal along which it
    separates.

    Attributes:
        depth: Largest depth at which a vertex inside the other body is found [m].
    """

    def __init__(
        self,
        first_triangles: np.ndarray,
        first_point_count: int,
        second_triangles: np.ndarray,
        second_point_count: int,
        depth: float | None = None,
        rigid_points: tuple[np.ndarray | None, np.ndarray | None] = (None, None),
    ):
        """Finds the connectivity of both surfaces.

        Args:
            first_triangles: Point indices, outward normals, shape (first_triangle_count, 3).
            first_point_count: Number of points of the first, used by its surface or not.
            second_triangles: Same for the second, shape (second_triangle_count, 3).
            second_point_count: Number of points of the second.
            depth: Largest depth of an overlap [m]; by default twice the mean edge length of the
                coarser surface at the first call.
            rigid_points: For each rigid surface its points, in any body-fixed frame [m]: its
                coplanar neighbouring triangles act as one plane. None for a deforming surface.

        Raises:
            MeshError: A surface is not closed or not consistently oriented.
        """
        self.depth = depth
        surfaces = (
            closed_surface(first_triangles, first_point_count),
            closed_surface(second_triangles, second_point_count),
        )
        self._sides = [_side(*pair) for pair in zip(surfaces, rigid_points, strict=True)]
        self._grids = [*(side.grid for side in self._sides), empty_grid(len(surfaces[1].edges))]
        self._has_searched = False
        self._rest = no_excluded_pairs()

    def write(self, x, y, reach, rows: Proximities, span: np.ndarray) -> None:
        """Write the pairs that are near.

        Args:
            x: Points of the first body [m], shape (first_point_count, 3).
            y: Points of the second body [m], shape (second_point_count, 3).
            reach: See `proximities.py`.
            rows: See there.
            span: See there.
        """
        a, b = (side.surface for side in self._sides)
        if self.depth is None:
            coarser = max(mean_edge_length(a, x), mean_edge_length(b, y))
            self.depth = _DEPTH_IN_EDGES * coarser
        # The first call searches in any case, so that all kernels are compiled before a contact.
        if self._has_searched and are_apart(x, a.vertices, y, b.vertices, reach[0]):
            span[1] = span[0]
            return
        self._has_searched = True
        first, second = self._sides
        while not have_room(self._grids, pair_surfaces(
            first._replace(x=x, grid=self._grids[0]), second._replace(x=y, grid=self._grids[1]),
            self._grids[2], reach, float(self.depth), self._rest, rows, span,
        )):  # fmt: skip
            pass  # With longer lists.


def _side(surface: ClosedSurface, rigid_points: np.ndarray | None) -> SurfaceSide:
    """A surface that has no points yet; a deforming one gets its ridges with them."""
    count = len(surface.links)
    if rigid_points is None:
        ridges = np.empty(len(surface.edges), dtype=np.bool_)
        regions = FlatRegions(np.empty(0, dtype=np.int64), ridges, surface.vertices)
    else:
        regions = flat_regions(surface, rigid_points)
    return SurfaceSide(np.empty((0, 3)), surface, np.empty((count, 4)), empty_grid(count), *regions)
