"""Whether commands may leave, and how the model is brought to where the robot is, or to rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softrobot_twin.control.activity import Activity
from softrobot_twin.control.command_gate import LENGTH_TOLERANCE, CommandGate, Passage
from softrobot_twin.control.guidance import Guidance
from softrobot_twin.control.measured_lengths import MeasuredLengths
from softrobot_twin.simulation import Simulation, StepResult

PATIENCE = 0.5
"""Steps on the way may fail for so long before it is given up [s]; a single one always may."""
RESYNCHRONISED_SHARE = 1.0e-3
"""The model is where the robot is at this share of the travel: encoders have noise."""


class Engagement:
    """The state behind the last gate: disabled, resynchronising, returning, or engaged.

    It keeps one promise: no command differs from what left or was measured last by more than
    the rates allow. So the gate is told of the robot only, never of the model. Where the two
    differ, nothing leaves until the model was brought to where the robot is.

    Args:
        simulation: The model, at rest.
        guidance: Leads its guided bodies.
        device: What the device measures, or None without a device.

    Attributes:
        gate: The last gate.
        activity: Disabled, resynchronising, returning or, when engaged, holding.
        reason: Why it is in this state; empty where nothing has to be said.
        has_given_up: It was disabled because the model failed, not because it was told to.
    """

    def __init__(
        self, simulation: Simulation, guidance: Guidance, device: MeasuredLengths | None
    ):
        self._simulation, self._guidance, self._device = simulation, guidance, device
        self.gate = CommandGate(
            simulation.actuator_names, simulation.rest_setpoints, simulation.limits
        )
        travel = simulation.limits.displacement_max - simulation.limits.displacement_min
        self._near = RESYNCHRONISED_SHARE * np.where(np.isfinite(travel), travel, 0.0)
        self._must_return = self._without_model = False
        self._failing = 0.0
        self.activity = Activity.HOLDING if device is None else Activity.DISABLED
        self.reason = "" if device is None else "not enabled"
        self.has_given_up = False

    @property
    def is_enabled(self) -> bool:
        """True when commands may leave, now or once resynchronised."""
        return self.activity is not Activity.DISABLED

    def enable(self) -> str:
        """Lets commands out again, from where the robot is.

        Returns:
            What happens.
        """
        self._failing, self.has_given_up, self.reason = 0.0, False, ""
        if self._device is not None:
            self.activity = Activity.RESYNCHRONISING
            return "resynchronising with the device"
        if self._must_return:
            self._return()
            return "enabled, returning to rest"
        self.activity = Activity.HOLDING
        return "enabled"

    def disable(self, reason: str = "not enabled") -> None:
        """Lets no command out from now on."""
        self.activity, self.reason, self.has_given_up = Activity.DISABLED, reason, False

    def reset(self) -> str:
        """Goes to rest: the model alone where a device is, within the limits where none is.

        Returns:
            What happens.
        """
        if self._device is not None:
            self._simulation.reset()
            self.disable()
            return "at rest, disabled: enable to go on"
        self._must_return = True
        if not self.is_enabled:
            return "returning to rest when enabled"
        self._return()
        return "returning to rest"

    def resynchronise(self, reason: str) -> None:
        """Brings the model to where the robot is, before anything leaves."""
        self._failing = 0.0
        self.activity, self.reason = Activity.RESYNCHRONISING, reason

    def _return(self) -> None:
        self._failing = 0.0
        self.activity, self.reason = Activity.RETURNING, self._reason_to_return

    @property
    def _reason_to_return(self) -> str:
        if self._without_model:
            return "reset: the model failed, going to rest without it"
        return "reset"

    def begin(self) -> None:
        """Looks, before a tick, whether the model stands where the last command left the robot."""
        if not self.is_enabled or self._without_model:
            return
        if self.activity is not Activity.RESYNCHRONISING and not self._is_in_step():
            self.resynchronise("the model was elsewhere")

    def _is_in_step(self) -> bool:
        gate = self.gate
        apart = np.abs(self._simulation.state.setpoints - gate.within(gate.last.setpoints))
        return bool((apart <= 2.0 * LENGTH_TOLERANCE).all()) and self._guidance.is_in_step

    @property
    def goal(self) -> np.ndarray:
        """Where the model has to be brought: lengths of the robot [m], (actuator_count,)."""
        if self._device is not None and self._device.setpoints is not None:
            return self._device.setpoints
        return self.gate.last.setpoints

    @property
    def leads_by_model(self) -> bool:
        """False while a robot goes to rest whose model failed on the way."""
        return not self._without_model

    def release(self, result: StepResult, time_step: float) -> Passage | None:
        """What may be published of a step, or None when nothing may be.

        Args:
            result: The step.
            time_step: Time since the last command [s].
        """
        if self.activity in (Activity.DISABLED, Activity.RESYNCHRONISING):
            return None
        if self._without_model:
            return Passage(self.gate.lead(self.gate.home, time_step), ())
        return self.gate.pass_on(result.setpoints, result.efforts, time_step)

    def end(self, result: StepResult, time_step: float) -> bool:
        """Ends, after a tick, a return or a resynchronisation that arrived or cannot.

        Args:
            result: The tick's step.
            time_step: Its duration [s].

        Returns:
            True when the model was moved otherwise than by a step.
        """
        self._failing = self._failing + time_step if result.status.is_failure else 0.0
        gives_up = self._failing > max(PATIENCE, time_step)
        if self.activity is Activity.RETURNING:
            return self._end_return(gives_up)
        if self.activity is Activity.RESYNCHRONISING:
            return self._end_resynchronisation(gives_up, result, time_step)
        return False

    def _end_return(self, gives_up: bool) -> bool:
        way = np.abs(self.gate.last.setpoints - self.gate.home)
        if not (way > LENGTH_TOLERANCE).any() and self._guidance.is_home:
            self._must_return = self._without_model = False
            self.activity, self.reason = Activity.HOLDING, ""
        elif gives_up and not self._without_model:
            self._without_model = True
            self.reason = self._reason_to_return
        else:
            return False
        self._simulation.reset()
        return True

    def _end_resynchronisation(
        self, gives_up: bool, result: StepResult, time_step: float
    ) -> bool:
        goal, gate = self.goal, self.gate
        if gives_up:
            self._simulation.reset()
            self.disable(f"the model cannot follow to where the robot is: {result.status.value}")
            self.has_given_up = True
            return True
        near = np.maximum(gate.reach(time_step), np.maximum(self._near, LENGTH_TOLERANCE))
        # What is not finite is not there.
        there = (np.abs(result.setpoints - gate.within(goal)) <= near).all()
        there = there and np.isfinite(result.efforts).all()
        if result.status.is_failure or not there or not self._guidance.is_in_step:
            return False
        state = self._simulation.state
        if not np.array_equal(state.setpoints, gate.within(goal)):
            self._simulation.restore(replace(state, setpoints=gate.within(goal)))
        gate.start_from(goal, result.efforts)
        self.activity, self.reason = Activity.HOLDING, ""
        if self._must_return:
            self._return()
        return True
