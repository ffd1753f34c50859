"""Flat regions of a rigid triangle surface: neighbouring facets that lie in one plane.

Inside a region there is no feature to touch but the plane itself. Its edges and vertices are marks
of the file, not of the solid, and its narrow triangles have normals that are only round-off.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.geometry.closed_surface import (
    ACROSS,
    ClosedSurface,
    closed_surface,
    compute_normals,
)
from softrobot_twin.geometry.vector3 import dot, minus, row

# Points lie in one plane if none is farther from it than this share of the surface's size: files
# keep six or seven digits.
FLAT_SHARE = 2.0e-6


class FlatRegions(NamedTuple):
    """What of a rigid surface is flat. It holds for as long as the surface keeps its shape.

    Attributes:
        leaders: Of each triangle the largest one of its region, whose plane is the region's,
            shape (triangle_count,).
        ridges: Whether an edge lies between two regions and sticks out, shape (edge_count,).
        crests: Points at which such an edge ends: no other can touch a convex neighbourhood,
            ascending, shape (crest_count,).
    """

    leaders: np.ndarray
    ridges: np.ndarray
    crests: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def grow_regions(x, links, normals, order, tolerance, leaders):
    """Let each triangle, the largest first, gather neighbours as long as they lie in its plane.

    All points of a region are held against the plane of its first triangle and not against each
    other's, so that a finely cut round surface is never taken for a flat one.

    Args:
        x: Points [m].
        links: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        order: Triangles, the largest first.
        tolerance: Distance from the plane up to which a point lies in it [m].
        leaders: Gets the first triangle of each one's region.
    """
    stack = np.empty(3 * len(links) + 1, dtype=np.int64)
    for t in range(len(links)):
        leaders[t] = -1
    for first in order:
        if leaders[first] >= 0:
            continue
        leaders[first] = first
        n, offset = row(normals, first), normals[first, 3]
        # A triangle of no area has no plane to gather others in.
        stack[0], depth = first, 1 if dot(n, n) > 0.5 else 0
        while depth > 0:
            depth -= 1
            t = stack[depth]
            for i in range(3):
                s = links[t, ACROSS + i]
                if leaders[s] >= 0 or dot(n, row(normals, s)) < 0.0:
                    continue
                flat = True
                for c in range(3):
                    flat = flat and abs(dot(row(x, links[s, c]), n) - offset) <= tolerance
                if flat:
                    leaders[s] = first
                    stack[depth] = s
                    depth += 1


@njit(cache=True, nogil=True, error_model="numpy")
def mark_ridges(x, edges, normals, leaders, ridges):
    """Mark the edges between two regions that are not surely concave."""
    for e in range(len(edges)):
        t, s = leaders[edges[e, 2]], leaders[edges[e, 3]]
        start = row(x, edges[e, 0])
        below = dot(minus(row(x, edges[e, 5]), start), row(normals, t))
        above = dot(minus(row(x, edges[e, 4]), start), row(normals, s))
        ridges[e] = t != s and min(below, above) < 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def take_leaders_planes(leaders, normals):
    """Give each triangle the unit normal and the plane of its region, see `compute_normals`."""
    for t in range(len(leaders)):
        first = leaders[t]
        if first != t:
            for i in range(4):
                normals[t, i] = normals[first, i]


def flat_regions(surface: ClosedSurface, points: np.ndarray) -> FlatRegions:
    """Finds the flat regions of a surface.

    Args:
        surface: The surface.
        points: Its points in any frame that it is rigid in [m], shape (point_count, 3).

    Returns:
        The regions.
    """
    points = np.array(points, dtype=np.float64, order="C")
    corners = points[surface.links[:, :3]]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    size = float(np.linalg.norm(np.ptp(points[surface.vertices], axis=0)))
    normals = np.empty((len(surface.links), 4))
    compute_normals(points, surface.links, normals)
    leaders = np.empty(len(surface.links), dtype=np.int64)
    order = np.argsort(-areas, kind="stable")
    grow_regions(points, surface.links, normals, order, FLAT_SHARE * size, leaders)
    ridges = np.empty(len(surface.edges), dtype=np.bool_)
    mark_ridges(points, surface.edges, normals, leaders, ridges)
    return FlatRegions(leaders, ridges, np.unique(surface.edges[ridges, :2]))


def flattened(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Move the points of a closed surface into the planes of their flat regions.

    A file's round-off would leave dents in a region, through which what stands on it would have
    to be told inside from outside. No point moves farther than what counts as flat.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Indices of them, closed and outward, shape (triangle_count, 3).

    Returns:
        The points moved [m], shape (point_count, 3).
    """
    surface = closed_surface(triangles, len(points))
    regions = flat_regions(surface, points)
    normals = np.empty((len(surface.links), 4))
    points = np.array(points, dtype=np.float64, order="C")
    compute_normals(points, surface.links, normals)
    moved = points.copy()
    most = 2.0 * FLAT_SHARE * float(np.linalg.norm(np.ptp(points, axis=0)))
    for point, fan in enumerate(surface.fans):
        planes = normals[np.unique(regions.leaders[fan[1 : 1 + 3 * fan[0] : 3]])]
        heights = planes[:, :3] @ points[point] - planes[:, 3]
        if len(planes) == 1:
            shift = -heights[0] * planes[0, :3]
        else:
            # Nearly parallel planes say nothing of where along them the point is.
            shift = -np.linalg.pinv(planes[:, :3], rcond=1.0e-3) @ heights
        if np.linalg.norm(shift) <= most:
            moved[point] += shift
    return moved
