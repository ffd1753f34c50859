"""The seam to the hardware: all that a twin needs of a robot."""

from __future__ import annotations

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np


class DeviceReading(NamedTuple):
    """What a robot measures at one moment.

    Attributes:
        lengths: Cable lengths in place [m], shape (actuator_count,).
        tensions: Cable tensions [N], shape (actuator_count,).
        marker_ids: Ids of the markers, uint32, shape (marker_count,).
        marker_positions: Where they are seen [m], shape (marker_count, 3); NaN where hidden.
        effector_positions: Where the effectors are [m], shape (effector_count, 3); NaN where the
            robot cannot know.
    """

    setpoints: np.ndarray
    efforts: np.ndarray
    marker_ids: np.ndarray
    marker_positions: np.ndarray
    effector_positions: np.ndarray


class Device(Protocol):
    """A robot with cables. A driver of real hardware has these two methods too."""

    actuator_names: tuple[str, ...]
    effector_names: tuple[str, ...]

    def apply(self, lengths: np.ndarray, now: float) -> None:
        """Takes the newest command: cable lengths [m], shape (actuator_count,), at a time [s]."""

    def read(self, now: float) -> DeviceReading:
        """Measures at a time [s], which never runs backwards."""


@runtime_checkable
class CarriedDevice(Protocol):
    """A robot whose guided bodies are moved by something else, such as an arm that carries it.

    What a device has besides `Device`, where it takes poses too.
    """

    guided_names: tuple[str, ...]
    rigid_names: tuple[str, ...]

    def apply_pose(
        self, name: str, position: np.ndarray, quaternion: np.ndarray, now: float
    ) -> None:
        """Takes the newest pose of a guided body at a time [s]: position [m], (x, y, z, w)."""

    def rigid_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the rigid bodies are: positions [m], shape (rigid_body_count, 3), and quaternions
        (x, y, z, w), shape (rigid_body_count, 4); NaN where the robot cannot know."""
