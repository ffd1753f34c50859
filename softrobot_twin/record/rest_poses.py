"""Poses at which a robot rested, with what was measured there: of a recorded run, or of a table.

A robot rests while what is commanded stays the same, once it has for a while. What was measured in the
last half second of a rest is one pose.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.record.loop_calls import repeat
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import CALL, SUFFIX, TICK, RunFile
from softrobot_twin.record.run_values import numbers
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.limits import ANGLE
from softrobot_twin.simulation.building.table_columns import (
    TIME,
    column,
    force_columns,
    position_columns,
)
from softrobot_twin.simulation.runs.input_tables import Columns, TableFileError, open_columns

REST_TIME, WINDOW = 1.0, 0.5
"""A rest is at least so long, and what is measured in its last time counts [s]."""
SAME = 1.0e-3
"""A command that changes by less than this share of a large one stays the same."""
DRIFT, NOISE_FACTOR = 2.0e-4, 5.0
"""Markers move where the halves of the window differ by more than this share of the robot's size, and by more
than so many standard errors."""
MOST_POSES = 200
"""The oldest of more poses is forgotten."""
_MEASURED = ("markers.", "device.", "measured_angles.", "measured_pressures.", "touches.")
EXAMPLE = "north_length_m,marker_4_x_m,marker_4_y_m,marker_4_z_m"


class RestPose(NamedTuple):
    """What was commanded and measured while a robot rested.

    Attributes:
        setpoints: As measured or else commanded, of cables their lengths [m], of cavities gauge
            pressures [Pa], shape (actuator_count,).
        markers: Measured markers in the frame of the cameras [m], NaN for hidden ones, shape
            (marker_count, 3).
        effectors: Measured effectors [m], NaN where none is, shape (effector_count, 3).
        efforts: Measured efforts, such as tensions [N], NaN where none is, shape (actuator_count,).
        forces: On the touches [N], shape (touch_count, 3).
        origin: Where this is from, such as ``run.csv at 12.3 s``.
    """

    setpoints: np.ndarray
    markers: np.ndarray
    effectors: np.ndarray
    efforts: np.ndarray
    forces: np.ndarray
    origin: str = ""


class Sample(NamedTuple):
    """What was commanded and measured at one time.

    Attributes:
        time: [s].
        command: Commanded setpoints, NaN without any, shape (actuator_count,).
        seen: The measurements; its setpoints are NaN where none were measured.
    """

    time: float
    command: np.ndarray
    seen: RestPose


class RestWatch:
    """Finds the poses at which a robot rests, sample by sample.

    Attributes:
        found: The poses, the oldest first.
        dropped: How many rests were dropped, by the reason.
        moving_time: Time in which the robot moved [s].
    """

    def __init__(self, simulation: Simulation, source: str = ""):
        """Watches a robot.

        Args:
            simulation: Its model.
            source: Where the samples are from, for `RestPose.origin`.
        """
        actuators, size = simulation.actuators, simulation.model.nodes.size
        scale = np.where(actuators.is_effort_driven, actuators.effort_scale,
                         actuators.displacement_scale)  # fmt: skip
        self._same, self._size = SAME * scale, float(size) if np.isfinite(size) else 1.0
        self._source = source
        self.found: deque[RestPose] = deque(maxlen=MOST_POSES)
        self.dropped: Counter[str] = Counter()
        self.moving_time = 0.0
        self._window: deque[Sample] = deque()
        self._begin: Sample | None = None

    def add(self, sample: Sample) -> None:
        """Takes the next sample.

        Args:
            sample: The sample.
        """
        command = sample.command
        begin = self._begin
        if begin is not None and not np.all(np.abs(command - begin.command) <= self._same):
            self.end(sample.time)
        if not np.isfinite(command).all():
            return
        if self._begin is None:
            self._begin = sample
        self._window.append(sample)
        while self._window[0].time < sample.time - WINDOW:
            self._window.popleft()

    def end(self, time: float = np.nan) -> None:
        """Ends the present rest.

        Args:
            time: When the command changed [s]; NaN where nothing follows.
        """
        begin, window = self._begin, list(self._window)
        self._begin = None
        self._window.clear()
        if begin is None:
            return
        duration = window[-1].time - begin.time
        if duration < REST_TIME:
            self.moving_time += np.nan_to_num(time - begin.time, nan=duration)
            return
        pose = self._pose(window)
        if isinstance(pose, str):
            self.dropped[pose] += 1
        else:
            self.found.append(pose)

    def _pose(self, window: list[Sample]) -> RestPose | str:
        """The pose of a rest, or why it is none."""
        seen = [one.seen for one in window]
        setpoints = _middle([one.setpoints for one in seen])
        setpoints = np.where(np.isfinite(setpoints), setpoints, window[-1].command)
        markers, effectors, efforts = (
            _middle([getattr(one, name) for one in seen]) for name in ("markers", "effectors", "efforts"))
        points = np.array([np.concatenate([one.markers, one.effectors]) for one in seen])
        if not np.isfinite(np.concatenate([markers.ravel(), effectors.ravel(), efforts])).any():
            return "nothing was measured"
        half = len(points) // 2
        drift = np.abs(_middle(points[half:]) - _middle(points[:half])) if half else np.zeros(1)
        noise = np.std(np.diff(points, axis=0), axis=0) / np.sqrt(2.0 * max(half, 1))
        if np.any(drift > np.maximum(DRIFT * self._size, NOISE_FACTOR * noise)):
            return "the markers still moved"
        forces = np.array(seen[-1].forces)
        for one in self.found:
            if np.all(np.abs(one.setpoints - setpoints) <= self._same) and np.allclose(
                    one.forces, forces, atol=1e-3):  # fmt: skip
                return "it repeats an earlier pose"
        origin = f"{self._source} at {window[-1].time:.2f} s"
        return RestPose(setpoints, markers, effectors, efforts, forces, origin)

    def in_words(self) -> str:
        """How many poses were found, and why others were dropped."""
        words = [f"{self._source}: {len(self.found)} poses at rest"]
        words += [f"{count} dropped because {reason}" for reason, count in self.dropped.items()]
        if self.moving_time:
            words.append(f"rests shorter than {REST_TIME:g} s, and motion, of {self.moving_time:.1f} s in "
                         "all are left out")
        return "; ".join(words)


def _middle(values: Any) -> np.ndarray:
    """Medians over samples; NaN where half of them or more are hidden."""
    values = np.asarray(values, float)
    if not len(values):
        return np.empty(0)
    shown = np.isfinite(values).mean(axis=0) > 0.5
    found = np.full(values.shape[1:], np.nan)
    if shown.any():
        found[shown] = np.nanmedian(values[:, shown], axis=0)
    return found


# --- what a loop measures ------------------------------------------------------------------------


def sample_of(loop: TwinLoop, now: float, time: float, command: np.ndarray | None, forces: np.ndarray) -> Sample:  # fmt: skip
    """What a loop commands and measures.

    Args:
        loop: The loop.
        now: Time on its clock [s].
        time: Time of the sample [s].
        command: Setpoints that left the loop, shape (actuator_count,); None for none.
        forces: On the touches [N], shape (touch_count, 3).
    """
    simulation, device = loop.simulation, loop.device
    none = np.full(simulation.actuators.count, np.nan)
    is_fresh = device.setpoints is not None and device.age(now) <= loop.settings.device_timeout
    setpoints = np.array(device.setpoints) if is_fresh else none
    efforts = np.array(device.efforts) if is_fresh and device.efforts is not None else none
    commanded = setpoints if command is None else command
    markers = simulation.scene.marker_frame.of_cameras(np.array(loop.markers.measured(now)))
    effectors = np.full((len(simulation.effector_names), 3), np.nan)
    told = [_as_told(loop, one) for one in (commanded, setpoints)]
    return Sample(time, told[0], RestPose(told[1], markers, effectors, efforts, forces))


def _as_told(loop: TwinLoop, setpoints: np.ndarray) -> np.ndarray:
    """Setpoints with pressures as they are in messages, but gauge."""
    told, cavities = np.array(setpoints), loop.cavities
    absolute = cavities.absolute(told)
    for name, place in cavities.places.items():
        if name not in cavities.by_volume:
            told[place] = absolute[name] - cavities.ambient_pressure
    return told


def poses_of_run(path: Path, simulation: Simulation) -> tuple[list[RestPose], str]:
    """Poses at rest of a recorded run, and how many were found and dropped, in words.

    Args:
        path: The file of the run.
        simulation: The model that takes them: markers are in its order.

    Raises:
        RunFileError: The file cannot be used.
    """
    file = RunFile(path)
    loop = Replay(file).loop
    watch, count = RestWatch(loop.simulation, path.name), len(loop.simulation.touch_names)
    began = None
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
                np.zeros((count, 3)) if forces is None else np.nan_to_num(numbers(forces))))
    watch.end()
    order = {int(marker): place for place, marker in enumerate(loop.simulation.marker_ids)}
    hidden = np.full(3, np.nan)
    return [pose._replace(markers=np.array(
        [pose.markers[order[int(one)]] if int(one) in order else hidden
         for one in simulation.marker_ids]).reshape(-1, 3)) for pose in watch.found], watch.in_words()  # fmt: skip


# --- tables --------------------------------------------------------------------------------------


def poses_of_table(
    source: Path | str | Mapping, simulation: Simulation
) -> tuple[list[RestPose], str]:
    """Poses at rest of a CSV file or a table of columns, and how many were dropped, in words.

    Without the column ``time_s`` each row is a pose at rest. Setpoints are as runs write them; measured
    markers are ``marker_4_x_m`` and so on, efforts ``north_tension_N``, forces of touches
    ``finger_force_x_N``. Effectors are taken as measured where there are no markers.

    Args:
        source: The file or the table.
        simulation: The model.

    Raises:
        TableFileError: The table cannot be used.
    """
    columns = open_columns(source, EXAMPLE)
    name = columns.source.name
    actuators = simulation.actuators
    setpoints = np.column_stack([
        _setpoints(columns, simulation, place) for place in range(actuators.count)
    ]) if actuators.count else np.empty((len(columns), 0))  # fmt: skip
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
    if TIME not in columns:
        return seen, f"{name}: {len(seen)} poses at rest, one of each row{words}"
    watch = RestWatch(simulation, name)
    for time, one in zip(columns.times(), seen, strict=True):
        watch.add(Sample(float(time), one.setpoints, one))
    watch.end()
    return list(watch.found), watch.in_words() + words


def _setpoints(columns: Columns, simulation: Simulation, place: int) -> np.ndarray:
    """Setpoints of an actuator in each row, by the first of its columns that is there."""
    actuators = simulation.actuators
    name, kind = actuators.names[place], actuators.kinds[place]
    if column(name, kind.setpoint) in columns:
        return columns.pop(column(name, kind.setpoint))
    if not kind.is_effort_driven and column(name, kind.displacement) in columns:
        drives = columns.pop(column(name, kind.displacement))
        return actuators.rest_setpoints[place] + kind.sign * drives
    pulleys = actuators.pulleys
    for index, own in enumerate(pulleys.names):
        if place in pulleys.driven[index] and column(own, ANGLE) in columns:
            at = list(pulleys.driven[index]).index(place)
            angles = columns.pop(column(own, ANGLE))
            columns.put(column(own, ANGLE), angles)
            return np.array([pulleys.lengths(index, angle)[at] for angle in angles])
    raise TableFileError(columns.source, f"the header lacks what drives {name}, such as this column", 1,
                         column(name, kind.setpoint))  # fmt: skip


def _points(columns: Columns, names: Iterable[str]) -> np.ndarray:
    """Places of points in each row [m], NaN where there are no columns, shape (row_count, n, 3)."""
    found = [np.column_stack([
        columns.pop(one, may_be_open=True) if one in columns else np.full(len(columns), np.nan)
        for one in position_columns(name)]) for name in names]  # fmt: skip
    return np.stack(found, axis=1) if found else np.empty((len(columns), 0, 3))


def read_poses(
    sources: Iterable[Path | str | Mapping], simulation: Simulation
) -> tuple[list[RestPose], list[str]]:
    """Poses at rest of runs and tables, and a sentence on each of these.

    Args:
        sources: Files ``.mcap`` of runs, CSV files, or tables of columns.
        simulation: The model.

    Raises:
        SoftRobotTwinError: A file cannot be used.
    """
    poses, words = [], []
    for source in sources:
        is_run = isinstance(source, Path | str) and Path(source).suffix == SUFFIX
        found, told = (poses_of_run(Path(source), simulation) if is_run
                       else poses_of_table(source, simulation))  # fmt: skip
        poses += found
        words.append(told)
    return poses, words
