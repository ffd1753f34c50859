"""The loop of a step: linearize, condense, solve, correct by one rule of the share, until it is enough.

    repeat:
        A, b, H, δ = sum of the terms at x          `Newton.linearize`
        W, δ_free = condense(A, H, b)
        λ = solve(W, δ_free) as the goal asks       `Goal.solve`
        dq = A⁻¹ (b + Hᵀ λ);  x += share dq         `Newton.correct`, `ShareRule`
    until the residual is within its tolerance, or neither scene nor time allow more

(Coevoet 2017, eq. (9) to (18)).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.result import Status
from softrobot_twin.simulation.step.actuation import INVERSION, PASSING, Actuation
from softrobot_twin.simulation.step.direct_actuation import DirectActuation
from softrobot_twin.simulation.step.goals import Goal
from softrobot_twin.simulation.step.follower import Follower
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import StepPart, those_with
from softrobot_twin.simulation.step.step_report import NEAR_BALANCE, Balance, Outcome
from softrobot_twin.simulation.step.time_budget import StageClock, TimeBudget

# Linearizations of a step in time of which a move was too long for one of them, at most.
MOST_SHARES = 10
# Moves of bodies that are brought near balance, at most, and the length of one, by the body's size,
# that is near.
MOST_MOVES_TO_NEAR, NEAR = 12, 0.01
# A residual within tolerance tells of balance where it is this share of the loads, or would move the
# body by no more than this share of its size. A greater one does where moves are round-off, shares of it.
TELLING_LOAD, TELLING_MOVE, ROUND_OFF = 1.0e-3, 1.0e-6, 1.0e-13


# Share of a move that was made, the residual after it [N], and what the actuators do.
Moved = tuple[float, float, Actuation]


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


class Failure(NamedTuple):
    """A step that ended without a new state.

    Attributes:
        iterations: Linearizations that were begun.
        status: Why it failed.
        limits: Names of the limits that prevented it.
    """

    iterations: int
    status: Status = Status.DIVERGED
    limits: tuple[str, ...] = ()


class StepLoop:
    """The linearizations of a step, and the moves that they lead to.

    Attributes:
        time_budget: How long linearizations took.
    """

    def __init__(
        self, model: Model, newton: Newton, direct: DirectActuation, inverse: Follower | None,
        parts: tuple[StepPart, ...],
    ):
        """Build the loop.

        Args:
            model: The built scene.
            newton: Linearizes the model and corrects positions.
            direct: Finds what comes of setpoints and efforts.
            inverse: Finds actuation towards targets; None in scenes without effectors.
            parts: The optional effects around the steps.
        """
        self._model, self._newton, self._direct, self._inverse = model, newton, direct, inverse
        self._parts, self._with_rows = parts, those_with(parts, "rows")
        self._loading = those_with(parts, "loads")
        self._optimises = "optimise" in model.stages
        self.time_budget = TimeBudget()

    def run(
        self, positions: np.ndarray, efforts: np.ndarray, goal: Goal, clock: StageClock,
        budget: float | None, ahead: float, led: bool,
    ) -> Outcome | Failure:  # fmt: skip
        """Linearize and correct until it is enough.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            efforts: Efforts of the actuators there, in their units, shape (actuator_count,).
            goal: What is asked.
            clock: Books the stages.
            budget: Time for the step [s], or None.
            ahead: Time of the first linearization where it is prepared [s], else zero.
            led: Whether what is guided went all its way.
        """
        newton, time_budget = self._newton, self.time_budget
        pressed = not ahead and time_budget.must_hurry(budget)
        hurry = pressed and newton.tangent.may_keep_factor
        first, iterations, enough, rows = None, 0, False, self._model.rows
        doing, sought = goal, None
        inverted = newton.balance.inverted_count
        while not enough:
            iterations, begin, ahead = iterations + 1, clock.total - ahead, 0.0
            before = positions.copy() if hurry else positions
            done = self._iterate(positions, efforts, doing, clock, hurry)
            if done is None:
                return Failure(iterations)
            first = first or (done.linear, done.still)
            if hurry and not self._stale_factor_serves(done, inverted):
                positions[:], hurry = before, False
                continue
            if done.share == 0.0:
                refusal = (Status.REFUSED, (INVERSION,)) if done.actuation.is_refused else ()
                return Failure(iterations, *refusal)
            efforts = done.actuation.efforts
            if not hurry:
                time_budget.learn(clock.total - begin)
            asks_again = rows.ask_again(positions)
            enough = hurry and not asks_again
            enough = enough or self._is_enough(done, iterations, clock.total, budget, asks_again)
            if doing.seeks_once and done.actuation.solved and done.linear.contact_row_count > 0:
                # Bodies come to balance under what was found before something else is sought.
                sought, doing = done.actuation, goal.as_found(done.actuation)
        if asks_again and rows.lag(positions):
            return Failure(iterations, Status.REFUSED, (PASSING,))
        if sought is not None and iterations > 1:
            done = done._replace(actuation=self._inverse.told(done.actuation, sought))
        reached = self._balance(done, budget) if led and not asks_again else Balance.MISSED
        if reached is Balance.REACHED and rows.press_from_afar:
            reached = Balance.NEAR
        return Outcome(positions.copy(), done.actuation, done.held, done.linear, reached, done.residual,
                       iterations, first, pressed)  # fmt: skip

    def load_of_parts(self) -> float:
        """Size of all loads that the optional effects bring [N]."""
        return sum((part.load for part in self._loading), 0.0)

    def _iterate(
        self, positions: np.ndarray, efforts: np.ndarray, goal: Goal, clock: StageClock, with_stale_factor: bool
    ) -> Correction | None:
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
        linear = self._newton.linearize(
            positions, efforts, clock, with_stale_factor,
            goal.held if self._newton.tangent.asks_for_held else None,
        )  # fmt: skip
        if not linear:
            return None
        still = self._direct.held(linear, goal.drives, goal.bounds, goal.needs_held)
        actuation, held = goal.solve(linear, still, self._rows_of_parts(positions, efforts, goal, clock))
        if self._optimises:
            clock.mark("optimise")
        # Bodies that follow a prescribed move gain energy by it.
        is_judged = not self._model.rows.lag(positions)
        if with_stale_factor:
            share, residual, actuation = self._move(positions, actuation, clock, False, settles=False)
        elif goal.follows and is_judged and not self._model.is_dynamic:
            share, residual, actuation = self._approach(positions, actuation, held, clock)
        else:
            is_judged = is_judged and not goal.follows
            share, residual, actuation = self._move(positions, actuation, clock, is_judged)
        is_balanced = self._is_in_balance(actuation, residual)
        return Correction(linear, actuation, held, still, share, residual, is_balanced)

    def _rows_of_parts(self, positions: np.ndarray, efforts: np.ndarray, goal: Goal, clock: StageClock) -> Any:
        """Rows that a part adds to those of the effectors; see `StepPart.rows`."""
        if not (goal.follows and self._with_rows) or any(part.holds_robot for part in self._parts):
            return None
        state = self._newton.tangent.linearized_state(positions, efforts)
        for part in self._with_rows:
            rows = part.rows(state, goal.command)
            if rows is not None:
                clock.mark(part.name)
                return rows
        return None

    def come_near(
        self, positions: np.ndarray, efforts: np.ndarray, goal: Goal, clock: StageClock
    ) -> np.ndarray | None:
        """Bring the bodies near balance, while the actuators stay.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            efforts: Efforts of the actuators there, in their units, shape (actuator_count,).
            goal: A goal that holds the actuators.
            clock: Books the stages.

        Returns:
            Efforts of the actuators after it; None where there is no way.
        """
        for _ in range(MOST_MOVES_TO_NEAR):
            done = self._iterate(positions, efforts, goal, clock, False)
            if done is None or done.share == 0.0:
                return None
            efforts = done.actuation.efforts
            if done.share == 1.0 and self._newton.last_move <= NEAR * self._model.nodes.size:
                break
        return efforts

    def _is_enough(
        self, done: Correction, iterations: int, elapsed: float, budget: float | None, asks_again: bool
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
        asks_again |= self._model.is_dynamic and self._newton.asks_for_more_moves(done.share)
        most = max(self._model.scene.solver.newton_iterations, MOST_SHARES if asks_again else 1)
        return not self.time_budget.has_time(iterations, elapsed, budget, most)

    def _balance(self, done: Correction, budget: float | None) -> Balance:
        """How near to balance the last correction came.

        Near is where the scene or the deadline stopped the linearizations before they could converge,
        and the residual is small beside the forces at rest, and of actuators, contacts and parts.
        """
        if done.share != 1.0 or not done.actuation.contact.converged:
            return Balance.MISSED
        if done.is_balanced:
            return Balance.REACHED
        if budget is None and self._model.scene.solver.newton_iterations != 1:
            return Balance.MISSED
        return Balance.NEAR if self._is_small(done.actuation, done.residual, NEAR_BALANCE) else Balance.MISSED

    def _is_in_balance(self, actuation: Actuation, residual: float) -> bool:
        """Whether the residual is within its tolerance, or round-off of stiff bodies, and tells of balance.

        Of a body that bears less than the tolerance every residual is within it: a thin fibre far
        from its balance, too.
        """
        newton, size = self._newton, self._model.nodes.size
        if not residual <= self._model.scene.solver.residual_tolerance:
            round_off = ROUND_OFF * self._model.nodes.finite_size
            return newton.last_move <= round_off and newton.longest_left() <= round_off
        return self._is_small(actuation, residual, TELLING_LOAD) or newton.longest_left() <= TELLING_MOVE * size

    def _is_small(self, actuation: Actuation, residual: float, share: float) -> bool:
        """Whether a residual is at most a share of the forces at rest, of actuators, contacts and parts."""
        load = self._newton.balance.constant_load
        if residual > share * load:
            load += self._model.actuators.load(actuation.efforts)
            load += actuation.contact.load + self.load_of_parts()
        return residual <= share * load

    def _move(
        self, positions: np.ndarray, actuation: Actuation, clock: StageClock, is_judged: bool = True,
        is_sought: bool = False, settles: bool = True,
    ) -> Moved:  # fmt: skip
        """Correct the positions, by as much of the move as folds nothing.

        Args:
            positions: Node positions [m], shape (node_count, 3); moved.
            actuation: λ of the optimisation.
            clock: Books the stages.
            is_judged: Whether it is judged how far the move goes, too.
            is_sought: Whether targets chose the actuation.
            settles: Whether the residual is judged, which may shorten the move.
        """
        newton, residual = self._newton, math.nan
        share, actuation = newton.correct(positions, actuation, is_judged)
        if newton.tangent.is_augmented:
            self._direct.remember(actuation.efforts)
        clock.mark("correct")
        if share:
            residual = newton.residual(positions, actuation)
            settled = newton.settle(positions, share, is_sought) if settles else share
            if settled != share:
                share, residual = settled, float(newton.balance.largest[0])
        clock.mark("residual")
        return share, residual, actuation

    def _approach(self, positions: np.ndarray, actuation: Actuation, held: Actuation, clock: StageClock) -> Moved:
        """Correct the positions, in statics, by the first actuation of which most may be made."""
        newton, inverts, inverse = self._newton, False, self._inverse
        for tried in inverse.tries(actuation, held):
            share, residual, done = self._move(positions, tried, clock, is_sought=True)
            if share > 0.0 and (share >= inverse.least_share or tried is held):
                break
            inverts = inverts or newton.share_rule.folds_whole
            newton.take_back(positions)
        else:
            tried = held
            share, residual, done = self._move(positions, held, clock)
            if newton.inverts:
                # It cannot even stay: the last good state is kept.
                share, inverts = 0.0, True
                newton.balance.forget_folds()
        if tried is not actuation:
            self._direct.remember(done.efforts)
            inverse.refuse(tried is held and share == 0.0)
            done = done._replace(is_refused=inverts)
        return share, residual, done

    def _stale_factor_serves(self, done: Correction, inverted: int) -> bool:
        """Whether a correction by the factor of an earlier step may be kept."""
        is_near = self._balance(done, 0.0) is not Balance.MISSED
        return is_near and self._newton.balance.inverted_count <= inverted and self._newton.makes_progress()
