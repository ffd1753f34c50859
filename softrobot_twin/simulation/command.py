"""The commands of one step. The kind of command determines only how λ is found."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from softrobot_twin.errors import CommandError

TARGETS, SETPOINTS, EFFORTS, HOLD = "targets", "setpoints", "efforts", "hold"
"""Names of what drives a step, by which tables tell it."""
DEFAULT_TIME_STEP = 0.02
"""Duration of a step where nothing else is asked [s]: of Python, of the command line and of a
node."""
LONG = 1.0e3
"""Duration of a step that no rate limits [s]."""


@dataclass(frozen=True)
class FollowTargets:
    """Inverse step: efforts that bring the effectors to their targets (Coevoet 2017, eq. 17-18).

    Attributes:
        targets: Target of each effector [m], shape (effector_count, 3), in the order of
            `Simulation.effector_names`. A row of NaN leaves that effector free.
        time_step: Time since the last step [s]; scales the rate limits of the actuators.
        commanded: Lengths of the actuators that are commanded while the others are optimised
            around them [m], NaN where free, shape (actuator_count,); None: all are free.
        orientations: Wanted turn of each effector from rest as a quaternion (x, y, z, w), of any
            length but zero, shape (effector_count, 4); NaN where it is free, as for effectors that
            ask for no orientation. None: all are free.
        stiffness: Wanted apparent stiffness of each effector along x, y and z [N/m], NaN where it
            is free, as for effectors that ask for no stiffness, shape (effector_count, 3). None:
            those of the scene.
        reach_time: Time in which the actuators may move at their rates [s]; None: `time_step`.
        sensors: Wanted value of each sensor in its unit, NaN where it is free, as for sensors without
            a weight, in the order of `Simulation.sensor_names`, shape (sensor_count,). None: all are
            free.
        is_on_way: Whether the targets lie on the way to others, which are further away: where they are
            missed, no nearer pose is sought.
    """

    targets: np.ndarray
    time_step: float
    commanded: np.ndarray | None = None
    orientations: np.ndarray | None = None
    stiffness: np.ndarray | None = None
    reach_time: float | None = None
    is_on_way: bool = False
    sensors: np.ndarray | None = None


@dataclass(frozen=True)
class CommandSetpoints:
    """Direct step: actuators move to setpoints (eq. 16); a cable becomes slack, it never pushes.

    Attributes:
        setpoints: Commanded lengths of cables, pull point to last point, and positions of slides
            [m], shape (actuator_count,); NaN for actuators that hold.
        time_step: Time since the last step [s].
        reach_time: See `FollowTargets`.
    """

    setpoints: np.ndarray
    time_step: float
    reach_time: float | None = None


@dataclass(frozen=True)
class CommandEfforts:
    """Direct step: actuators act with efforts, such as a cable's tension.

    Attributes:
        efforts: Commanded tensions of cables [N], shape (actuator_count,); NaN for actuators that
            hold their setpoints, as slides do.
        time_step: Time since the last step [s].
        reach_time: See `FollowTargets`.
    """

    efforts: np.ndarray
    time_step: float
    reach_time: float | None = None


@dataclass(frozen=True)
class Hold:
    """Hold every actuator at its setpoint while the body settles.

    Attributes:
        time_step: Time since the last step [s]; required in dynamic scenes.
    """

    time_step: float = 0.0


Command = FollowTargets | CommandSetpoints | CommandEfforts | Hold


TIMES = ("time_step", "reach_time")


def may_move(command: Command) -> bool:
    """Whether a command leaves the actuators time to do what it asks: to move at their rates, or to stay.

    Args:
        command: The command.
    """
    reach_time = getattr(command, "reach_time", LONG)
    return (command.time_step if reach_time is None else reach_time) > 0.0


def are_same(first: Command, second: Command, besides: tuple[str, ...] = ()) -> bool:
    """Whether two commands ask for the same, to the bit.

    Args:
        first: One command.
        second: Another one.
        besides: Names of entries that may differ.
    """
    if type(first) is not type(second):
        return False
    for field in fields(first):
        if field.name in besides:
            continue
        one, other = getattr(first, field.name), getattr(second, field.name)
        if one is other:
            continue
        if one is None or other is None:
            return False
        one, other = np.asarray(one), np.asarray(other)
        if one.shape != other.shape or one.tobytes() != other.tobytes():
            return False
    return True


def fitting(name: str, array, shape: tuple[int, ...], nan_allowed: bool) -> np.ndarray:
    """An array of a command, checked.

    Args:
        name: Its name, for errors.
        array: Its values.
        shape: The shape that it must have.
        nan_allowed: Whether it may hold NaN; it must not hold infinite values in any case.

    Raises:
        CommandError: It does not fit.
    """
    array = np.asarray(array, dtype=float)
    if array.shape != shape:
        raise CommandError(name, f"must have shape {shape}, not {array.shape}")
    # Faster than a check of the array, which has few entries.
    if all(map(math.isfinite, array.ravel().tolist())):
        return array
    bad = np.isinf(array) if nan_allowed else ~np.isfinite(array)
    if bad.any():
        raise CommandError(name, f"holds {array[bad][0]}")
    return array
