"""``simulate --targets``: runs a scene row by row from a targets file, without ROS.

The file contains, in this order: the run, the run file, the summary and the command.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, NamedTuple

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.simulation.actuator_kinds import ActuatorKind, Quantity
from softrobot_twin.simulation.actuators import Actuators
from softrobot_twin.simulation.pulleys import ANGLE, TORQUE
from softrobot_twin.study.explain import print_mesh_error, print_reduction_errors
from softrobot_twin.simulation.input_tables import TargetTable, read_targets
from softrobot_twin.study.output_file import output_file
from softrobot_twin.study.scene_picture import check_picture, draw_snapshots, take_snapshot
from softrobot_twin.study.terminal import console, progress, table, warn


class RunRow(NamedTuple):
    """Result of one row of a targets file.

    Attributes:
        step: Steps recorded before this one; settling steps do not count.
        time: The row's time [s].
        result: The simulation's result.
    """

    step: int
    time: float
    result: StepResult


def run(simulation: Simulation, table: TargetTable, settle: int = 0) -> Iterator[RunRow]:
    """Runs every row once, in order, from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first compute time contains no compilation.
        table: Rows to run.
        settle: Number of times the first row is run before the recording.

    Yields:
        One row for each row of the table.
    """
    for _ in range(settle):
        simulation.step(table.command(0))
    for index, time in enumerate(table.times):
        yield RunRow(index, float(time), simulation.step(table.command(index)))


def far_target_warning(simulation: Simulation, table: TargetTable) -> str | None:
    """A warning when targets are so far away that their unit is probably wrong, else None.

    A target ten body sizes away is possible, but such targets are more often in millimetres.
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

    Of a cable: its length [m], its tension [N], its shortening [m] and its length at rest [m]. Of a
    cavity whose pressure is commanded: its pressure [Pa], its growth [m³] and its volume [m³]. Of a
    motor of a hinge: its angle [rad] and its torque [N m]. Last, of each pulley, its angle [rad] and
    its torque [N m].

    Args:
        actuators: The actuators of the scene.
    """
    return [
        (name, f"{prefix}{quantity.word}", quantity.unit)
        for name, kind in actuators.kind_of.items()
        for prefix, quantity in _quantities(kind)
    ] + [
        (name, *quantity) for name in actuators.pulleys.names for quantity in (ANGLE, TORQUE)
    ]


def _quantities(kind: ActuatorKind) -> tuple[tuple[str, Quantity], ...]:
    """Quantities of an actuator in a file, each with the prefix of its column."""
    if kind.is_effort_driven:  # The setpoint is the effort, and 0 at rest.
        return ("", kind.setpoint), ("", kind.displacement), ("", kind.extent)
    if kind.displacement == kind.setpoint:  # It is 0 at rest.
        return ("", kind.setpoint), ("", kind.effort)
    return ("", kind.setpoint), ("", kind.effort), ("", kind.displacement), ("rest_", kind.setpoint)


def actuator_cells(result: StepResult, actuators: Actuators) -> list[float]:
    """Values of the columns about actuators; see `actuator_columns`.

    Args:
        result: Result of a step.
        actuators: The actuators of the scene.
    """
    extents = actuators.extents(result.displacements)
    cells = []
    for index, kind in enumerate(actuators.kinds):
        setpoint, displacement = result.setpoints[index], result.displacements[index]
        if kind.displacement == kind.setpoint:
            cells += [setpoint, result.efforts[index]]
        elif kind.is_effort_driven:
            cells += [setpoint, displacement, extents[index]]
        else:
            cells += [setpoint, result.efforts[index], displacement,
                      actuators.rest_setpoints[index]]
    pulleys = actuators.pulleys
    for pair in zip(pulleys.angles(result.setpoints), pulleys.torques(result.efforts), strict=True):
        cells += pair
    return cells


def run_header(effector_names: Sequence[str], actuators: Actuators,
               oriented: Sequence[bool] = (), stiff: Sequence[bool] = ()) -> list[str]:
    """Columns of a run file; of effectors with orientation also their turns from rest, of those with
    stiffness also it [N/m].
    """
    turned = [name for name, asks in zip(effector_names, oriented) if asks]
    stiffened = [name for name, asks in zip(effector_names, stiff) if asks]
    return ["step", "t",
            *(f"{name}.{axis}" for name in effector_names for axis in "xyz"),
            *(f"{name}.{part}" for name in turned for part in ("qx", "qy", "qz", "qw")),
            *(f"{name}.{part}" for name in stiffened for part in ("kx", "ky", "kz")),
            *(f"{name}.{quantity}" for name, quantity, _ in actuator_columns(actuators)),
            "residual", "compute_ms", "status"]


def run_cells(row: RunRow, actuators: Actuators, stiff: Sequence[bool] = ()) -> list[str]:
    """One row as text: SI units; compute time in milliseconds."""
    result = row.result
    numbers = [*result.effector_positions.ravel()]
    turns = result.effector_orientations
    if turns is not None:
        numbers += [*turns[np.isfinite(turns).all(axis=1)].ravel()]
    if any(stiff):
        own = result.effector_stiffness
        numbers += [*np.full((sum(stiff), 3), np.nan).ravel()] if own is None else [
            *own[np.array(stiff)].ravel()]
    numbers += actuator_cells(result, actuators)
    numbers += [result.report.residual, 1e3 * result.report.compute_time]
    return [str(row.step), repr(row.time), *(repr(float(number)) for number in numbers),
            result.status.value]


@contextmanager
def run_file(path: Path | str, effector_names: Sequence[str],
             actuators: Actuators, oriented: Sequence[bool] = (),
             stiff: Sequence[bool] = ()) -> Iterator[Callable[[RunRow], None]]:
    """Opens a run file and returns a function that appends a row.

    An older file is replaced when the run has ended; see `output_file`.

    Raises:
        OutputError: The file cannot be written.
    """
    with output_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(run_header(effector_names, actuators, oriented, stiff))
        yield lambda row: writer.writerow(run_cells(row, actuators, stiff))
        file.close()


class Spread(NamedTuple):
    """Median, 99th percentile and maximum of a set of numbers, in their unit."""

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
    """Collects a few numbers of each row for a summary."""

    def __init__(self) -> None:
        self._errors: list[np.ndarray] = []
        self._angles: list[np.ndarray] = []
        self._stiffness: list[np.ndarray] = []
        self._compute_times: list[float] = []
        self.statuses: Counter[str] = Counter()
        self._residual = self.sampled_range = 0.0

    def add(self, row: RunRow) -> None:
        """Adds one row."""
        self._errors.append(row.result.effector_errors)
        if row.result.orientation_errors is not None:
            self._angles.append(row.result.orientation_errors)
        if row.result.stiffness_errors is not None:
            self._stiffness.append(row.result.stiffness_errors)
        self._compute_times.append(row.result.report.compute_time)
        self.statuses[row.result.status.value] += 1
        self._residual = float(np.fmax(self._residual, row.result.report.residual))
        self.sampled_range = max(self.sampled_range, row.result.report.sampled_range)

    def lines(self) -> list[tuple[str, str]]:
        """The summary as names and values with units."""
        compute = spread(1e3 * np.array(self._compute_times))
        lines = [("rows", str(len(self._errors)))]
        errors = 1e3 * np.concatenate(self._errors) if self._errors else np.empty(0)
        errors = errors[np.isfinite(errors)]
        if errors.size:
            lines += [("tracking error, mean", f"{errors.mean():.4f} mm"),
                      ("tracking error, max", f"{errors.max():.4f} mm")]
        angles = np.degrees(np.concatenate(self._angles)) if self._angles else np.empty(0)
        angles = angles[np.isfinite(angles)]
        if angles.size:
            lines += [("orientation error, mean", f"{angles.mean():.4f}°"),
                      ("orientation error, max", f"{angles.max():.4f}°")]
        wrong = 100.0 * np.concatenate(self._stiffness) if self._stiffness else np.empty(0)
        wrong = wrong[np.isfinite(wrong)]
        if wrong.size:
            lines += [("stiffness error, mean", f"{wrong.mean():.3f} %"),
                      ("stiffness error, max", f"{wrong.max():.3f} %")]
        lines += [("residual, max", f"{self._residual:.2g} N"),
                  ("compute time, median", f"{compute.median:.2f} ms"),
                  ("compute time, p99", f"{compute.p99:.2f} ms"),
                  ("compute time, max", f"{compute.maximum:.2f} ms")]
        lines += [(f"status {name}", f"{count} rows")
                  for name, count in sorted(self.statuses.items())]
        return lines


def simulate(scene: Path, targets: Path, output: Path, settle: int = 0,
             picture: Path | None = None) -> int:
    """Runs a scene over a targets file and writes the results.

    Args:
        scene: Scene file.
        targets: Targets file, see `read_targets`.
        output: Run file to write, see `run_file`.
        settle: Number of times the first row is run before the recording.
        picture: Picture of the last state to write, or None.

    Returns:
        Exit code: 0, or 1 when a row found no solution.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the targets or an output cannot be used.
    """
    simulation = Simulation.from_scene_file(scene)
    for note in simulation.notes:
        warn(note)
    rows = read_targets(targets, simulation)
    for note in rows.notes:
        warn(note)
    if far := far_target_warning(simulation, rows):
        warn(far)
    if picture is not None:
        check_picture(picture)
    simulation.warm_up()
    summary, failed = _run_and_write(simulation, rows, output, settle, picture)
    _print_summary(simulation.scene.name, summary, output, picture)
    print_mesh_error(simulation.scene)
    print_reduction_errors(simulation, summary.sampled_range)
    if failed:
        warn(f"{failed} of {len(rows.times)} rows found no solution and contain the last safe "
             f"command, see column status of {output}")
    return 1 if failed else 0


def _run_and_write(simulation: Simulation, rows: TargetTable, output: Path, settle: int,
                   picture: Path | None) -> tuple[RunSummary, int]:
    """Runs all rows and writes the run file and the picture; returns summary and failed rows."""
    summary = RunSummary()
    effector_path = np.empty((len(rows.times), len(simulation.effector_names), 3))
    failed = 0
    names, actuators = simulation.effector_names, simulation.actuators
    asks = simulation.oriented_effectors, simulation.stiff_effectors
    with run_file(output, names, actuators, *asks) as write:
        with progress() as bar:
            task = bar.add_task(simulation.scene.name, total=len(rows.times), note="")
            for row in run(simulation, rows, settle):
                write(row)
                summary.add(row)
                effector_path[row.step] = row.result.effector_positions
                failed += row.result.status.is_failure
                bar.update(task, advance=1, note=row.result.status.value)
        if picture is not None:
            _draw(simulation, rows, effector_path, picture)
    return summary, failed


def _draw(
    simulation: Simulation, rows: TargetTable, effector_path: np.ndarray, picture: Path
) -> None:
    """Draws the last state and the effectors' path [m], shape (row_count, effector_count, 3)."""
    name = simulation.scene.name
    goal = rows.values[-1] if rows.kind == "targets" else None
    draw_snapshots([take_snapshot(simulation, None, name, goal, effector_path)], picture, name)


def _print_summary(name: str, summary: RunSummary, output: Path, picture: Path | None) -> None:
    made = table(f"{name}, offline", "what", "value")
    for line in summary.lines():
        made.add_row(*line)
    made.add_row("run", str(output))
    if picture is not None:
        made.add_row("picture", str(picture))
    console().print(made)
