"""Connectivity, normals and flat regions of closed triangle surfaces.

A feature of a surface is a triangle, an edge or a vertex. The outward direction at an edge or a
vertex is the angle-weighted sum of the adjacent triangle normals. For the feature nearest to a
point, the sign of the distance along this direction tells inside from outside (Bærentzen and
Aanæs 2005).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.vector3 import add_scaled, cross, dot, norm, row, subtract, unit

class ClosedSurface(NamedTuple):
    """A closed, outward oriented triangle surface; its points move, this stays.

    Few arrays with many columns, because kernels take few arrays quicker than many.

    Attributes:
        links: Of each triangle its three points, its three edges (edge i runs from corner i to
            corner i + 1), the triangles across these, the far corners of those, and for each
            corner whether the triangle is the first at that point; shape (triangle_count, 15).
        edges: Of each edge its two points, its two triangles, ascending, and the corners of those
            that lie off the edge, shape (edge_count, 6).
        fans: Of each point the number of triangles around it and, for each of them, the triangle
            and its next and last corner, shape (point_count, 1 + 3 most).
        vertices: Points that some triangle uses, ascending, shape (vertex_count,).
    """

    links: np.ndarray
    edges: np.ndarray
    fans: np.ndarray
    vertices: np.ndarray


# Columns of `ClosedSurface.links`.
EDGES, ACROSS, FAR_CORNERS, FIRST_AT = 3, 6, 9, 12


def closed_surface(triangles: np.ndarray, point_count: int) -> ClosedSurface:
    """Finds edges and neighbours of a surface.

    Args:
        triangles: Point indices, outward normals, shape (triangle_count, 3).
        point_count: Number of points they index.

    Returns:
        The surface.

    Raises:
        MeshError: A triangle names a point that does not exist or names one twice, or an edge does
            not lie between exactly two triangles that run along it in opposite directions.
    """
    triangles = np.ascontiguousarray(triangles, dtype=np.int64)
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise MeshError(None, f"triangles of a surface have shape {triangles.shape}, not (n, 3)")
    if triangles.size and (triangles.min() < 0 or triangles.max() >= point_count):
        raise MeshError(None, f"a triangle names a point outside 0..{point_count - 1}")
    starts, ends = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    if (starts == ends).any():
        index = int(np.flatnonzero(starts == ends)[0]) // 3
        raise MeshError(None, f"surface triangle {index} names a point twice")
    edges, first, place, counts = np.unique(
        np.sort(np.stack([starts, ends], axis=1), axis=1),
        axis=0, return_index=True, return_inverse=True, return_counts=True,
    )  # fmt: skip
    place = place.ravel()
    balance = np.bincount(place, np.where(starts < ends, 1, -1), minlength=len(edges))
    wrong = np.flatnonzero((counts != 2) | (balance != 0))
    if len(wrong):
        i, j = edges[wrong[0]]
        raise MeshError(
            None,
            f"surface edge {i}-{j} lies at {counts[wrong[0]]} triangles; a closed outward oriented "
            "surface has two there, running along it in opposite directions",
        )
    halves = np.argsort(place, kind="stable").reshape(-1, 2)
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
    """`ClosedSurface.fans`, triangles ascending; what is left over is -1."""
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
    """Mean length of the edges [m]; points [m], shape (point_count, 3)."""
    ends = np.asarray(points, dtype=float)[surface.edges[:, :2]]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()) if len(ends) else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def compute_normals(x, links, normals):
    """Unit outward normals of all triangles and n · x on their planes, shape (triangle_count, 4).

    The normal of a triangle of no area is zero.
    """
    for t in range(len(links)):
        a = row(x, links[t, 0])
        n = unit(cross(subtract(row(x, links[t, 1]), a), subtract(row(x, links[t, 2]), a)))
        normals[t, 0] = n[0]
        normals[t, 1] = n[1]
        normals[t, 2] = n[2]
        normals[t, 3] = dot(n, a)


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_normal(x, fans, normals, v):
    """Unit angle-weighted normal at a vertex."""
    total = (0.0, 0.0, 0.0)
    p = row(x, v)
    for k in range(fans[v, 0]):
        a = subtract(row(x, fans[v, 2 + 3 * k]), p)
        b = subtract(row(x, fans[v, 3 + 3 * k]), p)
        angle = np.arctan2(norm(cross(a, b)), dot(a, b))
        total = add_scaled(total, row(normals, fans[v, 1 + 3 * k]), angle)
    return unit(total)


@njit(cache=True, nogil=True, error_model="numpy")
def mean_normal(fans, normals, v):
    """Unit mean of the normals around a vertex; coarse but quick."""
    total = (0.0, 0.0, 0.0)
    for k in range(fans[v, 0]):
        total = add_scaled(total, row(normals, fans[v, 1 + 3 * k]), 1.0)
    return unit(total)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def edge_normal(normals, t, s):
    """Unit normal at the edge between triangles t and s, half way between theirs."""
    return unit(add_scaled(row(normals, t), row(normals, s), 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def steepest_descent(x, fans, v, direction):
    """How far the surface around vertex v dips below the plane through it, at most.

    Returns:
        Largest sine, over the edges at v, of the angle at which they run against `direction`
        (unit); ≤ 0 where v is the lowest point of its neighbourhood.
    """
    p = row(x, v)
    worst = -1.0
    for k in range(fans[v, 0]):
        # On a closed surface the next corners of the triangles of a fan are all its neighbours.
        away = subtract(row(x, fans[v, 2 + 3 * k]), p)
        length = norm(away)
        if length > 0.0:
            worst = max(worst, -dot(away, direction) / length)
    return worst


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
        below = dot(subtract(row(x, edges[e, 5]), start), row(normals, t))
        above = dot(subtract(row(x, edges[e, 4]), start), row(normals, s))
        ridges[e] = t != s and min(below, above) < 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def apply_region_planes(leaders, normals):
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


def flatten_regions(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def is_outside_cone(x, edges, e, normal, sine):
    """Whether a normal of edge e lies outside its cone by more than an angle."""
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
