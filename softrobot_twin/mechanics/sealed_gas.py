"""Gas sealed in a cavity: an ideal gas at constant temperature, by Boyle's law.

With the absolute pressure p₀ at the volume at rest V₀, and the pressure p_a around the robot,

    p = p₀ V₀ / V - p_a,    E = -p₀ V₀ ln(V / V₀) + p_a (V - V₀),    f = p ∂V/∂q,

    -∂f/∂q = -p ∂²V + (p₀ V₀ / V²) h hᵀ,    h = ∂V/∂q.

The last part couples all unknowns of the walls. It is not assembled; see `dense_rows`.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.mechanics.cavity_surfaces import CavityLoad, CavitySurface
from softrobot_twin.mechanics.force_term import DenseRows


class SealedGas(CavityLoad):
    """The gas in all sealed cavities of a scene."""

    name = "sealed_gas"

    def __init__(
        self, surfaces: tuple[CavitySurface, ...], free_index: np.ndarray,
        rest_positions: np.ndarray, pressures: np.ndarray, ambient_pressures: np.ndarray,
    ):  # fmt: skip
        """Fill the cavities.

        Args:
            surfaces: The cavities.
            free_index: Unknown of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            pressures: Absolute pressure in each at rest [Pa], shape (cavity_count,).
            ambient_pressures: Absolute pressure around each [Pa], same shape.
        """
        super().__init__(surfaces, free_index, rest_positions)
        self._ambient = ambient_pressures
        self._work = pressures * self.walls.rest_volumes
        self._blocks = np.empty((len(self.walls.entry_cavity), 3))
        self._volumes = self.walls.rest_volumes

    def pressures(self, positions: np.ndarray) -> np.ndarray:
        """Gauge pressures [Pa], shape (cavity_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._work / self.walls.volumes(positions) - self._ambient

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """See `ForceTerm.add_forces`."""
        self._volumes = self.walls.write_gradients(positions, self._blocks)
        pressures = self._work / self._volumes - self._ambient
        loads = pressures[self.walls.entry_cavity, None] * self._blocks
        np.add.at(forces, self.walls.entry_nodes, loads)
        return 0

    def add_stiffness(self, positions: np.ndarray, storage: np.ndarray, projected: bool) -> None:
        """See `ForceTerm.add_stiffness`. Projected, it adds no blocks; see `Cavities.add_stiffness`."""
        if not projected:
            pressures = self._work / self._volumes - self._ambient
            self.walls.add_stiffness(positions, pressures, storage)

    @property
    def dense_rows(self) -> DenseRows:
        """h of each cavity and p₀ V₀ / V², at the state evaluated last; see `ForceTerm`."""
        return DenseRows(
            self.walls.entry_cavity, self.walls.entry_nodes, self._blocks,
            self._work / self._volumes**2,
        )  # fmt: skip

    def largest_share(self, before: np.ndarray, after: np.ndarray) -> float:
        """See `ForceTerm.largest_share`: gas is never compressed to nothing."""
        return self.walls.share_between(before, after)

    def energy(self, positions: np.ndarray) -> float:
        """E [J], zero at rest; see `ForceTerm.energy`."""
        rest, volumes = self.walls.rest_volumes, self.walls.volumes(positions)
        work = self._ambient * (volumes - rest) - self._work * np.log(volumes / rest)
        return float(work.sum())
