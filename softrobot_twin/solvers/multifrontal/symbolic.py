"""Symbolic analysis: from a node graph and an order to fronts, once per scene, without numbers.

Eliminating a node couples all its later neighbours with each other. Column j of the factor L has an
entry wherever this happens; the first entry below its diagonal names its *parent*, the first later
column that needs the result of j (Liu 1990). Columns in different subtrees never meet.

Columns with the same structure form a supernode, which is eliminated in one dense *front*. Small
supernodes are merged into their parents where this saves time. A supernode has costs besides its
arithmetic: its update is written, read and added into the parent; strips of eight rows are computed
whether filled or not; a pivot waits for the last one. Treating a child's columns as if they had all
rows of its parent stores and multiplies some zeros, and saves the child's own costs. The cost model
counts the operations of this package's kernels. The optimum is flat: it predicts the time of whole
factorizations within a fifth, and constants wrong by a factor of two cost a few percent.

Graphs are symmetric and in compressed form: the neighbours of j are
`indices[indptr[j]:indptr[j + 1]]`. Nodes are numbered in elimination order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.solvers.multifrontal.dense_kernels import WIDE
from softrobot_twin.solvers.multifrontal.vector_code import STRIP

NONE = -1
# Cycles (Zen 5, AVX-512): for a front; for a bar of columns (waiting for its pivots); for one strip
# of eight rows in one column: to multiply-add, to store and clear, to add into the parent.
FRONT = 250.0
BAR = 180.0
MULTIPLY = 0.5
STORE = 2.5
HAND_OVER = 3.0


class Elimination(NamedTuple):
    """Which nodes are eliminated when, and together in which front.

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
    """
    rows = np.asarray(rows, dtype=np.int64).ravel()
    columns = np.asarray(columns, dtype=np.int64).ravel()
    apart = rows != columns
    i = np.concatenate([rows[apart], columns[apart]])
    j = np.concatenate([columns[apart], rows[apart]])
    graph = sp.csr_array((np.ones(len(i)), (i, j)), shape=(node_count, node_count))
    graph.sum_duplicates()
    graph.data[:] = 1.0
    return _with_short_indices(graph)


def subgraph(graph: sp.csr_array, nodes: np.ndarray) -> sp.csr_array:
    """The graph of some nodes, numbered as they are listed.

    Args:
        graph: Adjacency of all nodes, symmetric, shape (node_count, node_count).
        nodes: Numbers of the nodes that remain, shape (count,).
    """
    return _with_short_indices(sp.csr_array(graph[nodes][:, nodes]))


def _with_short_indices(graph: sp.csr_array) -> sp.csr_array:
    """The same graph; scipy's graph routines take 32-bit indices only."""
    graph.indptr, graph.indices = graph.indptr.astype(np.int32), graph.indices.astype(np.int32)
    return graph


def renumbered(graph: sp.csr_array, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The graph with node order[k] numbered k, as (indptr, indices).

    Args:
        graph: Adjacency of the nodes, symmetric, shape (node_count, node_count).
        order: Node at each place, shape (node_count,).
    """
    rank = inverse(order)
    lengths = np.diff(graph.indptr)[order]
    indptr = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    within = np.arange(indptr[-1]) - np.repeat(indptr[:-1], lengths)
    source = np.repeat(graph.indptr[:-1][order], lengths) + within
    return indptr, rank[graph.indices[source]]


def inverse(order: np.ndarray) -> np.ndarray:
    """The inverse of a permutation, as int64.

    Args:
        order: Node at each place, shape (node_count,).
    """
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank


@njit(**KERNEL)
def elimination_tree(indptr, indices):
    """Parent of each column, -1 at roots, shape (node_count,).

    Args:
        indptr: Where the neighbours of each node begin, shape (node_count + 1,).
        indices: Neighbours of all nodes, shape (neighbour_count,).
    """
    count = len(indptr) - 1
    parent = np.full(count, NONE)
    ancestor = np.full(count, NONE)  # shortcuts towards the root
    for j in range(count):
        for p in range(indptr[j], indptr[j + 1]):
            i = indices[p]
            while i != NONE and i < j:
                following = ancestor[i]
                ancestor[i] = j
                if following == NONE:
                    parent[i] = j
                i = following
    return parent


@njit(**KERNEL)
def postorder(parent, precedence):
    """Order in which every subtree is finished before its parent.

    Args:
        parent: Parents of a forest, in any numbering, shape (count,).
        precedence: All members; of siblings the one that stands later here comes first,
            shape (count,).

    Returns:
        The members in postorder, shape (count,).
    """
    count = len(parent)
    first_child = np.full(count + 1, NONE)  # the last entry holds the roots
    sibling = np.full(count, NONE)
    for i in precedence:
        p = parent[i] if parent[i] != NONE else count
        sibling[i] = first_child[p]
        first_child[p] = i
    order = np.empty(count, np.int64)
    stack = np.empty(count + 1, np.int64)
    stack[0], height, done = count, 1, 0
    while height > 0:
        top = stack[height - 1]
        child = first_child[top]
        if child != NONE:
            first_child[top] = sibling[child]
            stack[height] = child
            height += 1
        else:
            height -= 1
            if top != count:
                order[done] = top
                done += 1
    return order


@njit(**KERNEL)
def _column_counts(indptr, indices, parent):
    """Entries of each column of L below its diagonal, shape (node_count,).

    Row i of L is the part of the tree between i and its earlier neighbours.
    """
    count = len(parent)
    counts = np.zeros(count, np.int64)
    seen = np.full(count, NONE)
    for i in range(count):
        seen[i] = i
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            while j < i and seen[j] != i:
                seen[j] = i
                counts[j] += 1
                j = parent[j]
    return counts


@njit(**KERNEL)
def fundamental_supernodes(parent, counts):
    """Runs of columns with one structure: each the parent of the one before it.

    Args:
        parent: Elimination tree in postorder, shape (node_count,).
        counts: Entries below the diagonal, shape (node_count,).

    Returns:
        Supernode of each column, shape (node_count,).
    """
    supernode = np.zeros(len(parent), np.int64)
    for j in range(1, len(parent)):
        follows = parent[j - 1] == j and counts[j - 1] == counts[j] + 1
        supernode[j] = supernode[j - 1] + (0 if follows else 1)
    return supernode


@njit(**KERNEL)
def supernode_rows(indptr, indices, first, supernode, parent):
    """Rows below each supernode's own columns.

    Args:
        indptr: Graph in elimination order.
        indices: Its neighbours.
        first: First column of each supernode, and the node count, shape (supernode_count + 1,).
        supernode: Supernode of each column, shape (node_count,).
        parent: Parent of each supernode, shape (supernode_count,).

    Returns:
        Where each supernode's rows start, shape (supernode_count + 1,), and the rows, ascending.
    """
    count = len(first) - 1
    start = np.zeros(count + 1, np.int64)
    rows = np.empty(0, np.int64)
    for filling in (False, True):
        seen = np.full(count, NONE)
        place = start[:-1].copy()
        for i in range(len(supernode)):
            seen[supernode[i]] = i
            for p in range(indptr[i], indptr[i + 1]):
                s = supernode[indices[p]] if indices[p] < i else supernode[i]
                while seen[s] != i:
                    seen[s] = i
                    if filling:
                        rows[place[s]] = i
                    place[s] += 1
                    s = parent[s]
        if not filling:
            for s in range(count):
                start[s + 1] = start[s] + place[s]
            rows = np.empty(start[-1], np.int64)
    return start, rows


@njit(**KERNEL)
def front_cost(column_nodes, row_nodes):
    """Cycles that a front takes.

    Args:
        column_nodes: Nodes eliminated in it.
        row_nodes: Nodes it updates.
    """
    columns, rows = 3 * column_nodes, 3 * (column_nodes + row_nodes)
    cost = FRONT
    for start in range(0, columns, WIDE):
        strip_columns = WIDE * ((rows - start + STRIP - 1) // STRIP)
        cost += BAR + strip_columns * (STORE + MULTIPLY * start)
    for start in range(columns, rows, WIDE):
        strip_columns = WIDE * ((rows - start + STRIP - 1) // STRIP)
        cost += strip_columns * (STORE + HAND_OVER + MULTIPLY * columns)
    return cost


@njit(**KERNEL)
def total_cost(column_nodes, row_nodes):
    """Cycles of a whole factorization.

    Args:
        column_nodes: Nodes eliminated in each front, shape (front_count,).
        row_nodes: Nodes that each front updates, same shape.
    """
    cost = 0.0
    for s in range(len(column_nodes)):
        cost += front_cost(column_nodes[s], row_nodes[s])
    return cost


@njit(**KERNEL)
def merge_supernodes(column_nodes, row_nodes, parent):
    """Merge children into parents, from the leaves up, best gain first.

    Args:
        column_nodes: Columns of each supernode, in postorder, shape (count,); changed to those
            of the merged ones.
        row_nodes: Rows below them, shape (count,).
        parent: Parent of each supernode, -1 at roots, shape (count,).

    Returns:
        For each supernode the one that it became part of, itself if it stays, shape (count,).
    """
    count = len(parent)
    into = np.arange(count)
    first_child = np.full(count, NONE)
    sibling = np.full(count, NONE)
    for s in range(count):
        if parent[s] != NONE:
            sibling[s] = first_child[parent[s]]
            first_child[parent[s]] = s
    for s in range(count):
        while True:
            child = _best_child(s, column_nodes, row_nodes, first_child, sibling)
            if child == NONE:
                break
            column_nodes[s] += column_nodes[child]
            into[child] = s
            _adopt(s, child, first_child, sibling)
    for s in range(count - 1, -1, -1):
        into[s] = into[into[s]]
    return into


@njit(**ONCE)
def _best_child(s, column_nodes, row_nodes, first_child, sibling):
    """The child whose merging into s gains most, or -1."""
    best, best_gain = NONE, 0.0
    own = front_cost(column_nodes[s], row_nodes[s])
    child = first_child[s]
    while child != NONE:
        apart = own + front_cost(column_nodes[child], row_nodes[child])
        gain = apart - front_cost(column_nodes[s] + column_nodes[child], row_nodes[s])
        if gain > best_gain:
            best, best_gain = child, gain
        child = sibling[child]
    return best


@njit(**ONCE)
def _adopt(s, child, first_child, sibling):
    """Remove a child from the list of s, and add its own children."""
    if first_child[s] == child:
        first_child[s] = sibling[child]
    else:
        before = first_child[s]
        while sibling[before] != child:
            before = sibling[before]
        sibling[before] = sibling[child]
    while first_child[child] != NONE:
        moved = first_child[child]
        first_child[child] = sibling[moved]
        sibling[moved] = first_child[s]
        first_child[s] = moved


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
    counts = _column_counts(*structure, parent)
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
    # Siblings with the largest updates come first: their memory is reused.
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
    """Order the nodes of each front so that those shared by the same descendants are neighbours.

    Inside a front any order has the same fill; with this one, updates are added to parents in
    longer runs.

    Args:
        graph: Adjacency of the nodes, symmetric, shape (node_count, node_count).
        elimination: An elimination of them; stays as it is.
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
    """The front below whose columns each of `rows` lies.

    Args:
        elimination: The elimination.
    """
    counts = np.diff(elimination.row_start)
    return np.repeat(np.arange(len(counts)), counts)


def _numbered(graph: sp.csr_array, order: np.ndarray, front: np.ndarray, parent: np.ndarray) -> Elimination:
    """The elimination with this order of nodes, and these fronts of ranks."""
    first = np.searchsorted(front, np.arange(len(parent) + 1)).astype(np.int64)
    row_start, rows = supernode_rows(*renumbered(graph, order), first, front, parent)
    cost = total_cost(np.diff(first), np.diff(row_start))
    return Elimination(order, inverse(order), first, front, parent, row_start, rows, cost)
