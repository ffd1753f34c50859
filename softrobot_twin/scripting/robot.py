"""A robot in Python: load or build a scene, step it, run it, look at it.

A `Robot` adds names and units to a `Simulation`; a step of one is a step of the other, to the bit.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.scene import Scene, load_scene, scene_from_mapping
from softrobot_twin.scripting.named_commands import (
    NOTHING,
    CommandReader,
    NamedCommand,
    hold,
)
from softrobot_twin.scripting.run_table import RunColumns, Table
from softrobot_twin.scripting.step_outcome import Names, Pose, Result
from softrobot_twin.simulation import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    State,
    Status,
)
from softrobot_twin.simulation.input_tables import read_commands
from softrobot_twin.study.direct_run import DEFAULT_RATE, rigid_poses, run_commands
from softrobot_twin.study.equilibrium import STILL
from softrobot_twin.study.passive_run import no_commands

TIME_STEP = 0.02
"""Default duration of a step [s]."""
MOST_STEPS = 1000
"""Steps in which `Robot.settle` waits for rest, by default."""
# A target this many sizes of the robot away is probably in millimetres.
_FAR = 10.0
# Names of a robot's parts that its short text shows, at most.
_MOST_NAMES = 6

AnyCommand: TypeAlias = NamedCommand | Command


class SceneWarning(UserWarning):
    """Something about a scene, or about what it is asked, looks wrong."""


def load(path: Path | str) -> Robot:
    """Reads a scene file and builds its robot, at rest.

    Args:
        path: YAML file; see docs/scene.md.

    Raises:
        SceneError: The file cannot be read, or an entry is not valid.
        MeshError: A mesh cannot be used.
    """
    return Robot(load_scene(path))


def build(**entries: Any) -> Robot:
    """Builds a robot from the entries of a scene, without a file.

    Args:
        **entries: The keys of a scene file, such as ``name="finger"``, ``body={...}`` and
            ``cables=[...]``. Numpy arrays may stand for lists. Files are relative to the working
            directory.

    Raises:
        SceneError: An entry is not valid; the error names ``<python>`` as its file.
        MeshError: A mesh cannot be used.
    """
    return Robot(scene_from_mapping(_plain(entries), IN_PYTHON))


IN_PYTHON = Path("<python>")
"""What errors name as the file of a scene that was built in Python."""


def _plain(value: Any) -> Any:
    """The same entries as a scene file would give them: lists, numbers, words."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, Path) else value


class Robot:
    """One scene that can be stepped by names and units.

    It is complete: a copy, also by `copy.copy` or through `pickle`, stands at the same state and
    continues in the same way.

    Attributes:
        simulation: What steps underneath.
    """

    simulation: Simulation

    def __init__(self, scene: Scene, state: State | None = None):
        """Build the simulation, and compile and run every path of a step once.

        Args:
            scene: The scene.
            state: Where it stands; None for rest.

        Raises:
            SceneError: An entry does not fit the mesh.
            MeshError: A mesh cannot be used.
        """
        self.simulation = Simulation(scene)
        for note in self.simulation.notes:
            warnings.warn(note, SceneWarning, stacklevel=3)
        self.simulation.warm_up()
        self._reader = CommandReader(self.simulation)
        self._columns = RunColumns(self.simulation)
        self._names = Names(
            self.simulation.effector_names, self.simulation.actuator_names,
            self.simulation.rigid_names, self.simulation.touch_names,
        )  # fmt: skip
        self._by_effort: np.ndarray | None = None
        self._has_warned = False
        if state is not None:
            self.simulation.restore(state)

    # --- what it is ------------------------------------------------------------------------------

    @property
    def scene(self) -> Scene:
        """Its scene."""
        return self.simulation.scene

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.simulation.scene.name

    @property
    def effector_names(self) -> tuple[str, ...]:
        """Names of the effectors."""
        return self.simulation.effector_names

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return self.simulation.actuator_names

    @property
    def setpoint_names(self) -> tuple[str, ...]:
        """Names that `setpoints` takes, such as ``north_shortening_m``."""
        return self._reader.setpoint_names

    @property
    def effort_names(self) -> tuple[str, ...]:
        """Names that `efforts` takes, such as ``north_tension_N``."""
        return self._reader.effort_names

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of effectors that `targets` takes, such as ``tip`` and ``tip_quaternion``."""
        return self._reader.target_names

    def __repr__(self) -> str:
        simulation, scene = self.simulation, self.simulation.scene
        cells = ((simulation.tet_count, "tetrahedra"), (simulation.hexahedron_count, "hexahedra"),
                 (simulation.beam_element_count, "beam elements"))  # fmt: skip
        parts = [f"{count} {word}" for count, word in cells if count]
        bodies = [body.name for body in simulation.model.bodies]
        bodies += [beam.name for beam in simulation.model.beams]
        parts += [_listed("mass-spring bodies", [entry.name for entry in scene.mass_springs])]
        parts = [_listed("bodies", bodies), *parts]
        parts.append(_listed("rigid bodies", self._names.rigid_bodies))
        parts += [_listed(section.replace("_", " "), [entry.name for entry in entries])
                  for section, entries in scene.actuator_entries.items()]
        parts.append(_listed("effectors", self._names.effectors))
        parts.append(_listed("touches", self._names.touches))
        parts.append(f"{simulation.dof_count} unknowns")
        if simulation.state.step_count:
            parts.append(f"after {simulation.state.time:.6g} s")
        return f"<Robot {self.name}: {'; '.join(part for part in parts if part)}>"

    # --- where it stands -------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """Where it stands; another state of the same scene may be put in its place.

        Raises:
            CommandError: The state is of another scene.
        """
        return self.simulation.state

    @state.setter
    def state(self, state: State) -> None:
        self.simulation.restore(state)

    @property
    def time(self) -> float:
        """Time since it was at rest [s]."""
        return self.simulation.state.time

    @property
    def positions(self) -> np.ndarray:
        """Positions of all nodes [m], then of the points of frames, shape (node_count, 3)."""
        return self.simulation.state.positions

    @property
    def effectors(self) -> dict[str, np.ndarray]:
        """Position of each effector [m], by name, each of shape (3,)."""
        positions = self.simulation.effector_positions()
        return dict(zip(self._names.effectors, positions, strict=True))

    @property
    def poses(self) -> dict[str, Pose]:
        """Pose of each rigid body, by name."""
        poses = rigid_poses(self.simulation)
        return {name: Pose(pose[:3], pose[3:])
                for name, pose in zip(self._names.rigid_bodies, poses, strict=True)}

    def reset(self) -> None:
        """Goes back to rest. What follows is the same, to the bit, as the first time."""
        self.simulation.reset()
        self._by_effort = None

    # --- steps -----------------------------------------------------------------------------------

    def step(
        self,
        command: AnyCommand | None = None,
        *,
        time_step: float = TIME_STEP,
        poses: Mapping[str, Any] = NOTHING,
        touches: Mapping[str, Any] = NOTHING,
    ) -> Result:
        """Advances by one command.

        Args:
            command: What is asked: `targets`, `setpoints`, `efforts` or `hold`; None holds.
            time_step: Duration of the step [s]; rates of actuators and motion depend on it.
            poses: Where guided bodies shall go, by name: a position [m], or a pair of it and a
                quaternion (x, y, z, w). They go no faster than the scene allows, and bodies without
                a new pose go on to their last one.
            touches: What is measured of a finger, by name and unit: ``fingertip_force_N``,
                ``fingertip_displacement_m`` or ``fingertip_place_m``, 3 numbers each.

        Returns:
            The outcome. Where no solution was found its status says so, and the robot stays.

        Raises:
            CommandError: A name is unknown, or a value does not fit it; the robot is as before.
        """
        asked = self._reader.read(hold() if command is None else command, _duration(time_step))
        aims = self._reader.poses(poses)
        touched = self._reader.touches(touches)
        self._warn_of_far_targets(asked)
        for aim in aims:
            self.simulation.model.guides.aim(*aim)
        before = self.simulation.state.positions
        outcome = self.simulation.step(asked, None, touched)
        self._by_effort = np.isfinite(asked.efforts) if isinstance(asked, CommandEfforts) else None
        return Result(
            outcome, self._names, self._columns, self._columns.cells(outcome), self.poses,
            self._is_at_rest(before, outcome.report.residual, outcome.status),
        )  # fmt: skip

    def settle(
        self,
        command: AnyCommand | None = None,
        *,
        time_step: float = TIME_STEP,
        most_steps: int = MOST_STEPS,
        poses: Mapping[str, Any] = NOTHING,
        touches: Mapping[str, Any] = NOTHING,
    ) -> Result:
        """Steps by the same command until nothing moves any more.

        Args:
            command: See `step`.
            time_step: See `step`.
            most_steps: Ends after as many steps, wherever the robot is.
            poses: See `step`.
            touches: See `step`.

        Returns:
            The last step; `Result.is_at_rest` tells whether it came to rest.

        Raises:
            CommandError: See `step`.
        """
        for _ in range(_count("most_steps", most_steps)):
            result = self.step(command, time_step=time_step, poses=poses, touches=touches)
            if result.is_at_rest:
                break
        return result

    def _is_at_rest(self, before: np.ndarray, residual: float, status: Status) -> bool:
        """Whether a step ended in balance and moved nothing."""
        if status.is_failure or status is Status.RATE_LIMITED:
            return False
        if residual > self.scene.solver.residual_tolerance:
            return False
        size = self.simulation.model.nodes.size
        still = STILL * (size if math.isfinite(size) else 1.0)
        return bool(np.abs(self.positions - before).max(initial=0.0) <= still)

    def _warn_of_far_targets(self, asked: Command) -> None:
        if self._has_warned or not isinstance(asked, FollowTargets):
            return
        size = self.simulation.model.nodes.size
        offsets = np.linalg.norm(asked.targets - self.simulation.effector_positions(), axis=1)
        offsets = offsets[np.isfinite(offsets)]
        if len(offsets) and math.isfinite(size) and offsets.max() > _FAR * size:
            self._has_warned = True
            warnings.warn(f"a target is {offsets.max():.3g} m away from its effector, and the robot "
                          f"is {size:.3g} m large: are the targets in metres?", SceneWarning,
                          stacklevel=3)

    # --- runs ------------------------------------------------------------------------------------

    def run(
        self,
        command: AnyCommand | Iterable[AnyCommand] | Path | str | None = None,
        *,
        steps: int | None = None,
        seconds: float | None = None,
        rate: float | None = None,
        poses: Mapping[str, Any] = NOTHING,
        touches: Mapping[str, Any] = NOTHING,
    ) -> Table:
        """Runs from where the robot stands, and returns a table with a row for each step.

        Args:
            command: One command that is given in each step; several, one for each step; a commands
                file; or None for a run without commands, whose table has the places of bodies and
                the energies too.
            steps: Number of steps, for one command; by default one.
            seconds: Duration in place of `steps` [s]; required without a command.
            rate: Steps per second [Hz]; by default 50, for files and without commands 250.
            poses: See `step`; for all steps.
            touches: See `step`; for all steps.

        Returns:
            A `pandas.DataFrame` where pandas is installed, otherwise a structured numpy array. Its
            columns are those of the files that ``simulate`` writes.

        Raises:
            CommandError: See `step`; or the arguments contradict each other.
            TableFileError: The file cannot be used.
        """
        if isinstance(command, Path | str):
            _refuse("run", "a file", steps=steps, seconds=seconds, poses=poses, touches=touches)
            table = read_commands(command, self.simulation)
            rows = run_commands(self.simulation, table, _rate(rate, DEFAULT_RATE))
            return self._columns.table([self._columns.row(*row[:3]) for row in rows])
        if command is None:
            return self._run_alone(steps, seconds, rate, poses, touches)
        if isinstance(
            command, NamedCommand | FollowTargets | CommandSetpoints | CommandEfforts | Hold
        ):
            count = _step_count(steps, seconds, _rate(rate, 1.0 / TIME_STEP))
            commands: Iterator[AnyCommand] = iter([command] * count)
        else:
            _refuse("run", "a list of commands", steps=steps, seconds=seconds)
            commands = iter(command)  # type: ignore[arg-type]
        time_step = 1.0 / _rate(rate, 1.0 / TIME_STEP)
        return self._run_each(commands, time_step, poses, touches)

    def _run_each(
        self, commands: Iterator[AnyCommand], time_step: float, poses: Mapping[str, Any],
        touches: Mapping[str, Any],
    ) -> Table:  # fmt: skip
        rows = []
        for step, command in enumerate(commands):
            outcome = self.step(command, time_step=time_step, poses=poses, touches=touches).outcome
            rows.append(self._columns.row(step, (step + 1) * time_step, outcome))
        return self._columns.table(rows)

    def _run_alone(
        self, steps: int | None, seconds: float | None, rate: float | None,
        poses: Mapping[str, Any], touches: Mapping[str, Any],
    ) -> Table:  # fmt: skip
        rate = _rate(rate, DEFAULT_RATE)
        count = _step_count(steps, seconds, rate)
        columns = RunColumns(self.simulation, with_bodies=True)
        if poses or touches:
            return self._run_each(iter([hold()] * count), 1.0 / rate, poses, touches)
        table = no_commands(self.simulation, count / rate if seconds is None else seconds)
        rows = run_commands(self.simulation, table, rate)
        return columns.table([columns.row(*row[:3]) for row in rows])


def _listed(word: str, names: Iterable[str]) -> str:
    """Names of parts of one kind, as text; empty without any."""
    names = list(names)
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return f"{word} {', '.join(names[:_MOST_NAMES])}{more}"


def _duration(time_step: float) -> float:
    try:
        number = float(time_step)
    except (TypeError, ValueError):
        raise CommandError("time_step", f"must be a number of seconds, not {time_step!r}") from None
    if not (math.isfinite(number) and number >= 0.0):
        raise CommandError("time_step", f"{time_step} s is not a duration")
    return number


def _rate(rate: float | None, default: float) -> float:
    if rate is None:
        return default
    if not (math.isfinite(rate) and rate > 0.0):
        raise CommandError("rate", f"{rate} Hz must be above 0")
    return float(rate)


def _count(name: str, count: int) -> int:
    if int(count) != count or count < 1:
        raise CommandError(name, f"{count} must be a whole number above 0")
    return int(count)


def _step_count(steps: int | None, seconds: float | None, rate: float) -> int:
    """Number of steps, by one of both."""
    if steps is not None and seconds is not None:
        raise CommandError("seconds", "is given beside steps: give one of them")
    if seconds is None:
        return 1 if steps is None else _count("steps", steps)
    if not (math.isfinite(seconds) and seconds > 0.0):
        raise CommandError("seconds", f"{seconds} s must be above 0")
    # The small number prevents an additional step due to rounding.
    return max(1, math.ceil(seconds * rate - 1e-9))


def _refuse(word: str, what: str, **given: Any) -> None:
    """Refuses arguments that have no meaning with others."""
    for name, value in given.items():
        if value is not None and value is not NOTHING:
            raise CommandError(name, f"has no meaning where {word} takes {what}")


