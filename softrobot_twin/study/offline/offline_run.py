"""A scene run row by row without ROS and without a clock."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.study.offline.targets_file import TargetTable


class RunRow(NamedTuple):
    """What one target row led to.

    Attributes:
        step: Steps recorded before this one; settling steps do not count.
        time: The row's time [s].
        result: What the simulation answered.
    """

    step: int
    time: float
    result: StepResult


def run(simulation: Simulation, table: TargetTable, settle: int = 0) -> Iterator[RunRow]:
    """Runs every row once, in order, from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first row's compute time is a step's and no more.
        table: Rows to run.
        settle: Times the first row is run before anything is recorded.

    Yields:
        One row for each row of the table.
    """
    for _ in range(settle):
        simulation.step(table.command(0))
    for index, time in enumerate(table.times):
        yield RunRow(index, float(time), simulation.step(table.command(index)))


def far_target_warning(simulation: Simulation, table: TargetTable) -> str | None:
    """Words of warning when targets lie so far off that a unit slip is likely, else None.

    A target ten body sizes away is no mistake of the simulation's, yet millimetres read as metres
    look just like it.
    """
    if table.kind != "targets":
        return None
    surface = simulation.surface_positions()
    size = float(np.linalg.norm(np.ptp(surface, axis=0)))
    offsets = table.values - simulation.effector_positions()
    farthest = float(np.nanmax(np.linalg.norm(offsets, axis=2)))
    if farthest <= 10.0 * size:
        return None
    return (f"a target lies {farthest:.3g} m away from its effector, the body is {size:.3g} m "
            "large: are the targets in metres?")
