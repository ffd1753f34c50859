"""The elimination tree of a graph, and what follows from it without doing any arithmetic.

Eliminating a node couples all its later neighbours with each other. Column j of the factor L has
an entry wherever that happened, and the first entry below its diagonal names its *parent*, the
first later column that needs j's result (Liu, "The role of elimination trees in sparse
factorization", SIAM J. Matrix Anal. Appl. 11, 1990). Columns in different subtrees never meet.

Graphs are symmetric and in compressed form: the neighbours of j are
`indices[indptr[j]:indptr[j + 1]]`. Nodes are numbered in elimination order.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NONE = -1


@njit(cache=True)
def elimination_tree(indptr, indices):
    """Parent of each column, -1 at roots, shape (node_count,)."""
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


@njit(cache=True)
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


@njit(cache=True)
def column_counts(indptr, indices, parent):
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


@njit(cache=True)
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


@njit(cache=True)
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
