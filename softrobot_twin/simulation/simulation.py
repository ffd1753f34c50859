"""A scene that can be stepped: commands in, states and an honest account out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.simulation.actuation import Actuation, Linearized, pull, wind
from softrobot_twin.simulation.build import build_model
from softrobot_twin.simulation.command import (
    Command,
    FollowTargets,
    Hold,
    SetLengths,
    SetTensions,
)
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.simulation.observed import Observed
from softrobot_twin.simulation.pace import Pace
from softrobot_twin.simulation.result import Status, StepReport, StepResult
from softrobot_twin.simulation.stage_clock import StageClock
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.verdict import effector_errors, imbalance, judge
from softrobot_twin.solvers.inverse_qp import Bounds


class _Outcome(NamedTuple):
    """What the linearizations of one step came to."""

    positions: np.ndarray
    actuation: Actuation
    converged: bool
    residual: float
    iterations: int
    error: float


class Simulation(Observed):
    """One scene, its state, and the step between states.

    Attributes:
        model: The built scene.
        state: Where it stands now.
    """

    def __init__(
        self, scene: Scene, now: Callable[[], float] = perf_counter,
        factorization_type: type | None = None, qp_solvers: tuple | None = None,
    ):
        """Build a scene.

        Args:
            scene: The scene.
            now: Gives the time that stages and budgets are measured by [s].
            factorization_type: Class to factorize with, in place of the scene's.
            qp_solvers: Solvers in the order they are asked, in place of the scene's.

        Raises:
            SceneError: An entry does not fit the mesh.
            MeshError: The mesh cannot be used.
        """
        self.model = build_model(scene, factorization_type)
        self._newton = Newton(self.model)
        self._now = now
        self._pace = Pace()
        self._inverse = self._build_inverse(qp_solvers)
        self._find_surface()
        self.reset()

    @classmethod
    def from_scene(cls, scene: Scene) -> Simulation:
        """Build a scene; see the constructor."""
        return cls(scene)

    @classmethod
    def from_scene_file(cls, path: Path | str) -> Simulation:
        """Read and build a scene file; see `load_scene` and the constructor."""
        return cls(load_scene(path))

    def _build_inverse(self, qp_solvers: tuple | None):
        """The inverse problem; its solver is imported only where a scene can be inverted."""
        model = self.model
        if model.cables is None or model.effectors is None:
            return None
        from softrobot_twin.simulation.inverse_actuation import InverseActuation

        return InverseActuation(model, qp_solvers)

    def reset(self) -> None:
        """Go back to the rest shape. What follows is the same, to the bit, as the first time."""
        count = len(self.actuator_names)
        self.state = State(
            self.model.body.mesh.node_positions.copy(),
            self.rest_lengths.copy(),
            np.zeros(count),
        )
        self._forget()

    def restore(self, state: State) -> None:
        """Put a saved state back.

        Args:
            state: A state of this simulation.

        Raises:
            CommandError: The state is of another scene or mesh.
        """
        if (
            state.positions.shape != self.state.positions.shape
            or state.lengths.shape != self.state.lengths.shape
        ):
            raise CommandError("state", "is not of this scene: its shapes differ")
        self.state = state
        self._forget()

    def _forget(self) -> None:
        self._newton.forget()
        if self._inverse is not None:
            self._inverse.reset()

    def warm_up(self) -> None:
        """Run every path once, so that nothing is compiled or set up later; state unchanged."""
        before = self.state
        count = len(self.actuator_names)
        self.step(Hold())
        if count:
            self.step(SetLengths(before.lengths, 1.0))
            self.step(SetTensions(np.zeros(count), 1.0))
        if self._inverse is not None:
            self.step(FollowTargets(self.effector_positions(), 1.0))
            self.step(FollowTargets(self.effector_positions(), 1.0), budget=0.0)
        self.discretization_error()
        self.restore(before)
        self._pace = Pace()

    def step(self, command: Command, budget: float | None = None) -> StepResult:
        """Advance by one command: eq. (9) to (18), as often as time and scene allow.

        Without a budget it linearizes at most `newton_iterations` times. With one it linearizes
        at least once, then goes on until the residual is under its tolerance or the next
        linearization would be late; where even the first would be late, it keeps the factor of
        an earlier step, and says so.

        Args:
            command: What is asked. Its arrays must fit this scene.
            budget: Time for this step [s], or None.

        Returns:
            The new state and what led to it; with a failure status, the last safe one.

        Raises:
            CommandError: The command does not fit this scene, or is not finite.
        """
        clock = StageClock(self._now)
        wanted, bounds = self._interpret(command)
        positions, tensions = self.state.positions.copy(), self.state.tensions
        solver, newton, pace = self.model.scene.solver, self._newton, self._pace
        hurry = pace.must_hurry(budget) and newton.factor_age is not None
        error, iterations, enough = math.nan, 0, False
        while not enough:
            iterations += 1
            begin = clock.total
            linear = newton.linearize(positions, tensions, clock, with_stale_factor=hurry)
            if linear is None:
                return self._failed(command, clock, iterations)
            held = wind(linear, self.rest_lengths - self.state.lengths, bounds)
            actuation = self._actuate(linear, command, wanted, held, bounds)
            if iterations == 1:
                error = imbalance(self.model.effectors, linear, held)
            if self.model.cables is not None:
                clock.mark("optimise")
            share = newton.correct(positions, actuation.tensions)
            clock.mark("correct")
            if share == 0.0:
                return self._failed(command, clock, iterations)
            tensions = actuation.tensions
            residual = newton.residual(positions, tensions)
            clock.mark("residual")
            if not hurry:
                pace.learn(clock.total - begin)
            converged = share == 1.0 and residual <= solver.residual_tolerance
            enough = converged or hurry or not pace.has_time(
                iterations, clock.total, budget, solver.newton_iterations
            )
        if budget is None and solver.newton_iterations == 1:
            # One linearization a step never quite converges; more than all loads together on a
            # single node is another matter.
            converged = share == 1.0 and residual <= max(
                solver.residual_tolerance, newton.constant_load + tensions.sum()
            )
        outcome = _Outcome(positions, actuation, converged, residual, iterations, error)
        return self._succeeded(command, wanted, bounds, outcome, clock)

    def _interpret(self, command: Command) -> tuple[np.ndarray, Bounds]:
        """What is asked, checked, and the bounds of this step."""
        count = len(self.actuator_names)
        shortening = self.rest_lengths - self.state.lengths
        if isinstance(command, Hold):
            return shortening, self.limits.bounds(shortening, 0.0)
        if not isinstance(command, FollowTargets | SetLengths | SetTensions):
            raise CommandError(type(command).__name__, "is not a command")
        if not (math.isfinite(command.time_step) and command.time_step >= 0.0):
            raise CommandError("time_step", f"{command.time_step} s is not a duration")
        bounds = self.limits.bounds(shortening, command.time_step)
        if isinstance(command, FollowTargets):
            if self._inverse is None:
                raise CommandError("targets", "this scene has no effectors or no actuators")
            targets = _fitting("targets", command.targets, (len(self.effector_names), 3), True)
            term = self.model.effectors
            return targets[term.row_effector, term.row_axis], bounds
        if isinstance(command, SetLengths):
            lengths = _fitting("lengths", command.lengths, (count,), False)
            return self.rest_lengths - lengths, bounds
        return _fitting("tensions", command.tensions, (count,), False), bounds

    def _actuate(
        self,
        linear: Linearized,
        command: Command,
        wanted: np.ndarray,
        held: Actuation,
        bounds: Bounds,
    ) -> Actuation:
        """Find λ in the way that the command asks for."""
        if isinstance(command, SetLengths):
            wound = np.clip(wanted, bounds.shortening_min, bounds.shortening_max)
            return wind(linear, wound, bounds)
        if isinstance(command, SetTensions):
            return pull(linear, wanted, held, bounds)
        if isinstance(command, FollowTargets):
            return self._inverse.solve(linear, wanted, held, bounds)
        return held

    def _succeeded(
        self,
        command: Command,
        wanted: np.ndarray,
        bounds: Bounds,
        outcome: _Outcome,
        clock: StageClock,
    ) -> StepResult:
        actuation, newton = outcome.actuation, self._newton
        lengths = self.rest_lengths - actuation.shortening
        holding = isinstance(command, Hold)
        self.state = State(
            outcome.positions, lengths, actuation.tensions,
            self.state.step_count + 1,
            self.state.time + (0.0 if holding else command.time_step),
        )  # fmt: skip
        # Who holds is held back by nothing.
        binding = self.limits.binding(actuation.shortening, actuation.tensions, bounds)
        active = () if holding else tuple(binding)
        errors = effector_errors(self.model.effectors, command, outcome.positions)
        status = judge(
            self.model.scene, command, wanted, actuation, active, errors,
            newton.inverted_count, outcome.converged,
        )  # fmt: skip
        report = StepReport(
            clock.times, clock.total, outcome.residual, outcome.iterations, active,
            projected_tangent=newton.projected_tangent, inverted_count=newton.inverted_count,
            linearization_error=outcome.error, factor_age=newton.factor_age,
            qp_solver=actuation.qp_solver,
        )  # fmt: skip
        return self._result(status, errors, report)

    def _failed(self, command: Command, clock: StageClock, iterations: int) -> StepResult:
        """The last good state, told as a failure."""
        self.state = replace(self.state, step_count=self.state.step_count + 1)
        errors = effector_errors(self.model.effectors, command, self.state.positions)
        report = StepReport(
            clock.times, clock.total, math.nan, iterations,
            projected_tangent=self._newton.projected_tangent,
        )  # fmt: skip
        return self._result(Status.DIVERGED, errors, report)

    def _result(self, status: Status, errors: np.ndarray, report: StepReport) -> StepResult:
        state = self.state
        return StepResult(
            state, status, state.lengths, state.tensions, self.rest_lengths - state.lengths,
            self.effector_positions(), errors, report,
        )  # fmt: skip


def _fitting(name: str, array, shape: tuple[int, ...], nan_allowed: bool) -> np.ndarray:
    """An array of a command, checked."""
    array = np.asarray(array, dtype=float)
    if array.shape != shape:
        raise CommandError(name, f"must have shape {shape}, not {array.shape}")
    bad = np.isinf(array) if nan_allowed else ~np.isfinite(array)
    if bad.any():
        raise CommandError(name, f"holds {array[bad][0]}")
    return array
