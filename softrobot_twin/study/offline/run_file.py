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

import numpy as np

from softrobot_twin.simulation import StepResult
from softrobot_twin.study.offline.offline_run import RunRow
from softrobot_twin.study.reports.output_file import output_file


QUANTITIES = ("length", "tension", "shortening", "rest_length")
"""What a run tells of each actuator, in this order."""


def actuator_cells(result: StepResult, rest_setpoints: np.ndarray) -> list[float]:
    """`QUANTITIES` of each actuator; of a slide, length is its position and 0 that at rest.

    Args:
        result: What a step came to.
        rest_lengths: Lengths that shortening counts from [m], shape (actuator_count,).
    """
    quantities = (result.setpoints, result.efforts, result.displacements, rest_setpoints)
    return [value for actuator in zip(*quantities, strict=True) for value in actuator]


def run_header(effector_names: Sequence[str], actuator_names: Sequence[str]) -> list[str]:
    """Columns of a run file."""
    return ["step", "t",
            *(f"{name}.{axis}" for name in effector_names for axis in "xyz"),
            *(f"{name}.{quantity}" for name in actuator_names for quantity in QUANTITIES),
            "residual", "compute_ms", "status"]


def run_cells(row: RunRow, rest_setpoints: np.ndarray) -> list[str]:
    """One row as text: metres, newtons, seconds; compute time in milliseconds."""
    result = row.result
    numbers = [*result.effector_positions.ravel()]
    numbers += actuator_cells(result, rest_setpoints)
    numbers += [result.report.residual, 1e3 * result.report.compute_time]
    return [str(row.step), repr(row.time), *(repr(float(number)) for number in numbers),
            result.status.value]


@contextmanager
def run_file(path: Path | str, effector_names: Sequence[str],
             actuator_names: Sequence[str],
             rest_setpoints: np.ndarray) -> Iterator[Callable[[RunRow], None]]:
    """Opens a run file and gives a function that appends a row.

    The file takes the place of an older one when the run is through; see `output_file`.

    Raises:
        OutputError: The file cannot be written.
    """
    with output_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(run_header(effector_names, actuator_names))
        yield lambda row: writer.writerow(run_cells(row, rest_setpoints))
        file.close()
