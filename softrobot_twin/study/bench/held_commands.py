"""A scene driven along a commands file to its longest hold, and held there to be timed."""

from __future__ import annotations

import math
from pathlib import Path

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import Command
from softrobot_twin.study.offline.commands_file import read_commands
from softrobot_twin.study.offline.direct_run import run_commands

RATE = 250.0
"""Steps a second [Hz]."""
# What swings from the way there dies down in this share of the hold.
_SETTLING_SHARE = 0.25


class NoHoldError(SoftRobotTwinError):
    """A commands file never stands still."""

    def __init__(self, path: Path):
        self.path = path
        super().__init__(f"{path}: a benchmark times the longest hold, a time in which no command "
                         "changes; there is none")


class HeldCommands:
    """The longest hold of a commands file, gone on with for as many steps as are to be timed."""

    def __init__(self, simulation: Simulation, path: Path):
        """Runs the file into the hold; none of this is to be timed.

        Args:
            simulation: Warmed up.
            path: Commands file.

        Raises:
            NoHoldError: The file never stands still.
            TableFileError: The file cannot be used.
        """
        self._table = read_commands(path, simulation)
        begin, end = self._table.longest_hold
        if math.isnan(begin):
            raise NoHoldError(path)
        self._time = begin + _SETTLING_SHARE * (end - begin)
        for row in run_commands(simulation, self._table, RATE):
            if row.time >= self._time:
                break

    def next(self) -> Command:
        """What is commanded in the hold; guided bodies stay where they were sent."""
        return self._table.command(self._time, 1.0 / RATE)
