"""All rows of H and values of δ of a scene, one term's below another's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from softrobot_twin.constraints.terms import ConstraintTerm
from softrobot_twin.mechanics.kinematics import CarriedPoints, CarriedRows


class RowStack:
    """The rows of several terms, one above the other, in memory that is allocated once.

    Terms write their entries at points. Entries at points that have no unknowns of their own (on
    free rigid bodies) are brought to the unknowns of the body.

    Attributes:
        row_index: Row of each entry, shape (entry_count,).
        node_index: Unknown of each entry, shape (entry_count,).
        blocks: Entries of H, shape (entry_count, 3).
        values: δ, shape (row_count,).
        row_count: Number of rows.
        row_room: Number of rows that there is memory for.
        reached_nodes: Unknowns that rows may touch.
    """

    def __init__(self, terms: Sequence[ConstraintTerm], points: CarriedPoints | None = None):
        """Give each term its place.

        Args:
            terms: Terms in the order of their rows.
            points: The carried points of the scene; None without any.
        """
        rows = np.cumsum([0] + [term.row_count for term in terms])
        entries = np.cumsum([0] + [len(term.entry_rows) for term in terms])
        self.row_count = self.row_room = int(rows[-1])
        self.row_index = self._point_rows = np.concatenate(
            [np.empty(0, np.int64)]
            + [term.entry_rows + start for term, start in zip(terms, rows[:-1], strict=True)]
        )
        self.node_index = self.reached_nodes = self._point_index = np.concatenate(
            [np.empty(0, np.int64)] + [term.entry_nodes for term in terms]
        )
        self.blocks = self._point_blocks = np.zeros((int(entries[-1]), 3))
        self.values = np.zeros(self.row_count)
        # Views into the memory that each term writes, made once.
        ends = zip(terms, entries[:-1], entries[1:], rows[:-1], rows[1:], strict=True)
        self._parts = [(term, self.blocks[a:b], self.values[c:d]) for term, a, b, c, d in ends]
        self._carried = None
        if points is not None and (self._point_index >= points.free_count).any():
            self._carried = CarriedRows(points, len(self._point_index))
            own = self._point_index[self._point_index < points.free_count]
            self.reached_nodes = np.concatenate([own, points.all_unknowns()])

    def evaluate(self, positions: np.ndarray) -> None:
        """Let every term write its rows at a state: node positions [m], shape (node_count, 3)."""
        for term, blocks, values in self._parts:
            term.evaluate(positions, blocks, values)
        if self._carried is not None:
            count = self._carried.reduce(
                positions, self._point_rows, self._point_index, self._point_blocks
            )
            self.row_index = self._carried.row_index[:count]
            self.node_index = self._carried.node_index[:count]
            self.blocks = self._carried.blocks[:count]

    def add_forces(self, multipliers: np.ndarray, forces: np.ndarray) -> None:
        """Add Hᵀ λ of the rows evaluated last to the nodes' forces.

        Args:
            multipliers: λ of every row [N], shape (row_count,).
            forces: Forces on the unknowns [N], shape (free_node_count, 3); added to.
        """
        add_row_forces(self.row_index, self.node_index, self.blocks, multipliers, forces)


@njit(cache=True, nogil=True, error_model="numpy")
def add_row_forces(row_index, node_index, blocks, multipliers, forces):
    """Add each entry of H times its row's multiplier to its node's force."""
    for entry in range(len(row_index)):
        node, multiplier = node_index[entry], multipliers[row_index[entry]]
        for axis in range(3):
            forces[node, axis] += blocks[entry, axis] * multiplier
