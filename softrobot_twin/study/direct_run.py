"""``simulate --commands`` and runs without commands: actuators, motors and guided bodies over time.

Each step is one `DirectRow`; `DirectSummary` collects heights, creep, contact forces and times.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.rotation import quaternion_from_rotation
from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.simulation.actuators import Actuators
from softrobot_twin.study.explain import print_mesh_error, print_reduction_errors
from softrobot_twin.simulation.input_tables import CommandTable, read_commands
from softrobot_twin.study.offline_run import actuator_cells, actuator_columns, spread
from softrobot_twin.study.output_file import output_file
from softrobot_twin.study.passive_run import BodyReadouts, no_commands
from softrobot_twin.study.scene_picture import check_picture, draw_snapshots, take_snapshot
from softrobot_twin.study.terminal import console, progress, table, warn


class DirectRow(NamedTuple):
    """One step of a direct run.

    Attributes:
        step: Steps before this one.
        time: The commands' time at its end [s].
        result: The simulation's result.
        rigid_poses: Position of each rigid body's origin [m] and quaternion x, y, z, w, shape
            (rigid_body_count, 7).
        pair_resultants: Sum of the contact forces on the first body of each pair of `pair_names`
            [N], shape (pair_count, 3).
        pair_magnitude_sums: Sum of those forces' magnitudes [N], shape (pair_count,).
        observed: Values of `BodyReadouts`, in the order of its columns.
    """

    step: int
    time: float
    result: StepResult
    rigid_poses: np.ndarray
    pair_resultants: np.ndarray
    pair_magnitude_sums: np.ndarray
    observed: tuple[float, ...] = ()


def step_times(table: CommandTable, rate: float) -> np.ndarray:
    """End times of the steps [s]: evenly spaced, and no step is longer than the rate's period.

    Args:
        table: Commands.
        rate: Steps per second [Hz].
    """
    begin, end = table.times[0], table.times[-1]
    # The small number prevents an additional step due to rounding.
    count = max(1, int(np.ceil((end - begin) * rate - 1e-9)))
    return begin + (end - begin) * np.arange(1, count + 1) / count


def run_commands(
    simulation: Simulation, table: CommandTable, rate: float
) -> Iterator[DirectRow]:
    """Runs a table of commands from the simulation's present state.

    Args:
        simulation: Warmed up, so that the first compute time contains no compilation.
        table: Commands; the run begins at its first row.
        rate: Steps per second [Hz].

    Yields:
        One row a step.
    """
    names = pair_names(simulation)
    times = step_times(table, rate)
    time_step = float(times[-1] - table.times[0]) / len(times)
    for step, time in enumerate(times):
        for name, pose in table.poses.items():
            simulation.model.guides.aim(name, *pose.at(time))
        touched = table.touched(time, simulation) if table.touches else None
        result = simulation.step(table.command(time, time_step), None, touched)
        yield direct_row(simulation, step, float(time), result, names)


def direct_row(simulation: Simulation, step: int, time: float, result: StepResult,
               names: Sequence[tuple[str, str]] | None = None) -> DirectRow:
    """The row of a step, just after it.

    Args:
        simulation: At the state that the step led to.
        step: Steps before this one.
        time: The commands' time at its end [s].
        result: Its result.
        names: See `pair_names`; None to look them up.
    """
    pairs = pair_names(simulation) if names is None else names
    return DirectRow(step, time, result, rigid_poses(simulation), *_pair_forces(result, pairs))


def rigid_poses(simulation: Simulation) -> np.ndarray:
    """Origin [m] and quaternion x, y, z, w of each rigid body, shape (rigid_body_count, 7)."""
    poses = np.empty((len(simulation.model.rigid), 7))
    for pose, part in zip(poses, simulation.model.rigid, strict=True):
        origin, rotation = part.entry_pose(simulation.state.positions)
        pose[:3], pose[3:] = origin, quaternion_from_rotation(rotation)
    return poses


def pair_names(simulation: Simulation) -> tuple[tuple[str, str], ...]:
    """Names of the pairs that may touch, each pair once."""
    if simulation.model.contacts is None:
        return ()
    return tuple(dict.fromkeys(tuple(pair.names) for pair in simulation.model.contacts.pairs))


def _pair_forces(result: StepResult, names: Sequence) -> tuple[np.ndarray, np.ndarray]:
    """Resultant and sum of magnitudes of each pair [N]."""
    if result.contacts is None:
        return np.zeros((len(names), 3)), np.zeros(len(names))
    forces = result.contacts.of_pairs()
    return forces.resultants, forces.magnitude_sums


_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def direct_header(simulation: Simulation, observed: Sequence[str] = ()) -> list[str]:
    """Columns of a run's file.

    Args:
        simulation: The scene.
        observed: Columns of `BodyReadouts`.
    """
    return [
        "step", "time_s",
        *("_".join(column) for column in actuator_columns(simulation.actuators)),
        *(f"{name}_{axis}_m" for name in simulation.effector_names for axis in "xyz"),
        *(f"{part.name}_{value}" for part in simulation.model.rigid for value in _POSE),
        *(f"{name}_{column.format(axis)}" for name in simulation.touch_names
          for column in ("force_{}_N", "displacement_{}_m") for axis in "xyz"),
        *observed,
        "contact_count",
        *(f"{quantity}_N" for first, second in pair_names(simulation)
          for quantity in (*(f"force_on_{first}_by_{second}_{axis}" for axis in "xyz"),
                           f"sum_of_magnitudes_{first}_{second}")),
        "residual_N", "contact_residual_m", "compute_ms", "status"]


def direct_cells(row: DirectRow, actuators: Actuators) -> list[str]:
    """One row as text."""
    result, report = row.result, row.result.report
    before = [*actuator_cells(result, actuators), *result.effector_positions.ravel(), *row.rigid_poses.ravel(),
              *_touch_cells(result), *row.observed]
    forces = np.column_stack([row.pair_resultants, row.pair_magnitude_sums])
    after = [*forces.ravel(), report.residual, report.contact_residual,
             1e3 * report.compute_time]
    return [str(row.step), repr(row.time), *(repr(float(number)) for number in before),
            str(report.contact_count), *(repr(float(number)) for number in after),
            result.status.value]


def _touch_cells(result: StepResult) -> np.ndarray:
    """Force [N] and displacement [m] of each touch, in one row."""
    touches = result.touches
    if touches is None:
        return np.empty(0)
    return np.hstack([touches.forces, touches.displacements]).ravel()


@contextmanager
def direct_run_file(path: Path, simulation: Simulation,
                    observed: Sequence[str] = ()) -> Iterator[Callable[[DirectRow], None]]:
    """Opens a run's file and returns a function that appends a row.

    An older file is replaced when the run has ended; see `output_file`.

    Raises:
        OutputError: The file cannot be written.
    """
    with output_file(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(direct_header(simulation, observed))
        actuators = simulation.actuators
        yield lambda row: writer.writerow(direct_cells(row, actuators))
        file.close()


class DirectSummary:
    """Collects a few numbers of each row for a summary."""

    def __init__(self, simulation: Simulation, hold: tuple[float, float]):
        """Records the state before the run.

        Args:
            simulation: Heights are measured from its present state.
            hold: Start and end of the interval in which creep is measured [s]; NaN for none.
        """
        self._hold = hold
        self._effectors = simulation.effector_names
        self._pairs = pair_names(simulation)
        self._free = [index for index, part in enumerate(simulation.model.rigid) if part.is_free]
        self._free_names = [simulation.model.rigid[index].name for index in self._free]
        gravity = np.array(simulation.scene.gravity)
        weight = np.linalg.norm(gravity)
        self._up = -gravity / weight if weight > 0.0 else np.array([0.0, 0.0, 1.0])
        self._before = rigid_poses(simulation)[self._free, :3]
        self._times: list[float] = []
        self._rigid: list[np.ndarray] = []
        self._tips: list[np.ndarray] = []
        self._resultants: list[np.ndarray] = []
        self._sums: list[np.ndarray] = []
        self._counts: list[int] = []
        self._compute_times: list[float] = []
        self._residual = self.sampled_range = 0.0
        self.statuses: Counter[str] = Counter()
        self.failed = 0

    def add(self, row: DirectRow) -> None:
        """Adds one row."""
        self._times.append(row.time)
        self._rigid.append(row.rigid_poses[self._free, :3])
        self._tips.append(row.result.effector_positions)
        self._resultants.append(np.linalg.norm(row.pair_resultants, axis=1))
        self._sums.append(row.pair_magnitude_sums)
        self._counts.append(row.result.report.contact_count)
        self._compute_times.append(row.result.report.compute_time)
        self._residual = float(np.fmax(self._residual, row.result.report.residual))
        self.sampled_range = max(self.sampled_range, row.result.report.sampled_range)
        self.statuses[row.result.status.value] += 1
        self.failed += row.result.status.is_failure

    def heights(self) -> dict[str, tuple[float, float]]:
        """Greatest rise of each free body [m], and its time [s]."""
        risen = (np.array(self._rigid) - self._before) @ self._up
        return {name: (float(rise.max()), self._times[int(rise.argmax())])
                for name, rise in zip(self._free_names, risen.T, strict=True)}

    def creep(self) -> dict[str, float]:
        """Greatest distance of each body from its position at the start of the hold [m]; empty
        without a hold.

        Bodies are the free bodies or, if there are none, the effectors.
        """
        begin, end = self._hold
        times = np.array(self._times)
        held = np.flatnonzero((times > begin - 1e-9) & (times < end + 1e-9))
        if not held.size:
            return {}
        names, places = self._free_names, np.array(self._rigid)
        if not names:
            names, places = self._effectors, np.array(self._tips)
        distances = np.linalg.norm(places[held] - places[held[0]], axis=2)
        return dict(zip(names, map(float, distances.max(axis=0)), strict=True))

    def lines(self) -> list[tuple[str, str]]:
        """The summary as names and values with units."""
        compute = spread(1e3 * np.array(self._compute_times))
        lines = [("steps", f"{len(self._times)}, {self._times[-1]:.6g} s at their end")]
        lines += [(f"{name}, highest", f"{1e3 * height:+.2f} mm at {time:.2f} s")
                  for name, (height, time) in self.heights().items()]
        begin, end = self._hold
        lines += [(f"{name}, creep while held", f"{1e3 * rise:.3f} mm in {begin:g}..{end:g} s")
                  for name, rise in self.creep().items()]
        lines.append(("contacts, maximum", str(max(self._counts))))
        resultants, sums = np.array(self._resultants), np.array(self._sums)
        for index, (first, second) in enumerate(self._pairs):
            touched = sums[:, index] > 0.0
            if touched.any():
                whole, summed = resultants[touched, index], sums[touched, index]
                lines.append((f"force on {first} by {second}",
                              f"resultant median {np.median(whole):.3f} N, max "
                              f"{whole.max():.3f} N; sum of magnitudes median "
                              f"{np.median(summed):.3f} N, max {summed.max():.3f} N; "
                              f"touching in {100 * touched.mean():.0f} % of steps"))
        lines += [("compute time, median", f"{compute.median:.2f} ms"),
                  ("compute time, p99", f"{compute.p99:.2f} ms"),
                  ("compute time, max", f"{compute.maximum:.2f} ms")]
        lines += [(f"status {name}", f"{count} steps")
                  for name, count in sorted(self.statuses.items())]
        return lines


DEFAULT_RATE = 250.0
"""Default number of steps per second [Hz]."""


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


def simulate_commands(scene: Path, commands: Path, output: Path, rate: float = DEFAULT_RATE,
                      picture: Picture | None = None) -> int:
    """Runs a scene with a commands file and writes the results.

    Args:
        scene: Scene file.
        commands: Commands file, see `read_commands`.
        output: Run file to write, see `direct_run_file`.
        rate: Steps per second [Hz].
        picture: Picture to draw, or None.

    Returns:
        Exit code: 0, or 1 when a step found no solution.

    Raises:
        SoftRobotTwinError: The scene, its mesh, the commands or an output cannot be used.
    """
    simulation = _load_with_notes(scene)
    commanded = read_commands(commands, simulation)
    summary = DirectSummary(simulation, commanded.longest_hold)
    return _run_and_report(simulation, commanded, output, rate, summary, picture)


def simulate_alone(scene: Path, seconds: float, output: Path, rate: float = DEFAULT_RATE,
                   picture: Picture | None = None) -> int:
    """Runs a scene without commands: bodies sag and fall, actuators hold.

    Args:
        scene: Scene file.
        seconds: Duration [s].
        output: Run file to write, see `direct_run_file`; with the columns of `BodyReadouts`.
        rate: Steps per second [Hz].
        picture: Picture to draw, or None.

    Returns:
        Exit code: 0, or 1 when a step found no solution.

    Raises:
        SoftRobotTwinError: The scene, its mesh or an output cannot be used.
    """
    simulation = _load_with_notes(scene)
    summary = DirectSummary(simulation, (math.nan, math.nan))
    return _run_and_report(simulation, no_commands(simulation, seconds), output, rate, summary,
                         picture, BodyReadouts(simulation))


def _load_with_notes(scene: Path) -> Simulation:
    """Builds a scene's simulation and prints its notes."""
    simulation = Simulation.from_scene_file(scene)
    for note in simulation.notes:
        warn(note)
    return simulation


def _run_and_report(simulation: Simulation, commanded: CommandTable, output: Path, rate: float,
                  summary: DirectSummary, picture: Picture | None,
                  body_readouts: BodyReadouts | None = None) -> int:
    simulation.warm_up()
    _run(simulation, commanded, output, rate, summary, picture, body_readouts)
    how = "direct" if body_readouts is None else "no commands"
    made = table(f"{simulation.scene.name}, {how}, {rate:g} Hz", "what", "value")
    lines = summary.lines() + ([] if body_readouts is None else body_readouts.lines())
    for line in lines:
        made.add_row(*line)
    made.add_row("run", str(output))
    if picture is not None:
        made.add_row("picture", str(picture.path))
    console().print(made)
    print_mesh_error(simulation.scene)
    print_reduction_errors(simulation, summary.sampled_range)
    if summary.failed:
        warn(f"{summary.failed} steps found no solution; their rows contain the last safe "
             f"state, see column status of {output}")
    return 1 if summary.failed else 0


def _run(simulation: Simulation, commanded: CommandTable, output: Path, rate: float,
         summary: DirectSummary, picture: Picture | None,
         body_readouts: BodyReadouts | None) -> None:
    """Runs all steps and writes the run file and the picture."""
    count = len(step_times(commanded, rate))
    shots = []
    if picture is not None:
        check_picture(picture.path)  # An error is raised before the run, not after it.
    wanted = _wanted_times(picture, commanded)
    observed = () if body_readouts is None else body_readouts.columns
    with direct_run_file(output, simulation, observed) as write:
        with progress() as bar:
            task = bar.add_task(simulation.scene.name, total=count, note="")
            for row in run_commands(simulation, commanded, rate):
                write(row if body_readouts is None else row._replace(observed=body_readouts.read()))
                summary.add(row)
                bar.update(task, advance=1, note=row.result.status.value)
                while wanted and row.time >= wanted[0] - 1e-9:
                    time = f"{wanted.pop(0):g} s"
                    shots.append(take_snapshot(simulation, row.result.contacts, time))
        if picture is not None:
            draw_snapshots(shots, picture.path, simulation.scene.name, picture.view)


def _wanted_times(picture: Picture | None, commanded: CommandTable) -> list[float]:
    """Times to draw, in increasing order."""
    if picture is None:
        return []
    last = float(commanded.times[-1])
    times: Sequence[float] = picture.times or (last,)
    return sorted(min(time, last) for time in times)
