"""Targets on a circle that a robot can follow for as many steps as are to be timed."""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.simulation import FollowTargets, CommandSetpoints, Simulation

TIME_STEP = 0.01
"""Time from one target to the next [s]."""
# Every cable is first wound in by this share of its limit: slack cables follow nothing.
_WOUND_SHARE = 0.25
_WINDING_STEPS = 60
_STEPS_A_ROUND = 500
# Radius of the circle, as a share of the body's size.
_RADIUS_SHARE = 0.03
_APPROACH_STEPS = 30


class NothingToFollowError(SoftRobotTwinError):
    """A scene has no effector or no cable, or has contact."""

    def __init__(self, scene: str, has_contact: bool = False):
        self.scene = scene
        lacks = "this scene lacks them"
        if has_contact:
            lacks = ("and no contact, in which effectors are not controlled: 'bench --commands "
                     "FILE.csv' times this scene along a commands file")
        super().__init__(f"{scene}: a benchmark follows a circle, which needs cables and an "
                         f"effector; {lacks}")


class CircleTour:
    """A horizontal circle of all effectors about where pretensioned cables hold them."""

    def __init__(self, simulation: Simulation):
        """Winds the cables in and comes onto the circle; none of this is to be timed.

        Args:
            simulation: Warmed up.

        Raises:
            NothingToFollowError: The scene cannot be inverted.
        """
        if simulation.model.contacts is not None:
            raise NothingToFollowError(simulation.scene.name, has_contact=True)
        if not simulation.effector_names or not simulation.actuator_names:
            raise NothingToFollowError(simulation.scene.name)
        most, rest = simulation.limits.displacement_max, simulation.rest_setpoints
        # Without a limit of its own a cable could be wound in whole.
        wound = _WOUND_SHARE * np.minimum(np.where(most >= rest, 0.4 * rest, most), 1.0)
        for _ in range(_WINDING_STEPS):
            simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 5.0 * TIME_STEP))
        self._centre = simulation.effector_positions()
        self._radius = _RADIUS_SHARE * simulation.model.nodes.size
        self._done = 0
        for _ in range(_APPROACH_STEPS):
            simulation.step(self._command(0))

    def next(self) -> FollowTargets:
        """The next target."""
        self._done += 1
        return self._command(self._done)

    def _command(self, number: int) -> FollowTargets:
        angle = 2.0 * math.pi * number / _STEPS_A_ROUND
        offset = self._radius * np.array([math.cos(angle), math.sin(angle), 0.0])
        return FollowTargets(self._centre + offset, TIME_STEP)
