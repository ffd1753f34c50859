"""Guided bodies of a simulation: they move to commanded poses, or to rest, or keep their poses."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.inputs import PoseInput, refusal_of_pose
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.appearance import Pose

FARTHEST = 1000.0
"""Where the workspace has no end, a body was sent this many sizes of the robot from rest at most."""
BEYOND_SHARE = 0.1
"""A body was sent this share of the workspace beyond it at most."""
# Tolerance of positions relative to the robot's size, and of rotations [rad].
_NEAR = 1.0e-6


class Guidance:
    """Sets the goal poses of guided bodies; the scene limits their speeds.

    It stores the poses sent last, as the gate does for the actuators: even when the model is reset
    or fails, the next poses continue from there, no faster than the speeds allow.

    Args:
        simulation: The model, at rest.
        poses: Their commanded poses; None in a scene without guided bodies.

    Attributes:
        sent: Poses sent last, by name; at first the poses at rest.
    """

    def __init__(self, simulation: Simulation, poses: PoseInput | None):
        self._simulation, self._poses = simulation, poses
        self._names = simulation.guided_names
        self._near = _NEAR * simulation.model.nodes.finite_size
        self._home = self.poses()
        self.sent = dict(self._home)
        self._stays = False

    def poses(self) -> dict[str, Pose]:
        """Present poses of the guided bodies of the model, by name."""
        if not self._names:
            return {}
        poses = self._simulation.poses()
        return {name: poses[name] for name in self._names}

    def why_implausible(self, name: str, pose: Pose, settings: LoopSettings) -> str:
        """Why a body cannot have been sent to a pose; empty where it can.

        Args:
            name: Name of the body.
            pose: The pose.
            settings: With the workspace.
        """
        if name not in self._home:
            return "the scene has no such guided body"
        if (refusal := refusal_of_pose(pose)) is not None:
            return f"its pose is {refusal.value}"
        home = self._home[name].position
        far = FARTHEST * self._simulation.model.nodes.finite_size
        low, high = (np.clip(end, home - far, home + far)
                     for end in (settings.workspace_min, settings.workspace_max))
        beyond = BEYOND_SHARE * (high - low)
        low, high = np.minimum(low, home) - beyond, np.maximum(high, home) + beyond
        is_inside = ((pose.position >= low) & (pose.position <= high)).all()
        return "" if is_inside else f"its position {pose.position} m is far beyond the workspace"

    def send(self, time_step: float) -> dict[str, Pose]:
        """Poses to publish: those of the model, limited by the greatest speeds.

        Args:
            time_step: Time since they were sent last [s].
        """
        here = self.poses()
        for name, pose in here.items():
            self.sent[name] = self._simulation.model.guides.towards(name, self.sent[name], pose, time_step)
        return dict(self.sent)

    @property
    def is_synchronised(self) -> bool:
        """True when the model's poses are those sent last."""
        return not self.sent or self._are_alike(self.sent, self.poses())

    def go_to_sent(self) -> None:
        """Moves the model's bodies to the poses sent last."""
        self._stays = False
        self._aim(self.sent)

    def follow(self, now: float, timeout: float, reach_time: float) -> None:
        """Moves them to the newest commanded poses; they stay after a timeout.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            timeout: Time without a pose after which they stay [s]; 0 waits without limit.
            reach_time: Time in which they may move at their speeds [s].
        """
        if 0.0 < timeout < self._poses.age(now):
            self.stay()
            return
        self._stays = False
        self._aim_within(reach_time, self._poses.newest)

    def stay(self) -> None:
        """Keeps them where they are."""
        if not self._stays:
            self._stays = True
            self._aim(self.poses())

    def go_home(self, reach_time: float) -> None:
        """Moves them to their poses at rest, at their speeds during a time [s].

        Args:
            reach_time: The time [s].
        """
        self._stays = False
        self._aim_within(reach_time, self._home)

    @property
    def is_home(self) -> bool:
        """True when all of them were sent to their poses at rest."""
        return self._are_alike(self.sent, self._home)

    def _aim_within(self, reach_time: float, poses: dict[str, Pose]) -> None:
        """Aims at poses no further from the present ones than their speeds allow in a time [s]."""
        model, here = self._simulation.model, self.poses()
        self._aim({
            name: model.guides.towards(name, here[name], pose, reach_time)
            for name, pose in poses.items()
        })  # fmt: skip

    def _aim(self, poses: dict[str, Pose]) -> None:
        for name, pose in poses.items():
            self._simulation.model.guides.aim(name, pose.position, pose.quaternion)

    def _are_alike(self, first: dict[str, Pose], second: dict[str, Pose]) -> bool:
        return all(
            np.linalg.norm(first[name].position - pose.position) <= self._near
            and _angle(first[name].quaternion, pose.quaternion) <= _NEAR
            for name, pose in second.items()
        )


def _angle(first: np.ndarray, second: np.ndarray) -> float:
    """Angle between two rotations given by unit quaternions [rad]."""
    chord = min(np.linalg.norm(first - second), np.linalg.norm(first + second))
    return 4.0 * float(np.arcsin(chord / 2.0))
