"""Merging small supernodes into their parents, where that saves time.

A supernode costs time that has nothing to do with its arithmetic: its update is written, read and
added into the parent; strips of eight rows are worked on whether filled or not; a pivot waits for
the one before. Treating a child's columns as if they had all rows of its parent stores and
multiplies some zeros, and saves the child's own costs. The cost model below counts what the
kernels of this package do. The optimum is flat: it predicts the time of whole factorizations to a
fifth, and constants wrong by a factor of two cost some percent.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.solvers.multifrontal.elimination_tree import NONE
from softrobot_twin.solvers.multifrontal.tiles import WIDE
from softrobot_twin.solvers.multifrontal.vector_code import STRIP

# Cycles (Zen 5, AVX-512) for a front as such; for a bar of columns (the wait for its pivots); for
# one strip of eight rows in one column: to multiply-add, to store and clear, to add into the parent.
FRONT = 250.0
BAR = 180.0
MULTIPLY = 0.5
STORE = 2.5
HAND_OVER = 3.0


@njit(cache=True)
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


@njit(cache=True)
def total_cost(column_nodes, row_nodes):
    """Cycles of a whole factorization, given the nodes of each front."""
    cost = 0.0
    for s in range(len(column_nodes)):
        cost += front_cost(column_nodes[s], row_nodes[s])
    return cost


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def _adopt(s, child, first_child, sibling):
    """Take a child off s's list, and put its children on."""
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
