"""Ticks of a run as rows of a CSV file, with the columns that all runs have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop
from softrobot_twin.simulation import FollowTargets
from softrobot_twin.tables.channels import measured
from softrobot_twin.tables.run_columns import RunColumns


class TickTable:
    """The columns of a run's ticks, and their cells.

    Errors are those of the loop: the distance of the effector, measured or else predicted, from the
    target that was given, also while the step is sent to a point on the way there.

    Attributes:
        header: Names of the columns.
    """

    def __init__(self, loop: TwinLoop):
        """Collects the columns.

        Args:
            loop: The loop.
        """
        self._loop = loop
        simulation = loop.simulation
        self._follows = loop.mode is Mode.INVERSE and bool(simulation.effector_names)
        followed = None
        if self._follows:
            # Any effector may get a target while the twin runs.
            places = np.zeros((len(simulation.effector_names), 3))
            turns = np.where(np.array(simulation.oriented_effectors)[:, None], np.zeros(4), np.nan)
            followed = FollowTargets(places, loop.settings.period, None, turns)
        columns_of_measured = [
            own for one in measured() for name in one.names(simulation)
            for own in one.columns(f"{name}_measured")
        ]  # fmt: skip
        self._columns = RunColumns(simulation, followed, columns_of_measured, False)
        self.header = self._columns.names

    def texts(self, outcome: TickOutcome, step: int, seconds: float) -> list[str]:
        """The cells of a tick, just after it; numbers are given to the last bit.

        Args:
            outcome: What the tick gave.
            step: Ticks before it.
            seconds: Time since the first tick [s].
        """
        result, command = outcome.result, None
        if self._follows:
            reading, period = outcome.reading, self._loop.settings.period
            command = FollowTargets(reading.targets, period, None, reading.orientations)
            result = replace(result, effector_errors=outcome.tracking_errors,
                             orientation_errors=outcome.orientation_errors)  # fmt: skip
        numbers = tuple(number for values in outcome.measured.values() for number in values.flat)
        return self._columns.texts(self._columns.row(step, seconds, result, command, numbers))
