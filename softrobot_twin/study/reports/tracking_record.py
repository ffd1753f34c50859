"""What was seen of a robot while it followed a path: points and cables, each with its time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError


class TimedValues(NamedTuple):
    """Samples of one quantity in the order of their times.

    Attributes:
        times: Time of each sample [s], shape (sample_count,), growing.
        values: The samples, shape (sample_count, width).
    """

    times: np.ndarray
    values: np.ndarray

    def at(self, times: np.ndarray) -> np.ndarray:
        """Values at other times, straight between samples; NaN outside, shape (n, width)."""
        if not len(self.times):
            return np.full((len(times), self.values.shape[1]), np.nan)
        return np.column_stack([
            np.interp(times, self.times, column, left=np.nan, right=np.nan)
            for column in self.values.T])


@dataclass(frozen=True)
class TrackingRecord:
    """One run along a path.

    Attributes:
        target: Where the effector should be [m], width 3, without any correction.
        twin: Where the twin believes it is [m], width 3.
        device: Where it really is [m], width 3.
        cable_names: Cables, in the order of the columns below.
        lengths: Commanded cable lengths [m], width cable_count.
        tensions: Cable tensions of the twin [N], width cable_count.
    """

    target: TimedValues
    twin: TimedValues
    device: TimedValues
    cable_names: tuple[str, ...]
    lengths: TimedValues
    tensions: TimedValues


class RecordError(SoftRobotTwinError):
    """A run was recorded too poorly to say anything of it.

    Attributes:
        name: Run or quantity that is lacking.
        reason: What is lacking.
    """

    def __init__(self, name: str, reason: str):
        self.name = name
        self.reason = reason
        super().__init__(f"{name}: {reason}")


def distances(target: TimedValues, measured: TimedValues) -> TimedValues:
    """Distance of what was measured from where it should be at that very moment [m], width 1.

    Moments without a target are left out, so a robot that comes late is as far off as it is.
    """
    apart = np.linalg.norm(measured.values - target.at(measured.times), axis=1)
    known = np.isfinite(apart)
    return TimedValues(measured.times[known], apart[known, None])


def save_records(path: Path, records: dict[str, TrackingRecord]) -> None:
    """Writes all samples into one compressed numpy file, fields named ``<run>.<quantity>``."""
    fields: dict[str, np.ndarray] = {}
    for run, record in records.items():
        fields[f"{run}.cable_names"] = np.array(record.cable_names)
        for quantity in ("target", "twin", "device", "lengths", "tensions"):
            samples = getattr(record, quantity)
            fields[f"{run}.{quantity}.times"] = samples.times
            fields[f"{run}.{quantity}.values"] = samples.values
    np.savez_compressed(path, **fields)
