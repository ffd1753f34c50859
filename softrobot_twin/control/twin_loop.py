"""One tick of the twin: what came in, one step of the simulation, what may go out."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.activity import Activity, Mode, refuse_impossible
from softrobot_twin.control.approach import approach
from softrobot_twin.control.cable_input import CableInput, ChosenInput
from softrobot_twin.control.command_gate import CableCommand, CommandGate
from softrobot_twin.control.effector_measurement import EffectorMeasurement
from softrobot_twin.control.guidance import Guidance
from softrobot_twin.control.loop_settings import LoopSettings, WhenLost
from softrobot_twin.control.marker_history import MarkerHistory
from softrobot_twin.control.marker_input import MarkerInput
from softrobot_twin.control.pose_input import PoseInput
from softrobot_twin.control.target_correction import TargetCorrection
from softrobot_twin.control.tick_outcome import TickOutcome, taken_back
from softrobot_twin.control.winding import Winding
from softrobot_twin.control.target_input import TargetInput, TargetReading
from softrobot_twin.errors import ParameterError
from softrobot_twin.simulation import (
    FollowTargets,
    Hold,
    SetLengths,
    SetTensions,
    Simulation,
    StepResult,
)


class TwinLoop:
    """Joins inputs, simulation, correction and gate. Knows no ROS and no clock of its own.

    Args:
        simulation: The model, warmed up and at rest.
        settings: What may change at run time.
        mode: What drives it.
        use_device: A device is driven: start disabled, publish only once resynchronised.
        velocity_effector: Index of the effector that a velocity drives.
        frame_id: The one frame of all positions.

    Raises:
        ParameterError: The mode or the settings ask for what the scene cannot do.
    """

    def __init__(
        self,
        simulation: Simulation,
        settings: LoopSettings,
        mode: Mode = Mode.INVERSE,
        use_device: bool = False,
        velocity_effector: int = 0,
        frame_id: str = "base_link",
    ):
        refuse_impossible(mode, simulation)
        self.simulation, self.mode, self.use_device = simulation, mode, use_device
        effector_count = len(simulation.effector_names)
        self.measurement = EffectorMeasurement(simulation)
        self.check(settings)
        self.settings = settings
        self.targets = TargetInput(effector_count, velocity_effector, frame_id, settings)
        self.markers = MarkerInput(simulation.marker_ids, frame_id, settings)
        names, motors = simulation.actuator_names, simulation.motors
        self.device = CableInput(Winding(names), settings)
        winding = Winding(names, motors, simulation.rest_lengths, simulation.slide_names)
        self.direct, self.chosen = CableInput(winding, settings), ChosenInput(winding, settings)
        self.poses = PoseInput(simulation.guided_names, frame_id, settings)
        self._guidance = Guidance(simulation, self.poses)
        self.correction = TargetCorrection(effector_count)
        self._history = MarkerHistory(len(simulation.marker_ids))
        self._rest = simulation.rest_lengths
        self._gate = CommandGate(names, self._rest, simulation.limits)
        self._activity = Activity.DISABLED if use_device else Activity.HOLDING
        self._must_return = False

    def check(self, settings: LoopSettings) -> None:
        """Refuses settings that the scene cannot carry out.

        Raises:
            ParameterError: The loop should be closed and no marker measures an effector.
        """
        if settings.closed_loop and not self.measurement.is_possible:
            raise ParameterError(
                "closed_loop", True, "", "no effector of the scene is measured_by a marker"
            )

    def apply(self, settings: LoopSettings) -> None:
        """Takes up changed settings from the next tick on."""
        self.check(settings)
        self.settings = settings
        inputs = (self.targets, self.markers, self.device, self.direct, self.chosen, self.poses)
        for taker in inputs:
            taker.apply(settings)

    @property
    def is_enabled(self) -> bool:
        """True when commands may be published, now or once resynchronised."""
        return self._activity is not Activity.DISABLED

    def enable(self, now: float) -> tuple[bool, str]:
        """Lets commands out again, from where the device is now; targets must be given anew.

        Returns:
            Whether it was done, and a sentence that says what happens.
        """
        if self.is_enabled:
            return True, "already enabled"
        if self.device_is_lost(now):
            return False, "the device's measured lengths do not arrive: nothing to start from"
        self._forget_commands()
        if self.use_device:
            self._activity = Activity.RESYNCHRONISING
            return True, "resynchronising with the device"
        self._activity = Activity.RETURNING if self._must_return else Activity.HOLDING
        return True, "enabled"

    def disable(self) -> None:
        """Publishes no command from the next tick on."""
        self._activity = Activity.DISABLED

    def reset(self) -> str:
        """Goes back to the rest shape and forgets targets and correction.

        A device is not pulled along: the loop is disabled until it is enabled again. Without one,
        the commands go to rest within their limits first, as soon as the loop is enabled; should
        that fail, the model alone is put to rest and the loop disabled.

        Returns:
            A sentence that says what happens.
        """
        self._forget_commands()
        self.correction.reset()
        if self.use_device:
            self._go_to_rest()
            self.disable()
            return "at rest, disabled: enable to go on"
        self._must_return = True
        if not self.is_enabled:
            return "returning to rest when enabled"
        self._activity = Activity.RETURNING
        return "returning to rest"

    def _forget_commands(self) -> None:
        for commands in (self.targets, self.direct, self.chosen, self.poses):
            commands.reset()

    def device_is_lost(self, now: float) -> bool:
        """True when a device is in use and its measured lengths do not arrive."""
        return self.use_device and (
            self.device.lengths is None or self.device.age(now) > self.settings.device_timeout
        )

    def markers_are_lost(self, measured: np.ndarray) -> bool:
        """True when the loop is closed and an effector cannot be measured.

        Args:
            measured: Measured markers [m], shape (marker_count, 3); NaN where not seen.
        """
        closed = self.settings.closed_loop and self.mode is Mode.INVERSE
        return closed and not self.measurement.is_complete(measured)

    def tick(self, now: float, ros_time: int) -> TickOutcome:
        """Does one tick.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            ros_time: Time on the clock of `Arrival.stamp` [ns].
        """
        simulation = self.simulation
        positions = simulation.effector_positions()
        reading = self.targets.read(now, self.settings.period, positions)
        corrected = reading.targets + self.correction.offsets
        wanted = self.measurement.controlled(corrected, positions)
        aims = approach(positions, wanted, self.settings.reach)
        measured = self.markers.measured(now)
        activity, cause = self._decide(now, reading, measured)
        self._guide(now, measured)
        before = simulation.state
        command = self._command(activity, cause, aims)
        result = simulation.step(command, self.settings.budget)
        released, violated = self._release(activity, result)
        if violated:
            before = before.kept_through(command.time_step)
            simulation.restore(before)
            result = taken_back(result, before, released, simulation)
        predicted = simulation.marker_positions()
        self._history.add(ros_time, predicted)
        misfit = self.markers.misfit(measured, self._history.at(self.markers.stamp))
        effectors = self.measurement.effectors(result.effector_positions, misfit)
        # On its way to a far target an effector tells nothing of the model.
        arrived = np.where(aims == wanted, effectors, np.nan)
        self.correction.tick(
            self.settings, activity is Activity.FOLLOWING, self.markers.stamp,
            self.measurement.differences(reading.targets, arrived), result.status,
        )
        errors = self.measurement.errors(reading.targets, result.effector_positions, effectors)
        self._arrive(activity, cause, result)
        return TickOutcome(
            activity, cause, result, released, violated, reading, aims, predicted, measured,
            misfit, effectors, errors, self._guidance.poses(),
        )

    def _decide(
        self, now: float, reading: TargetReading, measured: np.ndarray
    ) -> tuple[Activity, str]:
        """What to do in this tick, and why not more."""
        if self._activity is Activity.DISABLED:
            return Activity.DISABLED, "not enabled"
        if self._activity is Activity.RETURNING:
            return Activity.RETURNING, "reset"
        if self._activity is Activity.RESYNCHRONISING:
            return Activity.RESYNCHRONISING, "device lost" if self.device_is_lost(now) else ""
        cause = self._nothing_to_do(now, reading) or self._loss(now, measured)
        if cause:
            return Activity.HOLDING, cause
        return Activity.FOLLOWING if self.mode is Mode.INVERSE else Activity.COMMANDED, ""

    def _loss(self, now: float, measured: np.ndarray) -> str:
        """What is lost that everything has to hold for; empty when nothing is."""
        settings = self.settings
        if settings.on_lost_device is WhenLost.HOLD and self.device_is_lost(now):
            return "device lost"
        if settings.on_lost_markers is WhenLost.HOLD and self.markers_are_lost(measured):
            return "markers lost"
        return ""

    def _guide(self, now: float, measured: np.ndarray) -> None:
        """Leads the guided bodies through this tick: they need no cable command to be led."""
        if self._activity is Activity.RETURNING:
            self._guidance.go_home()
        elif self._activity is Activity.HOLDING and not self._loss(now, measured):
            self._guidance.follow(now, self.settings.target_timeout)
        else:
            self._guidance.stay()

    def _nothing_to_do(self, now: float, reading: TargetReading) -> str:
        """Why there is nothing to follow; empty when there is."""
        if self.mode is Mode.INVERSE:
            if not np.isfinite(reading.targets).all(axis=1).any():
                return "no target yet"
            if self.chosen.is_too_old(now, self.settings.target_timeout):
                return "no command for target_timeout"
            return "no target for target_timeout" if reading.timed_out else ""
        age = self.direct.age(now)
        if np.isinf(age):
            return "no command yet"
        return "no command for target_timeout" if 0.0 < self.settings.target_timeout < age else ""

    def _command(self, activity: Activity, cause: str, aims: np.ndarray):
        """The command of this tick's step."""
        time_step = self.settings.period
        if activity is Activity.FOLLOWING:
            return FollowTargets(aims, time_step, self.chosen.lengths)
        if activity is Activity.COMMANDED:
            if self.direct.lengths is not None:
                return SetLengths(self.direct.lengths, time_step)
            return SetTensions(self.direct.tensions, time_step)
        if activity is Activity.RETURNING:
            return SetLengths(self._rest, time_step)
        if activity is Activity.RESYNCHRONISING and not cause:
            return SetLengths(self.device.lengths, time_step)
        return Hold(time_step)

    def _release(
        self, activity: Activity, result: StepResult
    ) -> tuple[CableCommand | None, tuple[str, ...]]:
        """The command to publish, and the limits that the step's own command broke."""
        if activity in (Activity.DISABLED, Activity.RESYNCHRONISING):
            return None, ()
        return self._gate.pass_on(result.lengths, result.tensions, self.settings.period)

    def _arrive(self, activity: Activity, cause: str, result: StepResult) -> None:
        """Ends a return or a resynchronisation that has come as far as it can."""
        returning = activity is Activity.RETURNING
        resynchronising = activity is Activity.RESYNCHRONISING and not cause
        if not (returning or resynchronising) or result.is_on_the_way:
            return
        if returning and not result.status.is_failure and not self._guidance.is_home:
            return
        if result.status.is_failure or returning:
            self._go_to_rest()
        else:
            self._gate.start_from(result.lengths, result.tensions)
        self._activity = Activity.DISABLED if result.status.is_failure else Activity.HOLDING

    def _go_to_rest(self) -> None:
        """Puts the model to its rest shape, and the gate with it."""
        self._must_return = False
        self.simulation.reset()
        self._history.forget()
        self._gate.start_from(self._rest, np.zeros_like(self._rest))
