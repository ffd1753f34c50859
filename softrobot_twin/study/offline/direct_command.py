"""``python -m softrobot_twin simulate --commands``: a scene driven directly from a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.offline.commands_file import CommandTable, read_commands
from softrobot_twin.study.offline.direct_run import run_commands, step_times
from softrobot_twin.study.offline.direct_run_file import direct_run_file
from softrobot_twin.study.offline.direct_summary import DirectSummary
from softrobot_twin.study.offline.mesh_error_words import tell_mesh_error
from softrobot_twin.study.offline.passive_run import Onlooker, left_alone
from softrobot_twin.study.reports.terminal import console, progress, table, warn

DEFAULT_RATE = 250.0
"""Steps a second, where none is asked for [Hz]."""


class Picture(NamedTuple):
    """A picture to draw of a run.

    Attributes:
        path: File to write; its ending says the format.
        times: Times to draw side by side [s]; the last state where there are none.
        view: Elevation and azimuth of the eye [degrees], or None for the usual ones.
    """

    path: Path
    times: tuple[float, ...] = ()
    view: tuple[float, float] | None = None


def simulate_commands(scene: Path, commands: Path, output: Path, rate: float = DEFAULT_RATE,
                      picture: Picture | None = None) -> int:
    """Runs a scene as a commands file says and writes what came of it.

    Args:
        scene: Scene file.
        commands: Commands file, see `commands_file`.
        output: Run file to write, see `direct_run_file`.
        rate: Steps a second [Hz].
        picture: Picture to draw, or None.

    Returns:
        Exit code: 0, or 1 when a step found no solution.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the commands or an output cannot be used.
    """
    simulation = _told(scene)
    commanded = read_commands(commands, simulation)
    summary = DirectSummary(simulation, commanded.longest_hold)
    return _run_and_tell(simulation, commanded, output, rate, summary, picture)


def simulate_alone(scene: Path, seconds: float, output: Path, rate: float = DEFAULT_RATE,
                   picture: Picture | None = None) -> int:
    """Runs a scene that nobody commands: bodies sag and fall, cables hold their lengths.

    Args:
        scene: Scene file.
        seconds: How long [s].
        output: Run file to write, see `direct_run_file`; with what an `Onlooker` sees.
        rate: Steps a second [Hz].
        picture: Picture to draw, or None.

    Returns:
        Exit code: 0, or 1 when a step found no solution.

    Raises:
        SoftRobotTwinError: The scene, its mesh or an output cannot be used.
    """
    simulation = _told(scene)
    summary = DirectSummary(simulation, (math.nan, math.nan))
    return _run_and_tell(simulation, left_alone(simulation, seconds), output, rate, summary,
                         picture, Onlooker(simulation))


def _told(scene: Path) -> Simulation:
    """The scene, with its notes told."""
    simulation = Simulation.from_scene_file(scene)
    for note in simulation.notes:
        warn(note)
    return simulation


def _run_and_tell(simulation: Simulation, commanded: CommandTable, output: Path, rate: float,
                  summary: DirectSummary, picture: Picture | None,
                  onlooker: Onlooker | None = None) -> int:
    simulation.warm_up()
    _run(simulation, commanded, output, rate, summary, picture, onlooker)
    how = "direct" if onlooker is None else "left to itself"
    made = table(f"{simulation.scene.name}, {how}, {rate:g} Hz", "what", "value")
    for line in summary.lines() if onlooker is None else [*summary.lines(), *onlooker.lines()]:
        made.add_row(*line)
    made.add_row("run", str(output))
    if picture is not None:
        made.add_row("picture", str(picture.path))
    console().print(made)
    tell_mesh_error(simulation.scene)
    if summary.failed:
        warn(f"{summary.failed} steps found no solution; the last safe state stands in their "
             f"place, see column status of {output}")
    return 1 if summary.failed else 0


def _run(simulation: Simulation, commanded: CommandTable, output: Path, rate: float,
         summary: DirectSummary, picture: Picture | None, onlooker: Onlooker | None) -> None:
    """Runs and writes; what is written is put in place when all of it is done."""
    count = len(step_times(commanded, rate))
    shots = []
    if picture is not None:
        # Only a run that is to be drawn pays for loading the pictures' code.
        from softrobot_twin.study.reports.scene_picture import check_picture, draw_snapshots
        from softrobot_twin.study.reports.scene_snapshot import take
        check_picture(picture.path)  # refused before the run, not after
    wanted = _wanted_times(picture, commanded)
    observed = () if onlooker is None else onlooker.columns
    with direct_run_file(output, simulation, observed) as write:
        with progress() as bar:
            task = bar.add_task(simulation.scene.name, total=count, note="")
            for row in run_commands(simulation, commanded, rate):
                write(row if onlooker is None else row._replace(observed=onlooker.look()))
                summary.add(row)
                bar.update(task, advance=1, note=row.result.status.value)
                while wanted and row.time >= wanted[0] - 1e-9:
                    shots.append(take(simulation, row.result.contacts, f"{wanted.pop(0):g} s"))
        if picture is not None:
            draw_snapshots(shots, picture.path, simulation.scene.name, picture.view)


def _wanted_times(picture: Picture | None, commanded: CommandTable) -> list[float]:
    """Times to draw that are still to come, in their order."""
    if picture is None:
        return []
    last = float(commanded.times[-1])
    times: Sequence[float] = picture.times or (last,)
    return sorted(min(time, last) for time in times)
