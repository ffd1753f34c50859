"""Symbolic analysis: from a graph and an order to fronts, once per scene, without numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrobot_twin.solvers.multifrontal.elimination_tree import (
    NONE,
    column_counts,
    elimination_tree,
    fundamental_supernodes,
    postorder,
    supernode_rows,
)
from softrobot_twin.solvers.multifrontal.merging import merge_supernodes, total_cost


class Elimination(NamedTuple):
    """Who is eliminated when, and together with whom.

    Attributes:
        order: Node at each rank, shape (node_count,).
        rank: Rank of each node, shape (node_count,).
        first: First rank of each front, and the node count, shape (front_count + 1,).
        front: Front of each rank, shape (node_count,).
        parent: Front that each front's update goes to, -1 at roots, shape (front_count,).
        row_start: Where each front's rows start, shape (front_count + 1,).
        rows: Ranks of the rows below each front's own columns, ascending.
        cost: Estimated cycles of the numeric factorization.
    """

    order: np.ndarray
    rank: np.ndarray
    first: np.ndarray
    front: np.ndarray
    parent: np.ndarray
    row_start: np.ndarray
    rows: np.ndarray
    cost: float


def node_graph(rows: np.ndarray, columns: np.ndarray, node_count: int) -> sp.csr_array:
    """The symmetric graph of coupled nodes, without loops.

    Args:
        rows: Nodes of coupled pairs, in any order, repeated or not.
        columns: Their partners, same shape.
        node_count: Number of nodes.

    Returns:
        Adjacency, shape (node_count, node_count), its indices sorted.

    Raises:
        ValueError: A pair names a node that does not exist.
    """
    rows = np.asarray(rows, dtype=np.int64).ravel()
    columns = np.asarray(columns, dtype=np.int64).ravel()
    for nodes in (rows, columns):
        if len(nodes) and not 0 <= nodes.min() <= nodes.max() < node_count:
            raise ValueError(f"a pair names a node outside 0..{node_count - 1}")
    apart = rows != columns
    i = np.concatenate([rows[apart], columns[apart]])
    j = np.concatenate([columns[apart], rows[apart]])
    graph = sp.csr_array((np.ones(len(i)), (i, j)), shape=(node_count, node_count))
    graph.sum_duplicates()
    graph.data[:] = 1.0
    return _with_short_indices(graph)


def subgraph(graph: sp.csr_array, nodes: np.ndarray) -> sp.csr_array:
    """The graph of some nodes, numbered as they are listed."""
    return _with_short_indices(sp.csr_array(graph[nodes][:, nodes]))


def _with_short_indices(graph: sp.csr_array) -> sp.csr_array:
    """The same graph; scipy's graph routines take 32-bit indices only."""
    graph.indptr, graph.indices = graph.indptr.astype(np.int32), graph.indices.astype(np.int32)
    return graph


def renumbered(graph: sp.csr_array, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The graph with node order[k] numbered k, as (indptr, indices)."""
    rank = inverse(order)
    lengths = np.diff(graph.indptr)[order]
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    within = np.arange(indptr[-1]) - np.repeat(indptr[:-1], lengths)
    source = np.repeat(graph.indptr[:-1][order], lengths) + within
    return indptr, rank[graph.indices[source]]


def inverse(order: np.ndarray) -> np.ndarray:
    """The inverse of a permutation, as int64."""
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank


def analyse(graph: sp.csr_array, order: np.ndarray) -> Elimination:
    """Find the fronts of an elimination order.

    Args:
        graph: Symmetric graph of the nodes, without loops.
        order: Node to eliminate at each rank, shape (node_count,); only the tree that it
            defines matters, so the order returned is another one with the same fill.

    Returns:
        The elimination, fronts in postorder.
    """
    order = np.asarray(order, dtype=np.int64)
    parent = elimination_tree(*renumbered(graph, order))
    order = order[postorder(parent, np.arange(len(order))[::-1].copy())]
    structure = renumbered(graph, order)
    parent = elimination_tree(*structure)
    counts = column_counts(*structure, parent)
    supernode = fundamental_supernodes(parent, counts)

    count = int(supernode[-1]) + 1 if len(supernode) else 0
    last = np.searchsorted(supernode, np.arange(count), side="right") - 1
    column_nodes, row_nodes = np.bincount(supernode, minlength=count), counts[last]
    tree = _contracted(parent[last], supernode)
    into = merge_supernodes(column_nodes, row_nodes, tree)

    kept = np.flatnonzero(into == np.arange(count))
    number = np.full(count, NONE)
    number[kept] = np.arange(len(kept))
    tree = _contracted(tree[kept], number[into])
    # Siblings with the largest updates come first: theirs is the room that is reused.
    sequence = postorder(tree, np.argsort(row_nodes[kept], kind="stable"))
    place = inverse(sequence)
    # Columns keep their order inside a front, fronts follow their new postorder.
    front = place[number[into[supernode]]]
    order = order[np.argsort(front, kind="stable")]
    return _numbered(graph, order, np.sort(front), _contracted(tree[sequence], place))


def _contracted(parent: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Groups of the parents, -1 at roots."""
    return np.where(parent == NONE, NONE, np.append(group, NONE)[parent])


def with_longer_runs(graph: sp.csr_array, elimination: Elimination) -> Elimination:
    """Order nodes inside fronts so that those which descendants hold in common stand together.

    Inside a front any order has the same fill; this one lets updates be added to parents in longer
    stretches.
    """
    holder = front_of_rows(elimination)
    by_row = np.lexsort((holder, elimination.rows))
    ends = np.cumsum(np.bincount(elimination.rows, minlength=len(elimination.order)))
    holders = [tuple(part.tolist()) for part in np.split(holder[by_row], ends[:-1])]
    ranks = sorted(
        range(len(elimination.order)), key=lambda rank: (elimination.front[rank], holders[rank])
    )
    return _numbered(graph, elimination.order[ranks], elimination.front, elimination.parent)


def front_of_rows(elimination: Elimination) -> np.ndarray:
    """The front below whose columns each of `rows` lies."""
    counts = np.diff(elimination.row_start)
    return np.repeat(np.arange(len(counts)), counts)


def _numbered(
    graph: sp.csr_array, order: np.ndarray, front: np.ndarray, parent: np.ndarray
) -> Elimination:
    """The elimination with this order of nodes, and these fronts of ranks."""
    first = np.searchsorted(front, np.arange(len(parent) + 1)).astype(np.int64)
    row_start, rows = supernode_rows(*renumbered(graph, order), first, front, parent)
    cost = total_cost(np.diff(first), np.diff(row_start))
    return Elimination(order, inverse(order), first, front, parent, row_start, rows, cost)
