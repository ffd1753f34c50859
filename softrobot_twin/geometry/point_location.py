"""Cell and weights of points, or the nearest point of the surface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from softrobot_twin.geometry.box_tree import BoxTree, box_tree, near_items, nearest_distances
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.shape_functions import TRILINEAR_HEXAHEDRON
from softrobot_twin.geometry.surface import boundary_faces
from softrobot_twin.geometry.tet_mesh import TetMesh

# A negative weight above minus this value is round-off: the point lies on the face.
_WEIGHT_ROUND_OFF = 1e-9
# Newton's method in a hexahedron: when it has converged, as a share of the cell's size; the least
# determinant, as a share of its cube; the largest coordinate; and how often at most.
_CONVERGED, _SINGULAR, _FURTHEST, _MOST_ITERATIONS = 1e-12, 1e-14, 2.0, 30
# Number of points handled at once, which bounds the memory of the candidate pairs.
_CHUNK = 1024
# Two triangles of one edge are equally near a point but for round-off: the first of them is taken.
_ROUND_OFF = 1.0 + 1e-9


class PointLocation(NamedTuple):
    """Location of points in a mesh: point i is ``barycentric_weights[i] @ positions[nodes[i]]``.

    A point outside the body is represented by the nearest point of the surface.

    Attributes:
        cells: Cell that contains each point, int64, shape (point_count,).
        nodes: Corners of that cell, as in `mesh.cells`, int64, shape (point_count, 4); of a
            `HexahedralMesh` (point_count, 8).
        barycentric_weights: Weights of those nodes, all ≥ 0 with sum 1, same shape.
        distances: Distances of the query points from the body [m], 0 inside, shape (point_count,).
    """

    cells: np.ndarray
    nodes: np.ndarray
    barycentric_weights: np.ndarray
    distances: np.ndarray


def locate_points(mesh: TetMesh | HexahedralMesh, points: np.ndarray) -> PointLocation:
    """Finds the cell of points and their weights in it.

    Args:
        mesh: Mesh of the body, by its corners.
        points: Points [m], shape (point_count, 3) or (3,).

    Returns:
        The location of each point. A point shared by several cells is assigned to the one that it
        is deepest in, by its smallest weight in a tetrahedron, then to the first. A point outside gets the weights of
        the nearest point of the surface and its distance from it; weights are never extrapolated.
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    cells, weights, lowest = _deepest_cells(mesh, points)
    weights = np.clip(weights, 0.0, None)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1.0)
    distances = np.zeros(len(points))
    outside = lowest < -_WEIGHT_ROUND_OFF
    if outside.any():
        cells[outside], weights[outside], distances[outside] = _nearest_on_surface(mesh, points[outside])
    return PointLocation(cells, mesh.cells[cells], weights, distances)


def extrapolated_weights(
    mesh: TetMesh | HexahedralMesh, found: PointLocation, points: np.ndarray
) -> np.ndarray:
    """Weights of points in the cells that were found for them, also of points outside.

    Args:
        mesh: Mesh of the body, by its corners.
        found: Location of the points.
        points: The points [m], shape (point_count, 3).

    Returns:
        Weights of `found.nodes`, each row of sum 1, same shape. Outside a hexahedron they are
        continued linearly from the nearest point of the surface.
    """
    if not isinstance(mesh, HexahedralMesh):
        return barycentric_weights(mesh.node_positions[found.nodes], points)
    weights = found.barycentric_weights.copy()
    tet_count = len(mesh.tets)
    in_tets = np.flatnonzero(found.cells < tet_count)
    if len(in_tets):
        corners = mesh.node_positions[found.nodes[in_tets, :4]]
        weights[in_tets] = 0.0
        weights[in_tets, :4] = barycentric_weights(corners, points[in_tets])
    outside = np.flatnonzero((found.cells >= tet_count) & (found.distances > 0.0))
    if len(outside):
        corners = mesh.node_positions[found.nodes[outside]]
        nearest = np.einsum("pa,pai->pi", weights[outside], corners)
        places, _ = _inverse_isoparametric(corners, nearest)
        slopes = TRILINEAR_HEXAHEDRON.slopes(np.clip(places, -1.0, 1.0))
        jacobians = np.einsum("pai,paj->pij", corners, slopes)
        beyond = np.linalg.solve(jacobians, (points[outside] - nearest)[..., None])[..., 0]
        weights[outside] += np.einsum("paj,pj->pa", slopes, beyond)
    return weights


def barycentric_weights(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights of points in tetrahedra, also of points outside.

    Args:
        corners: Corners of the tetrahedron of each point [m], shape (point_count, 4, 3).
        points: The points [m], shape (point_count, 3).

    Returns:
        Weights, each row of sum 1, shape (point_count, 4).
    """
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    last = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
    return np.column_stack([1.0 - last.sum(axis=1), last])


def _deepest_cells(
    mesh: TetMesh | HexahedralMesh, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cell of each point, its weights there, and how deep it is: negative outside."""
    if not isinstance(mesh, HexahedralMesh):
        return _deepest_tets(_items_of(mesh, "cells", mesh.cells), points)
    cells, weights, depths = _deepest_hexahedra(mesh, points)
    cells += len(mesh.tets)
    if len(mesh.tets):
        tets, of_tets, in_tets = _deepest_tets(_items_of(mesh, "tets", mesh.tets), points)
        better = in_tets >= depths
        cells[better], depths[better] = tets[better], in_tets[better]
        weights[better] = np.hstack([of_tets, np.zeros((len(points), 4))])[better]
    return cells, weights, depths


class _Items(NamedTuple):
    """Cells, or triangles of a surface, as they are searched.

    Attributes:
        corners: Of each item [m], shape (item_count, corner_count, 3).
        tree: Of their boxes.
    """

    corners: np.ndarray
    tree: BoxTree


# A scene asks for the points of each of its entries, and each change of its numbers once more: of
# each mesh this keeps what was laid out, by its name, and where the last sets of points are.
_KNOWN: WeakKeyDictionary[TetMesh | HexahedralMesh, dict[str | bytes, Any]] = WeakKeyDictionary()
_MOST_KNOWN = 256


def remembered_location(mesh: TetMesh | HexahedralMesh, points: np.ndarray) -> PointLocation:
    """The same as `locate_points` for a set of points that may be asked for again soon.

    Args:
        mesh: Mesh of the body, by its corners.
        points: Points [m], shape (point_count, 3).
    """
    known, key = _KNOWN.setdefault(mesh, {}), points.tobytes()
    if key not in known:
        if len(known) > _MOST_KNOWN:
            for old in [one for one in known if isinstance(one, bytes)][: _MOST_KNOWN // 2]:
                del known[old]
        known[key] = locate_points(mesh, points)
    found: PointLocation = known[key]
    return found


def _surface_of(mesh: TetMesh | HexahedralMesh) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the surface, and the cells that they belong to; found once."""
    if isinstance(mesh, HexahedralMesh):
        return mesh.surface_triangles, mesh.cells_of_surface
    known = _KNOWN.setdefault(mesh, {})
    if "surface" not in known:
        known["surface"] = boundary_faces(mesh.cells)
    surface, owners = known["surface"]
    return surface, owners


def _items_of(mesh: TetMesh | HexahedralMesh, kind: str, nodes: np.ndarray) -> _Items:
    """The items of a mesh of one kind, which are laid out once."""
    known, key = _KNOWN.setdefault(mesh, {}), f"{kind} tree"
    if key not in known:
        corners = mesh.node_positions[nodes]
        known[key] = _Items(corners, box_tree(corners))
    items: _Items = known[key]
    return items


def _deepest(
    cells: _Items, points: np.ndarray,
    weights_in: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """For each point, the cell that it is deepest in, its weights there, and its depth.

    The depth is −∞ for points outside the boxes of all cells, in which the cells lie.

    Args:
        cells: The cells.
        points: The points [m], shape (point_count, 3).
        weights_in: Gives weights and depths of pairs of a point and a cell, by its number.
    """
    best = np.zeros(len(points), dtype=np.int64)
    weights = np.zeros((len(points), cells.corners.shape[1]))
    depths = np.full(len(points), -np.inf)
    for start in range(0, len(points), _CHUNK):
        chunk = points[start : start + _CHUNK]
        owner, found = near_items(cells.tree, chunk, np.zeros(len(chunk)))
        if len(owner) == 0:
            continue
        own, depth = weights_in(chunk[owner], found)
        winners = _first_best(owner, found, -depth)
        rows = start + owner[winners]
        best[rows], weights[rows], depths[rows] = found[winners], own[winners], depth[winners]
    return best, weights, depths


def _deepest_hexahedra(mesh: HexahedralMesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same among hexahedra: the depth is (1 - max |ξ_i|) / 2."""
    items = _items_of(mesh, "hexahedra", mesh.hexahedra)
    corners = items.corners

    def weights_in(asked: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        places, is_found = _inverse_isoparametric(corners[cells], asked)
        depth = np.where(is_found, 0.5 * (1.0 - np.abs(places).max(axis=1)), -np.inf)
        return TRILINEAR_HEXAHEDRON.values(np.clip(places, -1.0, 1.0)), depth

    return _deepest(items, points, weights_in)


def _inverse_isoparametric(corners: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reference coordinates of points in hexahedra by Newton's method, and whether it converged.

    Iterates are kept within twice the cell: a point that needs more is not in it.
    """
    # Relative to the cell: its place in the world costs no digits.
    centres = corners.mean(axis=1)
    corners, points = corners - centres[:, None], points - centres
    places = np.zeros((len(points), 3))
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    for _ in range(_MOST_ITERATIONS):
        slopes = TRILINEAR_HEXAHEDRON.slopes(places)
        left = points - np.einsum("pa,pai->pi", TRILINEAR_HEXAHEDRON.values(places), corners)
        if (np.linalg.norm(left, axis=1) <= _CONVERGED * size).all():
            break
        jacobians = np.einsum("pai,paj->pij", corners, slopes)
        regular = np.abs(np.linalg.det(jacobians)) > _SINGULAR * size**3
        jacobians[~regular] = np.eye(3)
        moves = np.linalg.solve(jacobians, left[..., None])[..., 0]
        moves[~regular] = 0.0
        places = np.clip(places + moves, -_FURTHEST, _FURTHEST)
    left = points - np.einsum("pa,pai->pi", TRILINEAR_HEXAHEDRON.values(places), corners)
    return places, np.linalg.norm(left, axis=1) <= _CONVERGED * size


def _deepest_tets(items: _Items, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same among tetrahedra: the depth is the smallest weight."""
    corners = items.corners

    def weights_in(asked: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        used, of_used = np.unique(tets, return_inverse=True)
        edges = (corners[used, 1:] - corners[used, :1]).transpose(0, 2, 1)
        weights = np.empty((len(tets), 4))
        weights[:, 1:] = np.einsum("pij,pj->pi", np.linalg.inv(edges)[of_used], asked - corners[tets, 0])
        weights[:, 0] = 1.0 - weights[:, 1:].sum(axis=1)
        return weights, weights.min(axis=1)

    return _deepest(items, points, weights_in)


def _nearest_on_surface(
    mesh: TetMesh | HexahedralMesh, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cells, weights and distances [m] of the nearest points on the surface."""
    surface, owners = _surface_of(mesh)
    corners, tree = _items_of(mesh, "surface", surface)
    reaches = nearest_distances(tree, corners, points)
    cells = np.empty(len(points), dtype=np.int64)
    weights = np.zeros((len(points), mesh.cells.shape[1]))
    distances = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        chunk = slice(start, start + _CHUNK)
        owner, triangles = near_items(tree, points[chunk], _ROUND_OFF * reaches[chunk])
        asked = points[chunk][owner]
        corner_weights = closest_on_triangles(asked, corners[triangles])
        closest = np.einsum("pc,pci->pi", corner_weights, corners[triangles])
        pair_distances = np.linalg.norm(asked - closest, axis=1)
        winners = _first_best(owner, triangles, pair_distances)
        rows = start + owner[winners]
        cells[rows] = owners[triangles[winners]]
        distances[rows] = pair_distances[winners]
        nodes = mesh.cells[cells[rows]]
        on_face = nodes[:, :, None] == surface[triangles[winners], None]
        # A tetrahedron's row of eight nodes repeats its last one, which counts once.
        on_face[:, 4:] &= (nodes[:, 4:] != nodes[:, 3:-1])[:, :, None]
        weights[rows] = np.einsum("pnc,pc->pn", on_face, corner_weights[winners])
    return cells, weights, distances


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
