"""Writes the samples of a demo with the columns of all runs, one file for each of its runs.

Such a file has a row for each command of the twin. Times count from its first row; what is
published at other times is interpolated.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from softrobot_twin.harness.output_file import csv_output
from softrobot_twin.simulation.building.actuator_kinds import ActuatorKind, column
from softrobot_twin.simulation.command import SETPOINTS, TARGETS
from softrobot_twin.study.tracking import TrackingRecord
from softrobot_twin.tables.column_names import DRIVEN_BY, STEP, TIME, position_columns, target_name


def demo_columns(
    record: TrackingRecord, effector: str, kind_of: Mapping[str, ActuatorKind]
) -> dict[str, np.ndarray]:
    """The samples of a run by the names of columns, each of shape (row_count,).

    Rows before the first or after the last sample of a quantity are left out.

    Args:
        record: The run.
        effector: The effector that is driven or compared.
        kind_of: Kind of each actuator by its name.
    """
    times = record.setpoints.times
    parts = [(position_columns(effector), record.twin.at(times))]
    if record.target is not None:
        parts.append((position_columns(target_name(effector)), record.target.at(times)))
    device = record.device.at(times)
    parts.append((position_columns(f"{effector}_device"), device))
    off = np.linalg.norm(device - record.reference.at(times), axis=1)
    parts.append(((f"{effector}_error_m",), off[:, None]))
    setpoints, efforts = record.setpoints.values, record.efforts.at(times)
    for index, name in enumerate(record.actuator_names):
        kind = kind_of[name]
        parts.append(((column(name, kind.setpoint),), setpoints[:, [index]]))
        if not kind.is_effort_driven:
            parts.append(((column(name, kind.effort),), efforts[:, [index]]))
    values = np.hstack([part for _, part in parts])
    known = np.isfinite(values).all(axis=1)
    begin = times[known][0] if known.any() else 0.0
    names = [name for own, _ in parts for name in own]
    return {STEP: np.arange(known.sum()), TIME: times[known] - begin,
            **dict(zip(names, values[known].T, strict=True))}


def write_demo_table(
    path: Path, record: TrackingRecord, effector: str, kind_of: Mapping[str, ActuatorKind]
) -> None:
    """Writes the samples of a run; `simulate --targets` follows its targets, `plot` draws it.

    Args:
        path: File to write.
        record: The run.
        effector: The effector that is driven or compared.
        kind_of: Kind of each actuator by its name.

    Raises:
        OutputError: The file cannot be written.
    """
    columns = demo_columns(record, effector, kind_of)
    driver = SETPOINTS if record.target is None else TARGETS
    with csv_output(path, [*columns, DRIVEN_BY]) as write:
        for row in zip(*(values.tolist() for values in columns.values()), strict=True):
            write([*map(repr, row), driver])
