"""Detector of contacts between two closed triangle surfaces that move and deform.

Arguments of the kernels here that tell of pairs are as in `proximities`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.compilation import INNER, KERNEL, njit
from softrobot_twin.geometry.broad_phase import (
    bounding_box,
    empty_grid,
    fill_grid,
    have_room,
    is_empty,
    shared_box,
)
from softrobot_twin.geometry.closed_surface import (
    apply_region_planes,
    closed_surface,
    compute_normals,
    flat_regions,
    mean_edge_length,
)
from softrobot_twin.geometry.proximities import Proximities, found_by
from softrobot_twin.geometry.surface import checked_points
from softrobot_twin.geometry.triangle_pairs import (
    SurfaceSide,
    feature_count,
    find_ridges,
    half_longest_ridge,
    no_excluded_pairs,
    pair_edges,
    pair_vertices,
)

# Default depth, in mean edge lengths of the coarser surface.
_DEPTH_IN_EDGES = 2.0


@njit(**KERNEL)
def are_apart(x, vertices, y, others, margin):
    """Whether the bounding boxes of two sets of points are farther apart than the margin."""
    return is_empty(shared_box(bounding_box(x, vertices), bounding_box(y, others), margin))


@njit(**INNER)
def find_features(side):
    """Compute the current normals and ridges; returns half the length of the longest ridge [m]."""
    compute_normals(side.x, side.surface.links, side.normals)
    if len(side.leaders) == 0:
        return find_ridges(side.x, side.surface.edges, side.normals, side.ridges)
    apply_region_planes(side.leaders, side.normals)
    return half_longest_ridge(side.x, side.surface.edges, side.ridges)


@njit(**KERNEL)
def pair_surfaces(first, second, edge_grid, reach, depth, rest, rows, span):
    """Find all pairs of two different surfaces.

    Args:
        first: First surface, a `SurfaceSide`.
        second: Second surface.
        edge_grid: Grid for the edges of the second.
        reach: See `proximities.py`.
        depth: Largest depth of a pair [m].
        rest: Result of `no_excluded_pairs`.
        rows: See `proximities.py`.
        span: See there.

    Returns:
        The capacities that the grids of the first surface, of the second and of the edges need. If
        one of these exceeds what is allocated, no row is written.
    """
    margin = reach[0]
    x, a, y, b = first.x, first.surface, second.x, second.surface
    box, other = bounding_box(x, a.vertices), bounding_box(y, b.vertices)
    region, other_region = shared_box(other, box, margin), shared_box(box, other, margin)
    half_edge = min(find_features(first), find_features(second))
    far = max(margin, depth)
    edge_depth = min(depth, half_edge)
    every = first.ridges[:0]
    need_first = fill_grid(x, a.links, 3, far, other_region, every, first.grid)
    need_second = fill_grid(y, b.links, 3, far, region, every, second.grid)
    need_edges = fill_grid(
        y, b.edges, 2, max(margin, edge_depth), region, second.ridges, edge_grid
    )  # fmt: skip
    if (
        need_first > len(first.grid.items)
        or need_second > len(second.grid.items)
        or need_edges > len(edge_grid.items)
    ):
        return need_first, need_second, need_edges
    count = pair_vertices(first, second, region, margin, depth, rest, False, 0, rows, span[0])
    key = len(x) * feature_count(second)
    count = pair_vertices(
        second, first, other_region, margin, depth, rest, True, key, rows, count
    )  # fmt: skip
    key += len(y) * feature_count(first)
    span[1] = pair_edges(
        first, second, edge_grid, margin, edge_depth, x[:0], first.normals, 0.0, key, rows, count
    )
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
        self._counts = (first_point_count, second_point_count)
        self._surfaces = (
            closed_surface(first_triangles, first_point_count),
            closed_surface(second_triangles, second_point_count),
        )
        self._normals = [np.empty((len(s.links), 4)) for s in self._surfaces]
        self._features = [
            _features(s, points) for s, points in zip(self._surfaces, rigid_points, strict=True)
        ]
        self._grids = [empty_grid(len(s.links)) for s in self._surfaces]
        self._grids.append(empty_grid(len(self._surfaces[1].edges)))
        self._has_searched = False
        self._rest = no_excluded_pairs()

    def detect(
        self, first_points: np.ndarray, second_points: np.ndarray, margin: float
    ) -> Proximities:
        """Finds the pairs that are nearer than a margin.

        Args:
            first_points: Points of the first body [m], shape (first_point_count, 3).
            second_points: Points of the second body [m], shape (second_point_count, 3).
            margin: Largest gap of a pair [m].

        Returns:
            The pairs; a key identifies a vertex and a feature, or two edges.

        Raises:
            MeshError: The points have another shape.
        """
        x = checked_points(first_points, self._counts[0])
        y = checked_points(second_points, self._counts[1])
        reach = np.array([float(margin)])
        return found_by(lambda rows, span: self.write(x, y, reach, rows, span))

    def write(self, x, y, reach, rows: Proximities, span: np.ndarray) -> None:
        """Write the pairs that are near.

        Args:
            x: Points of the first body [m], shape (first_point_count, 3).
            y: Points of the second body [m], shape (second_point_count, 3).
            reach: See `proximities.py`.
            rows: See there.
            span: See there.
        """
        a, b = self._surfaces
        if self.depth is None:
            coarser = max(mean_edge_length(a, x), mean_edge_length(b, y))
            self.depth = _DEPTH_IN_EDGES * coarser
        # The first call searches in any case, so that all kernels are compiled before a contact.
        if self._has_searched and are_apart(x, a.vertices, y, b.vertices, reach[0]):
            span[1] = span[0]
            return
        self._has_searched = True
        while not have_room(self._grids, pair_surfaces(
            self._side(0, x), self._side(1, y), self._grids[2], reach, float(self.depth),
            self._rest, rows, span,
        )):  # fmt: skip
            pass  # With longer lists.

    def _side(self, index: int, points: np.ndarray) -> SurfaceSide:
        ridges, leaders, crests = self._features[index]
        return SurfaceSide(
            points, self._surfaces[index], self._normals[index], ridges, self._grids[index],
            leaders, crests,
        )  # fmt: skip


def _features(surface, rigid_points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ridges, leaders and crests of a `SurfaceSide`; a deforming one gets its ridges later."""
    if rigid_points is None:
        ridges = np.empty(len(surface.edges), dtype=np.bool_)
        return ridges, np.empty(0, dtype=np.int64), surface.vertices
    regions = flat_regions(surface, rigid_points)
    return regions.ridges, regions.leaders, regions.crests
