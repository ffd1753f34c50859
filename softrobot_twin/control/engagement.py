"""Whether commands may leave, and how the model is moved to where the robot is, or to rest."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum

import numpy as np

from softrobot_twin.control.command_gate import ActuatorCommand, CommandGate, Passage
from softrobot_twin.control.device import MeasuredSetpoints
from softrobot_twin.control.guidance import Guidance
from softrobot_twin.simulation import Simulation, State, StepResult
from softrobot_twin.simulation.appearance import Pose

LONGEST_FAILURE = 0.5
"""A return or a resynchronisation ends when its steps fail for longer than this [s]. A single
failed step never ends it."""
RESYNCHRONISED_SHARE = 1.0e-3
"""The model is where the robot is when they differ by less than this share of the travel, because
encoders have noise."""


class Activity(Enum):
    """What the loop does in a tick. The value is the word that diagnostics show."""

    DISABLED = "disabled"
    """No command is published."""
    RESYNCHRONISING = "resynchronising"
    """The model moves to where the robot is; nothing is published yet."""
    RETURNING = "returning"
    """The robot moves to the rest shape, within the limits; the model is reset there."""
    HOLDING = "holding"
    """The actuators keep their setpoints."""
    FOLLOWING = "following"
    """The effectors follow their targets."""
    COMMANDED = "commanded"
    """The actuators follow a direct command."""

    @property
    def follows_robot(self) -> bool:
        """True when the model is where the robot was sent, so that both can be compared."""
        return self not in (Activity.DISABLED, Activity.RESYNCHRONISING)


class Engagement:
    """The state behind the gate: disabled, resynchronising, returning, or engaged.

    Its purpose: no command differs from the last command or measurement by more than the rates
    allow. Therefore the gate stores positions of the robot, never of the model. When the two
    differ, no command is published until the model has been moved to where the robot is.

    Args:
        simulation: The model, at rest.
        guidance: Moves its guided bodies.
        device: The setpoints that the device measures, or None without a device.

    Attributes:
        gate: The gate for commands.
        activity: Disabled, resynchronising, returning or, when engaged, holding.
        reason: Why it is in this state; empty where no reason is needed.
        has_given_up: It was disabled because something failed, not by a request.
        is_without_model: The robot returns to rest without the model, because the model failed.
    """

    def __init__(self, simulation: Simulation, guidance: Guidance, device: MeasuredSetpoints | None):
        self._simulation, self._guidance, self._device = simulation, guidance, device
        self.gate = CommandGate(simulation.actuator_names, simulation.rest_setpoints, simulation.limits)
        self._near = np.maximum(
            RESYNCHRONISED_SHARE * simulation.limits.travel(0.0), self.gate.tolerances.setpoints
        )
        self._must_return = self.is_without_model = False
        self._failing, self._led = 0.0, (None, None)
        self._begun: tuple[State, ActuatorCommand, bool, dict[str, Pose]] | None = None
        self.activity = Activity.HOLDING if device is None else Activity.DISABLED
        self.reason = "" if device is None else "not enabled"
        self.has_given_up = False

    @property
    def is_enabled(self) -> bool:
        """True when commands may leave, now or after the resynchronisation."""
        return self.activity is not Activity.DISABLED

    @property
    def goal(self) -> np.ndarray:
        """Setpoints of the robot, to which the model must be moved, shape (actuator_count,)."""
        if self._device is not None and self._device.setpoints is not None:
            return self._device.setpoints
        return self.gate.last.setpoints

    def enable(self) -> str:
        """Allows commands again, starting from where the robot is.

        Returns:
            What happens next.
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
        """Stops all commands from now on.

        Args:
            reason: Why, for the status.
        """
        self.activity, self.reason, self.has_given_up = Activity.DISABLED, reason, False

    def give_up(self, reason: str) -> None:
        """Disables because something failed, not by a request.

        Args:
            reason: Why, for the status.
        """
        self.disable(reason)
        self.has_given_up = True

    def reset(self) -> str:
        """Returns to rest: with a device only the model, without one also the commands.

        Returns:
            What happens next.
        """
        if self._device is not None:
            self._simulation.reset()
            self.disable()
            return "at rest and disabled; call enable to continue"
        self._must_return = True
        if not self.is_enabled:
            return "returning to rest when enabled"
        self._return()
        return "returning to rest"

    def resynchronise(self, reason: str) -> None:
        """Stops all commands until the model was moved to where the robot is.

        Args:
            reason: Why, for the status.
        """
        self._failing = 0.0
        self.activity, self.reason = Activity.RESYNCHRONISING, reason

    def _return(self) -> None:
        self._failing = 0.0
        self.activity, self.reason = Activity.RETURNING, self._reason_to_return

    @property
    def _reason_to_return(self) -> str:
        if self.is_without_model:
            return "reset: the model failed, the robot returns to rest without it"
        return "reset"

    def begin(self) -> None:
        """Checks before a tick that the model is where the last command sent the robot."""
        self._begun = (self._simulation.state, self.gate.last, self.gate.is_outside,
                       dict(self._guidance.sent))  # fmt: skip
        if not self.is_enabled or self.is_without_model:
            return
        if self.activity is not Activity.RESYNCHRONISING and not self._is_synchronised():
            self.resynchronise("the model was not where the robot was sent")

    def keep(self) -> None:
        """Ends a tick whose command leaves."""
        self._begun = None

    def undo(self) -> None:
        """Takes back a tick that failed before its end: of its command nothing has left."""
        state = self._simulation.state
        if self._begun is not None:
            state, self.gate.last, self.gate.is_outside, self._guidance.sent = self._begun
            self._begun = None
        # What the simulation remembers beside its state may be of an unfinished step.
        self._simulation.restore(state)

    def _is_synchronised(self) -> bool:
        gate, state = self.gate, self._simulation.state
        if self._led[0] is not state or self._led[1] is not gate.last:
            apart = np.abs(state.setpoints - gate.within(gate.last.setpoints))
            if not (apart <= 2.0 * gate.tolerances.setpoints).all():
                return False
        return self._guidance.is_synchronised

    @property
    def last_command(self) -> ActuatorCommand | None:
        """The last command or measurement, where commands may leave now; else None."""
        if self.activity in (Activity.DISABLED, Activity.RESYNCHRONISING):
            return None
        return self.gate.last

    def release(self, result: StepResult, time_step: float) -> Passage | None:
        """The command of a step that may be published, or None when none may.

        Args:
            result: The step.
            time_step: Time since the last command [s].
        """
        if self.last_command is None:
            return None
        if self.is_without_model:
            return Passage(self.gate.lead(self.gate.home, time_step), ())
        state, is_inside = result.state, not self.gate.is_outside
        passage = self.gate.pass_on(result.setpoints, result.efforts, time_step)
        if is_inside and not passage.violated and result.setpoints is state.setpoints:
            # What passes from inside the limits is that of the state but for tolerances.
            self._led = state, passage.command
        return passage

    def end(self, result: StepResult, time_step: float) -> bool:
        """Ends, after a tick, a return or resynchronisation that is complete or has failed.

        Args:
            result: The tick's step.
            time_step: Its duration [s].

        Returns:
            True when the model was moved other than by a step.
        """
        self._failing = self._failing + time_step if result.status.is_failure else 0.0
        gives_up = self._failing > max(LONGEST_FAILURE, time_step)
        if self.activity is Activity.RETURNING:
            return self._end_return(gives_up)
        if self.activity is Activity.RESYNCHRONISING:
            return self._end_resynchronisation(gives_up, result, time_step)
        return False

    def _end_return(self, gives_up: bool) -> bool:
        gate = self.gate
        is_home = (np.abs(gate.last.setpoints - gate.home) <= gate.tolerances.setpoints).all()
        if is_home and self._guidance.is_home:
            self._must_return = self.is_without_model = False
            self.activity, self.reason = Activity.HOLDING, ""
        elif gives_up and not self.is_without_model:
            self.is_without_model = True
            self.reason = self._reason_to_return
        else:
            return False
        self._simulation.reset()
        return True

    def _end_resynchronisation(self, gives_up: bool, result: StepResult, time_step: float) -> bool:
        goal, gate = self.goal, self.gate
        if gives_up:
            self._simulation.reset()
            self.give_up(f"the model cannot be moved to where the robot is: {result.status.value}")
            return True
        near = np.maximum(gate.reach(time_step), self._near)
        # A comparison with NaN is false, so a result that is not finite counts as not arrived.
        arrived = (np.abs(result.setpoints - gate.within(goal)) <= near).all()
        arrived = arrived and np.isfinite(result.efforts).all()
        if result.status.is_failure or not arrived or not self._guidance.is_synchronised:
            return False
        state = self._simulation.state
        if not np.array_equal(state.setpoints, gate.within(goal)):
            self._simulation.restore(replace(state, setpoints=gate.within(goal)))
        gate.start_from(goal, result.efforts)
        self.activity, self.reason = Activity.HOLDING, ""
        if self._must_return:
            self._return()
        return True
