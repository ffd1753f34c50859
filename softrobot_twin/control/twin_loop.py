"""One tick of the twin: what came in, one step of the simulation, what may go out."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.activity import Activity, Mode, refuse_impossible
from softrobot_twin.control.approach import approach
from softrobot_twin.control.cable_input import CableInput, ChosenInput
from softrobot_twin.control.device_watch import DeviceWatch
from softrobot_twin.control.effector_measurement import EffectorMeasurement
from softrobot_twin.control.engagement import Engagement
from softrobot_twin.control.guidance import Guidance
from softrobot_twin.control.loop_settings import LoopSettings, WhenLost
from softrobot_twin.control.marker_history import MarkerHistory
from softrobot_twin.control.marker_input import MarkerInput
from softrobot_twin.control.marker_plausibility import MarkerPlausibility
from softrobot_twin.control.measured_lengths import MeasuredLengths
from softrobot_twin.control.pose_input import PoseInput
from softrobot_twin.control.settings_check import refuse_what_cannot_be
from softrobot_twin.control.target_correction import TargetCorrection
from softrobot_twin.control.target_input import TargetInput, TargetReading
from softrobot_twin.control.tick_outcome import TickOutcome, taken_back
from softrobot_twin.control.winding import Winding
from softrobot_twin.simulation import (
    FollowTargets,
    Hold,
    CommandSetpoints,
    CommandEfforts,
    Simulation,
)

DEVICE_LOST = "device lost"


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
        self.device = MeasuredLengths(
            names, simulation.rest_setpoints, simulation.limits, simulation.slide_names, settings
        )
        winding = Winding(names, motors, simulation.rest_setpoints, simulation.slide_names)
        self.direct, self.chosen = CableInput(winding, settings), ChosenInput(winding, settings)
        self.poses = PoseInput(simulation.guided_names, frame_id, settings)
        self._guidance = Guidance(simulation, self.poses)
        self.correction = TargetCorrection(effector_count)
        self._history = MarkerHistory(len(simulation.marker_ids))
        self._plausibility = MarkerPlausibility(simulation)
        self._is_lost = False
        self._watch = DeviceWatch(simulation.limits)
        self._engagement = Engagement(
            simulation, self._guidance, self.device if use_device else None
        )

    def check(self, settings: LoopSettings) -> None:
        """Refuses settings that the scene cannot carry out; see `refuse_what_cannot_be`."""
        refuse_what_cannot_be(settings, self.simulation, self.measurement, self.mode)

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
        return self._engagement.is_enabled

    @property
    def why_given_up(self) -> str:
        """Why the loop disabled itself; empty when it did not."""
        return self._engagement.reason if self._engagement.has_given_up else ""

    def enable(self, now: float) -> tuple[bool, str]:
        """Lets commands out again, from where the device is now; targets must be given anew.

        Returns:
            Whether it was done, and a sentence that says what happens.
        """
        if self.is_enabled:
            return True, "already enabled"
        if self.use_device and self.device.implausible is not None:
            return False, f"{self.device.implausible}: nothing to start from"
        if self.device_is_lost(now):
            return False, "the device's measured lengths do not arrive: nothing to start from"
        self._forget_commands()
        self._watch.forget()
        return True, self._engagement.enable()

    def disable(self) -> None:
        """Publishes no command from the next tick on."""
        self._engagement.disable()

    def reset(self) -> str:
        """Goes back to the rest shape and forgets targets and correction.

        A device is not pulled along: the loop is disabled until it is enabled again. Without one,
        the commands go to rest within their limits first, as soon as the loop is enabled; should
        the model fail on the way, they go on to rest without it.

        Returns:
            A sentence that says what happens.
        """
        self._forget_commands()
        self.correction.reset()
        if self.use_device:
            self._forget_markers()
        return self._engagement.reset()

    def _forget_markers(self) -> None:
        """The model was moved otherwise than by steps: what was measured before tells nothing."""
        self._history.forget()
        self._plausibility.forget()

    def _forget_commands(self) -> None:
        for commands in (self.targets, self.direct, self.chosen, self.poses):
            commands.reset()

    def device_is_lost(self, now: float) -> bool:
        """True when a device is in use and its measured lengths do not arrive."""
        return self.use_device and (
            self.device.setpoints is None or self.device.age(now) > self.settings.device_timeout
        )

    def markers_are_lost(self, measured: np.ndarray) -> bool:
        """True when the loop is closed and an effector cannot be measured.

        Args:
            measured: Measured markers [m], shape (marker_count, 3); NaN where not seen.
        """
        closed = self.settings.closed_loop and self.mode is Mode.INVERSE
        return closed and not self.measurement.is_complete(measured)

    def tick(self, now: float, ros_time: int) -> TickOutcome:
        """One tick.

        Args:
            now: Time on the clock of `Arrival.time` [s].
            ros_time: Time on the clock of `Arrival.stamp` [ns].
        """
        simulation, period = self.simulation, self.settings.period
        self._heed_device(now)
        self._engagement.begin()
        positions = simulation.effector_positions()
        reading = self.targets.read(now, period, positions)
        corrected = reading.targets + self.correction.offsets
        wanted = self.measurement.controlled(corrected, positions)
        aims = approach(positions, wanted, self.settings.reach)
        seen = self.markers.measured(now)
        activity, cause = self._decide(now, reading, self._plausibility.without_left_out(seen))
        self._guide(activity, now)
        before = simulation.state
        command = self._command(activity, cause, aims)
        result = simulation.step(command, self.settings.budget)
        passage = self._engagement.release(result, period)
        released, violated = (None, ()) if passage is None else passage
        if violated:
            before = before.kept_through(command.time_step)
            simulation.restore(before)
            result = taken_back(result, before, released, simulation)
        predicted = simulation.marker_positions()
        self._history.add(ros_time, predicted)
        expected = self._history.at(self.markers.stamp)
        self._plausibility.judge(seen - expected, self.markers.stamp, activity.follows_robot)
        measured = self._plausibility.without_left_out(seen)
        misfit = self.markers.misfit(measured, expected)
        effectors = self.measurement.effectors(result.effector_positions, misfit)
        # On its way to a far target an effector tells nothing of the model.
        there = aims == wanted
        self.correction.tick(
            self.settings, activity is Activity.FOLLOWING, self.markers.stamp,
            self.measurement.differences(reading.targets, np.where(there, effectors, np.nan)),
            result.status,
        )  # fmt: skip
        errors = self.measurement.errors(reading.targets, result.effector_positions, effectors)
        poses = self._guidance.poses() if released is None else self._guidance.send(period)
        if cause != DEVICE_LOST and self._engagement.end(result, period):
            self._forget_markers()
        return TickOutcome(
            activity, cause, result, released, violated, reading, aims, predicted, measured,
            misfit, effectors, errors, poses, self._plausibility.left_out,
            bool((~there & np.isfinite(wanted)).any()),
        )  # fmt: skip

    def _heed_device(self, now: float) -> None:
        """Resynchronises with a device that is not where it was sent; it is not driven on."""
        if not self.use_device:
            return
        gate = self._engagement.gate
        moved = self._watch.has_moved(
            self.device, self.device_is_lost(now), gate.last.setpoints,
            gate.reach(self.settings.period),
        )  # fmt: skip
        if moved and self._engagement.activity is Activity.HOLDING:
            if not self._watch.is_on_the_way:
                self._forget_commands()
            self._engagement.resynchronise("the device is not where it was sent")

    def _decide(
        self, now: float, reading: TargetReading, measured: np.ndarray
    ) -> tuple[Activity, str]:
        """What to do in this tick, and why not more."""
        engagement = self._engagement
        if engagement.activity is Activity.RESYNCHRONISING and self.device_is_lost(now):
            return engagement.activity, DEVICE_LOST
        if engagement.activity is not Activity.HOLDING:
            return engagement.activity, engagement.reason
        if engagement.gate.is_outside:
            return Activity.HOLDING, "measured outside the limits, coming in"
        loss = self._loss(now, measured)
        self._is_lost = bool(loss)
        cause = self._nothing_to_do(now, reading) or loss
        if cause:
            return Activity.HOLDING, cause
        return Activity.FOLLOWING if self.mode is Mode.INVERSE else Activity.COMMANDED, ""

    def _loss(self, now: float, measured: np.ndarray) -> str:
        """What is lost that everything has to hold for; empty when nothing is."""
        settings = self.settings
        if settings.on_lost_device is WhenLost.HOLD and self.device_is_lost(now):
            return DEVICE_LOST
        if settings.on_lost_markers is WhenLost.HOLD and self.markers_are_lost(measured):
            return "markers lost"
        return ""

    def _guide(self, activity: Activity, now: float) -> None:
        """Leads the guided bodies through this tick: they need no cable command to be led."""
        if activity is Activity.RETURNING:
            self._guidance.go_home()
        elif activity is Activity.RESYNCHRONISING:
            self._guidance.go_to_sent()
        elif activity is Activity.DISABLED or self._is_lost:
            self._guidance.stay()
        else:
            self._guidance.follow(now, self.settings.target_timeout)

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
            return FollowTargets(aims, time_step, self.chosen.setpoints)
        if activity is Activity.COMMANDED:
            if self.direct.setpoints is not None:
                return CommandSetpoints(self.direct.setpoints, time_step)
            return CommandEfforts(self.direct.efforts, time_step)
        if activity is Activity.RETURNING and self._engagement.leads_by_model:
            return CommandSetpoints(self._engagement.gate.home, time_step)
        if activity is Activity.RESYNCHRONISING and cause != DEVICE_LOST:
            return CommandSetpoints(self._engagement.goal, time_step)
        return Hold(time_step)
