"""Paths for an effector: circle, lemniscate, points from a file, one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from softrobot_twin.control.waypoints import read_waypoints
from softrobot_twin.errors import ParameterError

_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


class TargetPath(Protocol):
    """A place for every time."""

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s]."""


@dataclass(frozen=True)
class Round:
    """What a circle and a lemniscate have in common.

    Attributes:
        centre: Centre [m].
        radius: Radius of the circle, half the width of the lemniscate [m].
        period: Time of one round [s].
        plane: ``xy``, ``xz`` or ``yz``.

    Raises:
        ParameterError: A value is not finite, not above zero, or not a plane.
    """

    centre: tuple[float, float, float]
    radius: float
    period: float
    plane: str = "xy"

    def __post_init__(self) -> None:
        if len(self.centre) != 3 or not all(map(math.isfinite, self.centre)):
            raise ParameterError("target_center", self.centre, "m", "must be three finite numbers")
        for name, unit in (("radius", "m"), ("period", "s")):
            value = getattr(self, name)
            if not math.isfinite(value) or value <= 0.0:
                raise ParameterError(f"target_{name}", value, unit, "must be finite and above zero")
        if self.plane not in _PLANES:
            raise ParameterError("target_plane", self.plane, "", f"must be one of {list(_PLANES)}")

    def _placed(self, first: float, second: float) -> np.ndarray:
        position = np.array(self.centre, dtype=float)
        axes = _PLANES[self.plane]
        position[axes[0]] += self.radius * first
        position[axes[1]] += self.radius * second
        return position


class Circle(Round):
    """Once around in a period, from the first axis towards the second."""

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s]."""
        angle = 2.0 * math.pi * time / self.period
        return self._placed(math.cos(angle), math.sin(angle))


class Lemniscate(Round):
    """Gerono's figure of eight, along the first axis, from its far end."""

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s]."""
        angle = 2.0 * math.pi * time / self.period
        return self._placed(math.cos(angle), math.sin(angle) * math.cos(angle))


@dataclass(frozen=True)
class Turns:
    """Paths that take turns, for ever. Each begins at its own beginning.

    Attributes:
        paths: The paths.
        turn: Time that each runs [s].
        ramp_time: Time to come from where one ends onto the next [s], part of the turn.
    """

    paths: tuple[TargetPath, ...]
    turn: float
    ramp_time: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.turn) or self.turn <= self.ramp_time:
            raise ParameterError(
                "target_sequence_time", self.turn, "s",
                f"must be finite and longer than target_ramp_time = {self.ramp_time} s",
            )

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s]."""
        number = int(time // self.turn)
        since = time - number * self.turn
        path = self.paths[number % len(self.paths)]
        if number == 0:
            return path.position(since)
        before = self.paths[(number - 1) % len(self.paths)]
        # The last path runs on below the ramp, so that speed has no step either.
        left = before.position(since + self.turn)
        return _blend(left, path.position(since), since, self.ramp_time)


@dataclass(frozen=True)
class RampedIn:
    """A path that is joined softly from a place beside it.

    Attributes:
        start: Where the effector is before [m], shape (3,).
        path: The path to join.
        ramp_time: Time to come onto it [s]; 0 jumps.
    """

    start: np.ndarray
    path: TargetPath
    ramp_time: float

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s]."""
        return _blend(self.start, self.path.position(time), time, self.ramp_time)


def _blend(start: np.ndarray, end: np.ndarray, time: float, duration: float) -> np.ndarray:
    """From start to end with no step in position, speed or acceleration (quintic)."""
    if time >= duration:
        return end
    s = max(0.0, time / duration)
    weight = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return (1.0 - weight) * start + weight * end


def make_path(name: str, effector: str, around: Round) -> TargetPath:
    """A path by its name.

    Args:
        name: ``circle``, ``lemniscate`` or a CSV file.
        effector: Effector whose columns are read from a file.
        around: Centre, radius, period and plane of a circle or lemniscate.

    Raises:
        ParameterError: There is no such path.
    """
    kinds = {"circle": Circle, "lemniscate": Lemniscate}
    if name in kinds:
        return kinds[name](around.centre, around.radius, around.period, around.plane)
    if name.endswith(".csv"):
        return read_waypoints(Path(name), effector)
    raise ParameterError(
        "target_path", name, "", f"must be one of {list(kinds)} or a file that ends in .csv"
    )


def make_sequence(
    names: Sequence[str], effector: str, around: Round, turn: float, ramp_time: float
) -> TargetPath:
    """Paths by their names, taking turns; a single one runs for ever.

    Raises:
        ParameterError: There is no such path, or a turn is too short.
    """
    paths = tuple(make_path(name, effector, around) for name in names)
    return paths[0] if len(paths) == 1 else Turns(paths, turn, ramp_time)
