"""What may be changed while the loop runs."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import Enum

import numpy as np

from softrobot_twin.errors import ParameterError


class WhenLost(Enum):
    """What to do without a measurement that the loop counts on."""

    OPEN_LOOP = "open_loop"
    """Go on with the model alone."""
    HOLD = "hold"
    """Keep every actuator where it is."""


_UNITS = {
    "rate": "Hz",
    "deadline": "s",
    "message_timeout": "s",
    "future_tolerance": "s",
    "target_timeout": "s",
    "velocity_timeout": "s",
    "speed_limit": "m/s",
    "approach_speed": "m/s",
    "correction_gain": "1/s",
    "correction_limit": "m",
    "marker_timeout": "s",
    "device_timeout": "s",
}
_ABOVE_ZERO = ("rate", "velocity_timeout", "speed_limit", "marker_timeout", "device_timeout")


@dataclass(frozen=True)
class LoopSettings:
    """Limits, gains and timeouts of the loop.

    Attributes:
        rate: Ticks in a second [Hz].
        deadline: Time that a step may take [s]: what is left of it is spent on more
            linearizations, and where one would be late, a stale factor keeps the tick; 0 for as
            many linearizations as the scene says, however long they take.
        message_timeout: Oldest stamp accepted [s]; 0 accepts any age.
        future_tolerance: How far ahead a stamp may be [s].
        target_timeout: Without a target for so long the loop holds [s]; 0 waits for ever.
        velocity_timeout: A velocity counts for so long after it arrived [s].
        speed_limit: Greatest speed of a target that a velocity drives [m/s].
        approach_speed: A target further away is approached on a straight line, at this speed
            [m/s]; 0 goes as fast as the cables' rates allow, on a path that may be curved.
        workspace_min: Lower corner of the box that targets and poses of guided bodies are kept
            in [m].
        workspace_max: Upper corner of it [m].
        closed_loop: Correct the targets by what the markers measure.
        correction_gain: Gain k_i of that correction [1/s].
        correction_limit: Greatest length of the correction [m].
        marker_timeout: Markers count as lost after so long without any [s].
        on_lost_markers: What to do then, in closed loop.
        device_timeout: The device counts as lost after so long without its lengths [s].
        on_lost_device: What to do then.

    Raises:
        ParameterError: A value is not finite, below its least, or a box has no inside.
    """

    rate: float = 20.0
    deadline: float = 0.0
    message_timeout: float = 0.5
    future_tolerance: float = 0.1
    target_timeout: float = 0.0
    velocity_timeout: float = 0.6
    speed_limit: float = 0.02
    approach_speed: float = 0.0
    workspace_min: tuple[float, float, float] = (-1.0, -1.0, -1.0)
    workspace_max: tuple[float, float, float] = (1.0, 1.0, 1.0)
    closed_loop: bool = False
    correction_gain: float = 2.0
    correction_limit: float = 0.01
    marker_timeout: float = 0.5
    on_lost_markers: WhenLost = WhenLost.OPEN_LOOP
    device_timeout: float = 0.5
    on_lost_device: WhenLost = WhenLost.HOLD

    def __post_init__(self) -> None:
        for name, unit in _UNITS.items():
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0.0:
                raise ParameterError(name, value, unit, "must be finite and not negative")
            if name in _ABOVE_ZERO and value == 0.0:
                raise ParameterError(name, value, unit, "must be above zero")
        for name in ("workspace_min", "workspace_max"):
            corner = getattr(self, name)
            if len(corner) != 3 or not all(map(math.isfinite, corner)):
                raise ParameterError(name, corner, "m", "must be three finite numbers, x y z")
        for low, high in zip(self.workspace_min, self.workspace_max, strict=True):
            if low > high:
                raise ParameterError(
                    "workspace_min", self.workspace_min, "m",
                    f"must not be above workspace_max = {self.workspace_max}",
                )

    def in_workspace(self, position: np.ndarray) -> np.ndarray:
        """The nearest position inside the workspace [m], shape (3,)."""
        return np.clip(position, self.workspace_min, self.workspace_max)

    @property
    def budget(self) -> float | None:
        """Time that a step may take [s], or None without a deadline."""
        return self.deadline or None

    @property
    def period(self) -> float:
        """Time from tick to tick [s]."""
        return 1.0 / self.rate

    @property
    def reach(self) -> float:
        """How far an effector may be sent in one tick [m]."""
        return self.approach_speed * self.period if self.approach_speed > 0.0 else math.inf


SETTING_NAMES = tuple(field.name for field in fields(LoopSettings))
