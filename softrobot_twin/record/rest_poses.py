"""Poses at which a robot rested, with what was measured there: of a recorded run, or of a table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from softrobot_twin.control.rest_watch import RestPose, RestWatch, Sample, sample_of
from softrobot_twin.record.loop_calls import repeat
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import CALL, SUFFIX, TICK, RunFile
from softrobot_twin.record.run_values import numbers
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.simulation.command import SETPOINTS
from softrobot_twin.tables.column_names import TIME, force_columns, position_columns
from softrobot_twin.tables.input_tables import (
    Axes,
    Columns,
    TableFileError,
    drives_of,
    open_columns,
)

_MEASURED = ("markers.", "device.", "measured_angles.", "measured_pressures.", "touches.")
EXAMPLE = "north_length_m,marker_4_x_m,marker_4_y_m,marker_4_z_m"


def poses_of_run(path: Path, simulation: Simulation, name: str = "") -> tuple[list[RestPose], str]:
    """Poses at rest of a recorded run, and how many were found and dropped, in words.

    Args:
        path: The file of the run.
        simulation: The model that takes them: markers are in its order.
        name: What the poses are said to be from; empty for the name of the file.

    Raises:
        RunFileError: The file cannot be used.
    """
    file = RunFile(path)
    loop = Replay(file).loop
    watch, began = RestWatch(loop.simulation, name or path.name), None
    for entry in file.entries():
        content = entry.content
        if entry.kind == CALL and content["to"].startswith(_MEASURED) and content["answer"] is None:
            repeat(loop, content["to"], content["arguments"])
        elif entry.kind == TICK:
            began = content["now"] if began is None else began
            values = content["values"]
            sent, forces = values.get("command_setpoints"), values.get("touch_forces")
            watch.add(sample_of(
                loop, content["now"], content["now"] - began, None if sent is None else numbers(sent),
                None if forces is None else numbers(forces)))
    watch.end()
    order = {int(marker): place for place, marker in enumerate(loop.simulation.marker_ids)}
    hidden = np.full(3, np.nan)
    return [pose._replace(markers=np.array(
        [pose.markers[order[int(one)]] if int(one) in order else hidden
         for one in simulation.marker_ids]).reshape(-1, 3)) for pose in watch.found], watch.in_words()  # fmt: skip


# --- tables --------------------------------------------------------------------------------------


def poses_of_table(
    source: Path | str | Mapping, simulation: Simulation, axes: Axes = Axes(), name: str = ""
) -> tuple[list[RestPose], str]:
    """Poses at rest of a CSV file or a table of columns, and how many were dropped, in words.

    Without the column ``time_s`` each row is a pose at rest. Setpoints are as runs write them; measured
    markers are ``marker_4_x_m`` and so on, efforts ``north_tension_N``, forces of touches
    ``finger_force_x_N``. Effectors are taken as measured where there are no markers.

    Args:
        source: The file or the table.
        simulation: The model.
        axes: How the table names them.
        name: What the poses are said to be from; empty for the name of the file.

    Raises:
        TableFileError: The table cannot be used.
    """
    columns = open_columns(source, EXAMPLE)
    axes.turn(columns, simulation.actuators)
    name = name or columns.source.name
    actuators = simulation.actuators
    setpoints = _setpoints(columns, simulation)
    efforts = np.full(setpoints.shape, np.nan)
    for place, (own, kind) in enumerate(actuators.kind_of.items()):
        if not kind.is_effort_driven and column(own, kind.effort) in columns:
            efforts[:, place] = columns.pop(column(own, kind.effort), may_be_open=True)
    markers = _points(columns, [f"marker_{one}" for one in simulation.marker_ids])
    effectors = _points(columns, simulation.effector_names)
    words = ""
    if np.isfinite(markers).any():
        effectors[:] = np.nan
    elif np.isfinite(effectors).any():
        words = "; it has no markers: the places of effectors are taken as measured"
    forces = np.zeros((len(columns), len(simulation.touch_names), 3))
    for index, touch in enumerate(simulation.touch_names):
        for axis, own in enumerate(force_columns(touch)):
            if own in columns:
                forces[:, index, axis] = np.nan_to_num(columns.pop(own, may_be_open=True))
    seen = [RestPose(*parts, f"{name}, line {line}") for line, *parts in zip(
        columns.lines, setpoints, markers, effectors, efforts, forces, strict=True)]  # fmt: skip
    is_timed = TIME in columns
    times = columns.times() if is_timed else np.empty(0)
    if columns.left and not columns.is_output:
        words += f"; not read: {', '.join(map(columns.given, columns.left))}"
    if not is_timed:
        return seen, f"{name}: {len(seen)} poses at rest, one of each row{words}"
    watch = RestWatch(simulation, name)
    for time, one in zip(times, seen, strict=True):
        watch.add(Sample(float(time), one.setpoints, one))
    watch.end()
    return list(watch.found), watch.in_words() + words


def _setpoints(columns: Columns, simulation: Simulation) -> np.ndarray:
    """Setpoints of the actuators in each row, shape (row_count, actuator_count)."""
    actuators = simulation.actuators
    setpoints = np.full((len(columns), actuators.count), np.nan)
    drives = [one for one in drives_of(simulation) if SETPOINTS in one.gives]
    for drive in sorted(drives, key=lambda one: bool(one.lines)):  # First what is told itself.
        if drive.name in columns and np.isnan(setpoints[:, drive.places]).any():
            for place, told in drive.told(columns.pop(drive.name)):
                if np.isnan(setpoints[:, place]).any():
                    setpoints[:, place] = told
    for name, kind, own in zip(actuators.names, actuators.kinds, setpoints.T, strict=True):
        if np.isnan(own).any():
            raise TableFileError(
                columns.source, f"the header lacks what drives {name}, such as this column", 1,
                column(name, kind.setpoint))  # fmt: skip
    return setpoints


def _points(columns: Columns, names: Iterable[str]) -> np.ndarray:
    """Places of points in each row [m], NaN where there are no columns, shape (row_count, n, 3)."""
    found = [np.column_stack([
        columns.pop(one, may_be_open=True) if one in columns else np.full(len(columns), np.nan)
        for one in position_columns(name)]) for name in names]  # fmt: skip
    return np.stack(found, axis=1) if found else np.empty((len(columns), 0, 3))


def read_poses(
    sources: Iterable[Path | str | Mapping], simulation: Simulation, axes: Axes = Axes()
) -> tuple[list[RestPose], list[str]]:
    """Poses at rest of runs and tables, and a sentence on each of these.

    Args:
        sources: Files ``.mcap`` of runs, CSV files, or tables of columns.
        simulation: The model.
        axes: How the tables name them; runs are in the frame of the scene.

    Raises:
        SoftRobotTwinError: A file cannot be used.
    """
    poses, words, sources = [], [], list(sources)
    names = [Path(source).name if isinstance(source, Path | str) else "" for source in sources]
    for source, own in zip(sources, names, strict=True):
        # Files of one name in several folders are several sessions.
        name = str(source) if own and names.count(own) > 1 else own
        is_run = isinstance(source, Path | str) and Path(source).suffix == SUFFIX
        found, told = (poses_of_run(Path(source), simulation, name) if is_run
                       else poses_of_table(source, simulation, axes, name))  # fmt: skip
        poses += found
        words.append(told)
    return poses, words
