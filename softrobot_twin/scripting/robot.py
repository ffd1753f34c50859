"""A robot in Python: load or build a scene, step it, run it, look at it.

A `Robot` adds names and units to a `Simulation`; a step of one is a step of the other, to the bit.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, cast

import numpy as np

from softrobot_twin.analysis.apparent_compliance import ApparentCompliance, EffectorCompliance
from softrobot_twin.analysis.linear_model import LinearModel, ModalTangent
from softrobot_twin.analysis.sensitivities import Sensitivities
from softrobot_twin.calibration.calibration import Calibration, Given, calibrate
from softrobot_twin.calibration.calibration_report import measured_poses
from softrobot_twin.calibration.design import DesignModel, Objective
from softrobot_twin.control.force_observer import ForceObserver
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.errors import MOST_COUNTED, CommandError
from softrobot_twin.harness.equilibrium import is_at_rest
from softrobot_twin.harness.figure import load_pyplot
from softrobot_twin.harness.output_file import writing
from softrobot_twin.scene import Scene, load_scene, scene_from_mapping
from softrobot_twin.scene.scene_parameters import Parameter, changed_scene, parameters
from softrobot_twin.scripting.entries_in_python import IN_PYTHON, plain_entries
from softrobot_twin.scripting.labelled_matrix import LabelledMatrix
from softrobot_twin.scripting.mesh_export import export_mesh
from softrobot_twin.scripting.named_commands import (
    NOTHING,
    Aim,
    CommandReader,
    NamedCommand,
    check_given,
    finite_numbers,
    hold,
    one_number,
    place_of,
    positive_number,
    read_pose,
    whole_number,
)
from softrobot_twin.scripting.named_design import (
    Bounds,
    Design,
    Variables,
    Wanted,
    optimised,
    poses_of,
    variables_of,
)
from softrobot_twin.scripting.robot_view import RobotView
from softrobot_twin.scripting.run_table import (
    ColumnsOfSteps,
    Table,
    common_targets,
    run_table,
)
from softrobot_twin.scripting.step_outcome import Result
from softrobot_twin.simulation import (
    Command,
    CommandEfforts,
    FollowTargets,
    Hold,
    Simulation,
    State,
    StepResult,
)
from softrobot_twin.simulation.appearance import Pose
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.simulation.command import DEFAULT_TIME_STEP
from softrobot_twin.study import direct_run
from softrobot_twin.study.direct_run import DEFAULT_RATE, run_commands
from softrobot_twin.study.offline_run import columns_of, commands_of, unlikely_warning
from softrobot_twin.study.offline_run import run as run_targets
from softrobot_twin.study.passive_run import BodyReadouts, no_commands
from softrobot_twin.study.scene_picture import draw_snapshots, figure_of, take_snapshot
from softrobot_twin.tables.column_names import position_columns
from softrobot_twin.tables.input_tables import (
    TARGETS_EXAMPLE,
    open_columns,
    read_commands,
    read_targets,
)
from softrobot_twin.tables.run_columns import RunColumns, RunRow

if TYPE_CHECKING:
    from softrobot_twin.simulation.result import ContactForces

MOST_STEPS = 1000
"""Steps in which `Robot.settle` waits for rest, by default."""
# Names of a robot's parts that its short text shows, at most.
_MOST_NAMES = 6

AnyCommand: TypeAlias = NamedCommand | Command


class SceneWarning(UserWarning):
    """Something about a scene, or about what it is asked, looks wrong."""


def load(path: Path | str, changes: Mapping[str, Any] | None = None) -> Robot:
    """Reads a scene file and builds its robot, at rest.

    Args:
        path: YAML file; see docs/scene_reference.md. Paths that begin with ``config/`` name the
            package's own scenes in every folder that has no such file.
        changes: Other values of its entries, such as ``{"body.material.young_modulus": 2e5}``;
            None for those of the file.

    Raises:
        SceneError: The file cannot be read, or an entry is not valid.
        MeshError: A mesh cannot be used.
    """
    return _with_notes(Robot(load_scene(path, plain_entries(changes))))


def build(**entries: Any) -> Robot:
    """Builds a robot from the entries of a scene, without a file.

    Args:
        **entries: The keys of a scene file, such as ``name="finger"``, ``body={...}`` and
            ``cables=[...]``. Arrays may stand for lists, and a `meshio.Mesh` or a pair of points
            and cells for a mesh file. Files are relative to the working directory.

    Raises:
        SceneError: An entry is not valid; the error names ``<python>`` as its file.
        MeshError: A mesh cannot be used.
    """
    return _with_notes(Robot(scene_from_mapping(plain_entries(entries), IN_PYTHON)))


def _with_notes(robot: Robot) -> Robot:
    """A robot, after warnings of what was repaired and of what looks wrong in its scene."""
    for note in robot.simulation.notes:
        warnings.warn(note, SceneWarning, stacklevel=3)
    return robot


def _rebuilt(scene: Scene, state: State, aims: Mapping[str, Aim]) -> Robot:
    """A robot at a state, with guided bodies on their way to poses."""
    robot = Robot(scene, state)
    robot._aim(aims)
    return robot


class ExternalForce(NamedTuple):
    """A force on the robot that nobody modelled, as markers tell it.

    Attributes:
        force: The force [N], shape (3,).
        torque: Torque about its place [N m], zero but on a rigid body, shape (3,).
        deviations: Standard deviations of both, shape (6,).
        place: Where it acts [m], shape (3,).
        is_detected: Whether it is larger than noise makes it.
    """

    force: np.ndarray
    torque: np.ndarray
    deviations: np.ndarray
    place: np.ndarray
    is_detected: bool


class Robot:
    """One scene that can be stepped by names and units.

    It is complete: a copy, also by `copy.copy` or through `pickle`, stands at the same state and
    takes the same steps. Where things touch these differ within the tolerance of contacts, because
    their solver begins anew.

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
        check_given("scene", scene, Scene, "a scene, as that of a robot")
        simulation = Simulation(scene)
        simulation.warm_up()
        self._has_warned = False
        self._take(simulation)
        if state is not None:
            self.simulation.restore(state)

    def _take(self, simulation: Simulation) -> None:
        """Steps a simulation from now on, without the last command of another one."""
        self.simulation = simulation
        self._reader = CommandReader(simulation)
        self._columns = ColumnsOfSteps(simulation)
        self._compliance: EffectorCompliance | None = None
        self._observer = None if simulation.scene.observer is None else ForceObserver(simulation)
        self._sensitivities: Sensitivities | None = None
        self._view: RobotView | None = None
        self._forget()

    def _forget(self) -> None:
        """Forgets the last command and its result."""
        self._by_effort: np.ndarray | bool = False
        self._targets: np.ndarray | None = None
        self._contacts: ContactForces | None = None
        self._aims: dict[str, Aim] = {}
        if self._observer is not None:
            self._observer.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (self.scene, self.state, self._aims)

    def copy(self) -> Robot:
        """Another robot of the same scene at the same state; it is built anew.

        Its solvers begin anew from the efforts of the state, as they do after `state` is set: where
        friction or spare actuators leave more than one answer to a command, it may take another
        one.
        """
        return _rebuilt(self.scene, self.state, self._aims)

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
        return f"<Robot {self.name}: {self._summary()}>"

    def _summary(self) -> str:
        """What it is made of, in one line."""
        simulation, scene = self.simulation, self.simulation.scene
        cells = ((simulation.tet_count, "tetrahedra"), (simulation.hexahedron_count, "hexahedra"),
                 (simulation.beam_element_count, "beam elements"))  # fmt: skip
        parts = [f"{count} {word}" for count, word in cells if count]
        bodies = [one.name for one in (*simulation.model.bodies, *simulation.model.beams)]
        parts += [_listed("mass-spring bodies", [entry.name for entry in scene.mass_springs])]
        parts = [_listed("bodies", bodies), *parts]
        parts.append(_listed("rigid bodies", simulation.rigid_names))
        parts += [_listed(section.replace("_", " "), [entry.name for entry in entries])
                  for section, entries in scene.actuator_entries.items()]
        parts.append(_listed("effectors", self.effector_names))
        parts.append(_listed("touches", simulation.touch_names))
        parts.append(f"{simulation.dof_count} unknowns")
        if simulation.state.step_count:
            parts.append(f"after {simulation.state.time:.6g} s")
        return "; ".join(part for part in parts if part)

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
        self._forget()

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
        return dict(zip(self.effector_names, positions, strict=True))

    @property
    def poses(self) -> dict[str, Pose]:
        """Pose of each rigid body, by name."""
        return self.simulation.poses()

    # --- its numbers -----------------------------------------------------------------------------

    def parameters(self, *keys: str) -> tuple[Parameter, ...]:
        """Handles of the numbers of its scene, such as ``body.material.young_modulus``.

        Args:
            *keys: Keys, perhaps with ``*``, such as ``cables.*.rate``; of a list or a section, all
                numbers in it. All of the scene where none is given.

        Returns:
            Each with ``key``, ``unit``, and ``read(robot.scene)``.

        Raises:
            SceneError: No number has such a key.
        """
        return parameters(self.scene, *keys)

    def change(self, values: Mapping[str, Any]) -> None:
        """Gives entries of its scene other values, at the same state; nothing is compiled again.

        Actuators keep their setpoints, and nodes that rest elsewhere their displacements. The next step brings the robot to its new equilibrium.

        Args:
            values: By their keys, such as ``{"body.material.young_modulus": 2e5}``.

        Raises:
            SceneError: There is no such key, or the scene does not take the value: nothing changes.
            CommandError: Its bodies would have other unknowns, which its state does not fit.
            MeshError: A mesh cannot be used.
        """
        # Its kernels are compiled already, so its steps set up what they need: there is no warm-up.
        scene, mounted = changed_scene(self.scene, plain_entries(values)), self.simulation.mounted
        simulation = Simulation(scene, with_warnings=False, mounted=mounted)
        simulation.take_over(self.simulation)
        if self._view is not None:
            self._view.close()
        self._take(simulation)

    @property
    def sensitivities(self) -> Sensitivities:
        """Solves for the answers of its equilibrium to loads, and their adjoint; see there."""
        if self._sensitivities is None:
            self._sensitivities = Sensitivities(self.simulation)
        self._sensitivities.by_effort = self._by_effort
        return self._sensitivities

    def sensitivity(self, *keys: str, holds_setpoints: bool | np.ndarray = True) -> LabelledMatrix:
        """Derivatives of the positions of the effectors by numbers of the scene, in balance.

        Args:
            *keys: See `parameters`.
            holds_setpoints: Whether actuators hold their setpoints, such as the lengths of cables;
                else their displacements from rest, such as shortenings. Of all, or of each,
                shape (actuator_count,).

        Returns:
            Rows ``tip_x_m`` and so on, a column for each key.

        Raises:
            SceneError: No number has such a key.
            SensitivityError: A derivative does not exist at this state.
        """
        found = self.sensitivities.of_parameters(self.parameters(*keys), holds_setpoints)
        rows = [f"{name}_{axis}_m" for name in self.effector_names for axis in "xyz"]
        return LabelledMatrix(found.effectors.reshape(len(rows), -1), tuple(rows), tuple(
            one.key for one in found.parameters), "change of the effectors [m] by one unit of a parameter")

    def optimise(
        self, objective: Wanted | Objective, parameters: Variables,
        bounds: Bounds | tuple[float, float], commands: Sequence[NamedCommand] = (),
        tolerance: float | None = None,
    ) -> Design:  # fmt: skip
        """Finds numbers of the scene by which its poses are as wanted; the robot stays as it is.

        Args:
            objective: One of these:

                - pairs of a command and wanted positions of effectors [m], such as
                  ``[(st.setpoints(flexor_shortening_m=0.01), {"tip": [0.09, None, -0.02]}), ...]``;
                - a function that is made as small as possible. It takes `Equilibria` of all
                  commands and returns its value and its derivatives by them, as `Equilibria`.

            parameters: Keys, perhaps with ``*``; or names, each with a key, or with several keys and
                shares by which these change together: ``{"height": {"cables[0].points[0][2]": 1.0,
                "cables[0].points[1][2]": 0.5}}`` is 0 at first.
            bounds: Least and greatest value of each, by key or name; or one pair for all.
            commands: Poses of a function, each from rest.
            tolerance: Change of the objective that does not matter: of places, RMS, by default
                0.1 mm; of a function by default 1 % of what the design gains.

        Returns:
            The design: values, flatness, a scene.

        Raises:
            DesignError: The robot itself has no such poses, or an actuator is at its limit there;
                the error names the actuator, the pose and the limit.
            SceneError: No number has such a key.
            CommandError: A command or a wanted position does not fit the robot.
            SensitivityError: A derivative does not exist.
        """
        return optimised(self.scene, objective, parameters, bounds, commands, tolerance)

    def design_model(self, parameters: Variables, commands: Sequence[NamedCommand]) -> DesignModel:
        """Poses of the robot as a differentiable function of numbers of its scene.

        Args:
            parameters: See `optimise`.
            commands: Of each pose, each from rest.

        Returns:
            What solves them at values of the variables, and gives derivatives and their adjoint.

        Raises:
            SceneError: No number has such a key.
            CommandError: A command does not fit the robot.
        """
        return DesignModel(self.scene, variables_of(self.scene, parameters), poses_of(self.scene, commands))

    def calibrate(
        self, data: Any, fit: Iterable[str] = (), known: Mapping[str, Given] | None = None,
        check: Any = (),
    ) -> Calibration:  # fmt: skip
        """Fits numbers of its scene to what was measured at rest; the robot stays as it is.

        Args:
            data: A recorded run (.mcap), a table (.csv, a `pandas.DataFrame` or a dict) with setpoints,
                markers such as ``marker_4_x_m``, and efforts, or a list of these or of `RestPose`.
            fit: Keys of the numbers, see `softrobot_twin.scene.scene_parameters.tied`. None for those that
                lower the error of poses held back.
            known: What is known before by keys: standard deviations in their units, as shares of moduli,
                stiffnesses and densities; or a value and its deviation.
            check: Data that judge the result, in place of every fourth pose.

        Returns:
            The numbers with their intervals and errors at poses that were held back. Where it
            `is_accepted`, ``robot.change(found.values)`` uses them.

        Raises:
            SceneError: No number has such a key, or the robot has no statics.
            CalibrationError: The poses are too few, or a number cannot be fitted.
        """
        poses, judges = (measured_poses(one, self.simulation)[0] for one in (data, check))
        known = {} if known is None else known
        check_given("known", known, Mapping, "deviations by keys")
        return calibrate(self.scene, poses, list(fit), known, judges)

    def reset(self) -> None:
        """Goes back to rest. What follows is the same, to the bit, as the first time."""
        self.simulation.reset()
        self._forget()

    # --- steps -----------------------------------------------------------------------------------

    def step(
        self,
        command: AnyCommand | None = None,
        *,
        time_step: float = DEFAULT_TIME_STEP,
        poses: Mapping[str, Any] = NOTHING,
        touches: Mapping[str, Any] = NOTHING,
        grips: Mapping[str, Any] = NOTHING,
        base: Any = None,
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
            grips: Whether grips shall hold, by name, from this step on; others go on as they were told.
            base: Where a moving base is at the end of the step: a position [m], or a pair of it and a
                quaternion. Its acceleration follows from the poses of the steps before.

        Returns:
            The outcome. Where no solution was found its status says so, and the robot stays.

        Raises:
            CommandError: A name is unknown, or a value does not fit it; the robot is as before.
        """
        time_step = positive_number("time_step", time_step, "s")
        asked = self._reader.read(hold() if command is None else command, time_step)
        aims = self._reader.poses(poses)
        touched = self._reader.touches(touches)
        self._warn_of_unlikely(asked)
        check_given("grips", grips, Mapping, "names, such as palm=True")
        for name, holds in grips.items():
            place_of(name, "grips:", self.simulation.grip_names)
            if not isinstance(holds, bool | np.bool_):
                raise CommandError(name, f"{holds!r:.40} must be True to hold, or False to let go")
        self._aim(aims)
        for name, holds in grips.items():
            self.simulation.grip(name, holds)
        if base is not None:
            self.simulation.move_base(*read_pose("base", base), self.time + time_step)
        before = self.simulation.state.positions
        measured: list[Any] = [] if touched is None else [touched]
        if self._observer is not None:
            measured.append(self._observer.found)
        outcome = self.simulation.step(asked, None, measured)
        self._remember(outcome, asked)
        return Result(
            outcome, self.simulation, self._columns.of(asked), asked,
            is_at_rest(self.simulation, outcome, before),
        )  # fmt: skip

    def observe(
        self, markers: Any = NOTHING, noise: float = 1.0e-4, sensors: Mapping[str, Any] = NOTHING
    ) -> dict[str, ExternalForce]:
        """Finds forces that nobody modelled from measured markers and sensors; the next steps bear them.

        The robot must stand where the real one was when they were measured. A scene with an
        ``observer`` says which forces are looked for; see `docs/observer.md`.

        Args:
            markers: Measured places in the frame of the cameras [m]: by marker id, or one of each marker in
                the scene's order, shape (marker_count, 3), NaN for hidden ones.
            noise: Standard deviation of each coordinate [m], where the scene gives none.
            sensors: Measured values of sensors by their columns, such as ``spine_length_m``.

        Returns:
            The forces by name.

        Raises:
            CommandError: The scene has no observer, or a marker or sensor is not known.
        """
        observer, simulation = self._observer, self.simulation
        if observer is None:
            raise CommandError("observe", "the scene has no observer: load it with {\"observer\": {}}")
        seen = simulation.scene.marker_frame.of_robot(self._reader.markers(markers))
        columns = list(simulation.sensor_columns)
        told = np.full(len(columns), np.nan)
        check_given("sensors", sensors, Mapping, "names, such as spine_length_m=0.1")
        for column_of, value in sensors.items():
            told[place_of(column_of, "sensors:", columns)] = one_number(column_of, value)
        simulation.finish_result()
        observer.look()
        model = observer.moment(simulation.marker_positions(), simulation.effector_positions())
        stamp = max(round(NANOSECONDS * self.time), observer.stamp + 1)
        observer.update(seen, model, positive_number("noise", noise, "m"), stamp, sensors=told)
        return {name: ExternalForce(*row) for name, *row in zip(
            observer.names, observer.found.wrenches[:, :3], observer.found.wrenches[:, 3:],
            observer.found.deviations, observer.places, map(bool, observer.found.is_detected), strict=True)}

    def _remember(self, outcome: StepResult, command: Command) -> None:
        """Takes what pictures and read-outs need of a step, and shows it."""
        self._by_effort = np.isfinite(command.efforts) if isinstance(command, CommandEfforts) else False
        self._targets = command.targets if isinstance(command, FollowTargets) else None
        self._contacts = outcome.contacts
        if self._view is not None:
            self._view.show(outcome, command)

    def _aim(self, aims: Mapping[str, Aim]) -> None:
        """Sends guided bodies to poses; they go on to these in later steps."""
        guides: Any = self.simulation.model.guides
        for name, aim in aims.items():
            guides.aim(name, *aim)
        self._aims |= aims

    def settle(
        self,
        command: AnyCommand | None = None,
        *,
        time_step: float = DEFAULT_TIME_STEP,
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
        for _ in range(whole_number("most_steps", most_steps)):
            result = self.step(command, time_step=time_step, poses=poses, touches=touches)
            if result.is_at_rest:
                break
        return result

    def _warn_of_unlikely(self, asked: Command) -> None:
        """Warns once of targets, setpoints or efforts that suggest a wrong unit."""
        if not self._has_warned and (words := unlikely_warning(self.simulation, [asked])):
            self._has_warned = True
            warnings.warn(words, SceneWarning, stacklevel=3)

    # --- runs ------------------------------------------------------------------------------------

    def run(
        self,
        command: AnyCommand | Iterable[AnyCommand] | Path | str | Table | None = None,
        *,
        steps: int | None = None,
        seconds: float | None = None,
        rate: float | None = None,
        poses: Mapping[str, Any] = NOTHING,
        touches: Mapping[str, Any] = NOTHING,
    ) -> Table:
        """Runs from where the robot stands, and returns a table with a row for each step.

        Args:
            command: One of these:

                - a command that is given in each step;
                - a list of commands, one for each step;
                - a file, or a table of columns by name such as a `pandas.DataFrame` or a dict. With
                  targets of effectors, or as an earlier run wrote it, each row is a step, as by
                  ``simulate --targets``. Otherwise these are commands at increasing times, between
                  which the steps interpolate, as by ``simulate --commands``;
                - None for a run without commands, whose table has the places of bodies and the
                  energies too.

            steps: Number of steps, for one command; by default one.
            seconds: Duration in place of `steps` [s].
            rate: Steps per second [Hz]; by default 50.
            poses: See `step`; for all steps.
            touches: See `step`; for all steps.

        Returns:
            A `pandas.DataFrame` where pandas is installed, otherwise a structured numpy array. Its
            columns are those of the files that ``simulate`` writes.

        Raises:
            CommandError: See `step`; or the arguments contradict each other.
            TableFileError: The file or table cannot be used.
        """
        if _is_table(command):
            _refuse("a table of commands", steps=steps, seconds=seconds, poses=poses, touches=touches)
            return self._run_table(command, rate)
        if command is None and not self._reader.poses(poses) and self._reader.touches(touches) is None:
            return self._run_alone(steps, seconds, _rate(rate))
        hertz = _rate(rate)
        if command is None or isinstance(command, NamedCommand | Command):
            commands = [hold() if command is None else command] * _step_count(steps, seconds, hertz)
        else:
            check_given("run", command, Iterable, "commands, a file or a table")
            _refuse("a list of commands", steps=steps, seconds=seconds)
            commands = list(cast(Iterable[AnyCommand], command))
        return self._run_each(commands, 1.0 / hertz, poses, touches)

    def _run_each(
        self, commands: list[AnyCommand], time_step: float, poses: Mapping[str, Any],
        touches: Mapping[str, Any],
    ) -> Table:  # fmt: skip
        """A run by one command a step; all are checked before the first step."""
        read = [self._reader.read(command, time_step) for command in commands]
        columns = RunColumns(self.simulation, common_targets(read))
        rows = []
        for index, command in enumerate(commands):
            result = self.step(command, time_step=time_step, poses=poses, touches=touches)
            rows.append(columns.row(index, (index + 1) * time_step, result.outcome, read[index]))
        return run_table(columns, rows)

    def _run_table(self, source: Any, rate: float | None) -> Table:
        """A run by a file or a table of columns."""
        if isinstance(source, np.ndarray):
            source = {name: source[name] for name in source.dtype.names or ()}
        rows: Iterator[RunRow]
        if not self._is_by_rows(source):
            commanded = read_commands(source, self.simulation)
            if unlikely := unlikely_warning(self.simulation, direct_run.commands_of(commanded)):
                warnings.warn(unlikely, SceneWarning, stacklevel=4)
            columns = RunColumns(self.simulation)
            rows = run_commands(self.simulation, commanded, _rate(rate), columns)
            end = commanded.times[-1]
            self._aims |= {name: pose.at(end) for name, pose in commanded.poses.items()}
            return self._collected(columns, rows)
        _refuse("targets, of which each row is a step,", rate=rate)
        table = read_targets(source, self.simulation)
        if unlikely := unlikely_warning(self.simulation, commands_of(table)):
            warnings.warn(unlikely, SceneWarning, stacklevel=4)
        columns = columns_of(self.simulation, table)
        return self._collected(columns, run_targets(self.simulation, table, 0, columns))

    def _is_by_rows(self, source: Any) -> bool:
        """Whether each row of a table is a step: it has targets, or a run wrote it."""
        columns = open_columns(source, TARGETS_EXAMPLE)
        names = [name for effector in self.effector_names for name in position_columns(effector)]
        names += self.simulation.sensor_columns
        return columns.is_output or any(name in columns for name in names)

    def _run_alone(self, steps: int | None, seconds: float | None, rate: float) -> Table:
        """A run without commands."""
        count = _step_count(steps, seconds, rate)
        readouts = BodyReadouts(self.simulation)
        columns = RunColumns(self.simulation, observed=readouts.columns)
        table = no_commands(self.simulation, count / rate if seconds is None else seconds)
        rows = (row._replace(observed=readouts.read())
                for row in run_commands(self.simulation, table, rate, columns))
        return self._collected(columns, rows)

    def _collected(self, columns: RunColumns, rows: Iterable[RunRow]) -> Table:
        """The table of a run, which is shown on its way."""
        kept = []
        for row in rows:
            kept.append(row)
            self._remember(row.result, Hold() if row.command is None else row.command)
        return run_table(columns, kept)

    # --- how it yields ---------------------------------------------------------------------------

    def jacobian(self, effector: str) -> LabelledMatrix:
        """Motion of an effector by each actuator, the others held (Coevoet 2017, eq. 16).

        Args:
            effector: Its name.

        Returns:
            Rows x, y and z [m]; a column for one unit of each actuator: of its displacement, such
            as ``north_shortening_m``, or of its effort where that drives it, such as
            ``left_pressure_Pa``. A slack cable moves nothing.

        Raises:
            CommandError: There is no such effector.
        """
        place, found = self._place(effector), self._yielding()
        actuators = self.simulation.actuators
        columns = tuple(map(column, actuators.names, actuators.driven_quantities(found.is_by_effort)))
        return LabelledMatrix(found.jacobian[place], ("x_m", "y_m", "z_m"), columns,
                              f"motion of {effector} [m] by one unit of each actuator")

    def compliance(self, effector: str) -> LabelledMatrix:
        """How an effector yields to a force on it, while the actuators hold what they hold.

        Args:
            effector: Its name.

        Returns:
            Motion along x, y and z [m] by a force of 1 N along x, y and z.

        Raises:
            CommandError: There is no such effector.
        """
        place = self._place(effector)
        return LabelledMatrix(
            self._yielding().compliance[place], ("x_m", "y_m", "z_m"), ("x_N", "y_N", "z_N"),
            f"motion of {effector} [m] by a force of 1 N")

    def stiffness(self, effector: str) -> tuple[np.ndarray, np.ndarray]:
        """Stiffnesses of an effector along the directions in which it yields straight to a force.

        Args:
            effector: Its name.

        Returns:
            Stiffnesses [N/m], the least first, shape (3,), and their directions as rows, (3, 3).

        Raises:
            CommandError: There is no such effector.
        """
        return self._yielding().principal_stiffness(self._place(effector))

    def linear_model(self, modes: int | None = 5, time_step: float = DEFAULT_TIME_STEP) -> LinearModel:
        """Small motions about where the robot stands, by a few modes; in scenes that move in time.

        Actuators that were commanded by efforts last have these as inputs, the others what drives
        them.

        Args:
            modes: How many modes; None for all of the mesh.
            time_step: Of its forms in discrete time [s].

        Returns:
            ``M``, ``K``, ``damping``, ``H``, ``E`` and more; ``discrete()``, ``sampled()`` and
            ``continuous()`` give A, B, C and D, as `control.ss` takes them.

        Raises:
            CommandError: No linear model is built for such a scene, or an argument cannot be used.
        """
        count = None if modes is None else whole_number("modes", modes)
        step = positive_number("time_step", time_step, "s")
        return ModalTangent(self.simulation, self._by_effort).at_state(count, step)

    def _place(self, effector: str) -> int:
        return place_of(effector, "effectors:", self.effector_names)

    def _yielding(self) -> ApparentCompliance:
        if self._compliance is None:
            self._compliance = EffectorCompliance(self.simulation)
        return self._compliance.at_state(self._by_effort)

    # --- how it looks ----------------------------------------------------------------------------

    def plot(
        self, path: Path | str | None = None, *, view: tuple[float, float] | None = None,
        labelled: bool = False,
    ) -> Any:  # fmt: skip
        """Draws where it stands, with the targets and contacts of its last step.

        Args:
            path: Picture to write, such as ``finger.png``; None to return it.
            view: Elevation and azimuth of the eye [degrees]; None for the usual one.
            labelled: Whether the names of all things stand beside it.

        Returns:
            The `matplotlib.figure.Figure`, which a notebook shows; None where it was written.

        Raises:
            MissingExtraError: matplotlib is not installed.
            OutputError: The picture cannot be written.
        """
        if view is not None and len(finite_numbers("view", view)) != 2:
            raise CommandError("view", f"{view} must be an elevation and an azimuth [degrees]")
        shot = take_snapshot(self.simulation, self._contacts, self.name, self._targets)
        if path is not None:
            draw_snapshots([shot], path, self.name, view, labelled)
            return None
        figure = figure_of([shot], self.name, view, labelled)
        load_pyplot().close(figure)  # A notebook would show it twice.
        return figure

    def view(
        self, path: Path | str | None = None, *, serve: bool | None = None, spawn: bool = True,
        port: int = 0, force_scale: float = 0.1, notebook: bool = False,
    ) -> RobotView:  # fmt: skip
        """Opens a view in rerun, which shows this state and each later step until it is closed.

        Args:
            path: File to write, such as ``finger.rrd``, for ``rerun finger.rrd``; None for none.
            serve: Whether viewers can connect, on this machine only; by default where it has
                neither a file nor a viewer in a notebook.
            spawn: Whether a viewer is opened where there is a display.
            port: TCP port for viewers; 0 selects a free one.
            force_scale: Length of the arrow of a contact force [m/N].
            notebook: Whether the view is shown as a 3-D viewer by a cell of a notebook that ends
                with it; needs the package rerun-notebook.

        Returns:
            The view, whose ``address`` a viewer connects to: ``rerun --connect ADDRESS``. It may be
            used in a ``with`` statement. Another view takes its place.

        Raises:
            ViewError: It cannot be opened.
        """
        if self._view is not None:
            self._view.close()
        serves = path is None and not notebook if serve is None else serve
        with writing(str(path), TypeError):
            file = None if path is None else Path(path)
        self._view = RobotView(
            self.simulation, file, serves, spawn and serves, whole_number("port", port, 0, 65535),
            positive_number("force_scale", force_scale, "m/N"), notebook)
        self._view.show()
        return self._view

    def save_vtu(self, path: Path | str) -> tuple[str, ...]:
        """Writes the present shape of all bodies, with the displacements of their points [m].

        Args:
            path: File to write; ``.vtu`` for ParaView, or another format of meshio.

        Returns:
            Names of the parts; the cell data ``part`` holds their numbers, from 0.

        Raises:
            OutputError: The file cannot be written, or there is no such format.
        """
        return export_mesh(self.simulation, path)


def _listed(word: str, names: Iterable[str]) -> str:
    """Names of parts of one kind, as text; empty without any."""
    names = list(names)
    if not names:
        return ""
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return f"{word} {', '.join(names[:_MOST_NAMES])}{more}"


def _rate(rate: float | None) -> float:
    return DEFAULT_RATE if rate is None else positive_number("rate", rate, "Hz")


def _step_count(steps: int | None, seconds: float | None, rate: float) -> int:
    """Number of steps, by one of both."""
    if steps is not None and seconds is not None:
        raise CommandError("seconds", "is given beside steps: give one of them")
    if seconds is None:
        return 1 if steps is None else whole_number("steps", steps, most=MOST_COUNTED)
    return direct_run.step_count("seconds", positive_number("seconds", seconds, "s"), rate)


def _refuse(what: str, **given: Any) -> None:
    """Refuses arguments of a run that have no meaning beside what it takes."""
    for name, value in given.items():
        if value is not None and value is not NOTHING:
            raise CommandError(name, f"has no meaning where a run takes {what}")


def _is_table(command: Any) -> bool:
    """Whether something is a file, or has columns by name."""
    is_array = isinstance(command, np.ndarray) and command.dtype.names is not None
    return isinstance(command, Path | str) or is_array or hasattr(command, "keys")
