"""Damping in proportion to mass: Rayleigh's α, and the drag that first-order motion lives on."""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.nodal_masses import NodalMasses


class MassDamping(NodalMasses):
    """Force term -α M (q - q₀)/h of masses at nodes.

    It brakes against the world, all motion alike, that of a whole body too. Beside inertia it is
    the first part of Rayleigh's damping; without inertia it leaves first-order motion, which creeps
    to where the forces balance.

    Attributes:
        rate: α [1/s].
    """

    name = "mass damping"

    def __init__(
        self, nodes: np.ndarray, unknowns: np.ndarray, masses: np.ndarray, rate: float
    ):
        """Brake the masses.

        Args:
            nodes: Their rows among the positions, shape (mass_count,).
            unknowns: Their free-node indices, shape (mass_count,).
            masses: [kg], shape (mass_count,).
            rate: α [1/s], not negative.

        Raises:
            ValueError: As `NodalMasses`; the rate is negative or not finite.
        """
        super().__init__(nodes, unknowns, masses)
        if not 0.0 <= rate < np.inf:
            raise ValueError(f"rate must be finite and not negative, not {rate} 1/s")
        self.rate = float(rate)

    def begin_step(
        self, positions: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Remember where the step begins.

        Args:
            positions: Node positions q₀ [m], shape (node_count, 3).
            velocities: Not needed: what brakes is the velocity at the step's end.
            time_step: h [s].
        """
        np.take(positions, self._nodes, axis=0, out=self._start)
        self._per_second = 1.0 / time_step
