"""The error of a scene whose accuracy cannot be studied."""

from __future__ import annotations

from softrobot_twin.errors import SoftRobotTwinError


class AccuracyError(SoftRobotTwinError):
    """A scene, or what was measured of it, does not tell an accuracy.

    Attributes:
        scene: Name of the scene.
        reason: What is lacking.
    """

    def __init__(self, scene: str, reason: str):
        self.scene = scene
        self.reason = reason
        super().__init__(f"{scene}: {reason}")
