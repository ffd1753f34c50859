"""Where guided bodies are told to go: the newest pose for each of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal, RefusalCounts

# A quaternion with no number above this is no rotation: a message never filled in has zeros.
_SHORTEST = 1.0e-3


class Pose(NamedTuple):
    """Where a body's coordinates stand.

    Attributes:
        position: Its origin [m], shape (3,).
        quaternion: Its rotation (x, y, z, w), of any length but none, shape (4,).
    """

    position: np.ndarray
    quaternion: np.ndarray


def is_pose(pose: Pose) -> bool:
    """True when the numbers are finite and the quaternion is a rotation."""
    finite = np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()
    return bool(finite and np.abs(pose.quaternion).max() >= _SHORTEST)


class PoseInput:
    """Keeps the newest pose of every guided body.

    Args:
        names: Names of the guided bodies.
        frame_id: The one frame that is accepted.
        settings: Timeouts and workspace.

    Attributes:
        refusals: Messages refused, by reason.
        clamped: How often a pose was outside the workspace, and was kept in it.
        newest: The newest pose of each body that was given one since the last reset, by name.
    """

    def __init__(self, names: Sequence[str], frame_id: str, settings: LoopSettings):
        self.refusals = RefusalCounts()
        self.clamped = 0
        self._headers = {name: HeaderCheck(frame_id, 0.0, 0.0) for name in names}
        self.apply(settings)
        self.reset()

    def apply(self, settings: LoopSettings) -> None:
        """Takes up changed timeouts and workspace."""
        self._settings = settings
        for header in self._headers.values():
            header.message_timeout = settings.message_timeout
            header.future_tolerance = settings.future_tolerance

    def reset(self) -> None:
        """Forgets what came in; the counts stay."""
        self.newest: dict[str, Pose] = {}
        self._time = -math.inf
        for header in self._headers.values():
            header.forget()

    def accept(self, name: str, position, quaternion, arrival: Arrival) -> Refusal | None:
        """Takes one message, or says why not.

        Args:
            name: A guided body.
            position: Where it should go [m], shape (3,); it is kept in the workspace.
            quaternion: How it should be turned (x, y, z, w), shape (4,).
            arrival: Header and moment of the message.
        """
        pose = Pose(np.array(position, dtype=float), np.array(quaternion, dtype=float))
        refusal = self._refusal(name, pose, arrival)
        if refusal is not None:
            return self.refusals.add(refusal)
        self._headers[name].remember(arrival)
        inside = self._settings.in_workspace(pose.position)
        self.clamped += bool((inside != pose.position).any())
        self.newest[name] = pose._replace(position=inside)
        self._time = arrival.time
        return None

    def age(self, now: float) -> float:
        """Time since the last pose that was taken [s]; infinite when there was none."""
        return now - self._time

    def _refusal(self, name: str, pose: Pose, arrival: Arrival) -> Refusal | None:
        if name not in self._headers:
            return Refusal.WRONG_NAMES
        refusal = self._headers[name].refusal(arrival)
        if refusal is not None:
            return refusal
        if not (np.isfinite(pose.position).all() and np.isfinite(pose.quaternion).all()):
            return Refusal.NOT_FINITE
        return None if is_pose(pose) else Refusal.NO_ROTATION
