"""Repair of raw tetrahedra. Each repair returns what it changed, so that it can be reported."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from softrobot_twin.geometry.tet_mesh import tet_volumes

# Volume over the cube of the longest edge; a regular tetrahedron has 0.118. Below this the
# sign of the volume is round-off.
_FLAT = 1e-12
# Nodes of separate pieces this close, relative to the body's size, lie at one place: files of
# single precision keep 6e-8 of a coordinate.
_TOUCHING = 1e-6


class OrientedTets(NamedTuple):
    """Tetrahedra of positive volume.

    Attributes:
        tets: Node indices, shape (tet_count, 4).
        inverted: Indices of those that were turned round.
    """

    tets: np.ndarray
    inverted: np.ndarray


class KeptTets(NamedTuple):
    """Tetrahedra that enclose a volume.

    Attributes:
        tets: Node indices, shape (kept_count, 4).
        kept: Index of each among those given, shape (kept_count,).
        degenerate: Indices, among those given, of the ones dropped.
    """

    tets: np.ndarray
    kept: np.ndarray
    degenerate: np.ndarray


class RenumberedNodes(NamedTuple):
    """Fewer nodes, and how to translate between the old and the new numbers.

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


def orient_tets(node_positions: np.ndarray, tets: np.ndarray) -> OrientedTets:
    """Turns inverted tetrahedra round by swapping their last two nodes.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        The tetrahedra in the same order, and which were inverted.
    """
    inverted = np.flatnonzero(tet_volumes(node_positions, tets) < 0.0)
    oriented = tets.copy()
    oriented[inverted] = oriented[inverted][:, [0, 1, 3, 2]]
    return OrientedTets(oriented, inverted)


def drop_degenerate_tets(node_positions: np.ndarray, tets: np.ndarray) -> KeptTets:
    """Drops tetrahedra without volume: flat ones, and those that name a node twice.

    They carry no material; a mechanical law cannot be evaluated on them.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        The others in the same order, and which were dropped.
    """
    corners = node_positions[tets]
    edges = corners[:, [1, 2, 3, 2, 3, 3]] - corners[:, [0, 0, 0, 1, 1, 2]]
    longest = np.linalg.norm(edges, axis=2).max(axis=1)
    enclosing = np.abs(tet_volumes(node_positions, tets)) > _FLAT * longest**3
    kept = np.flatnonzero(enclosing)
    return KeptTets(tets[kept], kept, np.flatnonzero(~enclosing))


def first_of_repeated_tets(tets: np.ndarray) -> np.ndarray:
    """Finds the tetrahedra to keep where some stand more than once, in any order of their nodes.

    Args:
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Index of the first of each, in rising order, shape (kept_count,).
    """
    _, first = np.unique(np.sort(tets, axis=1), axis=0, return_index=True)
    return np.sort(first)


def drop_unused_nodes(node_positions: np.ndarray, tets: np.ndarray) -> RenumberedNodes:
    """Drops the nodes that no tetrahedron uses, keeping the order of the others.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        The used nodes, the renumbered tetrahedra and both translations.
    """
    used = np.unique(tets)
    new_indices = np.full(len(node_positions), -1, dtype=np.int64)
    new_indices[used] = np.arange(len(used))
    return RenumberedNodes(node_positions[used], new_indices[tets], used, new_indices)


def first_of_duplicates(node_positions: np.ndarray, tolerance: float) -> np.ndarray:
    """Finds which node stands for each when nodes that lie together become one.

    Nodes can lie together on purpose (a cut, two bodies in touch), so they are only merged
    when that is asked for.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tolerance: Largest distance between two nodes that are one [m].

    Returns:
        Index of the first node of each node's group, its own where it lies alone, int64,
        shape (node_count,).
    """
    node_count = len(node_positions)
    labels = _labels(coincident_pairs(node_positions, tolerance), node_count)
    first = np.full(labels.max() + 1, node_count, dtype=np.int64)
    np.minimum.at(first, labels, np.arange(node_count))
    return first[labels]


def first_of_touching_parts(node_positions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Finds which node stands for each when separate pieces that lie against each other join.

    A cut within one piece stays: its two sides hang together elsewhere, so it is meant.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices, shape (tet_count, 4).

    Returns:
        Index of the first node of each node's group, its own where it joins none, int64,
        shape (node_count,).
    """
    node_count = len(node_positions)
    own = np.arange(node_count)
    piece = component_labels(tets, node_count)
    used = np.unique(tets)
    if len(np.unique(piece[used])) == 1:
        return own
    corners = node_positions[tets]
    edges = np.linalg.norm(corners[:, [1, 2, 3, 2, 3, 3]] - corners[:, [0, 0, 0, 1, 1, 2]], axis=2)
    size = float(np.linalg.norm(np.ptp(node_positions[used], axis=0)))
    shortest = float(edges[edges > 0.0].min(initial=size))
    pairs = used[coincident_pairs(node_positions[used], min(_TOUCHING * size, 0.01 * shortest))]
    pairs = pairs[piece[pairs[:, 0]] != piece[pairs[:, 1]]].reshape(-1, 2)
    labels = _labels(pairs, node_count)
    first = np.full(labels.max() + 1, node_count, dtype=np.int64)
    np.minimum.at(first, labels, own)
    return first[labels]


def coincident_pairs(node_positions: np.ndarray, tolerance: float) -> np.ndarray:
    """Finds the nodes that lie together.

    Args:
        node_positions: Node positions [m], shape (node_count, 3).
        tolerance: Largest distance between nodes that lie together [m].

    Returns:
        Pairs of node indices, shape (pair_count, 2).
    """
    return cKDTree(node_positions).query_pairs(tolerance, output_type="ndarray")


def component_labels(tets: np.ndarray, node_count: int) -> np.ndarray:
    """Tells the pieces of a mesh apart: nodes of one piece hang together through tetrahedra.

    Args:
        tets: Node indices, shape (tet_count, 4).
        node_count: Number of nodes.

    Returns:
        Number of the piece of each node, from 0, shape (node_count,).
    """
    edges = np.concatenate([tets[:, [0, corner]] for corner in (1, 2, 3)])
    return _labels(edges, node_count)


def hinged_part_count(tets: np.ndarray, node_count: int) -> int:
    """Counts the parts that hang together by edges or single nodes only, which can turn there.

    Args:
        tets: Node indices, shape (tet_count, 4), each tetrahedron once.
        node_count: Number of nodes.

    Returns:
        Parts that no face joins, less the pieces that nothing joins; 0 where all are whole.
    """
    faces = np.sort(tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]], axis=2).reshape(-1, 3)
    _, place = np.unique(faces, axis=0, return_inverse=True)
    order = np.argsort(place.ravel(), kind="stable")
    place, owner = place.ravel()[order], (order // 4)
    joined = np.flatnonzero(place[1:] == place[:-1])
    parts = _labels(np.stack([owner[joined], owner[joined + 1]], axis=1), len(tets))
    pieces = component_labels(tets, node_count)[np.unique(tets)]
    return int(parts.max()) + 1 - len(np.unique(pieces))


def _labels(edges: np.ndarray, node_count: int) -> np.ndarray:
    graph = coo_matrix(
        (np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])),
        shape=(node_count, node_count),
    )
    _, labels = connected_components(graph, directed=False)
    return labels.astype(np.int64)
