"""Cavities: closed surfaces whose enclosed volume is the displacement (Coevoet 2017, eq. 3).

The displacement of a cavity is its growth δ = V(q) - V_rest, and its multiplier is the gauge
pressure. V and its derivatives are those of `CavitySurfaces`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface, CavitySurfaces
from softrobot_twin.mechanics.kinematics import CarriedPoints, FoldedStiffness
from softrobot_twin.mechanics.stencil import bind_stencils

# A cavity whose volume is below this share of that at rest is empty: its walls touch.
EMPTY = 0.01


class Cavities(ConstraintTerm):
    """Constraint term of cavities that are actuators, and the stiffness of their pressure.

    Attributes:
        walls: Their surfaces.
        surfaces: Surfaces of each cavity.
        row_count: Number of cavities.
        rest_areas: Area of the walls of each cavity at rest [m²], shape (row_count,).
        rest_volumes: Volumes at rest [m³], shape (row_count,).
    """

    name = "cavities"
    group = "actuators"

    def __init__(
        self, surfaces: tuple[CavitySurface, ...], free_index: np.ndarray,
        rest_positions: np.ndarray, points: CarriedPoints | None = None,
    ):  # fmt: skip
        """Lay out the surfaces.

        Args:
            surfaces: The cavities.
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
            rest_positions: Node positions at rest [m], shape (node_count, 3).
            points: The carried points of the scene; None without any.
        """
        self.walls = CavitySurfaces(surfaces, free_index, rest_positions)
        self.surfaces, self.row_count = self.walls.surfaces, self.walls.count
        self.rest_areas, self.rest_volumes = self.walls.rest_areas, self.walls.rest_volumes
        self.scales = self.rest_volumes
        self.entry_rows, self.entry_nodes = self.walls.entry_cavity, self.walls.entry_nodes
        self._points, self._folded = None, None
        if points is not None and (self.entry_nodes >= points.free_count).any():
            self._points, self._folded = points, FoldedStiffness(points, self.walls.stencils)

    def volumes(self, positions: np.ndarray) -> np.ndarray:
        """Volumes [m³], shape (row_count,); see `CavitySurfaces.volumes`."""
        return self.walls.volumes(positions)

    def stencils(self) -> np.ndarray:
        """Unknowns that each triangle couples, -1 where none, shape (triangle_count, width)."""
        return self.walls.stencils if self._folded is None else self._folded.stencils()

    def bind(self, elimination_rank: np.ndarray, slots: Callable) -> None:
        """Find the places of the stiffness in the storage."""
        if self._folded is not None:
            elimination_rank, slots = self._folded.bind(elimination_rank, slots)
        self.walls.sort(bind_stencils(self.walls.stencils, elimination_rank, slots))

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H and the growths δ [m³]; see `ConstraintTerm.evaluate`."""
        volumes = self.walls.write_gradients(positions, blocks)
        np.subtract(volumes, self.walls.rest_volumes, out=values)

    def add_stiffness(
        self, positions: np.ndarray, multipliers: np.ndarray, storage: np.ndarray,
        projected: bool = False,
    ) -> None:
        """Add the stiffness of the pressures; see `ConstraintTerm.add_stiffness`.

        Projected, it adds nothing: of -p ∂²V no part is known that is never negative.
        """
        if projected or not multipliers.any():
            return
        folded, pressures = self._folded, multipliers
        if folded is None:
            self.walls.add_stiffness(positions, pressures, storage)
            return
        folded.clear()
        self.walls.add_stiffness(positions, pressures, folded.scratch)
        folded.fold(positions, self._forces_on_carried_points(positions, pressures), storage)

    def _forces_on_carried_points(self, positions, pressures) -> np.ndarray:
        """Force of the pressures on each carried point [N], shape (carried_count, 3)."""
        free = self._points.free_count
        blocks = np.empty((len(self.entry_rows), 3))
        self.walls.write_gradients(positions, blocks)
        forces = np.zeros((free + self._points.count, 3))
        add_row_forces(self.entry_rows, self.entry_nodes, blocks, pressures, forces)
        return forces[free:]

    def largest_share(self, positions: np.ndarray, move: np.ndarray) -> float:
        """Share of a move that leaves every cavity a volume; see `ConstraintTerm`."""
        moves = move if self._points is None else self._points.point_moves(positions, move)
        return self.walls.largest_share(positions, moves)
