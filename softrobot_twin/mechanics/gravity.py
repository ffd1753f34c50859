"""Weight: the constant part of P(t) in Coevoet 2017, eq. (1)."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.vector_arrays import add_vectors
from softrobot_twin.mechanics.force_term import ForceTerm


class Gravity(ForceTerm):
    """Force term of all bodies' own weight."""

    name = "gravity"
    is_traceable = True

    def __init__(
        self, masses: np.ndarray, gravity: np.ndarray, more: np.ndarray | None = None
    ):
        """Compute the weight of each node.

        Args:
            masses: Mass whose weight acts at each unknown [kg], shape (free_node_count,); that of a
                rigid body acts at its translation.
            gravity: Acceleration [m/s²], shape (3,).
            more: Weight at unknowns that are no places, such as coordinates of a basis [N], shape
                (free_node_count, 3); None without any.
        """
        self.weights = np.outer(masses, np.asarray(gravity, dtype=float))
        if more is not None:
            self.weights += more

    def stencils(self) -> np.ndarray:
        """Weight does not depend on the shape: no node pairs, shape (0, 1)."""
        return np.empty((0, 1), dtype=np.int64)

    def bind(self, elimination_rank, slots) -> None:
        """Does nothing: there is no stiffness."""

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the weight [N] to forces, shape (free_node_count, 3); it inverts no element."""
        add_vectors(self.weights, forces)
        return 0

    def add(self, positions, forces, storage, projected) -> None:
        """Add the weight; it has no stiffness."""
        add_vectors(self.weights, forces)

    def add_force_curvature(self, positions, direction, reach, curvature) -> None:
        """Adds nothing: the weight is constant."""
