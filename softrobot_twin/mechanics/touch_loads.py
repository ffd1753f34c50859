"""Loads of touches: a measured force at a point of a body, or a point that a finger holds in place.

A measured force is a given load. Where a displacement is measured, the point x = Σ w_a x_a is held at
its measured place p along some axes, by the augmented Lagrangian method (Nocedal and Wright
2006, section 17.3): the force

    f = f₀ + s (p - x)

with a stiffness s far above that of the body, and with f₀ the force of the step before. At rest x = p
but for round-off, and f is the multiplier of the held point. During a motion x lags by the change of
f in a step, divided by s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.stencil import add_weighted_matrices, bind_stencils


class TouchState(NamedTuple):
    """What a step needs to know of the touches before it, and tells of those in it.

    Attributes:
        forces: Forces on the robot [N], zero along axes without touch, shape (touch_count, 3).
        origins: Where each touched point was when its touch began [m], NaN where there is no touch,
            same shape.
        points: Where the points are now [m], same shape.
    """

    forces: np.ndarray
    origins: np.ndarray
    points: np.ndarray

    @classmethod
    def of(cls, memory: Mapping[str, np.ndarray]) -> TouchState | None:
        """That in the memory of a state; None in a scene without touches.

        Args:
            memory: Arrays of all that remembers, by name; see `State`.
        """
        keys = [f"touches.{field}" for field in cls._fields]
        return cls(*(memory[key] for key in keys)) if keys[0] in memory else None

    @property
    def is_touched(self) -> np.ndarray:
        """Whether each point is touched, shape (touch_count,)."""
        return np.isfinite(self.origins).all(axis=1)

    @property
    def displacements(self) -> np.ndarray:
        """Displacement of each point since its touch began [m], zero without a touch, shape
        (touch_count, 3)."""
        return np.where(self.is_touched[:, None], self.points - self.origins, 0.0)


class TouchLoads(ForceTerm):
    """Force term of all points that may be touched. Untouched ones add nothing.

    Attributes:
        axes: Axes along which a touch acts, bool, shape (touch_count, 3).
        stiffness: s of each touch [N/m], shape (touch_count,).
        loads: Measured forces, or f₀ of held points [N], shape (touch_count, 3).
        places: Measured places p of held points [m], same shape.
        is_held: Whether the point is held, shape (touch_count,).
        is_active: Whether any point is touched.
    """

    name = "touches"

    def __init__(
        self, points: BarycentricMapping, axes: np.ndarray, stiffness: np.ndarray,
        free_index: np.ndarray,
    ):  # fmt: skip
        """Lay out the touches.

        Args:
            points: The points.
            axes: Axes along which each acts, bool, shape (touch_count, 3).
            stiffness: s [N/m], shape (touch_count,).
            free_index: Unknown or carried point of each node, -1 where it does not move,
                shape (node_count,).
        """
        count = points.point_count
        self.axes, self.stiffness = np.array(axes, bool), np.array(stiffness, float)
        self._points = points
        used = points.barycentric_weights != 0.0
        self._stencils = np.where(used, free_index[points.nodes], -1)
        self._weights = np.where(self._stencils >= 0, points.barycentric_weights, 0.0)
        self.loads, self.places = np.zeros((count, 3)), np.zeros((count, 3))
        self.is_held, self.is_active = np.zeros(count, bool), False

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """Find the places of the stiffness in the storage, and sort the points' nodes."""
        self._bound = bound = bind_stencils(self._stencils, elimination_rank, slots)
        self._stencils = bound.sorted(self._stencils)
        self._weights = bound.sorted(self._weights)

    def load(self, forces: np.ndarray, places: np.ndarray) -> bool:
        """Set the touches from now on.

        Args:
            forces: Force of each touch, zero without one; of a held point, f₀ [N], shape
                (touch_count, 3).
            places: Places of held points [m], NaN of the others, same shape.

        Returns:
            Whether other points are held than before, which changes the stiffness.
        """
        held = np.isfinite(places).all(axis=1)
        changes = not np.array_equal(held, self.is_held)
        self.loads, self.is_held = np.where(self.axes, forces, 0.0), held
        self.places = np.where(held[:, None], places, 0.0)
        self.is_active = bool(held.any() or self.loads.any())
        return changes

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Where the points are [m], shape (touch_count, 3), at node positions [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self._points.positions(positions)

    def forces(self, positions: np.ndarray) -> np.ndarray:
        """Forces of the touches on the bodies [N], shape (touch_count, 3), at node positions [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self.loads + self._held_stiffness() * (self.places - self.points(positions))

    def _held_stiffness(self) -> np.ndarray:
        """s along the axes of held points, else 0 [N/m], shape (touch_count, 3)."""
        return np.where(self.axes & self.is_held[:, None], self.stiffness[:, None], 0.0)

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces [N], shape (free_node_count, 3), at node positions [m]; none inverts an
        element."""
        if self.is_active:
            moving = self._stencils >= 0
            shares = self._weights[:, :, None] * self.forces(positions)[:, None, :]
            np.add.at(forces, self._stencils[moving], shares[moving])
        return 0

    def add_force_curvature(self, positions, direction, reach, curvature) -> None:
        """Adds nothing: the forces are linear in the positions."""

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add the stiffness of held points, which is positive."""
        if not self.is_active:
            return
        matrices = self._held_stiffness()[:, :, None] * np.eye(3)
        add_weighted_matrices(matrices, self._weights, self._bound.offsets, self._bound.strides, storage)
