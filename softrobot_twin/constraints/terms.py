"""The contract of a constraint term, and the stack that its rows go to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numba import njit


class ConstraintTerm(Protocol):
    """Rows of H and values of δ of all constraints of one kind.

    Attributes:
        name: What the term is called in reports.
        row_count: Number of its rows k.
        entry_rows: Row of each entry, from 0, shape (entry_count,).
        entry_nodes: Free node of each entry, shape (entry_count,).
    """

    name: str
    row_count: int
    entry_rows: np.ndarray
    entry_nodes: np.ndarray

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and δ at a state.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            blocks: Entries of H, shape (entry_count, 3); overwritten.
            values: δ [m], shape (row_count,); overwritten.
        """


class RowStack:
    """The rows of several terms, one above the other, in memory that is allocated once.

    Attributes:
        row_index: Row of each entry, shape (entry_count,).
        node_index: Free node of each entry, shape (entry_count,).
        blocks: Entries of H, shape (entry_count, 3).
        values: δ, shape (row_count,).
        row_count: Number of rows.
    """

    def __init__(self, terms: Sequence[ConstraintTerm]):
        """Give each term its place.

        Args:
            terms: Terms in the order of their rows.
        """
        rows = np.cumsum([0] + [term.row_count for term in terms])
        entries = np.cumsum([0] + [len(term.entry_rows) for term in terms])
        self.row_count = int(rows[-1])
        self.row_index = np.concatenate(
            [np.empty(0, np.int64)]
            + [term.entry_rows + start for term, start in zip(terms, rows[:-1], strict=True)]
        )
        self.node_index = np.concatenate(
            [np.empty(0, np.int64)] + [term.entry_nodes for term in terms]
        )
        self.blocks = np.zeros((int(entries[-1]), 3))
        self.values = np.zeros(self.row_count)
        # Each term's part of what is written, cut out once.
        ends = zip(terms, entries[:-1], entries[1:], rows[:-1], rows[1:], strict=True)
        self._parts = [(term, self.blocks[a:b], self.values[c:d]) for term, a, b, c, d in ends]

    @property
    def row_room(self) -> int:
        """Rows that there is room for."""
        return self.row_count

    @property
    def reached_nodes(self) -> np.ndarray:
        """Unknowns that rows may touch."""
        return self.node_index

    def evaluate(self, positions: np.ndarray) -> None:
        """Let every term write its rows at a state."""
        for term, blocks, values in self._parts:
            term.evaluate(positions, blocks, values)

    def add_forces(self, multipliers: np.ndarray, forces: np.ndarray) -> None:
        """Add Hᵀ λ of the rows evaluated last to the nodes' forces.

        Args:
            multipliers: λ of every row [N], shape (row_count,).
            forces: Forces on the free nodes [N], shape (free_node_count, 3); added to.
        """
        add_row_forces(self.row_index, self.node_index, self.blocks, multipliers, forces)


@njit(cache=True, nogil=True, error_model="numpy")
def add_row_forces(row_index, node_index, blocks, multipliers, forces):
    """Add each entry of H times its row's multiplier to its node's force."""
    for entry in range(len(row_index)):
        node, multiplier = node_index[entry], multipliers[row_index[entry]]
        for axis in range(3):
            forces[node, axis] += blocks[entry, axis] * multiplier
