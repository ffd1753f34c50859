"""Repair of raw tetrahedra. Each repair returns what it changed, so that it can be reported."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.geometry.hexahedral_mesh import (
    DIAGONAL_HALVES,
    HEXAHEDRON_FACES,
    INTO_TETS,
)
from softrobot_twin.geometry.tet_mesh import tet_volumes

# Volume divided by the cube of the longest edge, 0.118 for a regular tetrahedron. Below this value
# the sign of the volume is round-off.
_FLAT = 1e-12
# Distance, relative to the size of the body, below which nodes of separate parts coincide: files of
# single precision store coordinates to 6e-8.
_TOUCHING = 1e-6


class RenumberedNodes(NamedTuple):
    """The used nodes, and the mapping between old and new indices.

    Attributes:
        node_positions: Node positions [m], shape (new_count, 3).
        tets: New node indices, shape (tet_count, 4).
        old_indices: Old index of each new node, shape (new_count,).
        new_indices: New index of each old node, −1 for a dropped one, shape (old_count,).
    """

    node_positions: np.ndarray
    tets: np.ndarray
    old_indices: np.ndarray
    new_indices: np.ndarray


def orient_tets(node_positions: np.ndarray, tets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Reorients inverted tetrahedra by swapping their last two nodes.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        The tetrahedra in the same order, and the indices of those that were inverted.
    """
    inverted = np.flatnonzero(tet_volumes(node_positions, tets) < 0.0)
    oriented = tets.copy()
    oriented[inverted] = oriented[inverted][:, [0, 1, 3, 2]]
    return oriented, inverted


def enclose_volume(node_positions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Whether tetrahedra enclose a volume: flat ones and those that refer to a node twice do not.

    Those contain no material, and material laws cannot be evaluated on them.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Shape (tet_count,).
    """
    corners = node_positions[tets]
    edges = corners[:, [1, 2, 3, 2, 3, 3]] - corners[:, [0, 0, 0, 1, 1, 2]]
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    return np.abs(tet_volumes(node_positions, tets)) > _FLAT * longest**3


def first_of_repeated_tets(tets: np.ndarray) -> np.ndarray:
    """Finds the first of each set of tetrahedra with the same nodes in any order.

    Args:
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Index of the first of each, in rising order, shape (kept_count,).
    """
    _, first = np.unique(np.sort(tets, axis=1), axis=0, return_index=True)
    return np.sort(first)


def drop_unused_nodes(
    node_positions: np.ndarray, tets: np.ndarray, others: np.ndarray | None = None
) -> RenumberedNodes:
    """Drops the nodes that no cell uses, keeping the order of the others.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).
        others: Node indices of cells of another kind, any shape; None without any.

    Returns:
        The used nodes, the renumbered tetrahedra and both mappings.
    """
    used = np.unique(tets) if others is None else np.union1d(tets, others)
    new_indices = np.full(len(node_positions), -1, dtype=np.int64)
    new_indices[used] = np.arange(len(used))
    return RenumberedNodes(node_positions[used], new_indices[tets], used, new_indices)


def first_of_duplicates(node_positions: np.ndarray, tolerance: float) -> np.ndarray:
    """Finds the node that represents each node when coincident nodes are merged.

    Nodes may coincide on purpose (a cut, two bodies in contact), so they are merged only on
    request.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tolerance: Largest distance between two nodes to merge [m].

    Returns:
        Index of the first node of the group of each node, its own if it is alone, int64, shape
        (node_count,).
    """
    return _first_of_groups(coincident_pairs(node_positions, tolerance), len(node_positions))


def first_of_touching_parts(node_positions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Finds the node that represents each node when separate, touching parts are joined.

    A cut within one part is kept: its two sides are connected elsewhere, so it is intended.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Index of the first node of the group of each node, its own if it is not joined, int64, shape
        (node_count,).
    """
    node_count = len(node_positions)
    part = component_labels(tets, node_count)
    used = np.unique(tets)
    if len(np.unique(part[used])) == 1:
        return np.arange(node_count)
    corners = node_positions[tets]
    edges = np.linalg.norm(corners[:, [1, 2, 3, 2, 3, 3]] - corners[:, [0, 0, 0, 1, 1, 2]], axis=2)
    size = float(np.linalg.norm(np.ptp(node_positions[used], axis=0)))
    shortest = float(edges[edges > 0.0].min(initial=size))
    pairs = used[coincident_pairs(node_positions[used], min(_TOUCHING * size, 0.01 * shortest))]
    pairs = pairs[part[pairs[:, 0]] != part[pairs[:, 1]]].reshape(-1, 2)
    return _first_of_groups(pairs, node_count)


def _first_of_groups(pairs: np.ndarray, node_count: int) -> np.ndarray:
    """First node of the group that pairs connect each node to, shape (node_count,)."""
    _, first, group = np.unique(
        connected_pieces(*pairs.T, node_count), return_index=True, return_inverse=True
    )
    return first[group]


def coincident_pairs(node_positions: np.ndarray, tolerance: float) -> np.ndarray:
    """Finds the pairs of coincident nodes.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tolerance: Largest distance between coincident nodes [m].

    Returns:
        Pairs of node indices, shape (pair_count, 2).
    """
    return cKDTree(node_positions).query_pairs(tolerance, output_type="ndarray")


def component_labels(tets: np.ndarray, node_count: int) -> np.ndarray:
    """Labels the connected components of a mesh.

    Args:
        tets: Node indices, shape (tet_count, 4).
        node_count: Number of nodes.

    Returns:
        Number of the component of each node, from 0, shape (node_count,).
    """
    return connected_pieces(np.repeat(tets[:, 0], 3), tets[:, 1:].ravel(), node_count)


def hinged_part_count(tets: np.ndarray, hexahedra: np.ndarray, node_count: int) -> int:
    """Counts the hinges of a mesh: parts connected by edges or single nodes only can rotate.

    Args:
        tets: Node indices, shape (tet_count, 4), each tetrahedron once.
        hexahedra: Those of hexahedra, shape (hexahedron_count, 8). Here each of their faces counts
            as the triangles along both of its diagonals.
        node_count: Number of nodes.

    Returns:
        Number of parts connected by faces minus number of connected components; 0 without hinges.
    """
    faces = np.sort(tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]], axis=2).reshape(-1, 3)
    halves = np.sort(hexahedra[:, HEXAHEDRON_FACES[:, DIAGONAL_HALVES]], axis=-1)
    faces = np.concatenate([faces, halves.reshape(-1, 3)])
    cell_count = len(tets) + len(hexahedra)
    owners = np.repeat(np.arange(cell_count), [4] * len(tets) + [24] * len(hexahedra))
    linked = np.concatenate([tets, hexahedra[:, INTO_TETS].reshape(-1, 4)])
    _, place = np.unique(faces, axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    place, owner = place.ravel()[order], owners[order]
    joined = np.flatnonzero(place[1:] == place[:-1])
    parts = connected_pieces(owner[joined], owner[joined + 1], cell_count)
    components = component_labels(linked, node_count)[np.unique(linked)]
    return int(parts.max()) + 1 - len(np.unique(components))
