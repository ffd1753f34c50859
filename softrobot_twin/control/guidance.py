"""Leads the guided bodies of a simulation: to where they are told, home, or nowhere."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.pose_input import Pose, PoseInput
from softrobot_twin.simulation import Simulation

# A guided body is where it should be when it is as near as this share of the robot's size, and as
# this angle [rad].
_NEAR = 1.0e-6


class Guidance:
    """Says where guided bodies should go; how fast, the scene says.

    It remembers where they were sent last, as the last gate does for the actuators: whatever
    happens to the model, what carries them is sent on from there no faster than they may go.

    Args:
        simulation: The model, at rest.
        poses: Where they are told to go.

    Attributes:
        sent: Where they were sent last, by name; at first, where they are at rest.
    """

    def __init__(self, simulation: Simulation, poses: PoseInput):
        self._simulation, self._poses = simulation, poses
        # A single point has no size.
        self._near = _NEAR * min(simulation.model.nodes.size, 1.0)
        self._home = self.poses()
        self.sent = dict(self._home)
        self._stays = False

    def poses(self) -> dict[str, Pose]:
        """Where the guided bodies of the model are now, by name."""
        simulation = self._simulation
        guided = simulation.guided_names
        if not guided:
            return {}
        return {
            name: Pose(position, quaternion)
            for name, position, quaternion in zip(
                simulation.rigid_names, *simulation.rigid_poses(), strict=True
            )
            if name in guided
        }

    def send(self, time_step: float) -> dict[str, Pose]:
        """Poses to publish: those of the model, as far as what carries the bodies can follow.

        Args:
            time_step: Time since they were sent last [s].
        """
        here = self.poses()
        for name, pose in here.items():
            self.sent[name] = self._simulation.model.guides.towards(
                name, self.sent[name], pose, time_step
            )
        return dict(self.sent)

    @property
    def is_in_step(self) -> bool:
        """True when the model has the bodies where they were sent last."""
        return not self.sent or self._are_alike(self.sent, self.poses())

    def go_to_sent(self) -> None:
        """Leads the model's bodies to where they were sent last."""
        self._stays = False
        self._aim(self.sent)

    def follow(self, now: float, timeout: float) -> None:
        """Sends them to the newest poses, or lets them stay where no pose has come for long.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            timeout: After so long without a pose they stay [s]; 0 waits for ever.
        """
        if 0.0 < timeout < self._poses.age(now):
            self.stay()
            return
        self._stays = False
        self._aim(self._poses.newest)

    def stay(self) -> None:
        """Leaves them where they are."""
        if not self._stays:
            self._stays = True
            self._aim(self.poses())

    def go_home(self) -> None:
        """Sends them to where they stand at rest."""
        self._stays = False
        self._aim(self._home)

    @property
    def is_home(self) -> bool:
        """True when all of them were sent to where they stand at rest."""
        return self._are_alike(self.sent, self._home)

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
