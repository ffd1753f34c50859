"""Where the effectors should go, from messages that may be late, wrong or missing."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal, RefusalCounts


class TargetReading(NamedTuple):
    """The targets of one tick.

    Attributes:
        targets: Where each effector should be [m], shape (effector_count, 3); a row of NaN where
            none was given.
        source: ``none``, ``point`` or ``velocity``: what moved a target last.
        age: Time since the last target or velocity arrived [s]; infinite when none ever did.
        timed_out: True when that is longer than the timeout allows.
    """

    targets: np.ndarray
    source: str
    age: float
    timed_out: bool


class TargetInput:
    """Takes target points and velocities, and refuses what cannot be used.

    Args:
        effector_count: Effectors of the simulation.
        velocity_effector: Index of the effector that a velocity drives.
        frame_id: The one frame that targets may be given in.
        settings: Limits and timeouts.

    Attributes:
        point_refusals: Target points refused, by reason.
        velocity_refusals: Velocities refused, by reason.
        clamped: How often a point or a velocity led out of the workspace, and was kept in it.
    """

    def __init__(
        self, effector_count: int, velocity_effector: int, frame_id: str, settings: LoopSettings
    ):
        self.point_refusals = RefusalCounts()
        self.velocity_refusals = RefusalCounts()
        self.clamped = 0
        self._velocity_effector = velocity_effector
        self._targets = np.full((effector_count, 3), np.nan)
        self._headers = [HeaderCheck(frame_id, 0.0, 0.0) for _ in range(effector_count)]
        self.apply(settings)
        self.reset()

    def apply(self, settings: LoopSettings) -> None:
        """Takes up changed limits and timeouts."""
        self._settings = settings
        for header in self._headers:
            header.message_timeout = settings.message_timeout
            header.future_tolerance = settings.future_tolerance

    def reset(self) -> None:
        """Forgets every target and velocity; the counts stay."""
        self._targets[:] = np.nan
        self._velocity = np.zeros(3)
        self._velocity_time = -math.inf
        self._newest = -math.inf
        self._source = "none"
        for header in self._headers:
            header.forget()

    def accept_point(self, effector: int, position, arrival: Arrival) -> Refusal | None:
        """Takes a target [m], shape (3,), kept in the workspace, or says why not."""
        position = np.asarray(position, dtype=float)
        header = self._headers[effector]
        refusal = header.refusal(arrival)
        if refusal is None and position.shape != (3,):
            refusal = Refusal.WRONG_SIZE
        if refusal is None and not np.isfinite(position).all():
            refusal = Refusal.NOT_FINITE
        if refusal is not None:
            return self.point_refusals.add(refusal)
        header.remember(arrival)
        self._targets[effector] = self._settings.in_workspace(position)
        self.clamped += bool((self._targets[effector] != position).any())
        self._newest, self._source = arrival.time, "point"
        if effector == self._velocity_effector:
            self._velocity_time = -math.inf
        return None

    def accept_velocity(self, velocity, time: float) -> Refusal | None:
        """Takes a velocity [m/s], shape (3,), that arrived at a time [s], or says why not."""
        velocity = np.asarray(velocity, dtype=float)
        if velocity.shape != (3,):
            return self.velocity_refusals.add(Refusal.WRONG_SIZE)
        if not np.isfinite(velocity).all():
            return self.velocity_refusals.add(Refusal.NOT_FINITE)
        self._velocity, self._velocity_time = velocity, time
        self._newest, self._source = time, "velocity"
        return None

    def age(self, now: float) -> float:
        """Time since the last target or velocity arrived [s]; infinite when none ever did."""
        return now - self._newest

    def read(self, now: float, time_step: float, effector_positions: np.ndarray) -> TargetReading:
        """The targets now, moved on by a velocity that still counts.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            time_step: Time since the last tick [s].
            effector_positions: Where the effectors are [m], shape (effector_count, 3): a velocity
                starts from there when no target was given before.
        """
        if now - self._velocity_time <= self._settings.velocity_timeout:
            self._drive(time_step, effector_positions[self._velocity_effector])
        age = self.age(now)
        timeout = self._settings.target_timeout
        timed_out = timeout > 0.0 and math.isfinite(age) and age > timeout
        return TargetReading(self._targets.copy(), self._source, age, timed_out)

    def _drive(self, time_step: float, start: np.ndarray) -> None:
        """Integrates the velocity. A target outside the workspace may come in, not go further."""
        largest = float(np.abs(self._velocity).max())
        if largest == 0.0:
            return
        # Scaled first: the square of what a message may hold is not always finite.
        direction = self._velocity / largest
        speed = float(np.linalg.norm(direction))
        velocity = direction / speed * min(self._settings.speed_limit, largest * speed)
        target = self._targets[self._velocity_effector]
        if not np.isfinite(target).all():
            target = start
        low = np.minimum(target, self._settings.workspace_min)
        high = np.maximum(target, self._settings.workspace_max)
        moved = target + velocity * time_step
        self._targets[self._velocity_effector] = np.clip(moved, low, high)
        self.clamped += bool((self._targets[self._velocity_effector] != moved).any())
