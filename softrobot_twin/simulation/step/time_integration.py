"""Velocities of a scene: none in statics, those of backward Euler in dynamics.

`generalized_alpha.py` is the scheme of second order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.state import PastMotion, State
from softrobot_twin.simulation.step.actuation import Actuation


class Motion(NamedTuple):
    """How a state moves at the end of a step.

    Attributes:
        velocities: Of each unknown [m/s], of rotations [rad/s], shape (free_node_count, 3).
        past: What the next step needs beside them; None where that is nothing.
        actuation: The actuation with the forces that acted on average.
    """

    velocities: np.ndarray
    past: PastMotion | None
    actuation: Actuation


class Statics:
    """Every state is an equilibrium: there are no velocities."""

    def at_rest(self) -> np.ndarray:
        """Initial velocities [m/s] and [rad/s], shape (free_node_count, 3); (0, 3) in statics."""
        return np.empty((0, 3))

    def knows(self, past: PastMotion | None) -> bool:
        """Whether a state's past is one of this scheme and this scene."""
        return past is None

    def begin_step(
        self, beginners: tuple, positions: np.ndarray, velocities: np.ndarray,
        past: PastMotion | None, time_step: float, follows_targets: bool = False,
    ) -> bool:  # fmt: skip
        """Let all that remembers look at the state where a step begins; move what is guided.

        Args:
            beginners: Objects that use it; see `Model.beginners`.
            positions: Node positions [m], shape (node_count, 3); those of guided bodies are moved.
            velocities: Of the unknowns [m/s] and [rad/s], shape (free_node_count, 3).
            past: What the scheme knows of the steps before.
            time_step: h [s].
            follows_targets: Whether the step leads effectors towards targets.

        Returns:
            Whether the tangent of an equally long step before is of no use for this one.
        """
        for beginner in beginners:
            beginner.begin_step(positions, velocities, time_step)
        return False

    def end_step(
        self, before: State, positions: np.ndarray, actuation: Actuation, time_step: float
    ) -> Motion:
        """How the state moves after a step.

        Args:
            before: The state at its beginning.
            positions: Node positions at its end [m], shape (node_count, 3).
            actuation: Efforts and contact forces of its system.
            time_step: Its length [s].
        """
        return Motion(np.empty((0, 3)), None, actuation)


class Dynamics(Statics):
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
        """See `Statics.at_rest`."""
        velocities = np.zeros((self._nodes.free_node_count, 3))
        for index, part in enumerate(self._rigid):
            turning = np.array(part.entry.angular_velocity)
            # The scene gives the velocity of the entry's origin, not of the centre of mass.
            arm = part.rotation @ part.centre_of_mass
            first = self._first
            velocities[first + 2 * index] = part.entry.velocity + np.cross(turning, arm)
            velocities[first + 2 * index + 1] = turning
        return velocities

    def end_step(
        self, before: State, positions: np.ndarray, actuation: Actuation, time_step: float
    ) -> Motion:
        """See `Statics.end_step`."""
        velocities = self._nodes.displacement(before.positions, positions)
        velocities /= time_step
        return Motion(velocities, None, actuation)
