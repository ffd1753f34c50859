"""A scene that can be stepped: commands in, states and reports out."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.kernels.kernels_ahead import help_with
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.simulation.build import build_model
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import TIMES, Command, Hold, are_same, may_move
from softrobot_twin.simulation.effects.effects import step_parts
from softrobot_twin.simulation.effects.gripping import Gripping
from softrobot_twin.simulation.effects.moving_base import MovingBase
from softrobot_twin.simulation.mounting import Mounted, branch_notes, mount
from softrobot_twin.simulation.readouts import Readouts
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.state import State, made
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.goals import Goal, Goals
from softrobot_twin.simulation.step.inverse_choice import build_inverse
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.situation import NO_LOADS
from softrobot_twin.simulation.step.step import Failure, StepLoop
from softrobot_twin.simulation.step.step_part import Leader, Planner, StepPart, one_of, parts_by_method, those_with
from softrobot_twin.simulation.step.step_report import Balance, Outcome, StepResults
from softrobot_twin.simulation.step.time_budget import StageClock, TimeBudget
from softrobot_twin.simulation.step.time_integration import Dynamics, GeneralizedAlpha, Statics
from softrobot_twin.simulation.warm_up import run_every_path

# Steps towards the same targets that keep the state before further ones need not be made. Within
# fewer the inverse tries all that it will try from there, but one step for each actuator.
STEPS_UNTIL_REST = 120


class Kept(NamedTuple):
    """What keeps a state in balance.

    Attributes:
        command: The command whose step kept it last.
        count: Steps in a row that kept it by the same command, less one.
        result: What further steps by that command give; None where they must be made.
    """

    command: Command
    count: int
    result: StepResult | None


class Prepared(NamedTuple):
    """A step whose first linearization is done.

    Attributes:
        state: Where it begins.
        goal: A goal like its own.
        time: How long the linearization took [s].
    """

    state: State
    goal: Goal
    time: float

    def serves(self, state: State, goal: Goal) -> bool:
        """Whether it is the beginning of a step.

        Args:
            state: Where the step begins.
            goal: What is asked of it.
        """
        is_alike = goal.driven_by == self.goal.driven_by and state is self.state
        return is_alike and goal.command.time_step == self.goal.command.time_step


class Simulation(Readouts):
    """One scene, its state, and the step between states.

    Attributes:
        model: The built scene.
        state: Where it stands now.
        now: Gives the time that stages and budgets are measured by [s].
        newton: Linearizes the model and corrects positions.
        inverse: Finds actuation towards targets; None in scenes without effectors.
        mounted: What its mounting came to; None where the robot rests as it is drawn.
        parts: The optional effects around its steps.
        kept: What keeps the state; None where the last step changed it.
        is_balanced: Whether the last step ended in balance, or near it.
        may_rest: Whether a state in balance is kept while the command stays.
    """

    def __init__(
        self, scene: Scene, now: Callable[[], float] = perf_counter,
        factorization_type: type | None = None, with_warnings: bool = True, mounted: Mounted | None = None,
    ):
        """Build a scene.

        Args:
            scene: The scene.
            now: Gives the time that stages and budgets are measured by [s].
            factorization_type: Class to factorize with, in place of the scene's.
            with_warnings: Whether to look for what looks wrong, see `build_model`.
            mounted: Where a robot of this structure was mounted, from which this one is; None to begin
                with the drawn one.

        Raises:
            SceneError: An entry does not fit the mesh.
            MeshError: The mesh cannot be used.
        """
        help_with(scene)
        self.mounted = mount(scene, type(self), mounted) if scene.mounting else None
        rest = None if self.mounted is None else self.mounted.positions
        self._take(build_model(scene, factorization_type, with_warnings, rest))
        self.now = now
        parts = step_parts(self.model)
        self._motion = _motion_of(self.model)
        self._beginners = self.model.beginners
        # A step works on one array of its own, in which its stages are traced.
        self._positions = self.model.nodes.rest_positions.copy()
        self._motion.begin_step(
            self._beginners, self.model.nodes.rest_positions.copy(), self._motion.at_rest(), None, 1.0
        )
        self.newton = Newton(self.model)
        self.direct = DirectActuation(self.model)
        if self.model.is_dynamic:
            self._beginners = (*self._beginners, self.newton)
        self.inverse = build_inverse(self.model, self.direct)
        # The result of the last step, as long as somebody keeps it and nobody has read it.
        self._unread: Callable[[], StepResult | None] = _no_result
        self._prepared: Prepared | None = None
        self._goals = Goals(self.model, self.direct, self.inverse)
        self._find_surface()
        self._take_parts(parts)
        self.reset()
        if with_warnings and scene.mounting:
            self.model.notes.extend(branch_notes(self))

    def _take_parts(self, parts: tuple[StepPart, ...]) -> None:
        """Step with these optional effects around."""
        self.parts = parts
        self._parts_with = parts_by_method(parts)
        self._planner, self._leader = one_of(parts, Planner), one_of(parts, Leader)
        self._keeping = those_with(parts, "memory_at_rest", "may_keep")
        self._depends_on_time = any(part.depends_on_time for part in parts)
        self._results = StepResults(self.model, parts, self.newton)
        self._loop = StepLoop(self.model, self.newton, self.direct, self.inverse, parts)
        # Dynamic scenes, contacts and some parts remember more than a state that is kept tells of.
        may_all = all(part.may_rest for part in parts)
        self.may_rest = may_all and not (self.model.is_dynamic or self.model.rows.varies)

    @classmethod
    def from_scene_file(cls, path: Path | str) -> Simulation:
        """Read and build a scene file; see `load_scene` and the constructor."""
        return cls(load_scene(path))

    def grip(self, name: str, holds: bool) -> None:
        """Tell a grip to hold, or to let go, from the next step on.

        Args:
            name: Name of the grip.
            holds: Whether it shall hold.

        Raises:
            CommandError: The scene has no such grip.
        """
        part: Any = self._part_of(Gripping, name, "is no grip: this scene has none")
        part.tell(name, holds)

    def move_base(
        self, position: np.ndarray, quaternion: np.ndarray | None, time: float, is_anew: bool = False
    ) -> None:
        """Tell where a moving base is, from which its acceleration follows in the next steps.

        Args:
            position: Its origin in the world [m], shape (3,).
            quaternion: Its rotation (x, y, z, w), shape (4,); None for none.
            time: When it is there [s].
            is_anew: Whether the poses before are forgotten.

        Raises:
            CommandError: The scene has no moving base, or the quaternion is no rotation.
        """
        part: Any = self._part_of(MovingBase, "base", "does not move: the scene has no moving_base")
        if is_anew:
            part.track.forget()
        part.tell(position, quaternion, time)

    def _part_of(self, kind: type[StepPart], name: str, reason: str) -> StepPart:
        """The part of a kind, of which something new is told: no state is kept, and nothing explored."""
        part = next((part for part in self.parts if isinstance(part, kind)), None)
        if not part:
            raise CommandError(name, reason)
        self.kept = None
        self._planner.forget()
        return part

    def reset(self) -> None:
        """Go back to the rest shape. What follows is the same, to the bit, as the first time."""
        self.finish_result()
        count = len(self.actuator_names)
        self.state = State(
            self.model.nodes.rest_positions.copy(), self.rest_setpoints.copy(),
            np.zeros(count) if self.mounted is None else self.mounted.efforts.copy(),
            velocities=self._motion.at_rest(), memory=self._memory(
                (part, part.memory_at_rest()) for part in self.parts
            ),
        )  # fmt: skip
        for part in self.parts:
            part.reset()
        self._begin_anew()

    @staticmethod
    def _memory(parts: Iterable[tuple[StepPart, dict[str, np.ndarray]]]) -> dict[str, np.ndarray]:
        """The memory of all parts; see `State`."""
        return {
            f"{part.name}.{field}": array for part, fields in parts for field, array in fields.items()
        }

    def restore(self, state: State) -> None:
        """Put a saved state back.

        Args:
            state: A state of this simulation.

        Raises:
            CommandError: The state is of another scene or mesh.
        """
        self.finish_result()
        self.check_fits(state)
        self.state = state
        for part in self.parts:
            part.restore(state)
        self._begin_anew()

    def check_fits(self, state: State) -> None:
        """Refuses what is no state, or a state of other shapes.

        Args:
            state: A state of this simulation.

        Raises:
            CommandError: The state is of another scene or mesh.
        """
        if not isinstance(state, State):
            raise CommandError("state", f"must be a state of this robot, not {state!r:.60}")
        if (
            state.positions.shape != self.state.positions.shape
            or state.setpoints.shape != self.state.setpoints.shape
            or state.velocities.shape != self.state.velocities.shape
            or _shapes(state.memory) != _shapes(self.state.memory)
            or not self._motion.knows(state.past)
        ):
            raise CommandError("state", "is not of this scene: its shapes differ")

    def take_over(self, other: Simulation, state: State | None = None) -> None:
        """Stand as a simulation of the same structure, whose nodes may rest elsewhere.

        Args:
            other: The other one; its displacements, setpoints and efforts are taken.
            state: A state of it; None for that where it stands.

        Raises:
            CommandError: It is of another scene or mesh.
        """
        state = state or other.state
        self.check_fits(state)
        places = self.model.nodes.placed_like(other.model.nodes, state.positions)
        self.restore(replace(state, positions=places))

    def _begin_anew(self) -> None:
        """Forget the steps before."""
        self.kept: Kept | None = None
        self._planner.forget()
        self.forget_solvers()

    def forget_solvers(self) -> None:
        """Let the solvers begin from the state alone."""
        self.finish_result()
        self.is_balanced, self._goes_on = True, False
        self.newton.forget()
        self.direct.remember(self.state.efforts)
        if self.inverse:
            self.inverse.reset()

    @property
    def figure_names(self) -> tuple[str, ...]:
        """Names of what optional effects report of each step, such as ``fatigue.steps``."""
        return tuple(f"{part.name}.{figure}" for part in self.parts for figure in part.figures)

    def warm_up(self) -> None:
        """Run every path once, so that nothing is compiled or set up later; state unchanged."""
        before = self.state
        self.newton.balance.warm_up(before.positions)
        run_every_path(self)
        # What follows a step in balance, which those were not in every scene.
        self._goals.read(Hold(1.0), before).keeps(before, before, True)
        self.direct.warm_up()
        self._planner.warm_up(self)
        self.restore(before)
        self._loop.time_budget = TimeBudget()

    def prepare(self, command: Command) -> None:
        """Linearize ahead, while nobody knows yet what the next step is asked.

        Most of a step's time is its first linearization, which depends on the state alone (the
        preparation phase of Diehl et al. 2005, real-time iterations). The next step takes what is
        prepared, if nothing else was asked of the simulation since; its result is the same to the
        bit, in any case. Nothing is prepared where measurements or guided bodies change the forces, and
        where the tangent is not positive definite.

        Args:
            command: Of the kind and the duration of the next one; nothing else of it counts.

        Raises:
            CommandError: The command does not fit this scene, or is not finite.
        """
        self.finish_result()
        if self._parts_with["begin"] or self._leader.prescribes:
            return
        clock = StageClock(self.now)
        goal = self._goals.read(command, self.state)
        self._recall_parts()
        self._begin_motion(goal, False)
        if self.newton.prepare(self._positions, self.state.efforts, clock, goal.held):
            self._prepared = Prepared(self.state, goal, clock.total)

    def step(
        self, command: Command, budget: float | None = None, measured: object | None = None
    ) -> StepResult:
        """Advance by one command: eq. (9) to (18), as often as time and scene allow.

        Without a budget it linearizes at most `newton_iterations` times, in motion up to
        `MOST_SHARES` times where a move was too long for its linearization. With one it linearizes
        at least once, then goes on until the residual is under its tolerance or the next
        linearization would be late; where even the first would be late, it keeps the factor of
        an earlier step as long as that makes progress, and says so. Else it is late, and says so;
        in contact it always is. A failed step takes its time too: time and count go on.

        Args:
            command: What is asked. Its arrays must fit this scene.
            budget: Time for this step [s], or None.
            measured: What is measured beside the state, such as loads of a hand, or a list of
                such; None without any. A part may replace the command by it.

        Returns:
            The new state and what led to it; with a failure status, the last safe one.

        Raises:
            CommandError: The command or what is measured does not fit this scene, or is not finite.
        """
        clock = StageClock(self.now)
        self._make_result()
        measured = _each(measured)
        staying = self._planner.staying(self, command, measured)
        if staying:
            self.plan()
            return self._stay_by(command, staying)
        command, has_other_stiffness = self._begin_parts(command, measured)
        goal = self._goals.read(command, self.state)
        positions, efforts = self._positions, self.state.efforts
        ahead = self._begin_motion(goal, has_other_stiffness)
        if goal.follows:
            self._begin_inverse(positions)
        led = self._leader.lead(self, positions, efforts, command.time_step, clock)
        ended = self._loop.run(positions, efforts, goal, clock, budget, ahead, led)
        if isinstance(ended, Failure):
            return self._failed(goal, clock, ended)
        self.is_balanced = ended.balance is not Balance.MISSED
        self._goes_on = not (self.is_balanced or self.model.is_dynamic)
        return self._succeeded(goal, ended, clock)

    def finish_result(self) -> None:
        """Make the result of the last step, if somebody keeps it, before the model changes.

        What was prepared for the next one is dropped.
        """
        self._prepared = None
        self._make_result()

    def _make_result(self) -> None:
        unread, self._unread = self._unread(), _no_result
        if unread:
            unread.make()

    def stay(self, command: Command, measured=None) -> StepResult | None:
        """The result of a step that would keep the state, to the bit, without making it.

        A step depends on the state, the command and what the solvers remember. A step that kept the
        state left them beginning from the state alone; when one that began so kept it again, each
        further one with the same command does the same. Of targets, what was learnt and the factor
        stay: where `STEPS_UNTIL_REST` steps towards the same ones kept the state, nothing else is tried.

        Args:
            command: What is asked.
            measured: As in `step`; whether each says anything is its `is_any`.

        Returns:
            The result, at which `report.is_resting`; None where the step must be made.
        """
        kept, measured = self.kept, _each(measured)
        if kept is None or kept.result is None or not self.asks_as(kept.command, command):
            return None
        if any(one.is_any for one in measured):
            return None
        return self._stay_by(command, self._planner.staying(self, command, measured) or kept.result)

    def _stay_by(self, command: Command, rest: StepResult) -> StepResult:
        """A result at rest, after the time of one more step."""
        self.state = self.state.kept_through(command.time_step)
        return made(StepResult, rest.__dict__, state=self.state)

    def plan(self) -> None:
        """Look on for a nearer pose, where the robot rests and its scene asks for `solver.exploration`.

        It takes about as long as a step, and changes no state: between the steps of `stay`, whoever calls
        these does this while nobody waits. A `step` in place of `stay` does it itself.
        """
        goal = self._planner.plan(self)
        if goal is not None:
            self.kept = None
            self.forget_solvers()
            self.inverse.depart(goal)

    def asks_as(self, before: Command, command: Command) -> bool:
        """Whether a command asks for the same as one before, of a state that is kept.

        Args:
            before: The command before.
            command: The command.
        """
        # Where nothing depends on time, it is the same how long actuators are held, and how long a
        # step is that would have had time to move them.
        is_any_time = may_move(command) and may_move(before) and not self._depends_on_time
        return are_same(command, before, TIMES if is_any_time else ())

    def come_near(
        self, positions: np.ndarray, efforts: np.ndarray, time_step: float, clock: StageClock
    ) -> np.ndarray | None:
        """See `StepLoop.come_near`; the actuators are held for a time step [s]."""
        return self._loop.come_near(positions, efforts, self._goals.read(Hold(time_step), self.state), clock)

    def _begin_inverse(self, positions: np.ndarray) -> None:
        """Tell the inverse what the step begins with, at node positions [m]."""
        places, is_stable = self._leader.places(positions), not self.newton.tangent.is_projected
        loads, load = NO_LOADS, 0.0
        if self._parts_with["loads"]:
            loads = np.concatenate([part.loads for part in self._parts_with["loads"]])
            load = self._loop.load_of_parts() + self.actuators.load(self.state.efforts)
            load += self.newton.balance.constant_load
        self.inverse.begin_step(self.is_balanced, is_stable, loads, load, places)

    def _begin_parts(self, command: Command, measured: list) -> tuple[Command, bool]:
        """Let all parts begin a step.

        Args:
            command: What is asked.
            measured: What is measured; one part takes each.

        Returns:
            What is to be done, and whether the stiffness is another than before.
        """
        left, changes = measured, False
        self._recall_parts()
        for part in self._parts_with["begin"]:
            own = [one for one in left if isinstance(one, part.takes)]
            changes |= part.begin(self.state, own[0] if own else None)
            left = [one for one in left if not own or one is not own[0]]
        for part in self._parts_with["command"]:
            command = part.command(command, self.state)
        if left:
            what = type(left[0]).__name__.lower()
            raise CommandError(what, f"nothing in this scene can be {what}")
        return command, changes

    def _recall_parts(self) -> None:
        for part in self._parts_with["recall"]:
            part.recall(self.state)

    def _begin_motion(self, goal: Goal, has_other_stiffness: bool) -> float:
        """Let all that remembers begin a step, at the state and in a time step.

        Args:
            goal: What is asked.
            has_other_stiffness: Whether parts make the stiffness another than before.

        Returns:
            Time of the first linearization, where that is prepared [s]; zero where it is not.
        """
        prepared, self._prepared = self._prepared, None
        if prepared is not None and prepared.serves(self.state, goal):
            return prepared.time
        self._positions[:] = self.state.positions
        is_changed = self._motion.begin_step(
            self._beginners, self._positions, self.state.velocities, self.state.past,
            goal.command.time_step, goal.follows,
        )
        if is_changed or has_other_stiffness:
            self.newton.take_other_tangent()
        self.newton.expect(goal.command.time_step)
        if self._goes_on and not self.newton.tangent.is_projected:
            self.newton.go_on()
        return 0.0

    def _succeeded(self, goal: Goal, outcome: Outcome, clock: StageClock) -> StepResult:
        before, time_step, newton = self.state, goal.command.time_step, self.newton
        motion = self._motion.end_step(before, outcome.positions, outcome.actuation, time_step)
        if motion.actuation is not outcome.actuation:
            outcome = outcome._replace(actuation=motion.actuation)
        state = State(
            outcome.positions,
            self.actuators.setpoints(outcome.actuation.drives(self.limits)),
            outcome.actuation.efforts, before.step_count + 1, before.time + time_step,
            motion.velocities, motion.past, self._memory([
                (part, part.end(outcome.positions, outcome.actuation.efforts))
                for part in self._parts_with["end"]
            ]),
        )  # fmt: skip
        # What is changed by nothing but round-off is kept.
        is_kept = (
            self.may_rest and outcome.balance is Balance.REACHED and not newton.balance.inverted_count
            and goal.keeps(before, state, not newton.tangent.is_projected)
            and all(part.may_keep(before, state) for part in self._keeping)
        )  # fmt: skip
        self.state = before.kept_through(time_step) if is_kept else state
        result = StepResult.when_read(
            self.state, partial(self._results.of_step, goal, outcome, clock, before, self.state)
        )
        self._note_rest(goal, result, is_kept)
        self._unread = weakref.ref(result)
        return result

    def _note_rest(self, goal: Goal, result: StepResult, is_kept: bool) -> None:
        """Note whether a step left a state at which `stay` can answer.

        Args:
            goal: What was asked.
            result: Its result.
            is_kept: Whether the step kept the state.
        """
        newton, command = self.newton, goal.command
        before, self.kept = self.kept, None
        if not is_kept:
            return
        result.make()
        is_again = before is not None and self.asks_as(before.command, command)
        count = before.count + 1 if is_again else 0
        if goal.follows:
            self.direct.remember(self.state.efforts)
            wait = max(STEPS_UNTIL_REST, self._planner.steps_until_rest(command, result))
            is_again = count >= wait + len(self.state.setpoints)
        else:
            age = newton.tangent.factor_age
            self._begin_anew()
            # The factor is that of the kept state, for whoever asks for compliances there.
            newton.tangent.factor_age = 0 if age == 0 else None
        if not is_again:
            self.kept = Kept(command, count, None)
            return
        report = replace(
            result.report, stage_times=dict.fromkeys(result.report.stage_times, 0.0),
            compute_time=0.0, iterations=0, factor_age=0, is_late=False, is_resting=True,
        )  # fmt: skip
        self.kept = Kept(command, count, replace(result, report=report))
        if goal.follows:
            self._planner.rest(self, command, self.kept.result)

    def _failed(self, goal: Goal, clock: StageClock, failure: Failure) -> StepResult:
        """The last good state, told as a failure. Its time has passed all the same."""
        self._goes_on = False
        self.kept = None
        self.state = self.state.kept_through(goal.command.time_step)
        self.model.rows.tell_efforts(self.state.efforts)
        return self._results.of_failure(
            goal, clock, *failure, self.state, self.effector_positions()
        )


def _no_result() -> None:
    """Gives the result that nobody keeps."""


def _each(measured: object | None) -> list:
    """What is measured in a step, one by one."""
    return measured if isinstance(measured, list) else [] if measured is None else [measured]


def _motion_of(model: Model) -> Statics | Dynamics:
    """The scheme that a scene is integrated by."""
    if not model.is_dynamic:
        return Statics()
    by_alpha = model.scene.time_scheme == "generalized_alpha"
    return GeneralizedAlpha(model) if by_alpha else Dynamics(model)


def _shapes(memory: Mapping[str, np.ndarray]) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    return {key: (array.shape, array.dtype) for key, array in memory.items()}
