"""Looks for nearer poses by simulation, where a robot rests away from its targets.

The inverse problem follows its linearization downhill, so it may rest where a nearer pose exists that no
small move leads to. From there the simulation goes on while the robot stays: one actuator, or all, go by a
share of their scales, and from where that leads the targets are followed as always. Where the body comes
to rest nearer to them, the robot goes the same way. Trials are made on a copy of the simulation, between
the steps of the robot, which change nothing: they cost time and memory only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.command import Command, FollowTargets
from softrobot_twin.simulation.result import Status, StepResult
from softrobot_twin.simulation.step.step_part import Planner, Steppable, StepPart

# Moves of one actuator, as shares of its scale, in the order in which they are tried; a move that
# its limits shorten to less than the last share is not.
MOVES, LEAST_MOVE = (0.05, -0.1, -0.03, 0.15), 0.01
# After these, so many moves of all actuators are tried, at random with this standard deviation.
RANDOM_MOVES, RANDOM_MOVE = 8, 0.1
# Steps towards targets in vain that keep the state, before nearer poses are sought.
STEPS_UNTIL_EXPLORATION = 300
# A pose is nearer where the weighted sum of squared distances is below this share.
NEARER = 0.985
# Steps of one trial; steps in which it comes no nearer than so far by `PROGRESS`, before it is given up
# where it is not nearer. Where it is, it goes on until so many steps in balance were calm: actuators moved
# by no more than the last share of their scales.
MOST_STEPS, PATIENCE, PROGRESS, CALM_STEPS, CALM = 300, 12, 5.0e-3, 40, 1.0e-5


class Exploration:
    """Trials from one state towards the same targets.

    Attributes:
        command: The command to follow the targets.
        misses: Distances from the targets where it stays, times the roots of their weights [m], shape (n,).
        trial: Where the actuators go in the present trial before they follow the targets: displacements, or
            efforts of what is driven by them, shape (actuator_count,); None where all were in vain.
        is_found: Whether the present trial leads nearer, so that the robot itself goes this way.
    """

    def __init__(self, command: FollowTargets, result: StepResult, misses: np.ndarray, actuators: Actuators):
        """Begin with the first trial.

        Args:
            command: The command to follow the targets.
            result: What tells that the robot rests.
            misses: See `misses`.
            actuators: The actuators.
        """
        report = replace(result.report, is_exploring=True, is_resting=False)
        self._at_rest, self._exploring = result, replace(result, report=report)
        self.command, self.misses = command, misses
        self._is_free = np.ones(actuators.count, dtype=bool)
        if command.commanded is not None:
            self._is_free = np.isnan(command.commanded)
        self._drives, self.limits = actuators.drives(result.state.setpoints), actuators.limits
        self.is_found, self._trials = False, self._goals()
        self.next_trial()

    @property
    def missed(self) -> float:
        """Weighted sum of squared distances where the robot stays [m²]."""
        return float(self.misses @ self.misses)

    @property
    def result(self) -> StepResult:
        """What steps of the robot give while it stays."""
        return self._at_rest if self.trial is None else self._exploring

    def next_trial(self) -> None:
        """Begin the next trial where the robot stays, or end."""
        self.trial = next(self._trials, None)
        self._best, self._count, self._since, self._calm_count = np.inf, 0, 0, 0

    def end(self, result: StepResult) -> None:
        """Give up: the robot stays where a result tells that it rests.

        Args:
            result: The result.
        """
        self.trial, self.is_found, self._at_rest = None, False, result

    def judge(self, misses: np.ndarray, has_gone: bool, is_stable: bool, is_calm: bool) -> None:
        """Judge a step of the trial, and begin the next trial where it is over.

        Args:
            misses: Those where the step began [m], shape (n,).
            has_gone: Whether the actuators have gone to the goal.
            is_stable: Whether the step ended in stable balance.
            is_calm: Whether it moved no actuator.
        """
        self._count += 1
        if self._count >= MOST_STEPS:
            self.next_trial()
        elif has_gone:
            missed = float(misses @ misses)
            self._since += 1
            if missed < NEARER * self.missed or missed < (1.0 - PROGRESS) * self._best:
                self._best, self._since = min(missed, self._best), 0
            is_good = missed < NEARER * self.missed and is_stable and is_calm
            self._calm_count = self._calm_count + 1 if is_good else 0
            self.is_found = self._calm_count >= CALM_STEPS
            if self._since >= PATIENCE:
                self.next_trial()

    def _goals(self) -> Iterator[np.ndarray]:
        """Places from where the targets are followed: first one actuator has moved, then all."""
        count, scale = len(self._drives), self.limits.drive_scale
        moves = [share * np.eye(count)[i] for share in MOVES for i in np.flatnonzero(self._is_free)]
        rng = np.random.default_rng(0)
        moves += [RANDOM_MOVE * rng.normal(size=count) * self._is_free for _ in range(RANDOM_MOVES)]
        for move in moves:
            goal = np.clip(self._drives + move * scale, self.limits.drive_min, self.limits.drive_max)
            if (np.abs(goal - self._drives) >= LEAST_MOVE * scale).any():
                yield goal


class Explorer(StepPart, Planner):
    """Explores on a copy of the simulation while a robot rests away from its targets."""

    name = "exploration"

    def __init__(self) -> None:
        """Nothing is explored yet."""
        self._exploration: Exploration | None = None
        self._copy: Steppable | None = None

    def forget(self) -> None:
        """See `Planner`."""
        self._exploration = None

    def warm_up(self, simulation: Steppable) -> None:
        """Build and warm up the copy. See `Planner`."""
        self._copied(simulation).warm_up()

    def steps_until_rest(self, command: FollowTargets, result: StepResult) -> int:
        """More where an exploration would follow."""
        is_first = self._exploration is None and not command.is_on_way
        return STEPS_UNTIL_EXPLORATION if is_first and result.status is not Status.OK else 0

    def rest(self, simulation: Steppable, command: FollowTargets, result: StepResult) -> None:
        """Begin to look for nearer poses where a robot rests away from its targets.

        From where an exploration led, the next one begins, if that is nearer indeed.
        """
        if command.is_on_way:
            return
        before, misses = self._exploration, simulation.inverse.misses
        is_nearer = before is None or misses @ misses < NEARER * before.missed
        if result.status is not Status.OK and is_nearer:
            self._exploration = Exploration(command, result, misses, simulation.model.actuators)
            self._begin_trial(simulation)
        elif before is not None:
            before.end(result)

    def staying(self, simulation: Steppable, command: Command, measured: list) -> StepResult | None:
        """The result of a robot that explores, or has explored in vain. See `Planner`."""
        exploration = self._exploration
        if exploration and (any(one.is_any for one in measured) or not simulation.asks_as(exploration.command, command)):
            exploration = self._exploration = None
        return None if exploration is None or exploration.is_found else exploration.result

    def plan(self, simulation: Steppable) -> np.ndarray | None:
        """Make a step of a trial. See `Planner`."""
        exploration = self._exploration
        if exploration is None or exploration.is_found or exploration.trial is None:
            return None
        # A trial that raises ends the exploration.
        copy, self._exploration = self._copied(simulation), None
        before, trial = copy.state.setpoints, exploration.trial
        tried = copy.step(exploration.command)
        is_stable = copy.is_balanced and not copy.newton.tangent.is_projected
        is_calm = (np.abs(copy.state.setpoints - before) <= CALM * copy.limits.drive_scale).all()
        if tried.status.is_failure:
            exploration.next_trial()
        else:
            exploration.judge(copy.inverse.misses, not copy.inverse.is_departing, is_stable, bool(is_calm))
        self._exploration = exploration
        if exploration.trial is not trial:
            self._begin_trial(simulation)
        return trial if exploration.is_found else None

    def _copied(self, simulation: Steppable) -> Steppable:
        """The copy; it is built once."""
        if self._copy is None:
            scene = simulation.scene.changed(solver={"exploration": False})
            self._copy = type(simulation)(scene, with_warnings=False, mounted=simulation.mounted)
        return self._copy

    def _begin_trial(self, simulation: Steppable) -> None:
        if self._exploration.trial is not None:
            copy = self._copied(simulation)
            copy.take_over(simulation)
            copy.inverse.depart(self._exploration.trial)
