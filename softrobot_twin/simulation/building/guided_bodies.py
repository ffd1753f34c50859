"""Guided rigid bodies: they move towards commanded poses within their speed limits."""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.mechanics.rotation import (
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from softrobot_twin.simulation.building.scene_layout import Layout

# Default speed of a guided body: the size of the robot in a second; default turn rate [rad/s].
# A step does not converge where a body turns by more than about half a radian in it.
SIZES_IN_A_SECOND = 1.0
TURN_RATE = 1.0
# A share of a displacement that equals one up to rounding.
WHOLE = 1.0 - 1.0e-9


class Guides:
    """Moves guided bodies and the nodes attached to them at the beginning of each step.

    Attributes:
        limits: Greatest speed [m/s] and turn rate [rad/s], by names of bodies.
    """

    def __init__(self, layout: Layout):
        """Find the guided bodies and the nodes attached to them.

        Args:
            layout: The bodies.
        """
        self.frames, self._hinged = layout.frames, layout.hinged
        sliding = {slide.body for slide in layout.scene.slides}
        self._parts = {
            part.name: part for part in layout.rigid
            if part.is_guided and part.name not in sliding
        }  # fmt: skip
        self._size = layout.nodes.size
        by_default = SIZES_IN_A_SECOND * self._size
        self.limits = {
            name: (part.entry.speed or by_default, part.entry.turn_rate or TURN_RATE)
            for name, part in self._parts.items()
        }
        self._attached = []
        for body in layout.bodies:
            for name, nodes in body.riding.items():
                if name not in self._parts:  # moved by a slide, or free
                    continue
                rest = layout.drawn_positions[nodes + body.first_node]
                self._attached.append((nodes + body.first_node, self._parts[name].carried(rest)))
        self._ways = []  # Of the bodies that the last step moves: index, pose before, pose after.
        # Compiled here, not at the first move.
        rotation_from_vector(np.zeros(3))
        rest = {name: (part.origin, part.rotation) for name, part in self._parts.items()}
        if layout.scene.mounting:
            rest = self._poses(layout.nodes.rest_positions)
        self._rest = rest
        self.reset()

    def _poses(self, positions: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Origin [m] and rotation of each guided body at a state."""
        return {name: self.frames.pose(positions, part.index) for name, part in self._parts.items()}

    def reset(self) -> None:
        """Set the targets to the rest poses."""
        self._targets = dict(self._rest)

    def stay(self, positions: np.ndarray) -> None:
        """Set the targets to the poses at a state: node positions [m], shape (node_count, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        self._targets = self._poses(positions)

    def aim(self, name: str, position, quaternion=None) -> None:
        """Set the target pose of a guided body.

        Args:
            name: Its name.
            position: Target of its origin [m], shape (3,).
            quaternion: Target rotation, x, y, z, w; that at rest when left out.

        Raises:
            CommandError: There is no such body, or the pose is not finite.
        """
        if name not in self._parts:
            known = ", ".join(self._parts)
            raise CommandError("pose", f"{name} is not a guided body of this scene; it has {known}")
        position = np.asarray(position, float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise CommandError("pose", f"{name}: position {position} m is not a point")
        rotation = self._rest[name][1]
        if quaternion is not None:
            try:
                rotation = rotation_from_quaternion(np.asarray(quaternion, float))
            except ValueError as error:
                raise CommandError("pose", f"{name}: {error}") from None
        self._targets[name] = (position, rotation)

    def begin_step(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Move bodies towards their targets.

        Args:
            positions: Node positions [m], shape (node_count, 3); those of guided bodies and the
                nodes attached to them are moved.
            velocities: Not used.
            time_step: The step's duration [s].
        """
        self._ways = []
        if time_step == 0.0:
            return
        for name, part in self._parts.items():
            here = self.frames.pose(positions, part.index)
            there = self._reached(name, here, self._targets[name], time_step)
            if there is not None:
                self._ways.append((part.index, here, there))
        if self._ways:
            self.place(positions, 1.0)

    @property
    def moved(self) -> bool:
        """Whether the last step began with a move."""
        return bool(self._ways)

    def place(self, positions: np.ndarray, share: float) -> None:
        """Make a share of the last step's move.

        Args:
            positions: Node positions [m], shape (node_count, 3); those of guided bodies and the
                nodes attached to them are moved.
            share: The share, of the whole way and of the whole turn of each body.
        """
        relative = self._hinged.relative(positions) if self._hinged else None
        for index, (origin, rotation), there in self._ways:
            if share < 1.0:
                turn = rotation_from_vector(share * vector_from_rotation(there[1] @ rotation.T))
                there = (origin + share * (there[0] - origin), turn @ rotation)
            self.frames.place(positions, index, *there)
        if self._hinged:
            self._hinged.follow(positions, relative)
        for nodes, mapping in self._attached:
            positions[nodes] = mapping.positions(positions)

    def _reached(self, name: str, here, there, time_step: float):
        """Origin and rotation that a body can reach in a step; None where it does not move."""
        (origin, rotation), (target, target_rotation) = here, there
        speed, turn_rate = self.limits[name]
        displacement = target - origin
        turn = vector_from_rotation(target_rotation @ rotation.T)
        displacement *= _share(math.sqrt(displacement @ displacement), speed, time_step)
        turn *= _share(math.sqrt(turn @ turn), turn_rate, time_step)
        if not (displacement.any() or turn.any()):
            return None
        return origin + displacement, rotation_from_vector(turn) @ rotation

    def towards(self, name: str, here, there, time_step: float):
        """The pose between two poses that a body can reach within its speed limits.

        Args:
            name: Name of the guided body.
            here: Present position [m] and quaternion (x, y, z, w).
            there: Target position [m] and quaternion.
            time_step: Time for the motion [s].

        Returns:
            The pose, of the type of `there`; `there` itself where it can be reached.
        """
        speed, turn_rate = self.limits[name]
        start = (here[0], rotation_from_quaternion(here[1]))
        end = (there[0], rotation_from_quaternion(there[1]))
        turn = np.linalg.norm(vector_from_rotation(end[1] @ start[1].T))
        distance = np.linalg.norm(end[0] - start[0])
        least = min(_share(distance, speed, time_step), _share(turn, turn_rate, time_step))
        if least >= WHOLE:
            return there
        origin, rotation = self._reached(name, start, end, time_step)
        return type(there)(origin, quaternion_from_rotation(rotation))

    def points(self, positions: np.ndarray) -> np.ndarray:
        """Origin of each guided body and points on its axes, the robot's size away [m].

        Args:
            positions: Node positions [m], shape (node_count, 3).

        Returns:
            Their coordinates, shape (12 body_count,); turns count by how far they carry the robot.
        """
        poses = (self.frames.pose(positions, part.index) for part in self._parts.values())
        return np.concatenate([
            np.concatenate([origin, (origin + self._size * rotation.T).ravel()])
            for origin, rotation in poses
        ])  # fmt: skip

    def pose(self, name: str, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and quaternion (x, y, z, w) of a guided body.

        Args:
            name: Name of the body.
            positions: Node positions [m], shape (node_count, 3).
        """
        origin, rotation = self.frames.pose(positions, self._parts[name].index)
        return origin, quaternion_from_rotation(rotation)


def _share(distance: float, limit: float, time_step: float) -> float:
    """Share of a distance that can be covered in a step."""
    if distance <= limit * time_step:
        return 1.0
    return limit * time_step / distance
