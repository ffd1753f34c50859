"""Constant forces on unknowns: the weight of point masses and of rigid bodies."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def add_rows(unknowns, weights, forces):
    """Add each weight to its unknown's force."""
    for k in range(len(unknowns)):
        for i in range(3):
            forces[unknowns[k], i] += weights[k, i]


class PointWeights:
    """Force term of weights; that of a rigid body acts at its translation, with no torque.

    Attributes:
        unknowns: Unknown that each weight acts on, shape (weight_count,).
        weights: The weights [N], shape (weight_count, 3).
    """

    name = "point weights"

    def __init__(self, unknowns, weights):
        """Take the weights.

        Args:
            unknowns: Unknown of each point, -1 where it does not move, shape (point_count,).
            weights: Mass times gravity [N], shape (point_count, 3).
        """
        unknowns = np.asarray(unknowns, dtype=np.int64)
        moving = unknowns >= 0
        self.unknowns = unknowns[moving]
        self.weights = np.asarray(weights, dtype=float)[moving]

    def stencils(self) -> np.ndarray:
        """Weight does not depend on the shape: no pairs, shape (0, 1)."""
        return np.empty((0, 1), dtype=np.int64)

    def bind(self, elimination_rank, slots) -> None:
        """Nothing to bind: there is no stiffness."""

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the weights [N] to forces, shape (free_node_count, 3); it inverts no element."""
        add_rows(self.unknowns, self.weights, forces)
        return 0

    def add(self, positions, forces, storage, projected) -> None:
        """Add the weights; they have no stiffness."""
        self.add_forces(positions, forces)
