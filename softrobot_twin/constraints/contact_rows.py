"""Rows of a scene with contact: the fixed ones, and below them as many as there are contacts."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.mechanics.kinematics import CarriedPoints, CarriedRows
from softrobot_twin.constraints.row_stack import RowStack, add_row_forces


class ContactRows:
    """A stack of rows that grows and shrinks; reads like a `RowStack`.

    Attributes:
        values: δ of every row, shape (row_count,).
        row_index: Row of each entry, shape (entry_count,).
        node_index: Unknown of each entry, shape (entry_count,).
        blocks: Entries of H, shape (entry_count, 3).
        reached_nodes: Unknowns that rows may touch.
    """

    def __init__(self, stack: RowStack, contacts: Contacts, points: CarriedPoints | None):
        """Allocate.

        Args:
            stack: Rows of all other terms, at points.
            contacts: The contacts.
            points: The carried points of the scene; None without any.
        """
        self._stack, self._contacts = stack, contacts
        self._make_room()
        self._reduced = None
        reached = np.concatenate([stack.node_index, contacts.reached_nodes])
        if points is not None:
            self._reduced = CarriedRows(points, contacts.entry_room)
            own = reached[reached < points.free_count]
            reached = np.concatenate([own, points.all_unknowns()])
        self.reached_nodes = np.unique(reached)
        self.row_index = self.node_index = np.empty(0, np.int64)
        self.blocks, self.values = np.empty((0, 3)), np.empty(0)

    def _make_room(self) -> None:
        """For the stack's entries, which stay where they are, and below them the contacts'."""
        stack = self._stack
        self._contact_room = self._contacts.entry_room
        self._first = len(stack.row_index)
        room = self._first + self._contact_room
        self._rows, self._nodes = np.zeros(room, np.int64), np.zeros(room, np.int64)
        self._blocks = np.zeros((room, 3))
        self._rows[: self._first], self._nodes[: self._first] = stack.row_index, stack.node_index

    @property
    def row_count(self) -> int:
        """Rows at the state detected last."""
        return self._stack.row_count + self._contacts.row_count

    @property
    def row_room(self) -> int:
        """Rows that there is room for."""
        return self._stack.row_count + self._contacts.row_room

    def evaluate(self, positions: np.ndarray) -> None:
        """Let every term write its rows at a state."""
        stack, contacts = self._stack, self._contacts
        stack.evaluate(positions)
        values = np.empty(self.row_count)
        values[: stack.row_count] = stack.values
        self.values = values
        if contacts.entry_room > self._contact_room:
            self._make_room()
        self._blocks[: self._first] = stack.blocks
        count = contacts.evaluate(
            positions, stack.row_count, values, self._first, self._rows, self._nodes, self._blocks
        )
        rows, nodes, blocks = self._rows[:count], self._nodes[:count], self._blocks[:count]
        if self._reduced is None:
            self.row_index, self.node_index, self.blocks = rows, nodes, blocks
            return
        count = self._reduced.reduce(positions, rows, nodes, blocks)
        self.row_index = self._reduced.row_index[:count]
        self.node_index = self._reduced.node_index[:count]
        self.blocks = self._reduced.blocks[:count]

    def add_forces(self, multipliers: np.ndarray, forces: np.ndarray) -> None:
        """Add Hᵀ λ of the rows evaluated last; see `RowStack.add_forces`."""
        add_row_forces(self.row_index, self.node_index, self.blocks, multipliers, forces)
