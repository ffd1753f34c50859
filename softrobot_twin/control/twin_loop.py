"""One tick of the twin: read the inputs, do one step of the simulation, release a command."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.control.arrival import Input
from softrobot_twin.control.cavity_pressures import (STANDARD_ATMOSPHERE, CavityPressures, PressureInput)
from softrobot_twin.control.command_gate import ActuatorCommand
from softrobot_twin.control.device import OUTSIDE_SCALES, DeviceWatch, MeasuredSetpoints
from softrobot_twin.control.dynamic_control import DynamicControl
from softrobot_twin.control.engagement import Activity, Engagement
from softrobot_twin.control.force_observer import ForceObserver
from softrobot_twin.control.guidance import Guidance
from softrobot_twin.control.inputs import (
    ActuatorInput,
    DirectActuatorInput,
    ActuatorNames,
    AngleInput,
    BaseInput,
    ChannelInput,
    MarkerInput,
    Misfit,
    PoseInput,
    SelectedActuatorInput,
    SensorTargetInput,
    StiffnessInput,
    TargetInput,
    TargetReading,
    TouchInput,
)
from softrobot_twin.control.loop_settings import (LoopSettings, Mode, WhenLost, check_mode, check_settings)
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.marker_checks import MarkerPlausibility
from softrobot_twin.control.model_history import ModelHistory, Moment
from softrobot_twin.control.target_correction import (
    EffectorMeasurement,
    Law,
    SensorCorrection,
    TargetCorrection,
    approach,
    approach_poses,
)
from softrobot_twin.control.target_lead import TargetLead
from softrobot_twin.control.voices import CONTESTED_TIME, NOISE_SHARE
from softrobot_twin.geometry.shortened_vectors import shortened
from softrobot_twin.simulation import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    State,
    Status,
    StepResult,
)
from softrobot_twin.simulation.appearance import Pose
from softrobot_twin.tables.channels import measured

DEVICE_LOST = "device lost"
DISPUTED = "the device is measured at two places"
CONTESTED = (f"two devices measure, or with noise above {NOISE_SHARE:.0%} of the travel: the same "
             "actuators are at two places by turns")  # fmt: skip
_PAUSES = (DEVICE_LOST, DISPUTED)
"""The resynchronisation waits meanwhile."""
_SAME_TIME = 1.0e-6
"""A time that is shorter than a period by less than this share counts as a period: round-off."""
_SHORT_TICK = 0.5
"""A tick that comes sooner than this share of a period after the one before makes a shorter step."""
_SHORTEST_STEP = 1.0e-4
"""Shortest step of the simulation [s]."""
_SHOWN_UNITS = {"m3": "m³", "Pa": "Pa (gauge)"}


SERVICES = ("enable", "disable", "reset", "apply", "contest", "give_up", "after_failure",
            "continue_from", "grip")  # fmt: skip
"""Methods by which anything but messages and ticks reaches a loop from outside."""
MOST_REPEATS = 99
"""Ticks at rest that repeat the outcome of one before, at most: then all of a tick is done again."""
_MAY_REPEAT = (Activity.DISABLED, Activity.HOLDING, Activity.COMMANDED, Activity.FOLLOWING)


def owner_of(loop: TwinLoop, name: str) -> tuple[object | None, str]:
    """The part of a loop that takes a call, and the name of its method; see `TwinLoop.calls`.

    The part is None where the loop's scene or mode does not call for that input.

    Args:
        loop: The loop.
        name: Name of the call.
    """
    part, _, method = name.rpartition(".")
    return (getattr(loop, part) if part else loop), method


def is_call(loop: TwinLoop, name: str) -> bool:
    """Whether a loop of any scene or mode has a call of this name.

    Args:
        loop: The loop.
        name: Name of the call, as a recording has it.
    """
    part, _, method = name.rpartition(".")
    has_part = part in TwinLoop.__annotations__ or part in loop.inputs
    return has_part and method.startswith("accept") if part else method in SERVICES


class _Entrance:
    """A call of a loop, which ends the rest of the loop and is told to its listeners."""

    def __init__(self, loop: TwinLoop, name: str):
        owner, method = owner_of(loop, name)
        self._loop, self._name, self._method = loop, name, getattr(owner, method)
        self.__wrapped__ = self._method  # For its signature.
        setattr(owner, method, self)

    def __call__(self, *arguments, **options):
        self._loop.wake()
        answer = self._method(*arguments, **options)
        for note in self._loop.listeners:
            note(self._name, arguments, answer)
        return answer


class _Rest(NamedTuple):
    """A tick that the next ones may repeat.

    Attributes:
        outcome: Its outcome.
        command: The command of its step.
        repeats: How often it was repeated.
    """

    outcome: TickOutcome
    command: Command
    repeats: int = 0


class Aims(NamedTuple):
    """The positions to which a step moves the effectors.

    Attributes:
        reading: The targets as they were given.
        wanted: The corrected targets in the controlled directions, the present positions in the
            others [m], shape (effector_count, 3).
        aims: The same, limited to the reach of one tick [m], same shape.
        turns: Turns from rest to which the step leads the effectors (x, y, z, w), NaN where free,
            shape (effector_count, 4); None where no effector asks for an orientation.
    """

    reading: TargetReading
    wanted: np.ndarray
    aims: np.ndarray
    turns: np.ndarray | None = None

    @property
    def arrived(self) -> np.ndarray:
        """True where the aim is the wanted position, same shape."""
        return self.aims == self.wanted

    @property
    def is_approaching(self) -> bool:
        """True when an effector is sent to a point on the line to its target."""
        turns, wanted = self.turns, self.reading.orientations
        if turns is None:
            return self.aims is not self.wanted
        return bool((~np.isclose(turns, wanted, equal_nan=True)).any()
                    or (~self.arrived & np.isfinite(self.wanted)).any())  # fmt: skip


MOST_FAILURES = 3
"""The loop is disabled after so many ticks in a row that ended with an exception."""


class TickTime(NamedTuple):
    """The time that a tick stands for.

    Attributes:
        step: Duration of the simulation's step [s]: a period, less where the tick came sooner than
            half a period after the one before, as after a change of the rate.
        reach: Time in which actuators and guided bodies may move at their rates [s]: the time since
            the last command left, at most a period. It follows the clock: after a late tick the
            next one comes early, and its command may move less far.
    """

    step: float
    reach: float


class TickOutcome(NamedTuple):
    """The results of one tick.

    Attributes:
        activity: What the loop did.
        cause: Why it followed neither targets nor a direct command; empty when it did.
        result: The step.
        command: The command to publish, or None when none may be published.
        violated: Limits that the step's own command violated; `command` is the last valid one then.
        reading: The targets as they were given, and their age.
        aims: Positions to which the step sent the effectors [m], shape (effector_count, 3): the
            corrected targets, or points on the lines to far targets.
        predicted_markers: Markers of the model [m], shape (marker_count, 3).
        measured_markers: Measured markers [m], same shape; NaN for hidden ones and those left out.
        misfit: Measured minus predicted markers at the time of the measurement.
        measured_effectors: Effectors measured by the markers [m], shape (effector_count, 3); NaN
            without a measurement.
        tracking_errors: Distance of each effector, measured or else predicted, from its target in
            the controlled directions [m], shape (effector_count,); NaN without a target.
        guided_poses: Poses sent to the guided bodies, or their present poses when nothing is
            published, by name.
        left_out: Ids of the markers whose measurement is not plausible and was left out.
        is_approaching: An effector was sent to a point on the line to its far target.
        orientation_errors: Angle of each effector of the model from its wanted orientation [rad],
            shape (effector_count,), NaN without a target; None where no effector asks for one.
        measured: Newest measured numbers of channels that were added from outside, by the channel's
            name, each of shape (object_count, width); NaN where they are too old.
    """

    activity: Activity
    cause: str
    result: StepResult
    command: ActuatorCommand | None
    violated: tuple[str, ...]
    reading: TargetReading
    aims: np.ndarray
    predicted_markers: np.ndarray
    measured_markers: np.ndarray
    misfit: Misfit
    measured_effectors: np.ndarray
    tracking_errors: np.ndarray
    guided_poses: dict[str, Pose]
    left_out: tuple[int, ...] = ()
    is_approaching: bool = False
    orientation_errors: np.ndarray | None = None
    measured: Mapping[str, np.ndarray] = {}

    def shown(self) -> dict[str, Any]:
        """What a viewer shows of it beside its result, by the arguments of `SimulationFrames`."""
        return {
            "targets": self.reading.targets,
            "target_orientations": self.reading.orientations,
            "errors": self.tracking_errors,
            "predicted_markers": self.predicted_markers,
            "measured_markers": self.measured_markers,
            "status": f"{self.activity.value}: {self.result.status.value}",
        }


_MEASUREMENTS = ("markers", "device", "touches", "measured_")
"""Beginnings of the names of inputs of what is measured; the others take wishes."""


def inputs_of(
    simulation: Simulation, mode: Mode, settings: LoopSettings, frame_id: str,
    cavities: CavityPressures, velocity_effector: int,
) -> dict[str, Input]:  # fmt: skip
    """The inputs that a scene and a mode call for, by their names.

    Commands of actuators, their measured setpoints and markers are taken in all of them: who sends
    what the scene does not have is told so.

    Args:
        simulation: The model, at rest.
        mode: What drives the loop.
        settings: Limits and timeouts.
        frame_id: The frame of all positions.
        cavities: The cavities of the scene.
        velocity_effector: Index of the effector that velocities apply to.
    """
    names, kinds = simulation.actuator_names, simulation.actuators.kinds
    pulleys, rest = simulation.pulleys, simulation.rest_setpoints
    apart = (
        [name for name, kind in zip(names, kinds) if not kind.takes_efforts],
        [name for name, kind in zip(names, kinds) if kind.is_effort_driven],
        [*compress(names, pulleys.is_wound)],
    )
    units = [_SHOWN_UNITS.get(kind.setpoint.unit, kind.setpoint.unit) for kind in kinds]
    device = MeasuredSetpoints(ActuatorNames(names, None, rest, *apart), rest, simulation.limits,
                               settings, units, -cavities.ambient_pressure)  # fmt: skip
    known = ActuatorNames(names, simulation.motors, rest, *apart)
    made: dict[str, Input] = {
        "markers": MarkerInput(simulation.marker_ids, frame_id, settings,
                               simulation.scene.marker_frame.of_robot),
        "device": device}  # fmt: skip
    if mode is Mode.DIRECT:
        commands = made["direct"] = DirectActuatorInput(known, settings)
    else:
        commands = made["selected"] = SelectedActuatorInput(known, settings)
        made["targets"] = TargetInput(len(simulation.effector_names), velocity_effector, frame_id,
                                      settings, simulation.lengths_per_radian)  # fmt: skip
    if simulation.guided_names:
        made["poses"] = PoseInput(simulation.guided_names, frame_id, settings)
    if mode is Mode.INVERSE and any(simulation.stiff_effectors):
        made["stiffness"] = StiffnessInput(
            simulation.scene_stiffness, simulation.stiff_effectors, frame_id, settings)
    if mode is Mode.INVERSE and any(simulation.wanted_sensors.values()):
        made["sensors"] = SensorTargetInput(simulation.wanted_sensors, frame_id, settings)
    if pulleys.count:
        made["angles"] = AngleInput(pulleys, commands, settings, False)
        made["measured_angles"] = AngleInput(pulleys, device, settings, True)
    if cavities.names:
        made["pressures"] = PressureInput(cavities, commands, frame_id, settings, False)
        made["measured_pressures"] = PressureInput(cavities, device, None, settings, True)
    if simulation.base_names:
        made["measured_base"] = BaseInput(settings)
    if simulation.touch_names:
        made["touches"] = TouchInput(simulation, frame_id, settings)
    for one in measured():
        made[one.measured_name] = ChannelInput(
            one, len(one.names(simulation)), frame_id, settings, device.refusals)
    return made


class TwinLoop:
    """Connects inputs, simulation, correction and gate. Independent of ROS and of any clock.

    Args:
        simulation: The model, warmed up and at rest.
        settings: Limits, gains and timeouts.
        mode: What drives the twin.
        use_device: A device is driven: the loop starts disabled and publishes only after it was
            resynchronised.
        velocity_effector: Index of the effector that velocities apply to.
        frame_id: The frame of all positions.
        ambient_pressure: Absolute pressure around the robot [Pa]. It cannot change while the loop
            runs, because all pressures in messages would jump.

    Attributes:
        cavities: The cavities, and their absolute pressures.
        pulleys: The pulleys that wind cables, and their angles.
        inputs: The inputs that its scene and mode call for, by name; each is an attribute of its
            name too, and the others are None.
        observer: Finds forces that nobody modelled; None in a scene without an observer.
        dynamic: Commands a robot that vibrates; None in a scene without `control`, and in direct mode.
        is_repeating: True when the last tick repeated the outcome of the one before.
        listeners: Take the name, the arguments and the answer of each of its `calls`, after it was
            made.

    Raises:
        ParameterError: The scene does not allow the mode or the settings.
    """

    markers: MarkerInput
    device: MeasuredSetpoints
    direct: ActuatorInput | None = None
    selected: SelectedActuatorInput | None = None
    targets: TargetInput | None = None
    poses: PoseInput | None = None
    stiffness: StiffnessInput | None = None
    sensors: SensorTargetInput | None = None
    angles: AngleInput | None = None
    measured_angles: AngleInput | None = None
    measured_base: BaseInput | None = None
    pressures: PressureInput | None = None
    measured_pressures: PressureInput | None = None
    touches: TouchInput | None = None

    def __init__(
        self, simulation: Simulation, settings: LoopSettings, mode: Mode = Mode.INVERSE,
        use_device: bool = False, velocity_effector: int = 0, frame_id: str = "base_link",
        ambient_pressure: float = STANDARD_ATMOSPHERE,
    ):  # fmt: skip
        check_mode(mode, simulation)
        self.simulation, self.mode, self.use_device = simulation, mode, use_device
        self.check(settings)
        self.settings = settings
        self.cavities = CavityPressures(simulation, ambient_pressure)
        self.pulleys = simulation.pulleys
        self.inputs = inputs_of(simulation, mode, settings, frame_id, self.cavities, velocity_effector)
        vars(self).update(self.inputs)
        channels = {one.name: self.inputs[one.measured_name] for one in measured()}
        # Together in the order of the scene's sensors.
        self._by_sensors = [one for name, one in channels.items() if name.startswith("sensor_")]
        # Most robots have objects of few channels: the others tell the same in each tick.
        self._measured = {name: one.read(-math.inf) for name, one in channels.items()}
        self._channels = {name: one for name, one in channels.items() if len(self._measured[name])}
        self._no_targets = TargetReading.none(simulation.oriented_effectors)
        self._guidance = Guidance(simulation, self.poses)
        self.measurement = EffectorMeasurement(simulation)
        self.correction = TargetCorrection(len(simulation.effector_names), simulation.lengths_per_radian)
        self.lead = TargetLead(len(simulation.effector_names))
        if self.sensors is not None:
            self._of_sensors = SensorCorrection(simulation.model.sensors.lengths)
        limits = simulation.limits
        self._base_seen, self._base_frame, self._followed = -math.inf, "", -math.inf
        self.observer = None
        if simulation.scene.observer is not None:
            self.observer = ForceObserver(simulation)
            self.observer.warm_up()
        self.dynamic: DynamicControl | None = None
        if simulation.scene.control is not None and mode is Mode.INVERSE:
            self.dynamic = DynamicControl(simulation, settings.period, settings.prediction)
        self._history = ModelHistory(
            limits.travel(limits.drive_scale),
            len(simulation.marker_ids) if self.observer is None else self.observer.quantity_count,
            len(simulation.effector_names),
            load_count=0 if self.observer is None else len(self.observer.loads))
        self._plausibility = MarkerPlausibility(simulation)
        self._is_lost = False
        self._aimed = self._no_targets.targets
        self._last: StepResult | None = None
        self._ticked = self._released = -math.inf
        self._measured_stamp = 0
        self._contested: dict[str, tuple[str, float]] = {}
        self._watch = DeviceWatch(simulation.limits)
        self._engagement = Engagement(simulation, self._guidance, self.device if use_device else None)
        self._rest: _Rest | None = None
        self.is_repeating = False
        self.listeners: list[Callable[[str, tuple, object], None]] = []
        for name in self.calls:
            _Entrance(self, name)

    @property
    def commands(self) -> ActuatorInput:
        """Commands of actuators; in inverse mode they exclude these from the optimisation."""
        return self.direct or self.selected

    @property
    def calls(self) -> list[str]:
        """All by which anything reaches it from outside, but `tick`: `SERVICES`, and inputs with
        their methods, such as ``targets.accept_point``."""
        return [*SERVICES, *(f"{name}.{method}" for name, one in self.inputs.items()
                             for method in dir(one) if method.startswith("accept"))]  # fmt: skip

    @property
    def wishes(self) -> list[Input]:
        """The inputs of targets and commands."""
        return [one for name, one in self.inputs.items() if not name.startswith(_MEASUREMENTS)]

    def wake(self) -> None:
        """Lets the next tick do all of its work."""
        self._rest = None

    def check(self, settings: LoopSettings) -> None:
        """Checks that the scene allows the settings; see `check_settings`."""
        check_settings(settings, self.simulation, self.mode)

    def apply(self, settings: LoopSettings) -> None:
        """Uses changed settings from the next tick on.

        Args:
            settings: The changed settings.
        """
        self.check(settings)
        self.settings = settings
        for one in self.inputs.values():
            one.apply(settings)
        if self.dynamic is not None:
            self.dynamic.apply(settings.period, settings.prediction)

    @property
    def is_enabled(self) -> bool:
        """True when commands may be published, now or after the resynchronisation."""
        return self._engagement.is_enabled

    @property
    def activity(self) -> Activity:
        """Whether it is disabled, resynchronising, returning or engaged; then it is holding here."""
        return self._engagement.activity

    @property
    def last_command(self) -> ActuatorCommand | None:
        """The last command or measurement, where commands may leave now; else None."""
        return self._engagement.last_command

    @property
    def why_given_up(self) -> str:
        """Why the loop disabled itself; empty when it did not."""
        return self._engagement.reason if self._engagement.has_given_up else ""

    def enable(self, now: float) -> tuple[bool, str]:
        """Allows commands again, from where the device is now; old targets are forgotten.

        Args:
            now: Time on the clock of the ticks [s].

        Returns:
            Whether commands are allowed now, and a sentence that says what happens next.
        """
        if self.is_enabled:
            return True, "already enabled"
        if why := self._why_contested(now):
            return False, why
        if self.use_device and self.device.implausible is not None:
            return False, f"{self.device.implausible}: there are no setpoints to start from"
        if self.device_is_lost(now):
            why = f"no measured setpoints of {self.unheard(now)} arrive to start from"
            refused = self.device.refusals.in_words()
            return False, f"{why}; messages refused so far: {refused}" if refused else why
        self._forget_commands()
        self._watch.forget()
        return True, self._engagement.enable()

    def contest(self, topic: str, reason: str, is_severe: bool, now: float) -> None:
        """Takes notice that two publishers send on an input: the loop holds for `CONTESTED_TIME`.

        Args:
            topic: The input; none of its messages may be passed to the loop meanwhile.
            reason: What the status says.
            is_severe: It is where the robot is measured to be: the loop is disabled.
            now: Time on the clock of `Arrival.time` [s].
        """
        self._contested[topic] = (reason, now + CONTESTED_TIME)
        if self.targets is not None:
            self.targets.stop()
        if is_severe and (self.is_enabled or self.why_given_up == CONTESTED):
            self._engagement.give_up(reason)

    def after_failure(self, failure: str, in_a_row: int) -> ActuatorCommand | None:
        """Makes the loop safe after a tick that ended with an exception.

        Args:
            failure: The exception, in one line.
            in_a_row: How many ticks failed so; from `MOST_FAILURES` on the loop is disabled.

        Returns:
            The last safe command, which may be published; None where none may.
        """
        self._engagement.undo()
        if in_a_row >= MOST_FAILURES and self.is_enabled:
            self._engagement.give_up(f"{in_a_row} ticks in a row failed: {failure}")
        return self.last_command

    def continue_from(self, setpoints, efforts, poses: Mapping[str, Sequence]) -> str:
        """Takes what was sent last before this loop for its own last command.

        It is checked like a measurement: see `MeasuredSetpoints`. A guided body may be as far beyond
        the workspace as a tenth of it. The model moves there before anything is published.

        Args:
            setpoints: In the unit of each actuator's kind, shape (actuator_count,).
            efforts: In the unit of each actuator's kind, same shape.
            poses: Position [m] and quaternion (x, y, z, w) of each guided body, by name.

        Returns:
            Why it is not used; empty where it is.
        """
        limits, count = self.simulation.limits, len(self.simulation.actuator_names)
        setpoints, efforts = np.array(setpoints, float), np.array(efforts, float)
        if not setpoints.shape == efforts.shape == (count,):
            return f"it is not of {count} actuators"
        if not (np.isfinite(setpoints).all() and np.isfinite(efforts).all()):
            return "it has numbers that are not finite"
        if (implausible := self.device.implausible_of(setpoints)) is not None:
            return f"it cannot be of this robot: {implausible.in_words('was')}"
        found = {name: Pose(*(np.array(part, float) for part in pose)) for name, pose in poses.items()}
        for name, pose in found.items():
            if why := self._guidance.why_implausible(name, pose, self.settings):
                return f"{name}: {why}"
        most = OUTSIDE_SCALES * limits.effort_scale
        self._engagement.gate.start_from(setpoints, np.clip(efforts, -most, most))
        for name, pose in found.items():
            turn = pose.quaternion / np.abs(pose.quaternion).max()
            self._guidance.sent[name] = pose._replace(quaternion=turn / np.linalg.norm(turn))
        return ""

    def give_up(self, reason: str) -> None:
        """Publishes no command from the next tick on, and says why until it is enabled.

        Args:
            reason: Why, for the status.
        """
        self._engagement.give_up(reason)

    def grip(self, name: str, holds: bool) -> tuple[bool, str]:
        """Tells a grip to hold or to let go, from the next tick on.

        Args:
            name: Name of the grip.
            holds: Whether it shall hold.

        Returns:
            Whether the scene has it, and a sentence that says what happens next.
        """
        if name not in self.simulation.grip_names:
            return False, f"{name} is no grip of this scene"
        self.simulation.grip(name, holds)
        return True, f"{name} {'takes hold of what is in its reach' if holds else 'lets go'}"

    def disable(self) -> None:
        """Publishes no command from the next tick on."""
        self._engagement.disable()

    def reset(self) -> str:
        """Returns to the rest shape and forgets targets and correction.

        With a device only the model returns, and the loop is disabled until it is enabled again.
        Without one, the commands move to rest within their limits, as soon as the loop is enabled;
        when the model fails meanwhile, they continue to rest without it.

        Returns:
            A sentence that says what happens next.
        """
        self._forget_commands()
        self.correction.reset()
        if self.sensors is not None:
            self._of_sensors.reset()
        if self.use_device:
            self._forget_markers()
        return self._engagement.reset()

    def _forget_markers(self) -> None:
        """Drops old misfits, which are invalid after the model was moved other than by a step."""
        self._history.forget()
        self._plausibility.forget()
        self.lead.reset()
        if self.observer is not None:
            self.observer.reset()

    def _forget_commands(self) -> None:
        for one in self.wishes:
            one.reset()

    def driven_by_efforts(self, outcome: TickOutcome) -> np.ndarray | bool:
        """Actuators that a tick drove by commanded efforts, and that so hold no displacement.

        Args:
            outcome: The newest tick.

        Returns:
            Shape (actuator_count,); False where no efforts were commanded.
        """
        commands = self.commands
        is_commanded = outcome.activity is Activity.COMMANDED and commands.setpoints is None
        if not is_commanded or commands.efforts is None:
            return False
        return np.isfinite(commands.efforts)

    def _why_contested(self, now: float) -> str:
        """Which input two publishers send on; empty where none."""
        if self.use_device and self.device.places.is_contested(now):
            return CONTESTED
        if not self._contested:
            return ""
        self._contested = {topic: one for topic, one in self._contested.items() if now < one[1]}
        return next((reason for reason, _ in self._contested.values()), "")

    def _is_disputed(self, now: float) -> bool:
        """True while it is not known which of two measured places the device is at."""
        return self.use_device and self.device.places.is_disputed(now)

    def device_is_lost(self, now: float) -> bool:
        """True when a device is in use and its measured setpoints do not arrive.

        Args:
            now: Time on the clock of the ticks [s].
        """
        return self.use_device and (
            self.device.setpoints is None or self.device.age(now) > self.settings.device_timeout
        )

    def unheard(self, now: float) -> str:
        """What does not arrive of a lost device: names of actuators, or the device.

        Args:
            now: Time on the clock of the ticks [s].
        """
        missing = self.device.unheard(now, self.settings.device_timeout)
        some = len(missing) < len(self.simulation.actuator_names)
        return ", ".join(missing) if some else "the device"

    def markers_are_lost(self, measured: np.ndarray) -> bool:
        """True when the loop is closed and an effector cannot be measured.

        Args:
            measured: Measured markers [m], shape (marker_count, 3); NaN for hidden markers.
        """
        closed = self.settings.closed_loop and self.mode is Mode.INVERSE
        return closed and not self.measurement.is_complete(measured)

    def plausible_markers(self, now: float) -> np.ndarray:
        """Measured markers [m], shape (marker_count, 3); NaN for hidden and implausible ones.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return self._plausibility.without_left_out(self.markers.measured(now))

    def tick(self, now: float, ros_time: int) -> TickOutcome:
        """One tick.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            ros_time: Time on the clock of `Arrival.stamp` [ns].
        """
        time = self._time_of_tick(now)
        repeated = self._repeat(now, ros_time, time)
        self.is_repeating = repeated is not None
        if repeated is not None:
            return repeated
        self._rest = None
        self._watch_device(now)
        self._engagement.begin()
        aims = self._aims(now, time.step)
        seen = self.markers.measured(now)
        accepted = self._plausibility.without_left_out(seen)
        activity, cause = self._decide(now, aims.reading, accepted)
        self._guide(activity, now, time.reach)
        if self.dynamic is not None:
            self._measure_motion(accepted, seen, ros_time)
        command = self._command(activity, cause, aims, time, now)
        if self.measured_base is not None and (pose := self.measured_base.pose) is not None:
            self._follow_base(pose, now)
        felt = None if self.touches is None else self.touches.read(now)
        touched = [] if felt is None else [felt]
        if self.observer is not None:
            self._observe(seen, activity, tuple(touched), now)
            touched.append(self.observer.found)
        result, released, violated = self._step(command, touched, time.reach, cause)
        if self.observer is not None and not result.report.is_resting:
            self.observer.balance(() if felt is None else (felt,))
        if self.dynamic is not None:
            self.dynamic.end(self.simulation.state, activity is Activity.FOLLOWING, now)
        self._last, predicted = result, self.simulation.marker_positions()
        self._remember(ros_time, predicted, result)
        measured, misfit = self._compare(seen, activity)
        effectors = self.measurement.effectors(result.effector_positions, misfit)
        self._correct(activity, aims, effectors, measured, result, now)
        errors = self.measurement.errors(aims.reading.targets, result.effector_positions, effectors)
        if released is None:
            poses = self._guidance.poses()
        else:
            poses, self._released = self._guidance.send(time.reach), now
        if cause not in _PAUSES and self._engagement.end(result, time.step):
            self._forget_markers()
        outcome = TickOutcome(
            activity, cause, result, released, violated, aims.reading, aims.aims, predicted,
            measured, misfit, effectors, errors, poses, self._plausibility.left_out,
            aims.is_approaching, self.simulation.orientation_angles(aims.reading.orientations),
            {**self._measured, **{name: one.read(now) for name, one in self._channels.items()}},
        )  # fmt: skip
        is_resting = result.report.is_resting and activity in _MAY_REPEAT and not violated
        if is_resting and not self._waits(now):
            self._rest = _Rest(outcome, command)
        self._engagement.keep()
        return outcome

    def _repeat(self, now: float, ros_time: int, time: TickTime) -> TickOutcome | None:
        """The outcome of a tick that would be that of the tick before, to the bit.

        That tick was at rest, nothing has reached the loop since, and nothing waited for a timeout.

        Args:
            now: See `tick`.
            ros_time: See `tick`.
            time: The time that the tick stands for.

        Returns:
            The outcome; None where all of a tick must be done.
        """
        rest = self._rest
        if rest is None or rest.repeats == MOST_REPEATS:
            return None
        before, command = rest.outcome, rest.command
        if isinstance(command, Hold):
            command = command if command.time_step == time.step else Hold(time.step)
        elif time != (command.time_step, command.reach_time):
            command = replace(command, time_step=time.step, reach_time=time.reach)
        result = self.simulation.stay(command)
        # The very arrays of the command before have passed the gate.
        if (result is None or result.setpoints is not before.result.setpoints
                or result.efforts is not before.result.efforts):  # fmt: skip
            return None
        self._rest = _Rest(before, rest.command, rest.repeats + 1)
        self._remember(ros_time, before.predicted_markers, result)
        if before.command is not None:
            self._released = now
        if self.targets is not None:
            before = before._replace(reading=before.reading._replace(age=self.targets.age(now)))
        return before._replace(result=result)

    def _waits(self, now: float) -> bool:
        """Whether ticks change by time alone: something fades, or may time out."""
        settings, targets = self.settings, self.targets
        return (
            (targets is not None and targets.is_moving(now))
            or self.dynamic is not None
            or self.markers.age(now) <= settings.marker_timeout
            or (self.use_device and not self.device_is_lost(now))
            or self._is_disputed(now)
            or any(one.age(now) <= settings.device_timeout for one in self._channels.values())
            or self.commands.age(now) <= settings.target_timeout
            or (targets is not None and targets.age(now) <= settings.target_timeout)
            or self.correction.is_any
            or (self.observer is not None and self.observer.found.is_any)
            or bool(self.lead.ways.any())
            or bool(self._contested)
        )

    def _time_of_tick(self, now: float) -> TickTime:
        """The time that a tick at a time [s] stands for."""
        period = self.settings.period
        passed, self._ticked = now - self._ticked, now
        step = period if passed > _SHORT_TICK * period else max(passed, _SHORTEST_STEP)
        reach = max(0.0, now - self._released)
        return TickTime(step, reach if reach < (1.0 - _SAME_TIME) * period else period)

    def _watch_device(self, now: float) -> None:
        """Resynchronises with a device that is not where it was sent."""
        if not self.use_device:
            return
        if self.is_enabled and self.device.places.is_contested(now):
            self._engagement.give_up(CONTESTED)
        gate = self._engagement.gate
        moved = self._watch.has_moved(
            self.device, self.device_is_lost(now), gate.last.setpoints,
            gate.reach(self.settings.period),
        )  # fmt: skip
        if moved and self._engagement.activity is Activity.HOLDING:
            if not self._watch.is_on_the_way:
                self._forget_commands()
            self._engagement.resynchronise("the device is not where it was sent")

    def _aims(self, now: float, time_step: float) -> Aims:
        """The targets of this tick and the aims that follow from them."""
        last, orientations = self._last, self.simulation.effector_orientations()
        if last is not None and last.state is self.simulation.state:
            positions = last.effector_positions
        else:
            positions = self.simulation.effector_positions()
        reading = self._no_targets
        if self.targets is not None:
            reading = self.targets.read(now, time_step, positions, orientations)
            if self.correction.law is Law.MISFIT:
                self.lead.follow(self.targets.leads(now, self.lead.delay))
            else:
                self.lead.reset()
        corrected = reading.targets + self.lead.ways + self.correction.offsets
        wanted = self.measurement.controlled(corrected, positions)
        reach = self.settings.reach
        if reading.orientations is None:
            # A tick whose reach is not limited goes all the way.
            near = wanted if reach == math.inf else approach(positions, wanted, reach)
            return Aims(reading, wanted, near)
        aims, turns = approach_poses(
            positions, wanted, orientations,
            self.correction.turned(reading.orientations), self.simulation.lengths_per_radian, reach,
        )  # fmt: skip
        return Aims(reading, wanted, aims, turns)

    def _decide(self, now: float, reading: TargetReading, measured: np.ndarray) -> tuple[Activity, str]:
        """The activity of this tick and its cause, empty while targets or commands are followed."""
        engagement = self._engagement
        if engagement.activity is Activity.RESYNCHRONISING and self.device_is_lost(now):
            return engagement.activity, DEVICE_LOST
        if engagement.is_enabled and self._is_disputed(now):
            return engagement.activity, DISPUTED
        if engagement.activity is not Activity.HOLDING:
            return engagement.activity, engagement.reason
        if engagement.gate.is_outside:
            return Activity.HOLDING, "measured outside the limits, returning inside"
        loss, is_led = self._loss(now, measured), self._is_led(reading)
        self._is_lost = bool(loss)
        cause = loss if self._contested else self._nothing_to_do(now, reading, is_led) or loss
        if cause:
            return Activity.HOLDING, cause
        return Activity.FOLLOWING if is_led else Activity.COMMANDED, ""

    def _is_led(self, reading: TargetReading) -> bool:
        """Whether there are targets, of places, stiffness or sensors."""
        return self.mode is Mode.INVERSE and (any(map(math.isfinite, reading.targets.flat)) or any(
            one is not None and one.is_given for one in (self.stiffness, self.sensors)))

    def _loss(self, now: float, measured: np.ndarray) -> str:
        """The lost measurement for which the robot must hold; empty when there is none."""
        settings = self.settings
        if why := self._why_contested(now):
            return why
        if settings.on_lost_device is WhenLost.HOLD and self.device_is_lost(now):
            return DEVICE_LOST
        if settings.on_lost_markers is WhenLost.HOLD and self.markers_are_lost(measured):
            return "markers lost"
        return ""

    def _nothing_to_do(self, now: float, reading: TargetReading, is_led: bool) -> str:
        """Why there is nothing to follow; empty when there is."""
        if self.mode is Mode.INVERSE:
            if not is_led and self.selected.setpoints is None:
                return "no target yet"
            if self.selected.is_too_old(now, self.settings.target_timeout):
                return "no command for target_timeout"
            return "no target for target_timeout" if reading.timed_out else ""
        age = self.direct.age(now)
        if np.isinf(age):
            return "no command yet"
        return "no command for target_timeout" if 0.0 < self.settings.target_timeout < age else ""

    def _guide(self, activity: Activity, now: float, reach_time: float) -> None:
        """Moves the guided bodies in this tick, also without a command of the actuators."""
        if self.poses is None:
            return
        if reach_time == 0.0:
            self._guidance.stay()
        elif activity is Activity.RETURNING:
            self._guidance.go_home(reach_time)
        elif activity is Activity.RESYNCHRONISING:
            self._guidance.go_to_sent()
        elif activity is Activity.DISABLED or self._is_lost:
            self._guidance.stay()
        else:
            self._guidance.follow(now, self.settings.target_timeout, reach_time)

    def _measure_motion(self, accepted: np.ndarray, seen: np.ndarray, ros_time: int) -> None:
        """Tells the control of vibrations where the effectors are, or else where the model has them.

        Args:
            accepted: Plausible measured markers [m], shape (marker_count, 3).
            seen: All of them, same shape.
            ros_time: Time on the clock of stamps [ns].
        """
        stamp = self.markers.stamp
        if not self.settings.closed_loop or seen is self.markers.hidden:
            # In a step of the twin efforts grow, which jump in the robot: half a step earlier.
            late = 0.5 * self.settings.period if self.dynamic.by_effort else 0.0
            self.dynamic.measure(self.simulation.effector_positions(), late)
        elif stamp != self._measured_stamp and self._history.is_any:
            model = self._history.at(stamp)
            misfit = self.measurement.misfit(accepted, model).positions
            # Markers may lie: as far as they correct a robot that stands, they move one that vibrates.
            found = model.effectors + shortened(misfit, self.settings.correction_limit)
            self.dynamic.measure(found, (ros_time - stamp) / NANOSECONDS)
        self._measured_stamp = stamp

    def _command(self, activity: Activity, cause: str, aims: Aims, time: TickTime, now: float):
        """The command of this tick's step."""
        if time.reach == 0.0 or cause in _PAUSES:
            return Hold(time.step)
        if activity is Activity.FOLLOWING and self.dynamic is not None:
            ahead = self.targets.ahead(now, self.dynamic.horizon)
            return self.dynamic.command(
                aims.wanted, ahead, self.settings.reach, time, self.selected.setpoints, now)
        if activity is Activity.FOLLOWING:
            stiffness = None if self.stiffness is None else self.stiffness.wanted
            return FollowTargets(
                aims.aims, time.step, self.selected.setpoints, aims.turns, stiffness,
                time.reach, aims.is_approaching,
                None if self.sensors is None else self.sensors.wanted - self._of_sensors.offsets,
            )
        if activity is Activity.COMMANDED:
            return self._direct_command(time)
        if activity is Activity.RETURNING and not self._engagement.is_without_model:
            return CommandSetpoints(self._engagement.gate.home, *time)
        if activity is Activity.RESYNCHRONISING:
            return CommandSetpoints(self._engagement.goal, *time)
        return Hold(time.step)

    def _direct_command(self, time: TickTime) -> CommandSetpoints | CommandEfforts:
        """The direct command; actuators that it does not name stay where they are."""
        present, direct = self.simulation.state.setpoints, self.commands
        if direct.setpoints is not None:
            wanted = np.where(np.isnan(direct.setpoints), present, direct.setpoints)
            return CommandSetpoints(wanted, *time)
        return CommandEfforts(self.simulation.actuators.efforts(direct.efforts), *time)

    def _step(
        self, command, touched: list, reach_time: float, cause: str
    ) -> tuple[StepResult, ActuatorCommand | None, tuple[str, ...]]:
        """Steps the simulation and passes its command through the gate.

        Args:
            command: The command of this tick.
            touched: What is measured of touches, and what an observer found.
            reach_time: Time in which the actuators may move at their rates [s].
            cause: Why neither targets nor a direct command are followed.

        Returns:
            The step, the command that may be published or None, and the limits that the step's own
            command violated. Such a step is undone.
        """
        simulation, before = self.simulation, self.simulation.state
        budget = self.settings.budget
        result = simulation.stay(command, touched)
        if result is None:
            result = simulation.step(command, budget, *([touched] if touched else ()))
        passage = None
        if cause != DISPUTED:
            passage = self._engagement.release(result, reach_time)
        if passage is None:
            return result, None, ()
        if passage.violated:
            before = before.kept_through(command.time_step)
            simulation.restore(before)
            result = _undone(result, before, passage.command, simulation)
        return result, passage.command, passage.violated

    def _follow_base(self, pose: Pose, now: float) -> None:
        """Tells the model a pose of its base; one that is too old is told again: the base stands."""
        is_late = now - self.measured_base.time > self.settings.device_timeout
        time = now if is_late else self.measured_base.time
        if time > self._base_seen:
            # In another frame than before nothing is known of its velocity.
            is_anew, self._base_frame = self._base_frame != self.measured_base.frame, self.measured_base.frame
            self.simulation.move_base(*pose, time, is_anew)
            self._base_seen = time

    def _observe(self, seen: np.ndarray, activity: Activity, felt: tuple, now: float) -> None:
        """Finds the forces that nobody modelled, by plausible markers, and sensors at the same time.

        Args:
            seen: Measured markers [m], shape (marker_count, 3); NaN for hidden markers.
            activity: What the loop does.
            felt: What is measured of touches.
            now: Time on the clock of `Arrival.time` [s].
        """
        if not activity.follows_robot:
            self.observer.reset()
            return
        newest, is_any = self.markers, True
        if seen is self.markers.hidden:
            # Then sensors tell alone.
            newest = max(self._by_sensors, key=attrgetter("time"))
            is_any = newest.age(now) <= self.settings.device_timeout
        stamp = newest.stamp
        if not is_any:
            self.observer.fade(self.settings.period)
        elif self._history.is_any and self.observer.is_new(stamp):
            model = self._executed(stamp, newest.time) or self._history.at(stamp)
            accepted = self._plausibility.without_left_out(seen)
            loaded = self.observer.update(
                accepted, model, self._plausibility.noise, stamp, felt,
                self.settings.correction_limit, len(self._plausibility.left_out),
                self._sensors(lambda one: one.at(newest.time)))
            if loaded is not None:
                self._history.load_otherwise(model, loaded)
            if (settled := self.observer.settled) is not None:
                # The robot is there already, but for what it was commanded since.
                self.simulation.restore(replace(self.simulation.state, positions=settled.positions,
                                                efforts=settled.efforts))  # fmt: skip
        else:
            return
        if self.settings.closed_loop and activity is Activity.FOLLOWING and self.observer.handed_over.any():
            # The command stays what it is, until the correction sees that it should not.
            self.correction.offsets += self.measurement.moved(self.observer.handed_over)
            if self.sensors is not None:
                self._of_sensors.offsets -= self.observer.of_sensors(self.observer.handed_over)

    def _executed(self, stamp: int, time: float) -> Moment | None:
        """The model at the command that the robot executed at a time [ns]; None where unknown.

        Args:
            stamp: The time [ns].
            time: The same on the clock of `Arrival.time` [s].
        """
        setpoints = self.device.at(time)
        return None if setpoints is None else self._history.executed(setpoints, stamp)

    def _compare(self, seen: np.ndarray, activity: Activity) -> tuple[np.ndarray, Misfit]:
        """Compares measured markers with the model's at the time of the measurement.

        Args:
            seen: Measured markers [m], shape (marker_count, 3); NaN for hidden markers.
            activity: What the loop does.

        Returns:
            The plausible measured markers [m], same shape, and their misfit.
        """
        stamp, follows = self.markers.stamp, activity.follows_robot
        if seen is self.markers.hidden:
            self._plausibility.judge(None, stamp, follows)
            return seen, Misfit(seen, math.nan, 0)
        model = self._history.at(stamp)
        expected, bare = model.markers[: len(seen)], None
        if self.observer is not None:
            # What the observer found may be imagined.
            bare = seen - expected + (model.by_loads @ model.loads).reshape(-1, 3)[: len(seen)]
        self._plausibility.judge(seen - expected, stamp, follows, bare, seen)
        measured = self._plausibility.without_left_out(seen)
        return measured, self.markers.misfit(measured, expected)

    def _remember(self, ros_time: int, markers: np.ndarray, result: StepResult) -> None:
        """Adds the model of this tick [ns] to its history, where measurements are compared with it."""
        if not len(markers) and self.observer is None:
            return
        if self.observer is None:
            moment = Moment(markers, result.effector_positions)
        else:
            moment = self.observer.moment(markers, result.effector_positions)
        self._history.add(ros_time, result.setpoints, moment)

    def _sensors(self, read: Callable[[ChannelInput], np.ndarray]) -> np.ndarray:
        """What is measured of all sensors by their inputs, each in its unit, shape (sensor_count,)."""
        return np.concatenate([read(one)[:, 0] for one in self._by_sensors])

    def _correct(
        self, activity: Activity, aims: Aims, effectors: np.ndarray, markers: np.ndarray,
        result: StepResult, now: float,
    ) -> None:  # fmt: skip
        """Updates the correction of the targets by the measured effectors and markers [m]."""
        errors, misfit, stands = None, None, False
        stamp, targets, before = self.markers.stamp, aims.reading.targets, self._aimed
        self._aimed = targets
        corrects = self.settings.closed_loop and activity is Activity.FOLLOWING
        if corrects and self.correction.is_new(stamp) and not self._is_touched(result):
            # Nor is its distance while an effector approaches a far target.
            comparable = np.where(aims.arrived, effectors, np.nan)
            errors = self.measurement.differences(targets, comparable)
            # Measured lengths do not tell which tensions were executed.
            by_effort = self.dynamic is not None and self.dynamic.by_effort
            model = None if by_effort else self._executed(stamp, self.markers.time)
            if model is not None:
                self.lead.see(model.delay, stamp)
                if self.observer is not None:
                    model = self.observer.under_loads(model)
                misfit = self.measurement.misfit(markers, model)
                stands = targets.tobytes() == before.tobytes() and result.status.is_success
        if corrects and self.sensors is not None:
            # Each measurement counts once.
            since, self._followed = self._followed, now
            self._of_sensors.follow(
                self._sensors(lambda one: one.read(now, since)), self.simulation.sensor_readings(),
                self.settings.correction_limit,
                0.0 if self.observer is None else self.observer.of_sensors(self.observer.shifts))
        loaded = None if self.observer is None else self.measurement.moved(self.observer.shifts)
        self.correction.tick(self.settings, stamp, errors, misfit, result.status,
                             self._plausibility.noise, stands, loaded)

    def _is_touched(self, result: StepResult) -> bool:
        """Whether what displaces an effector is no error of the model: a finger, or a force that is new."""
        touches = result.touches
        is_new = self.observer is not None and self.observer.is_settling
        return is_new or (touches is not None and bool(touches.is_touched.any()))


def _undone(
    result: StepResult, before: State, released: ActuatorCommand, simulation: Simulation
) -> StepResult:
    """The result of a step that was undone because its command could not be released.

    Args:
        result: The result of the step.
        before: The state that was restored.
        released: The command that is published in its place.
        simulation: The model, restored.

    Returns:
        The result with the restored state and the published setpoints, as an unsolved step.
    """
    displacements = simulation.actuators.displacements(released.setpoints, before.positions)
    return replace(
        result, state=before, status=Status.UNSOLVED, **released._asdict(), displacements=displacements,
        effector_positions=simulation.effector_positions(),
        effector_orientations=simulation.effector_orientations(),
    )  # fmt: skip
