"""What a term of dynamics knows of the past: where its nodes were when the step began."""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.force_term import ForceTerm


class RememberedNodes(ForceTerm):
    """Nodes that move, and how they were when the step began.

    Until the first step begins, and if it takes infinitely long, nothing pulls: that is statics.
    """

    remembers_start = True

    def __init__(self, nodes: np.ndarray, unknowns: np.ndarray):
        """Take the nodes.

        Args:
            nodes: Their rows among the positions, shape (count,).
            unknowns: Their free-node indices, shape (count,).
        """
        self._nodes = np.array(nodes, dtype=np.int64)
        self._unknowns = np.array(unknowns, dtype=np.int64)
        self._start, self._start_velocities = np.zeros((2, len(self._nodes), 3))
        self._per_second = 0.0

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember what the step begins with.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Velocities v₀ of the free nodes [m/s], shape (free_node_count, 3).
            time_step: h [s].
        """
        np.take(positions, self._nodes, axis=0, out=self._start)
        np.take(velocities, self._unknowns, axis=0, out=self._start_velocities)
        self._per_second = 1.0 / time_step
