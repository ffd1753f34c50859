"""A stretch of a targets file, gone to and fro, to be timed where the robot leans."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import FollowTargets, Hold, Simulation
from softrobot_twin.simulation.command import Command
from softrobot_twin.study.offline.targets_file import read_targets

TIME_STEP = 0.02
"""Time between two targets [s]."""
_SETTLING_STEPS = 40


class Stretch(NamedTuple):
    """A part of a targets file.

    Attributes:
        path: The file.
        begin: Where the stretch begins [s].
        end: Where it ends [s].
    """

    path: Path
    begin: float
    end: float


class TargetStretch:
    """The stretch, for as many steps as are to be timed."""

    def __init__(self, simulation: Simulation, stretch: Stretch):
        """Follow the file to where the stretch begins; none of this is to be timed.

        Args:
            simulation: Warmed up.
            stretch: The stretch.

        Raises:
            TableFileError: The file cannot be used.
        """
        table = read_targets(
            stretch.path, simulation.effector_names, simulation.actuator_names)
        self._times, self._values = table.times, table.values
        self._stretch, self._time, self._way = stretch, stretch.begin, TIME_STEP
        for _ in range(_SETTLING_STEPS):
            simulation.step(Hold(TIME_STEP))
        for time in np.arange(table.times[0], stretch.begin, TIME_STEP):
            simulation.step(self._at(time))

    def next(self) -> Command:
        """The next target; at either end the way turns."""
        self._time += self._way
        if not self._stretch.begin <= self._time <= self._stretch.end:
            self._way = -self._way
            self._time += 2.0 * self._way
        return self._at(self._time)

    def _at(self, time: float) -> FollowTargets:
        """The target between two rows."""
        row = int(np.clip(np.searchsorted(self._times, time) - 1, 0, len(self._times) - 2))
        share = (time - self._times[row]) / (self._times[row + 1] - self._times[row])
        values = self._values[row] + share * (self._values[row + 1] - self._values[row])
        return FollowTargets(values, TIME_STEP)
