"""The CSV file that an offline run writes: one row a target row.

Numbers are written with all digits that make the same binary number when read back, so two runs
can be compared bit by bit; only ``compute_ms`` differs from run to run.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Callable

from softrobot_twin.study.offline.offline_run import RunRow
from softrobot_twin.study.reports.output_error import OutputError


def run_header(effector_names: Sequence[str], actuator_names: Sequence[str]) -> list[str]:
    """Columns of a run file."""
    return ["step", "t",
            *(f"{name}.{axis}" for name in effector_names for axis in "xyz"),
            *(f"{name}.{quantity}" for name in actuator_names
              for quantity in ("length", "tension")),
            "residual", "compute_ms", "status"]


def run_cells(row: RunRow) -> list[str]:
    """One row as text: metres, newtons, seconds; compute time in milliseconds."""
    result = row.result
    numbers = [*result.effector_positions.ravel()]
    for length, tension in zip(result.lengths, result.tensions):
        numbers += [length, tension]
    numbers += [result.report.residual, 1e3 * result.report.compute_time]
    return [str(row.step), repr(row.time), *(repr(float(number)) for number in numbers),
            result.status.value]


@contextmanager
def run_file(path: Path | str, effector_names: Sequence[str],
             actuator_names: Sequence[str]) -> Iterator[Callable[[RunRow], None]]:
    """Opens a run file and gives a function that appends a row.

    Rows go out as they come, so a run that is broken off leaves what it had done.

    Raises:
        OutputError: The file cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(run_header(effector_names, actuator_names))
            yield lambda row: writer.writerow(run_cells(row))
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error
