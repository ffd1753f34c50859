"""Leads the guided bodies of a simulation: to where they are told, home, or nowhere."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.control.pose_input import Pose, PoseInput
from softrobot_twin.simulation import Simulation

# A guided body is home when it is this near to where it stands at rest [m], [rad].
_AT_HOME = 1.0e-6


class Guidance:
    """Says where guided bodies should go; how fast, the scene says.

    Args:
        simulation: The model, at rest.
        poses: Where they are told to go.
    """

    def __init__(self, simulation: Simulation, poses: PoseInput):
        self._simulation, self._poses = simulation, poses
        self._home = self.poses()
        self._stays = False

    def poses(self) -> dict[str, Pose]:
        """Where the guided bodies are now, by name."""
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
        """True when all of them stand where they do at rest."""
        here = self.poses()
        return all(
            np.linalg.norm(here[name].position - home.position) <= _AT_HOME
            and _angle(here[name], home) <= _AT_HOME
            for name, home in self._home.items()
        )

    def _aim(self, poses: dict[str, Pose]) -> None:
        for name, pose in poses.items():
            self._simulation.model.guides.aim(name, pose.position, pose.quaternion)


def _angle(first: Pose, second: Pose) -> float:
    """Angle between two rotations [rad]."""
    turn = Rotation.from_quat(first.quaternion).inv() * Rotation.from_quat(second.quaternion)
    return float(turn.magnitude())
