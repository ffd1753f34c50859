"""Paths of targets: circle, lemniscate, waypoints from a file, sequences of them; setpoints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from softrobot_twin.control.loop_settings import check_numbers, setting
from softrobot_twin.errors import ParameterError
from softrobot_twin.tables.input_tables import TableFileError, Waypoints, read_path

_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


class TargetPath(Protocol):
    """A position for every time, and of some paths an orientation."""

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s].

        Args:
            time: Time since the path began [s].
        """

    def orientation(self, time: float) -> np.ndarray | None:
        """Orientation (x, y, z, w) at a time since the path began [s]; None of a path without.

        Args:
            time: Time since the path began [s].
        """
        return None


@dataclass(frozen=True)
class ClosedCurve(TargetPath):
    """Common parameters of a circle and a lemniscate.

    Attributes:
        centre: Centre [m].
        radius: Radius of the circle, half the width of the lemniscate [m].
        period: Time for the whole curve [s].
        plane: ``xy``, ``xz`` or ``yz``.

    Raises:
        ParameterError: A value is not finite or not above zero, or the plane is unknown.
    """

    centre: tuple[float, float, float]
    radius: float = setting("Radius of the circle, half the width of the lemniscate.", 0.01, "m", 1e-6, 10.0)
    period: float = setting("Time for the whole circle or lemniscate.", 10.0, "s", 0.001, 86400.0)
    plane: str = "xy"

    def __post_init__(self) -> None:
        if len(self.centre) != 3 or not all(map(math.isfinite, self.centre)):
            raise ParameterError("target_center", self.centre, "m", "must be three finite numbers")
        check_numbers(self, "target_")
        if self.plane not in _PLANES:
            raise ParameterError("target_plane", self.plane, "", f"must be one of {list(_PLANES)}")

    def _placed(self, first: float, second: float) -> np.ndarray:
        position = np.array(self.centre, dtype=float)
        axes = _PLANES[self.plane]
        position[axes[0]] += self.radius * first
        position[axes[1]] += self.radius * second
        return position


class Circle(ClosedCurve):
    """One revolution per period, from the first axis towards the second."""

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s].

        Args:
            time: Time since the path began [s].
        """
        angle = 2.0 * math.pi * time / self.period
        return self._placed(math.cos(angle), math.sin(angle))


class Lemniscate(ClosedCurve):
    """Gerono's figure of eight along the first axis, starting at its outer end."""

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s].

        Args:
            time: Time since the path began [s].
        """
        angle = 2.0 * math.pi * time / self.period
        return self._placed(math.cos(angle), math.sin(angle) * math.cos(angle))


def read_waypoints(file: Path, effector: str) -> Waypoints:
    """Reads the path of an effector from a targets file, or from what a run wrote.

    Its columns are ``time_s,<effector>_x_m,<effector>_y_m,<effector>_z_m``, for orientations too
    ``<effector>_qx``, ``_qy``, ``_qz`` and ``_qw``; see `read_path`.

    Raises:
        ParameterError: The file cannot be read, lacks a column, or does not contain a path.
    """
    try:
        return read_path(file, effector)
    except TableFileError as error:
        raise ParameterError("target_path", str(file), "", error.what) from None


@dataclass(frozen=True)
class AlternatingPaths:
    """Paths that alternate without end. Each starts at its own beginning.

    Attributes:
        paths: The paths.
        duration: Duration of each path [s].
        ramp_time: Duration of the transition from one path to the next [s], part of `duration`.
    """

    paths: tuple[TargetPath, ...]
    duration: float
    ramp_time: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.duration) or self.duration <= self.ramp_time:
            raise ParameterError(
                "target_sequence_time", self.duration, "s",
                f"must be finite and longer than target_ramp_time = {self.ramp_time} s",
            )

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s].

        Args:
            time: Time since the first path began [s].
        """
        path, before, since = self._at(time)
        if before is None:
            return path.position(since)
        # The previous path continues during the transition, so that the velocity has no jump.
        left = before.position(since + self.duration)
        return _blend(left, path.position(since), since, self.ramp_time)

    def orientation(self, time: float) -> np.ndarray | None:
        """Orientation (x, y, z, w) at a time since the path began [s], or None.

        A path without orientations leaves the last one as it is.

        Args:
            time: Time since the first path began [s].
        """
        path, before, since = self._at(time)
        now = path.orientation(since)
        if before is None:
            return now
        left = before.orientation(since + self.duration)
        return left if now is None else _blend_turns(left, now, since, self.ramp_time)

    def _at(self, time: float) -> tuple[TargetPath, TargetPath | None, float]:
        """The path at a time [s], the one before it, and the time since it began [s]."""
        number = int(time // self.duration)
        before = self.paths[(number - 1) % len(self.paths)] if number else None
        return self.paths[number % len(self.paths)], before, time - number * self.duration


@dataclass(frozen=True)
class RampedIn:
    """A path with a smooth transition from a start position.

    Attributes:
        start: Position of the effector before [m], shape (3,).
        path: The path.
        ramp_time: Duration of the transition [s]; 0 jumps.
        turn: Orientation of the effector before (x, y, z, w), shape (4,); None without.
    """

    start: np.ndarray
    path: TargetPath
    ramp_time: float
    turn: np.ndarray | None = None

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s].

        Args:
            time: Time since the path began [s].
        """
        return _blend(self.start, self.path.position(time), time, self.ramp_time)

    def orientation(self, time: float) -> np.ndarray | None:
        """Orientation (x, y, z, w) at a time since the path began [s], or None.

        Args:
            time: Time since the path began [s].
        """
        now = self.path.orientation(time)
        return None if now is None else _blend_turns(self.turn, now, time, self.ramp_time)


def has_orientations(path: TargetPath) -> bool:
    """Whether a path, or one in a sequence, gives orientations.

    Args:
        path: The path.
    """
    return any(one.orientation(0.0) is not None for one in getattr(path, "paths", (path,)))


@dataclass(frozen=True)
class ToAndFro:
    """A setpoint, or a wanted stiffness, that moves smoothly from one value to another and back.

    Attributes:
        ends: First value, and that after half a period [unit of the setpoint].
        period: Time of a movement to and fro [s].
        parameters: Names of the parameters that give both, for errors.

    Raises:
        ParameterError: A value is not finite, or the period is not above zero.
    """

    ends: tuple[float, float]
    period: float
    parameters: tuple[str, str] = ("target_setpoints", "target_setpoint_period")

    def __post_init__(self) -> None:
        of_ends, of_period = self.parameters
        if len(self.ends) != 2 or not all(map(math.isfinite, self.ends)):
            raise ParameterError(of_ends, self.ends, "", "must be two finite numbers")
        if not math.isfinite(self.period) or self.period <= 0.0:
            raise ParameterError(of_period, self.period, "s", "must be finite and above zero")

    def value(self, time: float) -> float:
        """Setpoint at a time since it began [s].

        Args:
            time: Time since it began [s].
        """
        share = 0.5 - 0.5 * math.cos(2.0 * math.pi * time / self.period)
        return self.ends[0] + share * (self.ends[1] - self.ends[0])


def _blend(start: np.ndarray, end: np.ndarray, time: float, duration: float) -> np.ndarray:
    """From start to end without a jump in position, velocity or acceleration (quintic)."""
    if time >= duration:
        return end
    weight = _blended_share(time, duration)
    return (1.0 - weight) * start + weight * end


def _blended_share(time: float, duration: float) -> float:
    s = max(0.0, time / duration)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _blend_turns(start: np.ndarray | None, end: np.ndarray, time: float, duration: float) -> np.ndarray:
    """The same for orientations (x, y, z, w), along the shorter turn; jumps without a start."""
    if start is None or time >= duration:
        return end
    turns = Slerp([0.0, 1.0], Rotation.from_quat([start, end]))
    return turns(_blended_share(time, duration)).as_quat()


def make_path(name: str, effector: str, around: ClosedCurve) -> TargetPath:
    """Makes a path from its name.

    Args:
        name: ``circle``, ``lemniscate`` or a CSV file.
        effector: The effector whose columns are read from a file.
        around: Centre, radius, period and plane of a circle or lemniscate.

    Raises:
        ParameterError: The name is unknown.
    """
    kinds = {"circle": Circle, "lemniscate": Lemniscate}
    if name in kinds:
        return kinds[name](around.centre, around.radius, around.period, around.plane)
    if name.endswith(".csv"):
        return read_waypoints(Path(name), effector)
    raise ParameterError("target_path", name, "", f"must be one of {list(kinds)} or a file that ends in .csv")


def make_sequence(
    names: Sequence[str], effector: str, around: ClosedCurve, duration: float, ramp_time: float
) -> TargetPath:
    """Makes a sequence of paths from their names; a single one continues without end.

    Args:
        names: Names of the paths, or of their files.
        effector: Name of the effector that follows.
        around: The circle, whose place and size the others take.
        duration: How long each path lasts [s].
        ramp_time: How long the change from one to the next takes [s].

    Raises:
        ParameterError: A name is unknown, or the duration of a path is too short.
    """
    paths = tuple(make_path(name, effector, around) for name in names)
    return paths[0] if len(paths) == 1 else AlternatingPaths(paths, duration, ramp_time)
