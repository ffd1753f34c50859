"""A simulated fingertip that presses a simulated robot again and again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softrobot_twin.control.loop_settings import check_numbers, number
from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import Simulation, StepResult, Touched

PAUSE = 0.5
"""Share of a period in which the fingertip does not touch the robot."""


@dataclass(frozen=True)
class Presses:
    """How a fingertip presses.

    Attributes:
        touch: Name of the scene's touch.
        depth: Greatest displacement of the touched point [m].
        period: Time from press to press [s].
        direction: Direction of the press, of any length but zero.

    Raises:
        ParameterError: The depth or the period is not above zero, or the direction is zero.
    """

    touch: str
    depth: float = number("m", above_zero=True)
    period: float = number("s", above_zero=True)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)

    def __post_init__(self) -> None:
        check_numbers(self, "device_touch_")
        if len(self.direction) != 3 or not np.isfinite(self.direction).all() or not any(self.direction):
            raise ParameterError(
                "device_touch_direction", self.direction, "", "must be three numbers, not all zero"
            )


class Fingertip:
    """Moves the touched point of a robot along a line and back, then lets go for a while.

    It rests on the point when a press begins, wherever the actuators have brought the point. It only
    pushes: when the robot would have to be pulled, it has left the robot, and waits for its next press.

    Args:
        simulation: The robot's body.
        presses: How it presses.

    Raises:
        ParameterError: The scene has no such touch.
    """

    def __init__(self, simulation: Simulation, presses: Presses):
        names = simulation.touch_names
        if presses.touch not in names:
            raise ParameterError(
                "device_touch", presses.touch, "",
                f"must be a touch of the device's scene: {', '.join(names) or 'it has none'}",
            )
        self._simulation, self._presses = simulation, presses
        self._index = names.index(presses.touch)
        direction = np.array(presses.direction, float)
        self._direction = direction / np.linalg.norm(direction)
        self._origin: np.ndarray | None = None
        self._has_left = False

    def touched(self, now: float) -> Touched | None:
        """Where the fingertip holds the point at a time [s]; None while it does not touch."""
        share = now / self._presses.period % 1.0
        if share < PAUSE:
            self._origin, self._has_left = None, False
            return None
        if self._has_left:
            return None
        if self._origin is None:
            self._origin = np.array(self._simulation.touches.points[self._index])
        course = (share - PAUSE) / (1.0 - PAUSE)
        depth = 0.5 * self._presses.depth * (1.0 - np.cos(2.0 * np.pi * course))
        touched = Touched.none(len(self._simulation.touch_names))
        touched.places[self._index] = self._origin + depth * self._direction
        return touched

    def observe(self, result: StepResult) -> None:
        """Lets go where a step's force pulls at the robot."""
        if self._origin is not None and not self._has_left:
            self._has_left = bool(result.touches.forces[self._index] @ self._direction < 0.0)
