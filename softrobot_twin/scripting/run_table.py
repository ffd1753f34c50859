"""Tables of runs in memory, with the columns of the files that the command line writes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np

from softrobot_twin.simulation.command import Command, FollowTargets
from softrobot_twin.tables.channels import WANTED
from softrobot_twin.tables.run_columns import (
    TEXT_COLUMNS,
    WHOLE_NUMBERS,
    RunColumns,
    RunRow,
)

Table: TypeAlias = Any
"""A `pandas.DataFrame` where pandas is installed, else a structured numpy array."""


def run_table(columns: RunColumns, rows: Iterable[RunRow]) -> Table:
    """A table of a run.

    Args:
        columns: Its columns.
        rows: Its rows.

    Returns:
        A `pandas.DataFrame` where pandas is installed, else a structured numpy array, with a column
        for each name of `columns`.
    """
    cells = [columns.cells(row) for row in rows]
    by_name = {
        name: np.array([row[place] for row in cells], str if name in TEXT_COLUMNS
                       else np.int64 if name in WHOLE_NUMBERS else np.float64)
        for place, name in enumerate(columns.names)
    }
    try:
        import pandas
    except ImportError:
        pass
    else:
        return pandas.DataFrame(by_name)
    table = np.empty(len(cells), [(name, array.dtype) for name, array in by_name.items()])
    for name, array in by_name.items():
        table[name] = array
    return table


def common_targets(commands: Sequence[Command]) -> Command | None:
    """The first of some commands where all of them follow targets of the same effectors, else None.

    Args:
        commands: The commands of a run.
    """
    named = {_named(one) for one in commands}
    return commands[0] if len(named) == 1 and named != {()} else None


def _named(command: Command) -> tuple[bytes, ...]:
    """What targets give of the effectors, in a form that can be compared; of other commands nothing."""
    if not isinstance(command, FollowTargets):
        return ()
    arrays = (*(getattr(command, channel.target) for channel in WANTED), command.sensors)
    return tuple(b"" if array is None else np.isfinite(array).tobytes() for array in arrays)


class ColumnsOfSteps:
    """The columns of single steps, by what their commands give; made when they are needed."""

    def __init__(self, simulation: Any):
        """Keep the simulation.

        Args:
            simulation: The simulation.
        """
        self._simulation = simulation
        self._known: dict[tuple[bytes, ...], RunColumns] = {}

    def of(self, command: Command) -> RunColumns:
        """The columns of a step by a command.

        Args:
            command: The command of the step.
        """
        key = _named(command)
        if key not in self._known:
            self._known[key] = RunColumns(
                self._simulation, command if key else None, with_reduction_errors=False
            )
        return self._known[key]
