"""Velocities of a scene: none in statics, those of backward Euler in dynamics."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.model import Model


class Statics:
    """Every state is an equilibrium: there are no velocities."""

    def at_rest(self) -> np.ndarray:
        """Initial velocities, shape (0, 3)."""
        return np.empty((0, 3))

    def velocities(self, before: np.ndarray, after: np.ndarray, time_step: float) -> np.ndarray:
        """No velocities, shape (0, 3)."""
        return np.empty((0, 3))


class Dynamics:
    """The velocity is the displacement of a step over its duration (Coevoet 2017, eq. (6))."""

    def __init__(self, model: Model):
        """Take the nodes.

        Args:
            model: The built scene.
        """
        self._nodes = model.nodes
        self._rigid = [part for part in model.rigid if part.is_free]
        self._first = model.nodes.kinds[0].first_unknown if model.nodes.kinds else 0

    def at_rest(self) -> np.ndarray:
        """Initial velocities [m/s] and [rad/s], shape (free_node_count, 3)."""
        velocities = np.zeros((self._nodes.free_node_count, 3))
        for index, part in enumerate(self._rigid):
            turning = np.array(part.entry.angular_velocity)
            # The scene gives the velocity of the entry's origin, not of the centre of mass.
            arm = part.rotation @ part.centre_of_mass
            first = self._first
            velocities[first + 2 * index] = part.entry.velocity + np.cross(turning, arm)
            velocities[first + 2 * index + 1] = turning
        return velocities

    def velocities(self, before: np.ndarray, after: np.ndarray, time_step: float) -> np.ndarray:
        """Velocities after a step.

        Args:
            before: Node positions at its beginning [m], shape (node_count, 3).
            after: Those at its end [m], same shape.
            time_step: Its length [s].

        Returns:
            Of each unknown [m/s], of rotations [rad/s], shape (free_node_count, 3).
        """
        return self._nodes.displacement(before, after) / time_step
