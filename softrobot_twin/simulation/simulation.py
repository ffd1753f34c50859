"""A scene that can be stepped: commands in, states and reports out."""

from __future__ import annotations

import math
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
from softrobot_twin.simulation.command import (
    TIMES,
    Command,
    Hold,
    are_same,
    may_move,
)
from softrobot_twin.simulation.effects.effects import step_parts
from softrobot_twin.simulation.effects.gripping import Gripping
from softrobot_twin.simulation.effects.moving_base import MovingBase
from softrobot_twin.simulation.mounting import Mounted, branch_notes, mount
from softrobot_twin.simulation.readouts import Readouts
from softrobot_twin.simulation.result import Status, StepResult
from softrobot_twin.simulation.state import State, made
from softrobot_twin.simulation.step.actuation import INVERSION, PASSING, Actuation
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.goals import Goal, Goals
from softrobot_twin.simulation.step.inverse_choice import build_inverse
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import (
    Leader,
    Planner,
    StepPart,
    one_of,
    parts_by_method,
    those_with,
)
from softrobot_twin.simulation.step.step_report import NEAR_BALANCE, Balance, Outcome, StepResults
from softrobot_twin.simulation.step.situation import NO_LOADS
from softrobot_twin.simulation.step.time_budget import StageClock, TimeBudget
from softrobot_twin.simulation.step.time_integration import Dynamics, GeneralizedAlpha, Statics
from softrobot_twin.simulation.warm_up import run_every_path

# Linearizations of a step in time of which a move was too long for one of them, at most.
MOST_SHARES = 10
# Moves of bodies that are brought near balance, at most, and the length of one, by the body's size,
# that is near.
MOST_MOVES_TO_NEAR, NEAR = 12, 0.01
# A residual within tolerance tells of balance where it is this share of the loads, or would move the
# body by no more than this share of its size. A greater one does where moves are round-off, shares of it.
TELLING_LOAD, TELLING_MOVE, ROUND_OFF = 1.0e-3, 1.0e-6, 1.0e-13
# Steps towards the same targets that keep the state before further ones need not be made. Within
# fewer the inverse tries all that it will try from there, but one step for each actuator.
STEPS_UNTIL_REST = 120


class Correction(NamedTuple):
    """One linearization of a step, and the move that it led to.

    Attributes:
        linear: The condensed system.
        actuation: What actuators and contacts do.
        held: What a shorter step begins with; None where nothing asked for it.
        still: What they do when all actuators stay; None likewise.
        share: Share of the move that was made; zero where it was not finite.
        residual: Largest force out of balance on a node after it [N].
        is_balanced: Whether that is within its tolerance, and tells of balance.
    """

    linear: Linearized
    actuation: Actuation
    held: Actuation | None
    still: Actuation | None
    share: float
    residual: float
    is_balanced: bool


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
        self._time_budget = TimeBudget()
        self._motion = _motion_of(self.model)
        self._most_shares = MOST_SHARES if self.model.is_dynamic else 1
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
        self._optimises = "optimise" in self.model.stages
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
        self._time_budget = TimeBudget()

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
        newton, time_budget = self.newton, self._time_budget
        if goal.follows:
            self._begin_inverse(positions)
        pressed = not ahead and time_budget.must_hurry(budget)
        led = self._leader.lead(self, positions, efforts, command.time_step, clock)
        hurry = pressed and newton.tangent.may_keep_factor
        first, iterations, enough, rows = None, 0, False, self.model.rows
        doing, sought = goal, None
        inverted = newton.balance.inverted_count
        while not enough:
            iterations, begin, ahead = iterations + 1, clock.total - ahead, 0.0
            before = positions.copy() if hurry else positions
            done = self._iterate(positions, efforts, doing, clock, hurry)
            if done is None:
                return self._failed(goal, clock, iterations)
            first = first or (done.linear, done.still)
            if hurry and not self._stale_factor_serves(done, inverted):
                positions[:], hurry = before, False
                continue
            if done.share == 0.0:
                return self._failed(goal, clock, iterations, *_why_kept(done.actuation))
            efforts = done.actuation.efforts
            if not hurry:
                time_budget.learn(clock.total - begin)
            asks_again = rows.ask_again(positions)
            may_end = hurry and not asks_again
            enough = may_end or self._is_enough(done, iterations, clock.total, budget, asks_again)
            if doing.seeks_once and done.actuation.solved and done.linear.contact_row_count > 0:
                # Bodies come to balance under what was found before something else is sought.
                sought = done.actuation
                doing = goal.as_found(sought)
        if asks_again and rows.lag(positions):
            return self._failed(goal, clock, iterations, Status.REFUSED, (PASSING,))
        if sought is not None and iterations > 1:
            done = done._replace(actuation=self.inverse.told(done.actuation, sought))
        reached = self._balance(done, budget) if led and not asks_again else Balance.MISSED
        if reached is Balance.REACHED and rows.press_from_afar:
            reached = Balance.NEAR
        self.is_balanced = reached is not Balance.MISSED
        self._goes_on = not (self.is_balanced or self.model.is_dynamic)
        outcome = Outcome(
            positions.copy(), done.actuation, done.held, done.linear, reached,
            done.residual, iterations, first, pressed,
        )  # fmt: skip
        return self._succeeded(goal, outcome, clock)

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

    def _begin_inverse(self, positions: np.ndarray) -> None:
        """Tell the inverse what the step begins with, at node positions [m]."""
        places, is_stable = self._leader.places(positions), not self.newton.tangent.is_projected
        loads, load = NO_LOADS, 0.0
        if self._parts_with["loads"]:
            loads = np.concatenate([part.loads for part in self._parts_with["loads"]])
            load = self._load_of_parts() + self.actuators.load(self.state.efforts)
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

    def _load_of_parts(self) -> float:
        return sum((part.load for part in self._parts_with["loads"]), 0.0)

    def _iterate(
        self, positions: np.ndarray, efforts: np.ndarray, goal: Goal, clock: StageClock,
        with_stale_factor: bool,
    ) -> Correction | None:  # fmt: skip
        """Linearize and condense, solve for λ, correct the positions, and take the residual.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            efforts: Efforts of the actuators there [N], shape (actuator_count,).
            goal: What is asked.
            clock: Books the stages.
            with_stale_factor: Whether to keep the factor of an earlier state.

        Returns:
            The correction; None where the tangent cannot be factorized.
        """
        linear = self.newton.linearize(
            positions, efforts, clock, with_stale_factor,
            goal.held if self.newton.tangent.asks_for_held else None,
        )  # fmt: skip
        if not linear:
            return None
        still = self.direct.held(linear, goal.drives, goal.bounds, goal.needs_held)
        rows = self._rows_of_parts(positions, efforts, goal, clock)
        actuation, held = goal.solve(linear, still, rows)
        if self._optimises:
            clock.mark("optimise")
        # Bodies that follow a prescribed move gain energy by it.
        is_judged = not self.model.rows.lag(positions)
        if with_stale_factor:
            share, residual, actuation = self._move(positions, actuation, clock)
        elif goal.follows and is_judged and not self.model.is_dynamic:
            share, residual, actuation = self._approach(positions, actuation, held, clock)
        else:
            is_judged = is_judged and not goal.follows
            share, residual, actuation = self._move_and_settle(positions, actuation, clock, is_judged)
        return Correction(linear, actuation, held, still, share, residual, self._is_in_balance(actuation, residual))

    def _rows_of_parts(
        self, positions: np.ndarray, efforts: np.ndarray, goal: Goal, clock: StageClock
    ) -> object | None:
        """Rows that a part adds to those of the effectors; see `StepPart.rows`."""
        parts = self._parts_with["rows"] if goal.follows else ()
        if not parts or any(part.holds_robot for part in self.parts):
            return None
        state = self.newton.tangent.linearized_state(positions, efforts)
        for part in parts:
            rows = part.rows(state, goal.command)
            if rows is not None:
                clock.mark(part.name)
                return rows
        return None

    def come_near(
        self, positions: np.ndarray, efforts: np.ndarray, time_step: float, clock: StageClock
    ) -> np.ndarray | None:
        """Bring the bodies near balance, while the actuators stay.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            efforts: Efforts of the actuators there, in their units, shape (actuator_count,).
            time_step: h [s].
            clock: Books the stages.

        Returns:
            Efforts of the actuators after it; None where there is no way.
        """
        newton, goal = self.newton, self._goals.read(Hold(time_step), self.state)
        for _ in range(MOST_MOVES_TO_NEAR):
            done = self._iterate(positions, efforts, goal, clock, False)
            if done is None or done.share == 0.0:
                return None
            efforts = done.actuation.efforts
            if done.share == 1.0 and newton.last_move <= NEAR * self.model.nodes.size:
                break
        return efforts

    def _is_enough(
        self, done: Correction, iterations: int, elapsed: float, budget: float | None,
        asks_again: bool,
    ) -> bool:
        """Whether the step has converged, or neither scene nor time allow a further iteration.

        Args:
            done: The last linearization.
            iterations: How many there were.
            elapsed: Time since the step began [s].
            budget: Time for the step [s], or None.
            asks_again: Whether a prescribed move asks for one more linearization.
        """
        if done.share == 1.0 and not asks_again and done.is_balanced:
            return True
        most = max(self.model.scene.solver.newton_iterations, MOST_SHARES if asks_again else 1)
        if self.model.is_dynamic and self.newton.asks_for_more_moves(done.share):
            most = max(most, self._most_shares)
        return not self._time_budget.has_time(iterations, elapsed, budget, most)

    def _balance(self, done: Correction, budget: float | None) -> Balance:
        """How near to balance the last correction came.

        Near is where the scene or the deadline stopped the linearizations before they could converge,
        and the residual is small beside the forces at rest, and of actuators, contacts and parts.
        """
        if done.share != 1.0 or not done.actuation.contact.converged:
            return Balance.MISSED
        if done.is_balanced:
            return Balance.REACHED
        if budget is None and self.model.scene.solver.newton_iterations != 1:
            return Balance.MISSED
        return Balance.NEAR if self._is_small(done.actuation, done.residual, NEAR_BALANCE) else Balance.MISSED

    def _is_in_balance(self, actuation: Actuation, residual: float) -> bool:
        """Whether the residual is within its tolerance, or round-off of stiff bodies, and tells of balance.

        Of a body that bears less than the tolerance every residual is within it: a thin fibre far
        from its balance, too.
        """
        newton, size = self.newton, self.model.nodes.size
        if not residual <= self.model.scene.solver.residual_tolerance:
            round_off = ROUND_OFF * self.model.nodes.finite_size
            return newton.last_move <= round_off and newton.longest_left() <= round_off
        return self._is_small(actuation, residual, TELLING_LOAD) or newton.longest_left() <= TELLING_MOVE * size

    def _is_small(self, actuation: Actuation, residual: float, share: float) -> bool:
        """Whether a residual is at most a share of the forces at rest, of actuators, contacts and parts."""
        load = self.newton.balance.constant_load
        if residual > share * load:
            load += self.actuators.load(actuation.efforts) + actuation.contact.load + self._load_of_parts()
        return residual <= share * load

    def _move(
        self, positions: np.ndarray, actuation: Actuation, clock: StageClock,
        is_judged: bool = False,
    ) -> tuple[float, float, Actuation]:
        """Correct the positions.

        Returns:
            The share of the move that was made, the residual [N], and what the actuators do.
        """
        newton, residual = self.newton, math.nan
        share, actuation = newton.correct(positions, actuation, is_judged)
        if newton.tangent.is_augmented:
            self.direct.remember(actuation.efforts)
        clock.mark("correct")
        if share:
            residual = newton.residual(positions, actuation)
        clock.mark("residual")
        return share, residual, actuation

    def _move_and_settle(
        self, positions: np.ndarray, actuation: Actuation, clock: StageClock,
        is_judged: bool = True, is_sought: bool = False,
    ) -> tuple[float, float, Actuation]:  # fmt: skip
        """Correct the positions, by as much of the move as folds nothing.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            actuation: λ of the optimisation.
            clock: Books the stages.
            is_judged: Whether it is judged how far the move goes, too.
            is_sought: Whether targets chose the actuation.
        """
        newton = self.newton
        share, residual, actuation = self._move(positions, actuation, clock, is_judged)
        if share:
            settled = newton.settle(positions, share, is_sought)
            if settled != share:
                share, residual = settled, float(newton.balance.largest[0])
                clock.mark("residual")
        return share, residual, actuation

    def _approach(
        self, positions: np.ndarray, actuation: Actuation, held: Actuation, clock: StageClock
    ) -> tuple[float, float, Actuation]:
        """Correct the positions, in statics, by the first actuation of which most may be made."""
        newton, inverts, inverse = self.newton, False, self.inverse
        for tried in inverse.tries(actuation, held):
            share, residual, done = self._move_and_settle(positions, tried, clock, is_sought=True)
            if share > 0.0 and (share >= inverse.least_share or tried is held):
                break
            inverts = inverts or newton.share_rule.folds_whole
            newton.take_back(positions)
        else:
            tried = held
            share, residual, done = self._move_and_settle(positions, held, clock)
            if newton.inverts:
                # It cannot even stay: the last good state is kept.
                share, inverts = 0.0, True
                newton.balance.forget_folds()
        if tried is not actuation:
            self.direct.remember(done.efforts)
            inverse.refuse(tried is held and share == 0.0)
            done = done._replace(is_refused=inverts)
        return share, residual, done

    def _stale_factor_serves(self, done: Correction, inverted: int) -> bool:
        """Whether a correction by the factor of an earlier step may be kept."""
        newton = self.newton
        is_near = self._balance(done, 0.0) is not Balance.MISSED
        return is_near and newton.balance.inverted_count <= inverted and newton.makes_progress()

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

    def _failed(self, goal, clock, iterations, status=Status.DIVERGED, limits=()) -> StepResult:
        """The last good state, told as a failure. Its time has passed all the same."""
        self._goes_on = False
        self.kept = None
        self.state = self.state.kept_through(goal.command.time_step)
        self.model.rows.tell_efforts(self.state.efforts)
        return self._results.of_failure(
            goal, clock, iterations, status, limits, self.state, self.effector_positions()
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


def _why_kept(actuation: Actuation) -> tuple[Status, tuple[str, ...]]:
    """Status of a step that moved nothing, and the names of the limits that prevented the move."""
    if actuation.is_refused:
        return Status.REFUSED, (INVERSION,)
    return Status.DIVERGED, ()


def _shapes(memory: Mapping[str, np.ndarray]) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    return {key: (array.shape, array.dtype) for key, array in memory.items()}
