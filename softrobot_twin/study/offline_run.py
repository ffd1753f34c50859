"""``simulate --targets``: runs a scene row by row from a targets file, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.runs.input_tables import TargetTable, read_targets
from softrobot_twin.simulation.runs.run_columns import RunColumns, RunRow
from softrobot_twin.simulation.unit_checks import unlikely_commands
from softrobot_twin.study.explain import print_mesh_error, print_reduction_errors
from softrobot_twin.study.output_file import csv_output
from softrobot_twin.study.run_summary import BAD_END, RunSummary
from softrobot_twin.study.scene_picture import check_picture, draw_snapshots, take_snapshot
from softrobot_twin.study.terminal import console, table, terminal_status, tracked, warn


def run(simulation: Simulation, table: TargetTable, settle: int = 0,
        columns: RunColumns | None = None) -> Iterator[RunRow]:
    """Runs every row once, in order, from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first compute time contains no compilation.
        table: Rows to run.
        settle: Number of times the first row is run before the recording.
        columns: Those of the file, see `columns_of`; None to make them.

    Yields:
        One row for each row of the table.
    """
    columns = columns or columns_of(simulation, table)
    for _ in range(settle):
        simulation.step(table.command(0))
    for index, time in enumerate(table.times):
        command = table.command(index)
        yield columns.row(index, float(time), simulation.step(command), command)


def columns_of(simulation: Simulation, table: TargetTable) -> RunColumns:
    """The columns of a run over a targets file."""
    return RunColumns(simulation, table.command(0))


def far_target_warning(simulation: Simulation, table: TargetTable) -> str | None:
    """A warning when targets, setpoints or efforts are so far away that their unit is probably
    wrong, else None.

    A target ten body sizes away is possible, but such targets are more often in millimetres.
    """
    actuators = simulation.actuators
    if table.kind == "setpoints":
        return unlikely_commands(actuators, table.values)
    if table.kind == "efforts":
        return unlikely_commands(actuators, actuators.rest_setpoints, table.values)
    surface = simulation.surface_positions()
    size = float(np.linalg.norm(np.ptp(surface, axis=0)))
    offsets = table.values - simulation.effector_positions()
    farthest = float(np.nanmax(np.linalg.norm(offsets, axis=2)))
    if farthest <= 10.0 * size:
        return None
    return (f"a target lies {farthest:.3g} m away from its effector, the body is {size:.3g} m "
            "large: are the targets in metres?")


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


def recorded(
    rows: Iterable[RunRow], simulation: Simulation, count: int, what: str, shorter: str,
    write: Callable[[RunRow], None], summary: RunSummary,
) -> Iterator[RunRow]:  # fmt: skip
    """Rows of a run as they are computed: each is written and summed up, and the progress is shown.

    Args:
        rows: The rows.
        simulation: What runs.
        count: Number of rows.
        what: What the rows are called.
        shorter: What makes the run shorter.
        write: Writes a row.
        summary: Sums the run up.
    """
    for row in tracked(rows, simulation.scene.name, count, what, shorter,
                       lambda row: row.result.status.value):
        write(row)
        summary.add(row)
        yield row


def load_with_notes(scene: Path) -> Simulation:
    """Builds the simulation of a scene file and prints its notes."""
    simulation = Simulation.from_scene_file(scene)
    for note in simulation.notes:
        warn(note)
    return simulation


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
        Exit code: see `RunSummary.exit_code`.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the targets or an output cannot be used.
    """
    simulation = load_with_notes(scene)
    rows = read_targets(targets, simulation)
    for note in rows.notes:
        warn(note)
    if far := far_target_warning(simulation, rows):
        warn(far)
    if picture is not None:
        check_picture(picture)
    with terminal_status("compiling and warming up"):
        simulation.warm_up()
    summary, name = RunSummary(simulation, unit="rows"), simulation.scene.name
    effector_path = np.empty((len(rows.times), len(simulation.effector_names), 3))
    columns = columns_of(simulation, rows)
    with run_file(output, columns) as write:
        for row in recorded(run(simulation, rows, settle, columns), simulation, len(rows.times),
                            "rows", "fewer rows of targets shorten it", write, summary):
            effector_path[row.step] = row.result.effector_positions
        if picture is not None:
            goal = rows.values[-1] if rows.kind == "targets" else None
            shot = take_snapshot(simulation, None, name, goal, effector_path)
            draw_snapshots([shot], picture, name)
    print_run(simulation, "offline", summary, summary.lines(), output, picture)
    if summary.failed:
        warn(f"{summary.failed} of {len(rows.times)} rows found no solution and contain the last "
             f"safe command, see column status of {output}")
    return end_of_run(summary)


def end_of_run(summary: RunSummary) -> int:
    """The exit code of a run; a warning says that its last row is not good.

    Args:
        summary: Summary of the run.
    """
    if summary.exit_code == BAD_END:
        warn(f"the last row is {summary.last_status}: see its residual, and docs/statuses.md "
             f"(exit code {BAD_END})")  # fmt: skip
    return summary.exit_code


def print_run(simulation: Simulation, how: str, summary: RunSummary,
              lines: list[tuple[str, str]], output: Path, picture: Path | None) -> None:
    """Prints what a run gave, and the errors that its model is estimated to have.

    Args:
        simulation: Where the run ended.
        how: How it was driven, for the title.
        summary: Summary of the run.
        lines: Names and values to print.
        output: The file that was written.
        picture: The picture that was written, or None.
    """
    made = table(f"{simulation.scene.name}, {how}", "what", "value")
    for line in lines:
        made.add_row(*line)
    made.add_row("run", str(output))
    if picture is not None:
        made.add_row("picture", str(picture))
    console().print(made)
    print_mesh_error(simulation.scene)
    print_reduction_errors(simulation, summary.sampled_range)
