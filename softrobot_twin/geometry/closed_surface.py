"""What touches what on a closed triangle surface, and which way is out.

A feature of the surface is a triangle, an edge or a vertex; its outward direction at a vertex or an
edge is the angle-weighted sum of the normals around it, whose sign tells inside from outside for
the feature nearest to a point (Bærentzen and Aanæs 2005).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.vector3 import cross, dot, minus, norm, plus, row, unit


class ClosedSurface(NamedTuple):
    """A closed, outward oriented triangle surface; its points move, this stays.

    Attributes:
        triangles: Point indices, shape (triangle_count, 3).
        vertices: Points that some triangle uses, ascending, shape (vertex_count,).
        edges: Their two points, shape (edge_count, 2).
        edge_triangles: The two triangles at each edge, ascending, shape (edge_count, 2).
        edge_apexes: The corner of each of those that lies off the edge, shape (edge_count, 2).
        triangle_edges: Edge from corner i to corner i + 1, shape (triangle_count, 3).
        ring_offsets: Where the triangles around each point start, shape (point_count + 1,).
        ring: Triangles around each point, ascending, one after another.
        ring_corners: Which corner of that triangle the point is.
    """

    triangles: np.ndarray
    vertices: np.ndarray
    edges: np.ndarray
    edge_triangles: np.ndarray
    edge_apexes: np.ndarray
    triangle_edges: np.ndarray
    ring_offsets: np.ndarray
    ring: np.ndarray
    ring_corners: np.ndarray


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
    order = np.argsort(triangles.ravel(), kind="stable")
    return ClosedSurface(
        triangles=triangles,
        vertices=np.unique(triangles),
        edges=np.stack([starts[first], ends[first]], axis=1),
        edge_triangles=halves // 3,
        edge_apexes=np.roll(triangles, -2, axis=1).ravel()[halves],
        triangle_edges=place.reshape(-1, 3),
        ring_offsets=np.searchsorted(triangles.ravel()[order], np.arange(point_count + 1)),
        ring=order // 3,
        ring_corners=order % 3,
    )


def mean_edge_length(surface: ClosedSurface, points: np.ndarray) -> float:
    """Mean length of the edges [m]; points [m], shape (point_count, 3)."""
    ends = np.asarray(points, dtype=float)[surface.edges]
    return float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean()) if len(ends) else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def compute_normals(x, surface, normals):
    """Unit outward normals of all triangles; zero for one of no area."""
    for t in range(len(surface.triangles)):
        a = row(x, surface.triangles[t, 0])
        n = cross(minus(row(x, surface.triangles[t, 1]), a), minus(row(x, surface.triangles[t, 2]), a))
        n = unit(n)
        normals[t, 0] = n[0]
        normals[t, 1] = n[1]
        normals[t, 2] = n[2]


@njit(cache=True, nogil=True, error_model="numpy")
def vertex_normal(x, surface, normals, v):
    """Unit angle-weighted normal at a vertex."""
    total = (0.0, 0.0, 0.0)
    for k in range(surface.ring_offsets[v], surface.ring_offsets[v + 1]):
        t, c = surface.ring[k], surface.ring_corners[k]
        p = row(x, v)
        a = minus(row(x, surface.triangles[t, (c + 1) % 3]), p)
        b = minus(row(x, surface.triangles[t, (c + 2) % 3]), p)
        angle = np.arctan2(norm(cross(a, b)), dot(a, b))
        total = plus(total, row(normals, t), angle)
    return unit(total)


@njit(cache=True, nogil=True, error_model="numpy")
def edge_normal(surface, normals, e):
    """Unit normal at an edge, half way between those of its triangles."""
    first = row(normals, surface.edge_triangles[e, 0])
    return unit(plus(first, row(normals, surface.edge_triangles[e, 1]), 1.0))


@njit(cache=True, nogil=True, error_model="numpy")
def edge_in_triangle(surface, t, a, b):
    """The edge of triangle t that joins points a and b."""
    for i in range(3):
        e = surface.triangle_edges[t, i]
        p, q = surface.edges[e, 0], surface.edges[e, 1]
        if (p == a and q == b) or (p == b and q == a):
            return e
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def steepest_descent(x, surface, v, direction):
    """How far the surface around vertex v dips below the plane through it, at most.

    Returns:
        Largest sine, over the edges at v, of the angle at which they run against `direction`
        (unit); ≤ 0 where v is the lowest point of its neighbourhood.
    """
    p = row(x, v)
    worst = -1.0
    for k in range(surface.ring_offsets[v], surface.ring_offsets[v + 1]):
        # On a closed surface the next corner of each triangle of the ring visits every edge once.
        c = (surface.ring_corners[k] + 1) % 3
        away = minus(row(x, surface.triangles[surface.ring[k], c]), p)
        length = norm(away)
        if length > 0.0:
            worst = max(worst, -dot(away, direction) / length)
    return worst
