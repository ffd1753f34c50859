"""Grips: points of bodies that are held at places of rigid bodies, or of the world, while these hold.

A grip that holds joins each of its points p = Σ w_a x_a, by a stiff spring without a length, to the
place where it was when the grip took hold: r = Σ c_n x_n + r₀, f = -k c_n r. On a rigid body the place
moves with the four nodes of its frame, by constant weights; in the world it is r₀. Nothing is added
while a grip does not hold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.stencil import add_weighted_matrices


class Held(NamedTuple):
    """What grips hold, and where.

    Attributes:
        holds: Whether each grip holds, 1 or 0, shape (grip_count,).
        weights: Weights of the four frame nodes at each point, zero in the world,
            shape (point_count, 4).
        places: Places in the world [m], zero on rigid bodies, shape (point_count, 3).
    """

    holds: np.ndarray
    weights: np.ndarray
    places: np.ndarray


class Grips(ForceTerm):
    """Force term of all grips of a scene.

    Attributes:
        points: Points of all grips.
        grip_of_point: Grip of each point, shape (point_count,).
        frames: Origin node of the frame that each grip holds, -1 in the world, shape (grip_count,).
        held: What they hold.
    """

    name = "grips"

    def __init__(
        self, points: BarycentricMapping, grip_of_point: np.ndarray, frames: np.ndarray,
        stiffness: np.ndarray, free_index: np.ndarray,
    ):  # fmt: skip
        """Lay out the grips; none holds.

        Args:
            points: Points of all grips.
            grip_of_point: Grip of each point, shape (point_count,).
            frames: Origin node of the frame that each grip holds, -1 in the world, shape (grip_count,).
            stiffness: k of each point [N/m], shape (point_count,).
            free_index: Unknown or carried point of each node, -1 where it does not move,
                shape (node_count,).
        """
        self.points, self.grip_of_point, self.frames = points, grip_of_point, frames
        self._stiffness = np.asarray(stiffness, float)
        firsts = frames[grip_of_point]
        others = np.where(firsts[:, None] >= 0, firsts[:, None] + np.arange(4), -1)
        self._nodes = np.hstack([points.nodes, others])
        used = np.hstack([points.barycentric_weights != 0.0, others >= 0])
        self._stencils = np.where(used, free_index[self._nodes], -1)
        self._unsorted = self._stencils
        count = points.point_count
        self.held = Held(np.zeros(len(frames)), np.zeros((count, 4)), np.zeros((count, 3)))

    def take_hold(self, grip: int, holds: bool, positions: np.ndarray) -> None:
        """Let a grip hold what is there, or let go.

        Args:
            grip: The grip.
            holds: Whether it holds from now on.
            positions: Node positions [m], shape (node_count, 3).
        """
        held = Held(*(field.copy() for field in self.held))
        own = self.grip_of_point == grip
        held.holds[grip] = float(holds)
        held.weights[own], held.places[own] = 0.0, 0.0
        if holds:
            points, frame = self.points.positions(positions)[own], self.frames[grip]
            if frame < 0:
                held.places[own] = points
            else:
                local = self.local(grip, points, positions)
                held.weights[own] = np.column_stack([1.0 - local.sum(axis=1), local])
        self.held = held

    def local(self, grip: int, points: np.ndarray, positions: np.ndarray) -> np.ndarray:
        """Points in the frame that a grip holds [m], shape (count, 3).

        Args:
            grip: The grip.
            points: In the world [m], shape (count, 3).
            positions: Node positions [m], shape (node_count, 3).
        """
        frame = positions[self.frames[grip] : self.frames[grip] + 4]
        return (points - frame[0]) @ (frame[1:] - frame[0]).T

    @property
    def _active(self) -> np.ndarray:
        """k of each point, zero where its grip does not hold [N/m], shape (point_count,)."""
        return self._stiffness * self.held.holds[self.grip_of_point]

    def forces(self, positions: np.ndarray) -> np.ndarray:
        """Force of each grip on the body of its points [N], shape (grip_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        pulls = self._active[:, None] * self._apart(positions)
        totals = np.zeros((len(self.frames), 3))
        np.add.at(totals, self.grip_of_point, pulls)
        return totals

    def _apart(self, positions: np.ndarray) -> np.ndarray:
        """From each point to its place [m], shape (point_count, 3)."""
        places = self.held.places.copy()
        on_frame = np.flatnonzero(self.frames[self.grip_of_point] >= 0)
        firsts = self.frames[self.grip_of_point][on_frame, None] + np.arange(4)
        places[on_frame] = np.einsum("pn,pni->pi", self.held.weights[on_frame], positions[firsts])
        return places - self.points.positions(positions)

    @property
    def _coefficients(self) -> np.ndarray:
        """c of the nodes of each point, shape (point_count, width)."""
        return np.hstack([-self.points.barycentric_weights, self.held.weights])

    def add_forces(self, positions: np.ndarray, forces: np.ndarray) -> int:
        """Add the forces; see `ForceTerm.add_forces`."""
        if self.held.holds.any():
            pulls = self._active[:, None] * self._apart(positions)
            moving = self._unsorted >= 0
            shares = -self._coefficients[:, :, None] * pulls[:, None, :]
            np.add.at(forces, self._unsorted[moving], shares[moving])
        return 0

    def add_force_curvature(self, positions, direction, reach, curvature) -> None:
        """Adds nothing: the forces are linear in the positions; see `ForceTerm`."""

    def energy(self, positions: np.ndarray) -> float:
        """½ Σ k ‖r‖² [J]; see `ForceTerm.energy`."""
        apart = self._apart(positions)
        return float(0.5 * self._active @ (apart * apart).sum(axis=1))

    def add_stiffness(self, positions, storage, projected: bool) -> None:
        """Add the stiffness, which is positive; see `ForceTerm.add_stiffness`."""
        if not self.held.holds.any():
            return
        add_weighted_matrices(
            self._active[:, None, None] * np.eye(3), self._bound.sorted(self._coefficients),
            self._bound.offsets, self._bound.strides, storage,
        )  # fmt: skip
