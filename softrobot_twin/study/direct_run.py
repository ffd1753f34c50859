"""``simulate --commands`` and runs without commands: actuators, motors and guided bodies over time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from softrobot_twin.errors import MOST_COUNTED, CommandError
from softrobot_twin.harness.terminal import warn
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import DEFAULT_TIME_STEP, Command
from softrobot_twin.study.offline_run import (
    MoreIterations,
    Picture,
    load_with_notes,
    run_and_report,
    unlikely_warning,
)
from softrobot_twin.study.passive_run import BodyReadouts, no_commands
from softrobot_twin.study.run_summary import RunSummary
from softrobot_twin.study.scene_picture import Snapshot, take_snapshot
from softrobot_twin.tables.input_tables import Axes, CommandTable, read_commands
from softrobot_twin.tables.run_columns import RunColumns, RunRow


def step_count(name: str, seconds: float, rate: float) -> int:
    """Number of steps in a time, none of which is longer than the rate's period.

    Args:
        name: What gives the time, for the error.
        seconds: The time [s].
        rate: Steps per second [Hz].

    Raises:
        CommandError: There are more than `MOST_COUNTED`.
    """
    if not seconds * rate <= MOST_COUNTED:
        raise CommandError(name, f"{seconds:g} s are more than {MOST_COUNTED:,} steps at {rate:g} Hz")
    # The small number prevents an additional step due to rounding.
    return max(1, math.ceil(seconds * rate - 1e-9))


def step_times(table: CommandTable, rate: float) -> np.ndarray:
    """End times of the steps [s]: evenly spaced, and no step is longer than the rate's period.

    Args:
        table: Commands.
        rate: Steps per second [Hz].

    Raises:
        CommandError: There are more than `MOST_COUNTED`.
    """
    begin, end = table.times[0], table.times[-1]
    count = step_count("time_s", end - begin, rate)
    return begin + (end - begin) * np.arange(1, count + 1) / count


def run_commands(
    simulation: Simulation, table: CommandTable, rate: float, columns: RunColumns | None = None,
    again: MoreIterations | None = None,
) -> Iterator[RunRow]:  # fmt: skip
    """Runs a table of commands from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first compute time contains no compilation.
        table: Commands; the run begins at its first row.
        rate: Steps per second [Hz].
        columns: Those of the file that is written; None for rows without error estimates.
        again: Steps the simulation; None to make it.

    Yields:
        One row a step.
    """
    columns = columns or RunColumns(simulation, with_reduction_errors=False)
    again = again or MoreIterations(simulation)
    # What leads bodies is told before a step, and a restored state does not have it.
    is_led = table.base is not None or bool(table.poses or table.grips)
    times = step_times(table, rate)
    time_step = float(times[-1] - table.times[0]) / len(times)
    if table.base is not None:
        simulation.move_base(*table.base.at(table.times[0]), float(table.times[0]))
    for step, time in enumerate(times):
        if table.base is not None:
            simulation.move_base(*table.base.at(time), float(time))
        for name, pose in table.poses.items():
            simulation.model.guides.aim(name, *pose.at(time))
        for name, holds in table.held(time - (1.0 - ROUNDING) * time_step):
            simulation.grip(name, holds)
        touched = table.touched(time, simulation) if table.touches else None
        command = table.command(time, time_step)
        result = simulation.step(command, None, touched) if is_led else again.step(command, touched)
        yield columns.row(step, float(time), result, command)


# A row at the beginning of a step counts for it, but for round-off of times.
ROUNDING = 1.0e-6
DEFAULT_RATE = 1.0 / DEFAULT_TIME_STEP
"""Default number of steps per second [Hz]."""


def commands_of(table: CommandTable) -> Iterator[Command]:
    """The commands of the rows of a commands file.

    Args:
        table: The rows of the file.
    """
    return (table.command(float(time), DEFAULT_TIME_STEP) for time in table.times)


def simulate_commands(scene: Path, commands: Path, output: Path, rate: float = DEFAULT_RATE,
                      picture: Picture | None = None, axes: Axes = Axes()) -> int:
    """Runs a scene with a commands file and writes the results.

    Args:
        scene: Scene file.
        commands: Commands file, see `read_commands`.
        output: Run file to write, see `run_file`.
        rate: Steps per second [Hz].
        picture: Picture to draw, or None.
        axes: How the commands file names them.

    Returns:
        Exit code: see `RunSummary.exit_code`.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the commands or an output cannot be used.
    """
    simulation = load_with_notes(scene)
    commanded = read_commands(commands, simulation, axes)
    if unlikely := unlikely_warning(simulation, commands_of(commanded)):
        warn(unlikely)
    summary = RunSummary(simulation, commanded.longest_hold)
    return _run_and_report(simulation, commanded, output, rate, summary, picture)


def simulate_alone(scene: Path, seconds: float, output: Path, rate: float = DEFAULT_RATE,
                   picture: Picture | None = None) -> int:
    """Runs a scene without commands: bodies sag and fall, actuators hold.

    Args:
        scene: Scene file.
        seconds: Duration [s].
        output: Run file to write, see `run_file`; with the columns of `BodyReadouts`.
        rate: Steps per second [Hz].
        picture: Picture to draw, or None.

    Returns:
        Exit code: see `RunSummary.exit_code`.

    Raises:
        SoftRobotTwinError: The scene, its mesh or an output cannot be used.
    """
    simulation = load_with_notes(scene)
    summary = RunSummary(simulation)
    return _run_and_report(simulation, no_commands(simulation, seconds), output, rate, summary,
                         picture, BodyReadouts(simulation))


def _run_and_report(simulation: Simulation, commanded: CommandTable, output: Path, rate: float,
                    summary: RunSummary, picture: Picture | None, seen: BodyReadouts | None = None) -> int:
    """Runs all steps, and takes a snapshot at each wanted time."""
    first, last = map(float, commanded.times[[0, -1]])
    wanted = sorted(picture.times or (last,)) if picture else []
    for time in wanted:
        if not first <= time <= last + ROUNDING:
            raise CommandError("--picture-at", f"{time:g} s is not in the run, which goes from {first:g} s to {last:g} s")
    columns = RunColumns(simulation, None, () if seen is None else seen.columns)
    again = MoreIterations(simulation)
    rows: Iterator[RunRow] = run_commands(simulation, commanded, rate, columns, again)
    if seen is not None:
        rows = (row._replace(observed=seen.read()) for row in rows)

    def shots(row: RunRow | None) -> list[Snapshot]:
        taken, (now, contacts) = [], (first, None) if row is None else (row.time, row.result.contacts)
        while wanted and now >= wanted[0] - 1e-9:
            taken.append(take_snapshot(simulation, contacts, f"{wanted.pop(0):g} s"))
        return taken

    return run_and_report(
        simulation, rows, columns, len(step_times(commanded, rate)),
        f"{'direct' if seen is None else 'no commands'}, {rate:g} Hz", output, summary, picture,
        shots, lambda: [*again.lines(), *(seen.lines() if seen else [])])
