"""The CSV file that a direct run writes: one row a step, each column with its unit.

Numbers are written with all digits that make the same binary number when read back, so two runs
can be compared bit by bit; only ``compute_ms`` differs from run to run.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.offline.direct_run import DirectRow, pair_names
from softrobot_twin.study.offline.run_file import actuator_cells
from softrobot_twin.study.reports.output_file import output_file

# As `run_file.QUANTITIES`, each with its unit.
_QUANTITIES = ("length_m", "tension_N", "shortening_m", "rest_length_m")
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def direct_header(simulation: Simulation, observed: Sequence[str] = ()) -> list[str]:
    """Columns of a run's file.

    Args:
        simulation: The scene.
        observed: Columns of what an onlooker sees.
    """
    return [
        "step", "time_s",
        *(f"{name}_{quantity}" for name in simulation.actuator_names
          for quantity in _QUANTITIES),
        *(f"{name}_{axis}_m" for name in simulation.effector_names for axis in "xyz"),
        *(f"{part.name}_{value}" for part in simulation.model.rigid for value in _POSE),
        *observed,
        "contact_count",
        *(f"{quantity}_N" for first, second in pair_names(simulation)
          for quantity in (*(f"force_on_{first}_by_{second}_{axis}" for axis in "xyz"),
                           f"sum_of_magnitudes_{first}_{second}")),
        "residual_N", "contact_residual_m", "compute_ms", "status"]


def direct_cells(row: DirectRow, rest_setpoints: np.ndarray) -> list[str]:
    """One row as text."""
    result, report = row.result, row.result.report
    actuators = actuator_cells(result, rest_setpoints)
    before = [*actuators, *result.effector_positions.ravel(), *row.rigid_poses.ravel(),
              *row.observed]
    forces = np.column_stack([row.pair_resultants, row.pair_magnitude_sums])
    after = [*forces.ravel(), report.residual, report.contact_residual,
             1e3 * report.compute_time]
    return [str(row.step), repr(row.time), *(repr(float(number)) for number in before),
            str(report.contact_count), *(repr(float(number)) for number in after),
            result.status.value]


@contextmanager
def direct_run_file(path: Path, simulation: Simulation,
                    observed: Sequence[str] = ()) -> Iterator[Callable[[DirectRow], None]]:
    """Opens a run's file and gives a function that appends a row.

    The file takes the place of an older one when the run is through; see `output_file`.

    Raises:
        OutputError: The file cannot be written.
    """
    with output_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(direct_header(simulation, observed))
        rest_setpoints = simulation.rest_setpoints
        yield lambda row: writer.writerow(direct_cells(row, rest_setpoints))
        file.close()
