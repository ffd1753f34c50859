"""Tetrahedron and barycentric weights of points, or the nearest point of the surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.surface import boundary_faces
from softrobot_twin.geometry.tet_mesh import TetMesh

# A negative weight above minus this value is round-off: the point lies on the face.
_WEIGHT_ROUND_OFF = 1e-9
# Number of points handled at once, which bounds the memory of the candidate pairs.
_CHUNK = 1024


class PointLocation(NamedTuple):
    """Location of points in a mesh: point i is ``barycentric_weights[i] @ positions[nodes[i]]``.

    A point outside the body is represented by the nearest point of the surface.

    Attributes:
        tets: Tetrahedron that contains each point, int64, shape (point_count,).
        nodes: Nodes of that tetrahedron, int64, shape (point_count, 4).
        barycentric_weights: Weights of those nodes, all ≥ 0 with sum 1, shape (point_count, 4).
        distances: Distances of the query points from the body [m], 0 inside, shape (point_count,).
    """

    tets: np.ndarray
    nodes: np.ndarray
    barycentric_weights: np.ndarray
    distances: np.ndarray


def locate_points(mesh: TetMesh, points: np.ndarray) -> PointLocation:
    """Finds the tetrahedron and the barycentric weights of points.

    Args:
        mesh: Mesh of the body.
        points: Points [m], shape (point_count, 3) or (3,).

    Returns:
        The location of each point. A point shared by several tetrahedra is assigned to the one in
        which its smallest weight is largest, then to the first. A point outside gets the weights of
        the nearest point of the surface and its distance from it; weights are never extrapolated.

    Raises:
        MeshError: A point is not finite, or the points have another shape.
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    if points.size == 0:
        points = points.reshape(0, 3)
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(None, f"points to locate have shape {points.shape}, not (n, 3)")
    if not np.isfinite(points).all():
        index = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise MeshError(None, f"point {index} to locate is {points[index].tolist()} m")

    tets, weights, lowest = _deepest_tets(mesh, points)
    weights = np.clip(weights, 0.0, None)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    distances = np.zeros(len(points))
    outside = lowest < -_WEIGHT_ROUND_OFF
    if outside.any():
        tets[outside], weights[outside], distances[outside] = _nearest_on_surface(
            mesh, points[outside]
        )
    return PointLocation(tets, mesh.cells[tets], weights, distances)


def _deepest_tets(
    mesh: TetMesh, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each point, the tetrahedron with the largest smallest weight, its weights, that weight.

    The smallest weight is −∞ for points far from all tetrahedra.
    """
    corners = mesh.node_positions[mesh.cells]
    centroids = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centroids[:, None], axis=2).max() * (1.0 + 1e-6)
    tree = cKDTree(centroids)
    inverse_edges = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))

    best_tets = np.zeros(len(points), dtype=np.int64)
    best_weights = np.zeros((len(points), 4))
    lowest = np.full(len(points), -np.inf)
    for start in range(0, len(points), _CHUNK):
        chunk = points[start : start + _CHUNK]
        owner, tets = _pairs(tree.query_ball_point(chunk, reach))
        if len(owner) == 0:
            continue
        offsets = chunk[owner] - corners[tets, 0]
        weights = np.empty((len(owner), 4))
        weights[:, 1:] = np.einsum("pij,pj->pi", inverse_edges[tets], offsets)
        weights[:, 0] = 1.0 - weights[:, 1:].sum(axis=1)
        smallest = weights.min(axis=1)
        winners = _first_best(owner, tets, -smallest)
        rows = start + owner[winners]
        best_tets[rows] = tets[winners]
        best_weights[rows] = weights[winners]
        lowest[rows] = smallest[winners]
    return best_tets, best_weights, lowest


def _nearest_on_surface(
    mesh: TetMesh, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The tetrahedra, weights and distances [m] of the nearest points on the surface."""
    faces = boundary_faces(mesh.cells)
    corners = mesh.node_positions[faces.triangles]
    centroids = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centroids[:, None], axis=2).max() * (1.0 + 1e-6)
    tree = cKDTree(centroids)
    # Centroids lie on the surface, so the nearest one is an upper bound of the distance.
    bounds, _ = tree.query(points)

    tets = np.empty(len(points), dtype=np.int64)
    weights = np.zeros((len(points), 4))
    distances = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        owner, triangles = _pairs(tree.query_ball_point(points[chunk], bounds[chunk] + reach))
        asked = points[chunk][owner]
        corner_weights = closest_on_triangles(asked, corners[triangles])
        closest = np.einsum("pc,pci->pi", corner_weights, corners[triangles])
        pair_distances = np.linalg.norm(asked - closest, axis=1)
        winners = _first_best(owner, triangles, pair_distances)
        rows = start + owner[winners]
        tets[rows] = faces.tets[triangles[winners]]
        distances[rows] = pair_distances[winners]
        on_face = mesh.cells[tets[rows]][:, :, None] == faces.triangles[triangles[winners], None]
        weights[rows] = np.einsum("pnc,pc->pn", on_face, corner_weights[winners])
    return tets, weights, distances


def _pairs(candidates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Converts lists of candidates to pairs (point, candidate)."""
    counts = [len(found) for found in candidates]
    owner = np.repeat(np.arange(len(candidates)), counts)
    return owner, np.array([index for found in candidates for index in found], dtype=np.int64)


def _first_best(owner: np.ndarray, candidates: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Indices of the pair with the least cost for each owner; the first candidate wins ties."""
    order = np.lexsort([candidates, costs, owner])
    first = np.ones(len(order), dtype=bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    return order[first]


def closest_on_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Finds the closest point of a triangle for each pair of a point and a triangle.

    It is the projection onto the plane of the triangle if this lies inside, else the closest point
    of the three edges.

    Args:
        points: Points [m], shape (pair_count, 3).
        corners: Triangle corners [m], shape (pair_count, 3, 3).

    Returns:
        Weights of the three corners at the closest points, all ≥ 0 with sum 1, shape
        (pair_count, 3).
    """
    pairs = np.arange(len(points))
    edge_weights = np.zeros((3, len(points), 3))
    distances = np.empty((3, len(points)))
    for edge in range(3):
        start, end = corners[:, edge], corners[:, (edge + 1) % 3]
        along = end - start
        fraction = np.einsum("pi,pi->p", points - start, along)
        squared_length = np.einsum("pi,pi->p", along, along)
        fraction /= np.where(squared_length > 0.0, squared_length, 1.0)
        fraction = np.clip(fraction, 0.0, 1.0)
        edge_weights[edge, :, edge] = 1.0 - fraction
        edge_weights[edge, :, (edge + 1) % 3] = fraction
        distances[edge] = np.linalg.norm(points - start - fraction[:, None] * along, axis=1)
    weights = edge_weights[distances.argmin(axis=0), pairs]

    plane_weights, inside = _projections(points, corners)
    weights[inside] = plane_weights[inside]
    return weights


def _projections(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the projections onto the planes of the triangles, and which lie inside."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0]
    normal = np.cross(u, v)
    squared_normal = np.einsum("pi,pi->p", normal, normal)
    proper = squared_normal > 0.0
    scale = np.where(proper, squared_normal, 1.0)
    second = np.einsum("pi,pi->p", np.cross(offset, v), normal) / scale
    third = np.einsum("pi,pi->p", np.cross(u, offset), normal) / scale
    weights = np.stack([1.0 - second - third, second, third], axis=1)
    inside = proper & (weights >= 0.0).all(axis=1)
    weights[~inside] = 0.0
    return weights, inside
