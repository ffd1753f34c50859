"""What commands a robot that vibrates: prediction of its motion, or what would do if it stood.

With `control` in a scene the twin steps that scene by direct commands, and these come from here: from
`PredictiveControl` around a state at rest, or from a copy of the scene in statics that follows the
targets as any other twin does. The copy also stands in where the linear model cannot follow; why is
told, and after a pause prediction is tried again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from softrobot_twin.analysis.linear_model import LinearModel, ModalTangent
from softrobot_twin.control.force_observer import USUAL_NOISE
from softrobot_twin.control.input_shaping import Shaper
from softrobot_twin.control.predictive_control import (
    InputRange,
    StabilityMargin,
    with_margin,
)
from softrobot_twin.control.target_correction import approach
from softrobot_twin.errors import CommandError
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Simulation,
    State,
    StepResult,
)
from softrobot_twin.simulation.command import LONG

OFF = "prediction is off"
SINGLE_ACTUATORS = "single actuators are commanded"
TOO_FAR = "the model does not predict the measured motion"
UNSOLVED = "its program was not solved"
SLACK = "{} is slack"
MOST_SURPRISE = 1.0
"""Errors of a prediction from one measurement to the next, by how far the outputs move meanwhile, both
RMS. A model that knows nothing of the motion has 1."""
SURPRISING_NOISE = 10.0
"""Smaller errors than so many standard deviations of the noise are no surprise."""
MEMORY = 0.5
"""Time over which these are averaged, and from the begin of which on [s]."""
PAUSE, LONGEST_PAUSE = 1.0, 60.0
"""Time after which prediction is tried again, doubled each time, and the longest one [s]."""
MOST_MISSED = 50
"""Ticks without a step for which the inputs are taken to have acted on, at most."""
MOST_STEPS = 200
"""Steps of the copy in statics to the state around which the model is linear."""


class DynamicControl:
    """Commands of a scene with `control`.

    Attributes:
        model: The linear model.
        by_effort: Whether tensions are commanded, and not lengths.
        statics: The copy of the scene in statics.
        margin: Margin of stability of prediction; None with `law: quasi_static`.
        shaper: Spreads targets over time; None without shaping.
        why_quasi_static: Why prediction does not command now; empty where it does.
        fallbacks: How often the copy in statics stood in.
    """

    def __init__(self, simulation: Simulation, period: float, may_predict: bool = True):
        """Build the linear model around a state at rest, and all that commands.

        Args:
            simulation: The twin's simulation; its state is as before afterwards.
            period: Time of a tick [s].
            may_predict: See `apply`.

        Raises:
            SceneError: There is no linear model at the state that the scene names.
        """
        self._simulation, self._entry = simulation, simulation.scene.control
        self.by_effort = self._entry.inputs == "efforts"
        statics = simulation.scene.changed(
            integration="quasi_static", time_scheme="backward_euler", spectral_radius=None, control=None)
        self.statics = Simulation(statics, with_warnings=False)
        self.statics.warm_up()
        self.model = self._linear_model()
        controlled = [axis in effector.directions for effector in simulation.scene.effectors
                      for axis in "xyz"]  # fmt: skip
        self._outputs = np.flatnonzero(controlled)
        self.fallbacks, self.shaper = 0, None
        self.margin: StabilityMargin | None = None
        self._may_predict = may_predict
        self._build(period)

    def _build(self, period: float) -> None:
        """Makes all that depends on the time of a tick."""
        entry, limits = self._entry, self._simulation.limits
        self._period = period
        if entry.shaping != "none":
            self.shaper = Shaper(self.model, self._outputs, entry.shaping, period)
        if entry.law == "dynamic":
            by_setpoint = ~self.model.is_by_effort
            allowed = InputRange(
                np.where(by_setpoint, limits.displacement_min, limits.effort_min),
                np.where(by_setpoint, limits.displacement_max, limits.effort_max), limits.drive_rate)
            self._control, self.margin = with_margin(
                self.model, period, self._outputs, allowed, noise=USUAL_NOISE,
                horizon=max(2, round(entry.horizon / period)), delay=round(entry.delay / period))  # fmt: skip
        self.reset()

    def apply(self, period: float, may_predict: bool = True) -> None:
        """Takes changed settings.

        Args:
            period: Time of a tick [s].
            may_predict: False where the copy in statics commands until further notice.
        """
        self._may_predict = may_predict
        if period != self._period:
            self._build(period)

    def reset(self) -> None:
        """Begins anew, without a target."""
        self._follows, self._pause, self._waits = False, 0.0, -1.0
        self.why_quasi_static = self._never()
        self._errors = self._motion = 0.0
        self._before: np.ndarray | None = None
        self._references: np.ndarray | None = None
        self._seen = 0
        self._is_of_statics = False
        self._ended = 0.0
        if self.shaper is not None:
            self.shaper.reset()

    def _never(self) -> str:
        """Why prediction never commands; empty where it may."""
        if self.margin is None:
            return "law is quasi_static"
        if not self._may_predict:
            return OFF
        return "" if self.margin.is_enough else f"too little margin: {self.margin.in_words()}"

    @property
    def surprise(self) -> float:
        """Errors of the predictions lately, by how far the effectors moved meanwhile, both RMS."""
        return float(np.sqrt(self._errors / self._motion)) if self._motion else 0.0

    @property
    def horizon(self) -> np.ndarray:
        """Times from now of the ends of the ticks for which targets are asked [s], shape (n,)."""
        if self.margin is None:
            return np.zeros(1)
        first = self._control.delay + 1
        return self._period * (first + np.arange(self._control.horizon))

    def words(self) -> str:
        """What it is and how sure, in a sentence for the log."""
        model, entry = self.model, self._entry
        modes = ", ".join(f"{one:.3g} Hz (damping {100 * ratio:.2g} %)" for one, ratio in
                          zip(model.frequencies, model.damping_ratios, strict=True))  # fmt: skip
        law = f"control {entry.law} by {', '.join(model.inputs)}; modes {modes}"
        if self.shaper is not None:
            return f"{law}; targets are spread over {self.shaper.duration:.3g} s"
        return law if self.margin is None else f"{law}; {self.margin.in_words()}"

    # --- a tick ----------------------------------------------------------------------------------

    def measure(self, effectors: np.ndarray, age: float) -> None:
        """Takes measured effectors.

        Args:
            effectors: [m], NaN where they are hidden, shape (effector_count, 3).
            age: How long ago they were measured [s].
        """
        outputs = effectors.ravel()[self._outputs]
        if not self._follows or self.margin is None or not np.isfinite(outputs).any():
            return
        self._control.measure(outputs, age)
        moved = np.nan_to_num(outputs - (outputs if self._before is None else self._before))
        self._before = outputs
        share, error = min(1.0, self._period / MEMORY), self._control.innovation
        self._seen += 1
        if self._seen * self._period > MEMORY:  # Before, the filter learns where the robot is.
            self._motion += share * (float(moved @ moved) - self._motion)
            self._errors += share * (float(error @ error) - self._errors)

    def command(
        self, wanted: np.ndarray, ahead: np.ndarray, reach: float, time, single: np.ndarray | None,
        now: float,
    ) -> CommandSetpoints | CommandEfforts:
        """The command of a tick that follows targets.

        Args:
            wanted: Targets of this tick, corrected, for the copy in statics [m], shape
                (effector_count, 3).
            ahead: Targets at the times of `horizon` [m], shape (n, effector_count, 3); NaN without.
            reach: Greatest distance of a target from one tick to the next [m].
            time: The time that the tick stands for, see `TickTime`.
            single: Setpoints of single actuators that are commanded; None for none.
            now: Time on the clock of the ticks [s].
        """
        if not self._follows:
            self._begin(now)
        if self.why_quasi_static and self._waits <= 0.0 and not self._never():
            self._restart()
            self.why_quasi_static = ""
        why = self._never() or self._why_not(single)
        if not (why or self.why_quasi_static):
            planned = self._control.plan(self._targets(ahead, reach))
            why = "" if planned.is_solved else UNSOLVED
        if why and not self.why_quasi_static:
            self._fall_back(why)
        if self.why_quasi_static:
            return self._by_statics(wanted, reach, time, single)
        self._is_of_statics = False
        return self._direct(planned.inputs, time)

    def end(self, state: State, follows: bool, now: float) -> None:
        """Takes the inputs that a tick ended with.

        Args:
            state: The state of the twin's simulation.
            follows: Whether the tick followed targets.
            now: Time on the clock of the ticks [s].
        """
        # Inputs of a tick act until the next one, also where ticks were missed before it.
        ticks = round((now - self._ended) / self._period) if self._follows else 1
        self._ended = now
        if not follows:
            if self._follows:
                self.reset()
        elif self.margin is not None:
            for _ in range(min(ticks, MOST_MISSED) - 1):
                self._control.send(self._control.last_inputs)
            self._control.send(self._inputs(state))
            self._waits -= self._period

    def _begin(self, now: float) -> None:
        """Begins to follow targets, from where the robot is, at a time [s]."""
        self._follows, self._ended = True, now - self._period
        if self.margin is not None:
            self._restart()

    def _restart(self) -> None:
        """The filter begins anew, with a robot that stands where the model has it."""
        at = self._simulation.effector_positions().ravel()[self._outputs]
        self._control.reset(self._inputs(self._simulation.state), at)
        self._errors = self._motion = 0.0
        self._before, self._references, self._seen = None, None, 0

    def _inputs(self, state: State) -> np.ndarray:
        """The inputs that a state of the twin's simulation stands for, shape (input_count,)."""
        drives = self._simulation.actuators.drives(state.setpoints)
        return np.where(self.model.is_by_effort, state.efforts, drives)

    def _why_not(self, single: np.ndarray | None) -> str:
        """Why the linear model cannot follow in this tick; empty where it can."""
        if single is not None and np.isfinite(single).any():
            return SINGLE_ACTUATORS
        least = SURPRISING_NOISE * USUAL_NOISE
        if self._seen * self._period > 2.0 * MEMORY and self._errors > MOST_SURPRISE**2 * self._motion + least**2:
            return TOO_FAR
        return self._why_slack(self._simulation.state)

    def _why_slack(self, state: State) -> str:
        """Which actuator that a length drives is slack, so that it moves nothing; empty for none."""
        actuators = self._simulation.actuators
        slack = actuators.one_sided & (state.efforts <= 0.0) & ~actuators.is_effort_driven
        return SLACK.format(actuators.names[int(np.argmax(slack))]) if slack.any() and not self.by_effort else ""

    def _fall_back(self, why: str) -> None:
        """Lets the copy in statics stand in for a while; the longer, the more often it must."""
        self.why_quasi_static = why
        self.fallbacks += 1
        if why in (SINGLE_ACTUATORS, OFF):
            self._waits = 0.0
            return
        # What lasted ten pauses is forgotten.
        self._pause = PAUSE if -self._waits > 10.0 * self._pause else 2.0 * self._pause
        self._waits = self._pause = min(self._pause, LONGEST_PAUSE)

    def _targets(self, ahead: np.ndarray, reach: float) -> np.ndarray:
        """Targets of the outputs over the horizon, shape (n, output_count)."""
        here = self._simulation.effector_positions()
        wanted = np.where(np.isfinite(ahead), ahead, here)
        if np.isfinite(reach):
            place = here if self._references is None else self._references
            walked = []
            for one in wanted:
                place = approach(place, one, reach)
                walked.append(place)
            wanted = np.array(walked)
            self._references = wanted[0]
        return wanted.reshape(len(wanted), -1)[:, self._outputs]

    def _by_statics(self, wanted, reach: float, time, single) -> CommandSetpoints | CommandEfforts:
        """The command of the copy in statics, which goes on from the present inputs."""
        statics = self.statics
        if not self._is_of_statics:
            self._is_of_statics, state = True, self._simulation.state
            statics.restore(replace(statics.state, positions=state.positions,
                                    setpoints=state.setpoints, efforts=state.efforts))  # fmt: skip
        if self.shaper is not None:
            wanted = self.shaper.shaped(wanted)
        if np.isfinite(reach):
            wanted = approach(statics.effector_positions(), wanted, reach)
        result = statics.step(FollowTargets(wanted, time.step, single, reach_time=time.reach))
        return self._direct(self._inputs(result.state), time)

    def _direct(self, inputs: np.ndarray, time) -> CommandSetpoints | CommandEfforts:
        """The command of inputs."""
        if self.by_effort:
            return CommandEfforts(inputs, time.step, time.reach)
        return CommandSetpoints(self._simulation.actuators.setpoints(inputs), time.step, time.reach)

    # --- the linear model ------------------------------------------------------------------------

    def _settle(self, inputs: np.ndarray) -> StepResult:
        """Brings the copy in statics to rest under inputs."""
        statics = self.statics
        command = CommandEfforts(inputs, LONG) if self.by_effort else CommandSetpoints(
            statics.actuators.setpoints(inputs), LONG)  # fmt: skip
        for _ in range(MOST_STEPS):
            result = statics.step(command)
            if result.status.is_success and statics.stay(command) is not None:
                break
        return result

    def _around(self) -> np.ndarray:
        """Inputs around which the model is linear, shape (actuator_count,)."""
        simulation, given = self._simulation, self._entry.around
        count, limits = simulation.actuators.count, simulation.limits
        if given and len(given) != count:
            raise simulation.scene.error(
                "control.around", list(given), f"has a number for each actuator: {count}")
        if given:
            return np.array(given, float)
        tensions = np.where(np.isfinite(limits.effort_max), 0.1 * limits.effort_max, 0.0)
        is_cable = simulation.actuators.one_sided & ~simulation.actuators.is_effort_driven
        return np.where(is_cable & self.by_effort, tensions, 0.0)

    def _linear_model(self) -> LinearModel:
        """The model around the state at rest that the scene names."""
        simulation, before = self._simulation, self._simulation.state
        around = self._around()
        result = self._settle(around)
        if not result.status.is_success:
            raise simulation.scene.error(
                "control.around", around.tolist(), f"has no state at rest: {result.status.value}")
        at = result.state
        if why := self._why_slack(at):
            raise simulation.scene.error("control.around", around.tolist(), f"{why} there: pull it more")
        try:
            simulation.restore(replace(
                before, positions=at.positions, setpoints=at.setpoints, efforts=at.efforts,
                velocities=np.zeros_like(before.velocities), past=None))  # fmt: skip
            by_effort = np.full(simulation.actuators.count, self.by_effort)
            return ModalTangent(simulation, by_effort).at_state(self._entry.modes)
        except CommandError as error:
            raise simulation.scene.error("control.around", around.tolist(), str(error)) from None
        finally:
            simulation.restore(before)
