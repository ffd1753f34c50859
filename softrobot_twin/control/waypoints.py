"""A path from a CSV file: points with times."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrobot_twin.errors import ParameterError


@dataclass(frozen=True)
class Waypoints:
    """Points with times, joined by straight lines; the last one is kept.

    Attributes:
        times: Increasing times [s], shape (n,).
        points: Positions [m], shape (n, 3).
    """

    times: np.ndarray
    points: np.ndarray

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s]."""
        return np.array([np.interp(time, self.times, column) for column in self.points.T])


def read_waypoints(file: Path, effector: str) -> Waypoints:
    """Reads the columns ``t,<effector>.x,<effector>.y,<effector>.z`` [s, m] of a CSV file.

    Raises:
        ParameterError: The file cannot be read, lacks a column, or holds what is no path.
    """
    columns = ["t", *(f"{effector}.{axis}" for axis in "xyz")]
    try:
        with open(file, newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream, skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ParameterError("target_path", str(file), "", f"cannot be read: {error}") from None
    missing = [column for column in columns if rows and column not in rows[0]]
    if missing or not rows:
        what = f"lacks the columns {missing}" if missing else "has no rows"
        raise ParameterError("target_path", str(file), "", what)
    try:
        table = np.array([[float(row[column]) for column in columns] for row in rows])
    except (TypeError, ValueError) as error:
        raise ParameterError("target_path", str(file), "", f"is not numbers: {error}") from None
    if not np.isfinite(table).all():
        raise ParameterError("target_path", str(file), "", "holds a value that is not finite")
    if (np.diff(table[:, 0]) <= 0.0).any():
        raise ParameterError("target_path", str(file), "s", "t must increase from row to row")
    return Waypoints(table[:, 0], table[:, 1:])
