"""``python -m softrobot_twin simulate``: a scene run offline from a targets file to a run file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.offline.mesh_error_words import tell_mesh_error
from softrobot_twin.study.offline.offline_run import far_target_warning, run
from softrobot_twin.study.offline.run_file import run_file
from softrobot_twin.study.offline.run_summary import RunSummary
from softrobot_twin.study.offline.targets_file import TargetTable, read_targets
from softrobot_twin.study.reports.terminal import console, progress, table, warn


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
    rows = read_targets(targets, simulation.effector_names, simulation.actuator_names)
    if far := far_target_warning(simulation, rows):
        warn(far)
    if picture is not None:
        # Only a run that is to be drawn pays for loading the pictures' code.
        from softrobot_twin.study.reports.scene_picture import check_picture
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
    names = simulation.effector_names, simulation.actuator_names
    with run_file(output, *names, simulation.rest_setpoints) as write:
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
    from softrobot_twin.study.reports.scene_picture import draw_snapshots
    from softrobot_twin.study.reports.scene_snapshot import take
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
