"""A scene that can be stepped: commands in, states and an honest account out."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.simulation.account import Account, Outcome
from softrobot_twin.simulation.actuation import INVERSION, Actuation, Linearized
from softrobot_twin.simulation.build import build_model
from softrobot_twin.simulation.caution import Caution
from softrobot_twin.simulation.command import (
    Command,
    FollowTargets,
    CommandSetpoints,
    CommandEfforts,
)
from softrobot_twin.simulation.interpretation import Asked, Interpretation
from softrobot_twin.simulation.motion import Dynamics, Statics
from softrobot_twin.simulation.observed import Observed
from softrobot_twin.simulation.pace import Pace
from softrobot_twin.simulation.result import Status, StepResult
from softrobot_twin.simulation.stage_clock import StageClock
from softrobot_twin.simulation.solution_building import build_inverse, build_solution
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.warming import run_every_path
from softrobot_twin.simulation.verdict import balance
from softrobot_twin.solvers.inverse_qp import Bounds

# A step in time whose move was too long for one linearization goes on for so many at most.
MOST_SHARES = 10


class Simulation(Observed):
    """One scene, its state, and the step between states.

    Attributes:
        model: The built scene.
        state: Where it stands now.
    """

    def __init__(
        self, scene: Scene, now: Callable[[], float] = perf_counter,
        factorization_type: type | None = None, qp_solvers: tuple | None = None,
        with_warnings: bool = True,
    ):
        """Build a scene.

        Args:
            scene: The scene.
            now: Gives the time that stages and budgets are measured by [s].
            factorization_type: Class to factorize with, in place of the scene's.
            qp_solvers: Solvers in the order they are asked, in place of the scene's.
            with_warnings: Whether to look for what looks wrong; see `build_model`.

        Raises:
            SceneError: An entry does not fit the mesh.
            MeshError: The mesh cannot be used.
        """
        self.model = build_model(scene, factorization_type, with_warnings)
        self._now = now
        self._pace = Pace()
        self._motion = Dynamics(self.model) if self.model.is_dynamic else Statics()
        self._most_shares = MOST_SHARES if self.model.is_dynamic else 1
        self._beginners = self.model.beginners
        self._begin(self.model.nodes.rest_positions.copy(), self._motion.at_rest(), 1.0)
        self._newton, self._direct = build_solution(self.model)
        if self.model.is_dynamic:
            self._beginners = (*self._beginners, self._newton)
        self._inverse = build_inverse(self.model, self._direct, qp_solvers)
        self._caution = Caution(
            self._newton, self._direct, self._inverse, self.model.actuators.row_count
        )
        self._account = Account(
            self.model, self._newton, self._direct, self._inverse
        )
        self._optimises = "optimise" in self.model.stages
        self._reading = Interpretation(self.model)
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

    def reset(self) -> None:
        """Go back to the rest shape. What follows is the same, to the bit, as the first time."""
        count = len(self.actuator_names)
        self.state = State(
            self.model.nodes.rest_positions.copy(), self.rest_setpoints.copy(), np.zeros(count),
            velocities=self._motion.at_rest(),
        )  # fmt: skip
        if self.model.guides is not None:
            self.model.guides.reset()
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
            or state.setpoints.shape != self.state.setpoints.shape
            or state.velocities.shape != self.state.velocities.shape
        ):
            raise CommandError("state", "is not of this scene: its shapes differ")
        self.state = state
        if self.model.guides is not None:
            self.model.guides.stay(state.positions)
        self._forget()

    def _forget(self) -> None:
        self._newton.forget()
        self._direct.forget()
        self._caution.forget()
        if self._inverse is not None:
            self._inverse.reset()

    def warm_up(self) -> None:
        """Run every path once, so that nothing is compiled or set up later; state unchanged."""
        before = self.state
        run_every_path(self)
        self._direct.warm_up()
        self.restore(before)
        self._pace = Pace()

    def step(self, command: Command, budget: float | None = None) -> StepResult:
        """Advance by one command: eq. (9) to (18), as often as time and scene allow.

        Without a budget it linearizes at most `newton_iterations` times. With one it linearizes
        at least once, then goes on until the residual is under its tolerance or the next
        linearization would be late; where even the first would be late, it keeps the factor of
        an earlier step as long as that makes progress, and says so. Else it is late, and says so;
        in contact it always is. A failed step takes its time too: time and count go on.

        Args:
            command: What is asked. Its arrays must fit this scene.
            budget: Time for this step [s], or None.

        Returns:
            The new state and what led to it; with a failure status, the last safe one.

        Raises:
            CommandError: The command does not fit this scene, or is not finite.
        """
        clock = StageClock(self._now)
        asked = self._reading.read(command, self.state)
        positions, tensions = self.state.positions.copy(), self.state.efforts
        self._begin(positions, self.state.velocities, command.time_step)
        solver, newton, pace = self.model.scene.solver, self._newton, self._pace
        pressed = pace.must_hurry(budget)
        hurry = pressed and newton.may_keep_factor
        error, iterations, enough = math.nan, 0, False
        inverted, following = newton.inverted_count, isinstance(command, FollowTargets)
        while not enough:
            iterations += 1
            begin = clock.total
            linear = newton.linearize(positions, tensions, clock, with_stale_factor=hurry)
            if linear is None:
                return self._failed(command, clock, iterations)
            actuation, held = self._actuate(linear, command, asked.wanted, asked.bounds)
            if iterations == 1:
                error = self._direct.imbalance(self.model.effectors, linear, held)
            if self._optimises:
                clock.mark("optimise")
            before = positions.copy() if following or hurry else positions
            share, residual = self._move(positions, actuation, clock)
            if hurry and not self._stale_factor_serves(share, inverted):
                positions[:], hurry = before, False
                continue
            if following and self._caution.refuses(inverted):
                positions[:] = before
                actuation = self._caution.instead(linear, held, asked.bounds)
                share, residual = self._move(positions, actuation, clock)
                if newton.inverted_count > inverted and not self._caution.lets_go:
                    # It cannot even stay: the last good state is kept.
                    newton.inverted_count = inverted
                    return self._failed(command, clock, iterations, Status.REFUSED, (INVERSION,))
            if share == 0.0:
                return self._failed(command, clock, iterations)
            tensions = actuation.efforts
            if not hurry:
                pace.learn(clock.total - begin)
            converged = share == 1.0 and residual <= solver.residual_tolerance
            most = solver.newton_iterations
            if share < 1.0:
                most = max(most, self._most_shares)
            enough = converged or hurry or not pace.has_time(iterations, clock.total, budget, most)
        reached = balance(
            residual, share == 1.0 and actuation.is_exact,
            budget is not None or solver.newton_iterations == 1, solver,
            newton.constant_load + actuation.load,
        )  # fmt: skip
        outcome = Outcome(
            positions, actuation, held, linear, reached, residual, iterations, error, pressed
        )
        return self._succeeded(command, asked, outcome, clock)

    def _begin(self, positions: np.ndarray, velocities: np.ndarray, time_step: float) -> None:
        """Let all that remembers look at the state where a step begins; move what is guided."""
        for beginner in self._beginners:
            beginner.begin_step(positions, velocities, time_step)

    def _actuate(
        self, linear: Linearized, command: Command, wanted: np.ndarray, bounds: Bounds
    ) -> tuple[Actuation, Actuation]:
        """Find λ in the way that the command asks for; and what it is when all is held."""
        direct = self._direct
        held = direct.held(
            linear, self.actuators.displacements(self.state.setpoints), bounds, command
        )
        if isinstance(command, CommandSetpoints):
            wound = np.clip(wanted, bounds.displacement_min, bounds.displacement_max)
            return direct.wind(linear, wound, bounds), held
        if isinstance(command, CommandEfforts):
            return direct.pull(linear, wanted, held, bounds), held
        if isinstance(command, FollowTargets):
            return self._inverse.solve(linear, wanted, held, bounds), held
        return held, held

    def _move(self, positions, actuation: Actuation, clock: StageClock) -> tuple[float, float]:
        """Correct the positions; the share of the move that was made, and the residual [N]."""
        share = self._newton.correct(positions, actuation)
        clock.mark("correct")
        residual = self._newton.residual(positions, actuation) if share else math.nan
        clock.mark("residual")
        return share, residual

    def _stale_factor_serves(self, share: float, inverted: int) -> bool:
        """Whether a correction by the factor of an earlier step may be kept."""
        newton = self._newton
        return share > 0.0 and newton.inverted_count <= inverted and newton.makes_progress()

    def _succeeded(
        self, command: Command, asked: Asked, outcome: Outcome, clock: StageClock
    ) -> StepResult:
        before = self.state
        self.state = State(
            outcome.positions, self.actuators.setpoints(outcome.actuation.displacements),
            outcome.actuation.efforts, before.step_count + 1, before.time + command.time_step,
            self._motion.velocities(before.positions, outcome.positions, command.time_step),
        )  # fmt: skip
        return self._account.of_step(
            command, asked, outcome, clock, before, self.state, self.effector_positions()
        )

    def _failed(
        self, command, clock, iterations, status=Status.DIVERGED, limits=()
    ) -> StepResult:
        """The last good state, told as a failure. Its time has passed all the same."""
        self.state = self.state.kept_through(command.time_step)
        return self._account.of_failure(
            command, clock, iterations, status, limits, self.state, self.effector_positions()
        )
