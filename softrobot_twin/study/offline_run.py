"""``simulate --targets``: runs a scene row by row from a targets file, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.harness.output_file import csv_output
from softrobot_twin.harness.terminal import console, table, terminal_status, tracked, warn
from softrobot_twin.simulation import Command, Simulation, Status, StepResult
from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.step.step_report import ITERATIONS
from softrobot_twin.simulation.step.time_budget import MOST_ITERATIONS
from softrobot_twin.study.explain import print_mesh_error, print_reduction_errors
from softrobot_twin.study.run_summary import BAD_END, RunSummary
from softrobot_twin.study.scene_picture import (
    Snapshot,
    check_picture,
    draw_snapshots,
    take_snapshot,
)
from softrobot_twin.tables.input_tables import Axes, TargetTable, read_targets
from softrobot_twin.tables.run_columns import RunColumns, RunRow


def run(simulation: Simulation, table: TargetTable, settle: int = 0, columns: RunColumns | None = None,
        again: MoreIterations | None = None) -> Iterator[RunRow]:
    """Runs every row once, in order, from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first compute time contains no compilation.
        table: Rows to run.
        settle: Number of times the first row is run before the recording.
        columns: Those of the file, see `columns_of`; None to make them.
        again: Steps the simulation; None to make it.

    Yields:
        One row for each row of the table.
    """
    columns, again = columns or columns_of(simulation, table), again or MoreIterations(simulation)
    for _ in range(settle):
        simulation.step(table.command(0))
    for index, (time, command) in enumerate(zip(table.times, commands_of(table))):
        yield columns.row(index, float(time), again.step(command), command)


class MoreIterations:
    """Steps a simulation, and repeats a step with more linearizations where these were too few.

    Attributes:
        repeated: How many steps were repeated, and came into balance.
    """

    def __init__(self, simulation: Simulation):
        """Keeps the simulation.

        Args:
            simulation: What is stepped.
        """
        self._simulation, self.repeated = simulation, 0

    def step(self, command: Command, measured: object | None = None) -> StepResult:
        """See `Simulation.step`; what a step that is repeated took is its second time.

        Args:
            command: The command.
            measured: What is measured beside the state.
        """
        own, before = self._simulation, self._simulation.state
        result = own.step(command, None, measured)
        if result.status is not Status.NOT_CONVERGED or ITERATIONS not in result.report.active_limits:
            return result
        after = own.state
        own.restore(before)
        better = own.step(command, math.inf, measured)
        if better.status in (Status.NOT_CONVERGED, Status.LINEARIZED) or better.status.is_failure:
            own.restore(after)
            return result
        self.repeated += 1
        return better

    def lines(self) -> list[tuple[str, str]]:
        """How many steps were repeated, as names and values to print."""
        told = ("repeated", f"{self.repeated} rows, with up to {MOST_ITERATIONS} linearizations")
        return [told] if self.repeated else []


def commands_of(table: TargetTable) -> Iterator[Command]:
    """The commands of the rows of a targets file.

    Args:
        table: The rows of the file.
    """
    return map(table.command, range(len(table.times)))


def columns_of(simulation: Simulation, table: TargetTable) -> RunColumns:
    """The columns of a run over a targets file.

    Args:
        simulation: The simulation.
        table: The rows of the file.
    """
    return RunColumns(simulation, table.command(0))


# A target this many sizes of the robot away is possible, but more often in millimetres.
_FAR = 10.0
# A setpoint or effort of more than this many times a large one is reported as unlikely.
_UNLIKELY = 10.0


def unlikely_warning(simulation: Simulation, commands: Iterable[Command]) -> str | None:
    """A warning of commands that suggest a wrong unit, else None.

    Args:
        simulation: The scene, where the commands begin.
        commands: Targets, setpoints or efforts.
    """
    given = {"targets": [], "setpoints": [simulation.rest_setpoints], "efforts": []}
    for command in commands:
        for name in given.keys() & vars(command).keys():
            given[name].append(getattr(command, name))
    targets, setpoints, efforts = given.values()
    if targets:
        offsets = np.array(targets) - simulation.effector_positions()
        farthest = np.nanmax(np.linalg.norm(offsets, axis=2), initial=0.0)
        size = simulation.model.nodes.size
        if farthest > _FAR * size:
            return (f"a target is {farthest:.3g} m away from its effector, and the robot is "
                    f"{size:.3g} m large: are the targets in metres?")
    return _unlikely_commands(simulation.actuators, setpoints, efforts)


def _unlikely_commands(actuators: Actuators, setpoints: list, efforts: list) -> str | None:
    """A warning of setpoints or efforts, each of shape (count,), that suggest a wrong unit, else None."""
    every = np.ones(actuators.count, bool)
    for values, scale, by_effort in (
        (actuators.drives(np.array(setpoints)), actuators.limits.drive_scale, ~every),
        (np.array(efforts or [0.0 * every]), actuators.effort_scale, every),
    ):
        shares = np.nan_to_num(np.abs(values / scale), nan=0.0).max(axis=0)
        if shares.max(initial=0.0) > _UNLIKELY:
            worst = int(shares.argmax())
            word, unit = actuators.driven_quantities(by_effort)[worst]
            return (f"{actuators.names[worst]}: a {word} of {shares[worst] * scale[worst]:.3g} "
                    f"{unit} is {shares[worst]:.3g} times a large one: is it in {unit}?")
    return None


@contextmanager
def run_file(path: Path | str, columns: RunColumns) -> Iterator[Callable[[RunRow], None]]:
    """Opens the file of a run, however it is driven, and returns a function that appends a row.

    An older file is replaced when the run has ended; see `csv_output`.

    Args:
        path: The file.
        columns: Its columns.

    Raises:
        OutputError: The file cannot be written.
    """
    with csv_output(path, columns.names) as write:
        yield lambda row: write(columns.texts(row))


class Picture(NamedTuple):
    """A picture to draw of a run.

    Attributes:
        path: File to write; its suffix determines the format.
        times: Times to draw side by side [s]; empty to draw the last state.
        view: Elevation and azimuth of the eye [degrees], or None for the default.
    """

    path: Path
    times: tuple[float, ...] = ()
    view: tuple[float, float] | None = None


def run_and_report(
    simulation: Simulation, rows: Iterable[RunRow], columns: RunColumns, count: int, how: str,
    output: Path, summary: RunSummary, picture: Picture | None,
    shots: Callable[[RunRow | None], list[Snapshot]], more: Callable[[], list[tuple[str, str]]] = list,
) -> int:  # fmt: skip
    """Computes the rows of a run, writes the run file and the picture, and prints what it gave.

    Args:
        simulation: What runs.
        rows: The rows, each computed when it is asked for.
        columns: Those of the file.
        count: Number of rows.
        how: How it is driven, for the title.
        output: The run file.
        summary: Sums the run up.
        picture: Picture to draw, or None.
        shots: States to draw that are reached with a row; None before the first.
        more: Further names and values to print, as they are at the end.

    Returns:
        Exit code: see `RunSummary.exit_code`.

    Raises:
        SoftRobotTwinError: An output cannot be written.
    """
    if picture is not None:
        check_picture(picture.path)  # An error is raised before the run, not after it.
    with terminal_status("compiling and warming up"):
        simulation.warm_up()
    name, drawn = simulation.scene.name, shots(None)
    with run_file(output, columns) as write:
        for row in tracked(rows, name, count, lambda row: row.result.status.value):
            write(row)
            summary.add(row)
            drawn += shots(row)
        if picture is not None:
            draw_snapshots(drawn, picture.path, name, picture.view)
    lines = [*summary.lines(), *more(), ("run", str(output))]
    if picture is not None:
        lines.append(("picture", str(picture.path)))
    console().print(table(f"{name}, {how}", "what", "value", rows=lines))
    print_mesh_error(simulation.scene)
    print_reduction_errors(simulation, columns.reduction, summary.sampled_range)
    if summary.failed:
        warn(f"{summary.failed} of {count} {summary.unit} found no solution and contain the last "
             f"safe state, see column status of {output}")
    if summary.not_followed:
        warn(f"{summary.not_followed} of {count} {summary.unit} are saturated: at a limit, not where they were "
             f"commanded, see column active_limits of {output} (exit code {BAD_END})")
    elif summary.exit_code == BAD_END:
        warn(f"the last row is {summary.last_status}: see its residual, and docs/statuses.md "
             f"(exit code {BAD_END})")  # fmt: skip
    return summary.exit_code


def load_with_notes(scene: Path) -> Simulation:
    """Builds the simulation of a scene file and prints its notes.

    Args:
        scene: The scene file.
    """
    simulation = Simulation.from_scene_file(scene)
    for note in simulation.notes:
        warn(note)
    return simulation


def simulate(scene: Path, targets: Path, output: Path, settle: int = 0, picture: Path | None = None,
             axes: Axes = Axes()) -> int:
    """Runs a scene over a targets file and writes the results.

    Args:
        scene: Scene file.
        targets: Targets file, see `read_targets`.
        output: Run file to write, see `run_file`.
        settle: Number of times the first row is run before the recording.
        picture: Picture of the last state to write, or None.
        axes: How the targets file names them.

    Returns:
        Exit code: see `RunSummary.exit_code`.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the targets or an output cannot be used.
    """
    simulation = load_with_notes(scene)
    rows = read_targets(targets, simulation, axes)
    if unlikely := unlikely_warning(simulation, commands_of(rows)):
        warn(unlikely)
    summary, name = RunSummary(simulation, unit="rows"), simulation.scene.name
    effector_path = np.empty((len(rows.times), len(simulation.effector_names), 3))
    goal = rows.values[-1] if rows.kind == "targets" else None

    def shots(row: RunRow | None) -> list[Snapshot]:
        if row is None:
            return []
        effector_path[row.step] = row.result.effector_positions
        is_last = picture is not None and row.step == len(effector_path) - 1
        return [take_snapshot(simulation, None, name, goal, effector_path)] if is_last else []

    columns, again = columns_of(simulation, rows), MoreIterations(simulation)
    return run_and_report(
        simulation, run(simulation, rows, settle, columns, again), columns, len(effector_path), "offline", output,
        summary, picture and Picture(picture), shots, again.lines)
