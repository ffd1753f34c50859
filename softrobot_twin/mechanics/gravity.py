"""Weight: the constant part of P(t) in Coevoet 2017, eq. (1)."""

from __future__ import annotations

import numpy as np


def borne_masses(mesh, density: float) -> np.ndarray:
    """Mass whose weight each node bears, ∫ρ N dV [kg], shape (node_count,).

    Args:
        mesh: The body, a `TetMesh` or a `QuadraticMesh`.
        density: Mass per volume [kg/m³].
    """
    shares = np.outer(density * mesh.volumes, mesh.load_shares)
    return np.bincount(mesh.cells.ravel(), weights=shares.ravel(), minlength=mesh.node_count)


class Gravity:
    """Force term of all bodies' own weight."""

    name = "gravity"

    def __init__(self, masses: np.ndarray, gravity: np.ndarray):
        """Weigh the nodes.

        Args:
            masses: Mass that each unknown bears [kg], shape (free_node_count,); of rigid bodies
                their translations bear all.
            gravity: Acceleration [m/s²], shape (3,).
        """
        self.weights = np.outer(masses, np.asarray(gravity, dtype=float))

    def stencils(self) -> np.ndarray:
        """Weight does not depend on the shape: no node pairs, shape (0, 1)."""
        return np.empty((0, 1), dtype=np.int64)

    def bind(self, elimination_rank, slots) -> None:
        """Nothing to bind: there is no stiffness."""

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the weight [N] to forces, shape (free_node_count, 3); it inverts no element."""
        forces += self.weights
        return 0

    def add(self, positions, forces, storage, projected) -> None:
        """Add the weight; it has no stiffness."""
        forces += self.weights
