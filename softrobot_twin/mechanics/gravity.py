"""Forces that do not depend on the shape: weight, the constant part of P(t) in Coevoet 2017, eq. (1)."""

from __future__ import annotations

import numpy as np

from softrobot_twin.geometry.vector_arrays import add_vectors
from softrobot_twin.mechanics.force_term import ForceTerm


class ConstantForces(ForceTerm):
    """Force term of forces that stay as they are in a step: they have no stiffness.

    Attributes:
        forces: On the unknowns [N], shape (free_node_count, 3).
    """

    forces: np.ndarray

    def stencils(self) -> np.ndarray:
        """They do not depend on the shape: no node pairs, shape (0, 1)."""
        return np.empty((0, 1), dtype=np.int64)

    def bind(self, elimination_rank, slots) -> None:
        """Does nothing: there is no stiffness."""

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add them [N] to forces, shape (free_node_count, 3); they invert no element."""
        add_vectors(self.forces, forces)
        return 0

    def add_force_curvature(self, positions, direction, reach, curvature) -> None:
        """Adds nothing: they are constant."""


class Gravity(ConstantForces):
    """Force term of all bodies' own weight.

    Attributes:
        weights: The same as its forces.
        masses: Mass whose weight acts at each unknown [kg], shape (free_node_count,).
    """

    name = "gravity"
    is_traceable = True

    def __init__(self, masses: np.ndarray, gravity: np.ndarray, more: np.ndarray | None = None):
        """Compute the weight of each node.

        Args:
            masses: Mass whose weight acts at each unknown [kg], shape (free_node_count,); that of a
                rigid body acts at its translation.
            gravity: Acceleration [m/s²], shape (3,).
            more: Weight at unknowns that are no places, such as coordinates of a basis [N], shape
                (free_node_count, 3); None without any.
        """
        self.masses = masses
        self.forces = self.weights = np.outer(masses, np.asarray(gravity, dtype=float))
        if more is not None:
            self.weights += more
