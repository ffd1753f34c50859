"""Rows of a scene with rigid bodies: what terms write at frame nodes, at the bodies' unknowns."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.frame_rows import FrameRows
from softrobot_twin.constraints.terms import RowStack, add_row_forces
from softrobot_twin.mechanics.rigid_frames import RigidFrames


class FramedRows:
    """A stack of rows that may lie on rigid bodies; reads like a `RowStack`.

    Attributes:
        row_count: Number of rows.
        row_room: Rows that there is room for, as many.
        values: δ of every row, shape (row_count,).
        reached_nodes: Unknowns that rows may touch.
    """

    def __init__(self, stack: RowStack, frames: RigidFrames):
        """Allocate.

        Args:
            stack: The rows, whose entries may stand on frame nodes.
            frames: The rigid bodies.
        """
        self._stack = stack
        self._reduced = FrameRows(frames, len(stack.row_index))
        self.row_count = self.row_room = stack.row_count
        self.values = stack.values
        soft = stack.node_index[stack.node_index < frames.free_node_count]
        self.reached_nodes = np.concatenate([soft, frames.translations, frames.rotations])

    @property
    def row_index(self) -> np.ndarray:
        """Row of each entry, shape (entry_count,)."""
        return self._reduced.row_index[: self._reduced.count]

    @property
    def node_index(self) -> np.ndarray:
        """Unknown of each entry, shape (entry_count,)."""
        return self._reduced.node_index[: self._reduced.count]

    @property
    def blocks(self) -> np.ndarray:
        """Entries of H, shape (entry_count, 3)."""
        return self._reduced.blocks[: self._reduced.count]

    def evaluate(self, positions: np.ndarray) -> None:
        """Let every term write its rows at a state; see `RowStack.evaluate`."""
        stack = self._stack
        stack.evaluate(positions)
        self._reduced.reduce(positions, stack.row_index, stack.node_index, stack.blocks)

    def add_forces(self, multipliers: np.ndarray, forces: np.ndarray) -> None:
        """Add Hᵀ λ of the rows evaluated last; see `RowStack.add_forces`."""
        add_row_forces(self.row_index, self.node_index, self.blocks, multipliers, forces)
