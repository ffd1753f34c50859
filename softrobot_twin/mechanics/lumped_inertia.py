"""Inertia of masses at the nodes: the matrix M of Coevoet 2017, eq. (1), where it is diagonal."""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.nodal_masses import NodalMasses


class LumpedInertia(NodalMasses):
    """Force term -M ((q - q₀)/h - v₀)/h of masses at nodes, backward Euler as in eqs. (5-8).

    A body of quadratic tetrahedra whose inertia is lumped must bear its weight at the same masses:
    its nodes would fall apart under `Gravity`, which pulls its corners up.
    """

    name = "lumped inertia"

    @property
    def rate(self) -> float:
        """1/h [1/s]."""
        return self._per_second

    def momentum(self, velocities: np.ndarray) -> np.ndarray:
        """Σ m v [kg m/s], shape (3,).

        Args:
            velocities: Velocities of the free nodes [m/s], shape (free_node_count, 3).
        """
        return self.masses @ velocities[self._unknowns]

    def kinetic_energy(self, positions: np.ndarray, velocities: np.ndarray) -> float:
        """½ Σ m ‖v‖² [J]; see `ForceTerm.kinetic_energy`."""
        return float(0.5 * self.masses @ np.sum(velocities[self._unknowns] ** 2, axis=1))
