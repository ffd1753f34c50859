"""Cavities of a body that is reduced to its vertebrae: their growth follows from frames and pressure.

The walls of such a cavity are inside a superelement (`mechanics/superelements.py`). They yield to
the pressure p even where the vertebrae are held, so the growth δ = -∂Π/∂p depends on p as well as
on q. This term takes efforts: it is told the efforts at which it is evaluated, and has a
compliance C = -∂²Π/∂p² of its own. Around efforts p₀

    δ(q + dq, p) = δ(q, p₀) + H dq + C (p - p₀),       forces(p) = forces(p₀) + Hᵀ (p - p₀).

The force term holds the forces at the told pressures, with their whole stiffness, and the rows only
what a change of pressure adds. At the end of a step the pressures that were found are told, and the
residual is exact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface, sphere_volumes
from softrobot_twin.mechanics.superelements import Superelements


class SuperelementCavities(ConstraintTerm):
    """Constraint term of cavities in superelements; see the module.

    Attributes:
        surfaces: Walls of each cavity, carried by the vertebrae, as pictures show them.
        rest_volumes: Volume of each cavity at rest [m³], shape (row_count,).
        rest_areas: Area of its walls at rest [m²], shape (row_count,).
        compliance: C at the state evaluated last [m³/Pa], shape (row_count, row_count).
    """

    name = "cavities"
    group = "actuators"
    is_traceable = True
    takes_efforts = True

    def __init__(
        self, superelements: Sequence[Superelements], rest_volumes: np.ndarray,
        rest_areas: np.ndarray, surfaces: tuple[CavitySurface, ...] = (),
    ):  # fmt: skip
        """Lay out the rows.

        Args:
            superelements: Those of each body.
            rest_volumes: Volume of each cavity at rest [m³], shape (row_count,).
            rest_areas: Area of its walls at rest [m²], shape (row_count,).
            surfaces: Walls of each cavity, carried by the vertebrae.
        """
        self.surfaces = surfaces
        # It answers what pictures and limits ask of `CavitySurfaces`.
        self.walls = self
        self.rest_volumes, self.rest_areas = np.array(rest_volumes), np.array(rest_areas)
        self.scales, self.sphere_volumes = self.rest_volumes, sphere_volumes(self.rest_areas)
        self.row_count = len(self.rest_volumes)
        self.compliance = np.zeros((self.row_count, self.row_count))
        self._parts, first, rows, nodes = [], 0, [], []
        for bodies_own in superelements:
            points, cavities = bodies_own.unknowns, bodies_own.cavities
            used = (cavities >= 0)[:, :, None] & (points >= 0)[:, None, :]
            reached = np.broadcast_to(points[:, None, :], used.shape)[used]
            row = np.broadcast_to(cavities[:, :, None], used.shape)[used]
            span = int(points.max(initial=0)) + 1
            keys, place = np.unique(row * span + reached, return_inverse=True)
            entry = np.full(used.shape, -1, np.int64)
            entry[used] = place.ravel()
            rows.append(keys // span)
            nodes.append(keys % span)
            self._parts.append((bodies_own, entry, slice(first, first + len(keys))))
            first += len(keys)
        self.entry_rows = np.concatenate([np.empty(0, np.int64), *rows])
        self.entry_nodes = np.concatenate([np.empty(0, np.int64), *nodes])

    def volumes(self, positions: np.ndarray) -> np.ndarray:
        """Volumes at the told pressures [m³], shape (row_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self.rest_volumes + self.rows_at(positions)[1]

    def tell_efforts(self, efforts: np.ndarray) -> None:
        """Set the pressures of superelements and rows; see `ConstraintTerm.tell_efforts`."""
        for superelements, _, _ in self._parts:
            superelements.pressures[:] = efforts

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H, the growths δ [m³] and the compliance; see `ConstraintTerm.evaluate`."""
        for numbers in (blocks, values, self.compliance):
            clear(numbers.reshape(-1))
        for superelements, entry, entries in self._parts:
            superelements.add_growths(positions, entry, values, blocks[entries], self.compliance)
