"""A scene run row by row from a targets file, without ROS and without a clock."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.simulation.actuators import Actuators
from softrobot_twin.study.explain import tell_mesh_error
from softrobot_twin.study.input_tables import TargetTable, read_targets
from softrobot_twin.study.output_file import output_file
from softrobot_twin.study.scene_picture import check_picture, draw_snapshots, take
from softrobot_twin.study.terminal import console, progress, table, warn


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


def actuator_columns(actuators: Actuators) -> list[tuple[str, str, str]]:
    """Name, quantity and unit of each column about actuators, in the order of `actuator_cells`.

    Of a cable: its length [m], its tension [N], its shortening [m] and its length at rest [m].

    Args:
        actuators: The actuators of the scene.
    """
    return [
        (name, f"{prefix}{quantity.word}", quantity.unit)
        for name, kind in actuators.kind_of.items()
        for prefix, quantity in (("", kind.setpoint), ("", kind.effort), ("", kind.displacement),
                                 ("rest_", kind.setpoint))
    ]


def actuator_cells(result: StepResult, rest_setpoints: np.ndarray) -> list[float]:
    """Setpoint, effort, displacement and setpoint at rest of each actuator.

    Args:
        result: What a step came to.
        rest_setpoints: Setpoints at rest, shape (actuator_count,).
    """
    quantities = (result.setpoints, result.efforts, result.displacements, rest_setpoints)
    return [value for actuator in zip(*quantities, strict=True) for value in actuator]


def run_header(effector_names: Sequence[str], actuators: Actuators) -> list[str]:
    """Columns of a run file."""
    return ["step", "t",
            *(f"{name}.{axis}" for name in effector_names for axis in "xyz"),
            *(f"{name}.{quantity}" for name, quantity, _ in actuator_columns(actuators)),
            "residual", "compute_ms", "status"]


def run_cells(row: RunRow, rest_setpoints: np.ndarray) -> list[str]:
    """One row as text: SI units; compute time in milliseconds."""
    result = row.result
    numbers = [*result.effector_positions.ravel()]
    numbers += actuator_cells(result, rest_setpoints)
    numbers += [result.report.residual, 1e3 * result.report.compute_time]
    return [str(row.step), repr(row.time), *(repr(float(number)) for number in numbers),
            result.status.value]


@contextmanager
def run_file(path: Path | str, effector_names: Sequence[str],
             actuators: Actuators) -> Iterator[Callable[[RunRow], None]]:
    """Opens a run file and gives a function that appends a row.

    The file takes the place of an older one when the run is through; see `output_file`.

    Raises:
        OutputError: The file cannot be written.
    """
    with output_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(run_header(effector_names, actuators))
        yield lambda row: writer.writerow(run_cells(row, actuators.rest_setpoints))
        file.close()


class Spread(NamedTuple):
    """Middle and tail of a set of numbers, in their unit."""

    median: float
    p99: float
    maximum: float


def spread(values: np.ndarray) -> Spread:
    """Median, 99th percentile and maximum over the finite values; NaN when there is none."""
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    if not finite.size:
        return Spread(np.nan, np.nan, np.nan)
    return Spread(float(np.median(finite)), float(np.percentile(finite, 99.0)),
                  float(finite.max()))


class RunSummary:
    """Gathers rows as they come; keeps two numbers a row and no state."""

    def __init__(self) -> None:
        self._errors: list[np.ndarray] = []
        self._compute_times: list[float] = []
        self.statuses: Counter[str] = Counter()
        self._residual = 0.0

    def add(self, row: RunRow) -> None:
        """Counts one row."""
        self._errors.append(row.result.effector_errors)
        self._compute_times.append(row.result.report.compute_time)
        self.statuses[row.result.status.value] += 1
        self._residual = float(np.fmax(self._residual, row.result.report.residual))

    def lines(self) -> list[tuple[str, str]]:
        """What was found, as name and value with its unit."""
        compute = spread(1e3 * np.array(self._compute_times))
        lines = [("rows", str(len(self._errors)))]
        errors = 1e3 * np.concatenate(self._errors) if self._errors else np.empty(0)
        errors = errors[np.isfinite(errors)]
        if errors.size:
            lines += [("tracking error, mean", f"{errors.mean():.4f} mm"),
                      ("tracking error, max", f"{errors.max():.4f} mm")]
        lines += [("residual, max", f"{self._residual:.2g} N"),
                  ("compute time, median", f"{compute.median:.2f} ms"),
                  ("compute time, p99", f"{compute.p99:.2f} ms"),
                  ("compute time, max", f"{compute.maximum:.2f} ms")]
        lines += [(f"status {name}", f"{count} rows")
                  for name, count in sorted(self.statuses.items())]
        return lines


def simulate(scene: Path, targets: Path, output: Path, settle: int = 0,
             picture: Path | None = None) -> int:
    """Runs a scene over a targets file and writes what came of it.

    Args:
        scene: Scene file.
        targets: Targets file, see `targets_file`.
        output: Run file to write, see `run_file`.
        settle: Times the first row is run before anything is recorded.
        picture: Picture of the last state to write, or None.

    Returns:
        Exit code: 0, or 1 when a row found no solution.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the targets or an output cannot be used.
    """
    simulation = Simulation.from_scene_file(scene)
    for note in simulation.notes:
        warn(note)
    rows = read_targets(targets, simulation.effector_names, simulation.actuators.kind_of)
    if far := far_target_warning(simulation, rows):
        warn(far)
    if picture is not None:
        check_picture(picture)
    simulation.warm_up()
    summary, failed = _run_and_write(simulation, rows, output, settle, picture)
    _print_summary(simulation.scene.name, summary, output, picture)
    tell_mesh_error(simulation.scene)
    if failed:
        warn(f"{failed} of {len(rows.times)} rows found no solution; the last safe lengths stand "
             f"in their place, see column status of {output}")
    return 1 if failed else 0


def _run_and_write(simulation: Simulation, rows: TargetTable, output: Path, settle: int,
                   picture: Path | None) -> tuple[RunSummary, int]:
    """Summary, and failed rows; what is written is put in place when all of it is done."""
    summary = RunSummary()
    trail = np.empty((len(rows.times), len(simulation.effector_names), 3))
    failed = 0
    names, actuators = simulation.effector_names, simulation.actuators
    with run_file(output, names, actuators) as write:
        with progress() as bar:
            task = bar.add_task(simulation.scene.name, total=len(rows.times), note="")
            for row in run(simulation, rows, settle):
                write(row)
                summary.add(row)
                trail[row.step] = row.result.effector_positions
                failed += row.result.status.is_failure
                bar.update(task, advance=1, note=row.result.status.value)
        if picture is not None:
            _draw(simulation, rows, trail, picture)
    return summary, failed


def _draw(simulation: Simulation, rows: TargetTable, trail: np.ndarray, picture: Path) -> None:
    """The last state, with the effectors' way of shape (row_count, effector_count, 3) [m]."""
    name = simulation.scene.name
    goal = rows.values[-1] if rows.kind == "targets" else None
    draw_snapshots([take(simulation, None, name, goal, trail)], picture, name)


def _print_summary(name: str, summary: RunSummary, output: Path, picture: Path | None) -> None:
    made = table(f"{name}, offline", "what", "value")
    for line in summary.lines():
        made.add_row(*line)
    made.add_row("run", str(output))
    if picture is not None:
        made.add_row("picture", str(picture))
    console().print(made)
