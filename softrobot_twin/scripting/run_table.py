"""Tables of runs in memory, with the columns of the files that the command line writes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.study.direct_run import DirectRow, direct_cells, direct_header, direct_row
from softrobot_twin.study.offline_run import actuator_columns
from softrobot_twin.study.passive_run import BodyReadouts

# Columns that are no floating-point numbers, and their types in a structured array.
_OTHERS = {"step": "i8", "contact_count": "i8", "status": "U16"}

Table: TypeAlias = Any
"""A pandas.DataFrame where pandas is installed, else a structured numpy array."""


class RunColumns:
    """The columns of a run of one simulation, and their values in its steps.

    Attributes:
        header: All columns, as in a run file.
        numbers: Those that hold numbers.
        driven: Those of the efforts of the actuators.
    """

    def __init__(self, simulation: Simulation, with_bodies: bool = False):
        """Collect the columns.

        Args:
            simulation: The simulation, at any state.
            with_bodies: Whether bodies, markers and energies have columns, as in a run without
                commands.
        """
        self._simulation = simulation
        self._readouts = BodyReadouts(simulation) if with_bodies else None
        observed = () if self._readouts is None else self._readouts.columns
        self.header = tuple(direct_header(simulation, observed))
        self.numbers = tuple(name for name in self.header if name not in ("step", "status"))
        efforts = {(name, kind.effort) for name, kind in simulation.actuators.kind_of.items()}
        self.driven = tuple(
            "_".join((name, *quantity))
            for name, *quantity in actuator_columns(simulation.actuators)
            if (name, tuple(quantity)) in efforts
        )  # fmt: skip

    def row(self, step: int, time: float, result: StepResult) -> list[str]:
        """One row of a run file.

        Args:
            step: Steps before this one.
            time: At its end [s].
            result: Its result; the simulation stands where it ended.
        """
        row: DirectRow = direct_row(self._simulation, step, time, result)
        if self._readouts is not None:
            row = row._replace(observed=self._readouts.read())
        return direct_cells(row, self._simulation.actuators)

    def cells(self, result: StepResult) -> tuple[float, ...]:
        """Values of `numbers` in one step."""
        row = self.row(0, result.state.time, result)
        return tuple(float(cell) for name, cell in zip(self.header, row, strict=True)
                     if name not in ("step", "status"))

    def table(self, rows: Sequence[Sequence[str]]) -> Table:
        """A table of rows: a `pandas.DataFrame` where pandas is installed, else a structured array.

        Args:
            rows: See `row`.
        """
        types = np.dtype([(name, _OTHERS.get(name, "f8")) for name in self.header])
        array = np.array([tuple(row) for row in rows], types)
        try:
            import pandas
        except ImportError:
            return array
        return pandas.DataFrame({name: array[name] for name in self.header})
