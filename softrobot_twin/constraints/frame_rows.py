"""Rows on rigid bodies: what is written at frame nodes, brought to the bodies' two unknowns.

Constraint terms write a block h at every node that a row touches, frame nodes of rigid bodies
included, by their virtual index. A body that turns by θ moves its frame node x by θ × (x - c), so

    h · (u + θ × (x - c)) = h · u + ((x - c) × h) · θ :

the block becomes h at the translation and (x - c) × h at the rotation. Entries of one row on one
body that follow each other are summed into one pair, as the four of a mapped point are.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from softrobot_twin.mechanics.rigid_frames import RigidFrames


@njit(cache=True, nogil=True, error_model="numpy")
def reduce_kernel(
    x, origins, first_unknown, free_node_count, rows, nodes, blocks, out_rows, out_nodes, out_blocks
):
    """Write the real entries; gives their number, at most two for each entry that comes in."""
    count, last_row, last_body = 0, -1, -1
    for e in range(len(rows)):
        row, node = rows[e], nodes[e]
        h0, h1, h2 = blocks[e, 0], blocks[e, 1], blocks[e, 2]
        if node < free_node_count:
            out_rows[count], out_nodes[count] = row, node
            out_blocks[count, 0], out_blocks[count, 1], out_blocks[count, 2] = h0, h1, h2
            count, last_body = count + 1, -1
            continue
        body, corner = divmod(node - free_node_count, 4)
        if row != last_row or body != last_body:
            for part in range(2):
                out_rows[count + part] = row
                out_nodes[count + part] = first_unknown + 2 * body + part
                out_blocks[count + part] = 0.0
            count, last_row, last_body = count + 2, row, body
        n = origins[body]
        r0 = x[n + corner, 0] - x[n, 0]
        r1 = x[n + corner, 1] - x[n, 1]
        r2 = x[n + corner, 2] - x[n, 2]
        out_blocks[count - 2, 0] += h0
        out_blocks[count - 2, 1] += h1
        out_blocks[count - 2, 2] += h2
        out_blocks[count - 1, 0] += r1 * h2 - r2 * h1
        out_blocks[count - 1, 1] += r2 * h0 - r0 * h2
        out_blocks[count - 1, 2] += r0 * h1 - r1 * h0
    return count


class FrameRows:
    """Entries of H on real unknowns, in memory that is kept from call to call.

    Attributes:
        count: Number of entries written last.
        row_index: Row of each entry; the first `count` hold, shape (capacity,).
        node_index: Its unknown, shape (capacity,).
        blocks: Derivative by that unknown [-] or [m], shape (capacity, 3).
    """

    def __init__(self, frames: RigidFrames, most_entries: int):
        """Allocate.

        Args:
            frames: The rigid bodies.
            most_entries: Entries that are expected to come in at most; should more come, memory
                is allocated anew, with room to spare.
        """
        self._frames = frames
        self.count = 0
        self._allocate(most_entries)

    def _allocate(self, most_entries: int) -> None:
        capacity = 2 * most_entries
        self.row_index = np.zeros(capacity, dtype=np.int64)
        self.node_index = np.zeros(capacity, dtype=np.int64)
        self.blocks = np.zeros((capacity, 3))

    def reduce(
        self,
        positions: np.ndarray,
        row_index: np.ndarray,
        node_index: np.ndarray,
        blocks: np.ndarray,
    ) -> int:
        """Write the real entries.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            row_index: Row of each entry, shape (entry_count,).
            node_index: Its unknown or virtual index, not negative, shape (entry_count,).
            blocks: Derivative by that node's position, shape (entry_count, 3).

        Returns:
            Number of entries written, `count`.
        """
        if 2 * len(row_index) > len(self.row_index):
            self._allocate(2 * len(row_index))
        frames = self._frames
        self.count = reduce_kernel(
            positions, frames.origins, frames.first_unknown, frames.free_node_count,
            row_index, node_index, blocks, self.row_index, self.node_index, self.blocks,
        )  # fmt: skip
        return self.count
