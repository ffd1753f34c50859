"""The last check before a command leaves: finite, and within position, rate and effort limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.limits import ActuatorLimits

SETPOINT_SHARE = 6.0e-5
"""Inexact solutions may exceed a position or rate limit by this share of the actuator's travel."""
EFFORT_SHARE = 5.0e-4
"""Inexact solutions may exceed an effort limit by this share of the actuator's greatest effort."""


class ActuatorCommand(NamedTuple):
    """A command to the hardware.

    Attributes:
        setpoints: Setpoints in the unit of each actuator's kind, shape (actuator_count,).
        efforts: Efforts in the unit of each actuator's kind, shape (actuator_count,).
    """

    setpoints: np.ndarray
    efforts: np.ndarray


class Passage(NamedTuple):
    """The result of the gate.

    Attributes:
        command: The command to publish.
        violated: Limits that the rejected command violated, such as ``north.rate``; empty when it
            passed.
    """

    command: ActuatorCommand
    violated: tuple[str, ...]


class Tolerances(NamedTuple):
    """How far a command may exceed its limits because a solution is not exact.

    Attributes:
        setpoints: In the unit of each actuator's setpoint, shape (actuator_count,).
        efforts: In the unit of each actuator's effort, shape (actuator_count,).
    """

    setpoints: np.ndarray
    efforts: np.ndarray


def gate_tolerances(limits: ActuatorLimits) -> Tolerances:
    """Tolerances relative to the travel and the greatest effort of each actuator.

    An actuator without a limit of its travel or of its effort has the natural scales of its kind.

    Args:
        limits: Limits of the actuators.
    """
    travel = limits.travel(limits.drive_scale)
    return Tolerances(SETPOINT_SHARE * travel, EFFORT_SHARE * limits.effort_scale)


@njit(**KERNEL)
def pass_command(
    setpoints, efforts, before, reach, lowest, highest, effort_min, effort_max, beyond,
    beyond_effort, by_effort, zeros, slopes,
):  # fmt: skip
    """Whether a command is finite, and within limits of setpoints, rates and efforts.

    Where it is, what the tolerances allow beyond the limits is taken away. Where it is not,
    `CommandGate` finds out which limit of which actuator it violates. An actuator that was measured
    outside its limits violates no rate: it moves as far as its rate allows.

    Args:
        setpoints, efforts: The command, shape (actuator_count,); changed where it passes.
        before: Setpoints of the last command.
        reach: Greatest moves in the time since the last command.
        lowest, highest: Limits of setpoints.
        effort_min, effort_max: Limits of efforts.
        beyond, beyond_effort: Tolerances of setpoints and efforts.
        by_effort: Whether the setpoint of each actuator holds its effort.
        zeros, slopes: Setpoints at rest, and changes of setpoints with what they hold.
    """
    for i in range(len(setpoints)):
        x, effort, slack = setpoints[i], efforts[i], beyond[i]
        if not (np.isfinite(x) and np.isfinite(effort)):
            return False
        if x < lowest[i] - slack or x > highest[i] + slack:
            return False
        outside = abs(min(highest[i], max(lowest[i], before[i])) - before[i])
        if outside <= slack and abs(x - before[i]) > reach[i] + slack:
            return False
        if effort < effort_min[i] - beyond_effort[i] or effort > effort_max[i] + beyond_effort[i]:
            return False
    for i in range(len(setpoints)):
        x = min(highest[i], max(lowest[i], setpoints[i]))
        setpoints[i] = min(before[i] + reach[i], max(before[i] - reach[i], x))
        effort = min(effort_max[i], max(effort_min[i], efforts[i]))
        efforts[i] = (setpoints[i] - zeros[i]) / slopes[i] if by_effort[i] else effort
    return True


class CommandGate:
    """Passes a command that is within all limits; replaces any other by the last valid one.

    The simulation already respects the limits; the gate checks each command before it is published.
    It stores the last published command, or the measurement that was passed to `start_from` after
    it. No service call and no failure changes what is stored. At first the actuators are assumed to
    be at rest.

    A command that exceeds a limit by less than the tolerance is reduced to the limit. Actuators
    that were measured outside their limits return inside as fast as their rates allow.

    Args:
        actuator_names: Names of the actuators.
        rest_setpoints: Setpoints at rest, in the unit of each actuator's kind, shape
            (actuator_count,).
        limits: Limits of displacement, rate and effort.

    Attributes:
        last: The last command or measurement.
        is_outside: True while an actuator that was measured outside its limits has not returned
            inside.
        home: Setpoints at rest, or the nearest ones that the limits allow, shape (actuator_count,).
        tolerances: How far a command may exceed the limits.
    """

    def __init__(self, actuator_names: Sequence[str], rest_setpoints: np.ndarray, limits: ActuatorLimits):
        self._names = tuple(actuator_names)
        self._lowest, self._highest = limits.setpoint_range(rest_setpoints)
        self._limits, self._rest = limits, np.array(rest_setpoints, float)
        self._reach = (0.0, limits.reach(0.0))
        self.tolerances = gate_tolerances(limits)
        self.home = self.within(rest_setpoints)
        self.start_from(self.home, np.zeros(len(rest_setpoints)))
        self.pass_on(*self.last, 0.0)  # Loads the kernel before the first tick.

    def within(self, setpoints: np.ndarray) -> np.ndarray:
        """The nearest setpoints inside the limits, shape (actuator_count,).

        Args:
            setpoints: Setpoints in the actuators' units, shape (actuator_count,).
        """
        return np.minimum(np.maximum(setpoints, self._lowest), self._highest)

    @property
    def _outside(self) -> np.ndarray:
        """True for each actuator that is outside its limits, shape (actuator_count,)."""
        distance = np.abs(self.within(self.last.setpoints) - self.last.setpoints)
        return distance > self.tolerances.setpoints

    def start_from(self, setpoints: np.ndarray, efforts: np.ndarray) -> None:
        """Sets where the actuators are: the first command may differ from there as rates allow.

        Args:
            setpoints: Measured setpoints in the unit of each actuator's kind, shape
                (actuator_count,).
            efforts: Efforts in the unit of each actuator's kind, same shape.
        """
        limits, setpoints = self._limits, np.array(setpoints, dtype=float)
        efforts = np.clip(efforts, limits.effort_min, limits.effort_max)
        held = (setpoints - self._rest) / limits.slopes
        efforts = np.where(limits.is_effort_driven, held, efforts)
        self.last = ActuatorCommand(setpoints, efforts)
        self.is_outside = bool(self._outside.any())

    def pass_on(self, setpoints: np.ndarray, efforts: np.ndarray, time_step: float) -> Passage:
        """Checks a command; passes it, or the last valid one in its place.

        Args:
            setpoints: Setpoints in the unit of each actuator's kind, shape (actuator_count,).
            efforts: Efforts in the unit of each actuator's kind, same shape.
            time_step: Time since the last command [s].
        """
        command = ActuatorCommand(np.array(setpoints, float), np.array(efforts, float))
        limits = self._limits
        if not command.setpoints.shape == command.efforts.shape == self.home.shape:
            violated = ("wrong_size",)
        elif pass_command(
            *command, self.last.setpoints, self.reach(time_step), self._lowest, self._highest,
            limits.effort_min, limits.effort_max, *self.tolerances, limits.is_effort_driven,
            self._rest, limits.slopes,
        ):  # fmt: skip
            self.last, violated = command, ()
            # What starts inside stays there.
            self.is_outside = self.is_outside and bool(self._outside.any())
        else:
            violated = self._violations(*command, time_step)
        if violated and self.is_outside:
            self.lead(self.within(self.last.setpoints), time_step)
        return Passage(self.last, violated)

    def lead(self, setpoints: np.ndarray, time_step: float) -> ActuatorCommand:
        """Moves towards setpoints as fast as the rates allow, with unchanged efforts.

        Args:
            setpoints: Where to move, in the unit of each actuator's kind, shape (actuator_count,);
                limited to the allowed range.
            time_step: Time since the last command [s].
        """
        before, reach = self.last.setpoints, self.reach(time_step)
        near = np.minimum(np.maximum(self.within(setpoints), before - reach), before + reach)
        self.start_from(near, self.last.efforts)
        return self.last

    def reach(self, time_step: float) -> np.ndarray:
        """Greatest move of each actuator in a time [s], shape (actuator_count,).

        Args:
            time_step: The time [s].
        """
        if time_step != self._reach[0]:  # Most ticks stand for a period.
            self._reach = (time_step, self._limits.reach(time_step))
        return self._reach[1]

    def _violations(self, setpoints, efforts, time_step: float) -> tuple[str, ...]:
        """Names of the limits that a command violates."""
        beyond, beyond_effort = self.tolerances
        moved = np.abs(setpoints - self.last.setpoints)
        too_fast = moved > self.reach(time_step) + beyond
        limits, grows = self._limits, self._limits.slopes > 0.0
        low, high = setpoints < self._lowest - beyond, setpoints > self._highest + beyond
        least, greatest = zip(*limits.drive_names, strict=True) if self._names else ((), ())
        loads = limits.effort_words
        every = ("",) * len(self._names)
        checks = (
            (every, "not_finite", ~(np.isfinite(setpoints) & np.isfinite(efforts))),
            (greatest, "", np.where(grows, high, low)),
            (least, "", np.where(grows, low, high)),
            (loads, "_min", efforts < limits.effort_min - beyond_effort),
            (loads, "_max", efforts > limits.effort_max + beyond_effort),
            (every, "rate", too_fast & ~self._outside),
        )
        return tuple(
            f"{self._names[i]}.{words[i]}{end}"
            for words, end, broken in checks for i in np.flatnonzero(broken)
        )  # fmt: skip
