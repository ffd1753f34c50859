"""Rows of what pulls along segments between points: cables and muscles.

A segment is a vector r = Σ c_a x_a + r_0 of points a. A row is the sum over its segments, and the stiffness
of a segment is one matrix K for all its points: c_a c_b K couples the points a and b.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.constraints.spread_stiffness import SpreadStiffness
from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.mechanics.kinematics import CarriedPoints, FoldedSegments
from softrobot_twin.mechanics.stencil import bind_stencils


class SegmentTerm(ConstraintTerm):
    """Constraint term of rows along segments, which says where their entries and stiffness are stored.

    Attributes:
        stretch_of_entry: Segment of each entry of H, shape (entry_count,).
    """

    group = "actuators"
    # Part of the stiffness as dense rows, where segments couple many nodes.
    _spread: SpreadStiffness | None = None

    def _take_segments(
        self, row_of_segment: np.ndarray, nodes: np.ndarray, coefficients: np.ndarray, free_index: np.ndarray,
        points: CarriedPoints | None,
    ) -> None:  # fmt: skip
        """Lay out the rows; `row_count` is known.

        Args:
            row_of_segment: Row that each segment is part of, shape (segment_count,).
            nodes: Nodes of each segment, -1 where there is none, shape (segment_count, width).
            coefficients: c of these nodes, same shape.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            points: The carried points of the scene; None without any.
        """
        self._row_of_segment, self._free_index = row_of_segment, free_index
        self._nodes, self._coefficients = nodes, coefficients
        self._matrices = np.empty((len(nodes), 3, 3))
        self._lay_out_entries()
        self._bound = self._points = self._folded = None
        if points is not None and (self._free >= points.free_count).any():
            self._points, self._folded = points, FoldedSegments(points, self._free, coefficients)
            self._pulls = (
                np.empty((len(self.entry_rows), 3)), np.empty(self.row_count),
                np.empty((points.free_count + points.count, 3)),
            )  # fmt: skip

    def _lay_out_entries(self) -> None:
        self._free = np.where(self._nodes >= 0, self._free_index[self._nodes], -1)
        moves = self._free >= 0
        self._entry = np.where(moves, np.cumsum(moves.ravel()).reshape(moves.shape) - 1, -1)
        self.entry_nodes = self._free[moves]
        self.stretch_of_entry = np.repeat(np.arange(len(moves)), moves.sum(axis=1))
        self.entry_rows = self._row_of_segment[self.stretch_of_entry]

    def stencils(self) -> np.ndarray:
        """Unknowns that each segment couples, -1 where none, shape (segment_count, width)."""
        other = self._folded or self._spread
        return self._free if other is None else other.stencils()

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness in the storage, and sort the segments' nodes."""
        other = self._folded or self._spread
        if other is not None:
            other.bind(elimination_rank, slots)
            return
        self._bound = bound = bind_stencils(self._free, elimination_rank, slots)
        self._nodes, self._coefficients = bound.sorted(self._nodes), bound.sorted(self._coefficients)
        self._lay_out_entries()

    def _write_rows(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H; the values are of no use to who calls this."""
        self.evaluate(positions, blocks, values)

    def _fold_matrices(
        self, positions: np.ndarray, entry_rows: np.ndarray, multipliers: np.ndarray, projected: bool,
        storage: np.ndarray,
    ) -> None:  # fmt: skip
        """Add `_matrices` of segments between carried points, and the turning of these points.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            entry_rows: Multiplier of each entry, shape (entry_count,).
            multipliers: What pulls, such as tensions [N].
            projected: True without the turning of points.
            storage: The factorization's storage [N/m]; added to.
        """
        pulls = None
        if self._folded.turns and not projected:
            blocks, values, forces = self._pulls
            self._write_rows(positions, blocks, values)
            clear(forces.reshape(-1))
            add_row_forces(entry_rows, self.entry_nodes, blocks, multipliers, forces)
            pulls = forces[self._points.free_count :]
        self._folded.add(positions, self._matrices, pulls, storage)
