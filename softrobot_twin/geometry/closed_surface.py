"""Connectivity, normals and flat regions of closed triangle surfaces.

A feature of a surface is a triangle, an edge or a vertex. The outward direction at an edge or a
vertex is the angle-weighted sum of the adjacent triangle normals. For the feature nearest to a
point, the sign of the distance along this direction tells inside from outside (Bærentzen and
Aanæs 2005).

Arguments of the kernels here:
    edges: Two points, two triangles and their opposite corners, shape (edge_count, 6).
    fans: Triangles and corners around each point, shape (point_count, 1 + 3 largest number).
    leaders: First triangle of the region of each triangle, shape (triangle_count,).
    links: Corners, neighbours and ownership of each triangle, shape (triangle_count, 15).
    normals: Unit normal and offset [m] of each triangle, shape (triangle_count, 4).
    ridges: Whether each edge is a ridge, shape (edge_count,).
    v: A vertex, a row of x.
    x: Points [m], shape (point_count, 3).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, norm, row, set_row, subtract, unit
from softrobot_twin.kernels.compilation import INLINED, INNER, KERNEL, njit


class ClosedSurface(NamedTuple):
    """Connectivity of a closed, outward oriented triangle surface, independent of its points.

    It consists of few arrays with many columns because kernels take few arguments faster than many.

    Attributes:
        links: For each triangle: its three points, its three edges (edge i runs from corner i to
            corner i + 1), the three neighbours across them, the opposite corners of those, and for
            each corner whether the triangle is the first at that point; shape (triangle_count, 15).
        edges: For each edge: its two points, its two triangles, ascending, and the opposite corners
            of those, shape (edge_count, 6).
        fans: For each point: the number of triangles around it and, for each of them, the triangle
            and its next and previous corner, shape (point_count, 1 + 3 largest number).
        vertices: Points that a triangle uses, ascending, shape (vertex_count,).
    """

    links: np.ndarray
    edges: np.ndarray
    fans: np.ndarray
    vertices: np.ndarray

# Columns of `ClosedSurface.links`.
EDGES, ACROSS, FAR_CORNERS, FIRST_AT = 3, 6, 9, 12


def closed_surface(triangles: np.ndarray, point_count: int) -> ClosedSurface:
    """Finds the edges and the neighbourhoods of a surface.

    Args:
        triangles: Point indices, outward normals, shape (triangle_count, 3).
        point_count: Number of points they index.

    Returns:
        The surface.

    Raises:
        MeshError: A triangle refers to one point twice, or an edge is not shared by exactly two
            triangles with opposite directions along it.
    """
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    starts, ends = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    if (starts == ends).any():
        index = int(np.flatnonzero(starts == ends)[0]) // 3
        raise MeshError(None, f"surface triangle {index} refers to a point twice")
    edges, place, counts = half_edges(triangles)[1:]
    balance = np.bincount(place, np.where(starts < ends, 1, -1), minlength=len(edges))
    wrong = np.flatnonzero((counts != 2) | (balance != 0))
    if len(wrong):
        i, j = edges[wrong[0]]
        raise MeshError(
            None,
            f"surface edge {i}-{j} belongs to {counts[wrong[0]]} triangles; in a closed, outward "
            "oriented surface every edge belongs to two, with opposite directions along it",
        )
    halves = np.argsort(place, kind="stable").reshape(-1, 2)
    first = halves[:, 0]
    apexes = np.roll(triangles, -2, axis=1).ravel()
    other = np.empty(len(starts), dtype=np.int64)
    other[halves[:, 0]], other[halves[:, 1]] = halves[:, 1], halves[:, 0]
    _, first_use = np.unique(triangles.ravel(), return_index=True)
    first_at = np.zeros(len(starts), dtype=np.int64)
    first_at[first_use] = 1
    links = [triangles, *(a.reshape(-1, 3) for a in (place, other // 3, apexes[other], first_at))]
    edges = [np.stack([starts[first], ends[first]], axis=1), halves // 3, apexes[halves]]
    return ClosedSurface(
        links=np.ascontiguousarray(np.hstack(links), dtype=np.int64),
        edges=np.ascontiguousarray(np.hstack(edges), dtype=np.int64),
        fans=triangle_fans(triangles, point_count),
        vertices=np.unique(triangles),
    )


def triangle_fans(triangles: np.ndarray, point_count: int) -> np.ndarray:
    """Computes `ClosedSurface.fans`, triangles ascending; unused entries are -1.

    Args:
        triangles: Points of each triangle, shape (triangle_count, 3).
        point_count: Number of points of the surface.
    """
    points = triangles.ravel()
    order = np.argsort(points, kind="stable")
    counts = np.bincount(points, minlength=point_count)
    place = np.arange(len(points)) - np.repeat(np.cumsum(counts) - counts, counts)
    fans = np.full((point_count, 1 + 3 * counts.max(initial=0)), -1, dtype=np.int64)
    fans[:, 0] = counts
    rows = points[order]
    fans[rows, 1 + 3 * place] = order // 3
    fans[rows, 2 + 3 * place] = np.roll(triangles, -1, axis=1).ravel()[order]
    fans[rows, 3 + 3 * place] = np.roll(triangles, -2, axis=1).ravel()[order]
    return fans


def mean_edge_length(surface: ClosedSurface, points: np.ndarray) -> float:
    """Mean length of the edges [m]; points [m], shape (point_count, 3).

    Args:
        surface: The surface.
        points: Its points [m], shape (point_count, 3).
    """
    ends = np.asarray(points, dtype=float)[surface.edges[:, :2]]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()) if len(ends) else 0.0


@njit(**KERNEL)
def compute_normals(x, links, normals):
    """Compute the outward unit normals of all triangles and the offsets n · x of their planes.

    The normal of a triangle without area is zero.

    Args:
        x: Points [m].
        links: See `ClosedSurface`.
        normals: Output: normal and offset [m] of each triangle, shape (triangle_count, 4).
    """
    for t in range(len(links)):
        a = row(x, links[t, 0])
        n = unit(cross(subtract(row(x, links[t, 1]), a), subtract(row(x, links[t, 2]), a)))
        set_row(normals, t, n)
        normals[t, 3] = dot(n, a)


@njit(**INNER)
def vertex_normal(x, fans, normals, v):
    """Angle-weighted unit normal at a vertex."""
    total = (0.0, 0.0, 0.0)
    p = row(x, v)
    for k in range(fans[v, 0]):
        a = subtract(row(x, fans[v, 2 + 3 * k]), p)
        b = subtract(row(x, fans[v, 3 + 3 * k]), p)
        angle = np.arctan2(norm(cross(a, b)), dot(a, b))
        total = add_scaled(total, row(normals, fans[v, 1 + 3 * k]), angle)
    return unit(total)


@njit(**INNER)
def mean_normal(fans, normals, v):
    """Unweighted unit mean of the normals around a vertex: less accurate but fast."""
    total = (0.0, 0.0, 0.0)
    for k in range(fans[v, 0]):
        total = add_scaled(total, row(normals, fans[v, 1 + 3 * k]), 1.0)
    return unit(total)


@njit(**INLINED)
def edge_normal(normals, t, s):
    """Unit normal at the edge between triangles t and s: the mean direction of their normals."""
    return unit(add_scaled(row(normals, t), row(normals, s), 1.0))


@njit(**INNER)
def steepest_descent(x, fans, v, direction):
    """Steepest descent of the surface from vertex v, relative to a unit direction.

    Returns:
        Largest sine, over the edges at v, of the angle by which they descend against `direction`;
        ≤ 0 where v is the lowest point of its neighbourhood.
    """
    p = row(x, v)
    worst = -1.0
    for k in range(fans[v, 0]):
        # On a closed surface the next corners of all triangles of a fan are all neighbours of v.
        away = subtract(row(x, fans[v, 2 + 3 * k]), p)
        length = norm(away)
        if length > 0.0:
            worst = max(worst, -dot(away, direction) / length)
    return worst


# Points lie in one plane if none is farther from it than this share of the size of the surface:
# files store six or seven digits.
FLAT_SHARE = 2.0e-6


class FlatRegions(NamedTuple):
    """Flat regions of a rigid surface: neighbouring triangles in one plane.

    Inside a region only the plane itself can be touched. Its edges and vertices result from the
    triangulation, not from the solid, and normals of its narrow triangles are only round-off.

    Attributes:
        leaders: For each triangle the largest one of its region, whose plane is that of the region,
            shape (triangle_count,).
        ridges: Whether an edge is convex and lies between two regions, shape (edge_count,).
        crests: End points of such edges, ascending, shape (crest_count,). Other points cannot
            touch anything.
    """

    leaders: np.ndarray
    ridges: np.ndarray
    crests: np.ndarray


@njit(**KERNEL)
def grow_regions(x, links, normals, order, tolerance, leaders):
    """Grow a region from each triangle, the largest first, over neighbours in its plane.

    All points of a region are compared with the plane of its first triangle and not with the
    planes of their neighbours, so that a finely triangulated round surface is never called flat.

    Args:
        x: Points [m].
        links: See `ClosedSurface`.
        normals: What `compute_normals` gives.
        order: Triangles, the largest first.
        tolerance: Distance from the plane up to which a point lies in it [m].
        leaders: Output: first triangle of the region of each triangle.
    """
    stack = np.empty(3 * len(links) + 1, dtype=np.int64)
    for t in range(len(links)):
        leaders[t] = -1
    for first in order:
        if leaders[first] >= 0:
            continue
        leaders[first] = first
        n, offset = row(normals, first), normals[first, 3]
        # A triangle without area has no plane, so its region does not grow.
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


@njit(**KERNEL)
def mark_ridges(x, edges, normals, leaders, ridges):
    """Mark the edges between two regions, except those that are clearly concave."""
    for e in range(len(edges)):
        t, s = leaders[edges[e, 2]], leaders[edges[e, 3]]
        start = row(x, edges[e, 0])
        below = dot(subtract(row(x, edges[e, 5]), start), row(normals, t))
        above = dot(subtract(row(x, edges[e, 4]), start), row(normals, s))
        ridges[e] = t != s and min(below, above) < 0.0


@njit(**INNER)
def apply_region_planes(leaders, normals):
    """Replace the plane of each triangle by that of its region, see `compute_normals`."""
    for t in range(len(leaders)):
        first = leaders[t]
        if first != t:
            for i in range(4):
                normals[t, i] = normals[first, i]


def flat_regions(surface: ClosedSurface, points: np.ndarray) -> FlatRegions:
    """Finds the flat regions of a surface.

    Args:
        surface: The surface.
        points: Its points in any body-fixed frame [m], shape (point_count, 3).

    Returns:
        The regions.
    """
    points = np.array(points, dtype=np.float64, order="C")
    corners = points[surface.links[:, :3]]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    size = float(np.linalg.norm(np.ptp(points[surface.vertices], axis=0)))
    normals = np.empty((len(surface.links), 4))
    compute_normals(points, surface.links, normals)
    leaders = np.empty(len(surface.links), dtype=np.int64)
    order = np.argsort(-areas, kind="stable")
    grow_regions(points, surface.links, normals, order, FLAT_SHARE * size, leaders)
    ridges = np.empty(len(surface.edges), dtype=np.bool_)
    mark_ridges(points, surface.edges, normals, leaders, ridges)
    return FlatRegions(leaders, ridges, np.unique(surface.edges[ridges, :2]))


def flatten_regions(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Moves the points of a closed surface into the planes of their flat regions.

    The round-off of a file leaves dents in a region, and whether a body that stands on the region
    is inside or outside would depend on them. No point moves farther than twice the flatness
    tolerance.

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
            # Nearly parallel planes do not determine the position along their intersection.
            shift = -np.linalg.pinv(planes[:, :3], rcond=1.0e-3) @ heights
        if np.linalg.norm(shift) <= most:
            moved[point] += shift
    return moved


@njit(**INLINED)
def is_outside_cone(x, edges, e, normal, sine):
    """Whether a unit normal lies outside the normal cone of edge e by more than a sine."""
    start = row(x, edges[e, 0])
    along = subtract(row(x, edges[e, 1]), start)
    scale = 1.0 / dot(along, along)
    for side in range(4, 6):
        into = subtract(row(x, edges[e, side]), start)
        into = add_scaled(into, along, -dot(into, along) * scale)
        height = dot(normal, into)
        if height > 0.0 and height * height > sine * sine * dot(into, into):
            return True
    return False
