"""The result of a step: its status, active limits, and figures."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.table_columns import EFFORTS, HOLD, SETPOINTS, TARGETS
from softrobot_twin.simulation.command import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
)
from softrobot_twin.simulation.result import (
    RATE,
    UNSTABLE,
    ContactForces,
    Status,
    StepReport,
    StepResult,
    contact_forces,
)
from softrobot_twin.simulation.state import State
from softrobot_twin.simulation.step.actuation import INVERSION, NO_EFFORT, Actuation, ContactLoads
from softrobot_twin.simulation.step.interpretation import Asked
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import StepPart, those_with
from softrobot_twin.simulation.step.step_status import (
    ENERGY,
    REACH,
    Balance,
    effector_errors,
    is_met,
    judge,
    misses,
    orientation_errors,
)
from softrobot_twin.simulation.step.time_budget import StageClock

_DRIVEN_BY = {
    FollowTargets: TARGETS, CommandSetpoints: SETPOINTS, CommandEfforts: EFFORTS, Hold: HOLD,
}  # fmt: skip


class Outcome(NamedTuple):
    """Result of the linearizations of one step.

    Attributes:
        positions: Node positions [m], shape (node_count, 3).
        actuation: Efforts and displacements of the actuators.
        held: The same with all actuators held.
        linear: The last linearization.
        balance: Residual forces of the state.
        residual: Largest residual force on a node [N].
        iterations: Linearizations done.
        begin: The first linearization, and the actuation there with all actuators held, or None.
        pressed: Whether the budget left no time for a linearization.
    """

    positions: np.ndarray
    actuation: Actuation
    held: Actuation
    linear: Linearized
    balance: Balance
    residual: float
    iterations: int
    begin: tuple[Linearized, Actuation | None]
    pressed: bool


class StepResults:
    """Makes the results of a simulation's steps."""

    def __init__(self, model: Model, parts: tuple[StepPart, ...], newton: Newton, inverse):
        """Store the objects from which results are read.

        Args:
            model: The built scene.
            parts: Its optional effects.
            newton: Linearizes it.
            inverse: Finds λ that leads to targets, or None.
        """
        self._model, self._parts, self._newton = model, those_with(parts, "report"), newton
        self._inverse = inverse

    def of_step(
        self, command: Command, asked: Asked, outcome: Outcome, clock: StageClock,
        before: State, state: State,
    ) -> StepResult:  # fmt: skip
        """The result of a step with a new state, before the model changes again.

        Args:
            command: What was asked.
            asked: The same, read.
            outcome: What the linearizations came to.
            clock: Booked the stages.
            before: The state that it began with.
            state: The new state.
        """
        model, newton, actuation = self._model, self._newton, outcome.actuation
        places = np.empty((0, 3))
        if model.effectors is not None:
            places = model.effectors.positions(state.positions)
        errors = effector_errors(model.effectors, command, places)
        angles = orientation_errors(model.effectors, command, outcome.positions)
        told = [part.report(state) for part in self._parts]
        more_misses = [part.misses for part in told if part.misses]
        missed = misses(model.effectors, errors, angles)
        for after, _ in more_misses:
            missed = _with_more(missed, after)
        # A command to hold needs no motion, so no limit restricts it.
        active: tuple[str, ...] = ()
        if not isinstance(command, Hold):
            active = (*self._binding(command, asked, actuation), *actuation.given_up)
        if newton.is_nearly_flat and INVERSION not in active:
            active = (*active, INVERSION)
        met = not newton.is_nearly_flat and is_met(
            model.scene, model.actuators.limits, command, asked, actuation, missed
        )
        following = isinstance(command, FollowTargets)
        if following and not met and not any(limit.endswith(RATE) for limit in active):
            missed_before = self._missed(command, before.positions)
            for _, earlier in more_misses:
                missed_before = _with_more(missed_before, earlier)
            active = (*active, *self._what_else_holds(asked, outcome, missed_before, missed))
        status = judge(
            actuation, newton.inverted_count, outcome.balance, met, active, following
        )
        if isinstance(command, CommandEfforts) and newton.projected_tangent:
            active = (*active, UNSTABLE)
        figures, entries, readings = {}, {}, {}
        for part, own in zip(self._parts, told):
            active = (*active, *own.limits)
            figures |= {f"{part.name}.{figure}": value for figure, value in own.figures.items()}
            entries |= own.entries
            readings |= own.readings
        touching = None
        if model.contacts is not None:
            loads = model.actuators.load(actuation.efforts) + actuation.contact.load
            touching = contact_forces(
                model.contacts, actuation.contact.multipliers, outcome.positions,
                newton.constant_load + loads,
            )
        report = StepReport(
            clock.times, clock.total, outcome.residual, outcome.iterations, active,
            projected_tangent=newton.projected_tangent, inverted_count=newton.inverted_count,
            linearization_error=imbalance(model.effectors, *outcome.begin),
            factor_age=newton.factor_age,
            is_late=outcome.pressed and newton.factor_age == 0,
            qp_solver=actuation.qp_solver,
            driven_by=_DRIVEN_BY[type(command)], figures=figures, **entries,
            **_of_contacts(actuation.contact, touching),
        )  # fmt: skip
        # The rows were evaluated last where the step ended.
        reached = model.rows.values[model.rows.groups.actuators].copy()
        displacements = model.actuators.displacements_at(state.setpoints, reached)
        return StepResult(
            state, status, state.setpoints, state.efforts, displacements, places, errors, report,
            touching, self._quaternions(outcome.positions), angles, **readings,
        )  # fmt: skip

    def _binding(self, command: Command, asked: Asked, actuation: Actuation) -> list[str]:
        """Names of the limits of actuators that bind.

        On the way to targets, a cable that is not commanded and has no tension holds nothing back:
        its winch may be at a limit, which binds nothing.
        """
        actuators, displacements = self._model.actuators, actuation.displacements
        names = actuators.limits.binding(displacements, actuation.efforts, asked.reach)
        if not names or not isinstance(command, FollowTargets):
            return names
        efforts = actuation.efforts
        is_slack = actuators.one_sided & (efforts <= NO_EFFORT * efforts.max(initial=0.0))
        if asked.commanded is not None:
            is_slack &= np.isnan(asked.commanded)
        if not is_slack.any():
            return names
        return actuators.limits.binding(
            np.where(is_slack, np.nan, displacements), efforts, asked.reach
        )

    def _missed(self, command: Command, positions: np.ndarray) -> np.ndarray:
        """Distances of the effectors from their targets at some node positions [m]; see `misses`.
        """
        effectors = self._model.effectors
        errors = effector_errors(effectors, command, effectors.positions(positions))
        return misses(effectors, errors, orientation_errors(effectors, command, positions))

    def _quaternions(self, positions: np.ndarray) -> np.ndarray | None:
        """Turns of the effectors from rest; None in a scene without orientations."""
        effectors = self._model.effectors
        if effectors is None or not effectors.orientations:
            return None
        return effectors.quaternions(positions)

    def of_failure(
        self, command: Command, clock: StageClock, iterations: int, status: Status,
        limits: tuple[str, ...], state: State, places: np.ndarray,
    ) -> StepResult:  # fmt: skip
        """The result of a step that kept the last state.

        Args:
            command: What was asked.
            clock: Booked the stages.
            iterations: Linearizations done.
            status: Why.
            limits: Names of active limits.
            state: The state that was kept.
            places: Where the effectors are [m], shape (effector_count, 3).
        """
        errors = effector_errors(self._model.effectors, command, places)
        report = StepReport(
            clock.times, clock.total, math.nan, iterations, limits,
            projected_tangent=self._newton.projected_tangent, driven_by=_DRIVEN_BY[type(command)],
        )  # fmt: skip
        displacements = self._model.actuators.displacements(state.setpoints, state.positions)
        return StepResult(
            state, status, state.setpoints, state.efforts, displacements, places, errors, report,
            None, self._quaternions(state.positions),
            orientation_errors(self._model.effectors, command, state.positions),
        )  # fmt: skip

    def _what_else_holds(
        self, asked: Asked, outcome: Outcome, before: np.ndarray, after: np.ndarray
    ) -> tuple[str, ...]:
        """Names of limits other than those of actuators that keep effectors from their targets.

        Args:
            asked: What was asked.
            outcome: What the linearizations came to.
            before: Distances of the effectors from the same targets before the step, see
                `misses` [m], shape (effector_count,).
            after: After it [m], same shape.
        """
        tolerance = self._model.scene.solver.reach_tolerance
        if np.fmax.reduce(before, initial=0.0) - np.fmax.reduce(after, initial=0.0) > tolerance:
            return (REACH,)
        is_held = self._inverse.is_held_by_energy(
            outcome.linear, asked.wanted, outcome.held, asked.bounds, tolerance
        )
        return (ENERGY,) if is_held else ()


@njit(**KERNEL)
def largest_distance(places, others, row_effector, squares):
    """Largest distance of an effector between two states [m]; NaN where one is.

    Args:
        places: Effector coordinates [m], shape (effector_row_count,).
        others: Those in the other state [m], same shape.
        row_effector: Effector of each row of positions, shape (position_row_count,).
        squares: Zeros; takes the squared distances [m²], shape (effector_count,).
    """
    for r in range(len(row_effector)):
        squares[row_effector[r]] += (places[r] - others[r]) ** 2
    return np.sqrt(np.max(squares))


def imbalance(effectors, linear: Linearized, held: Actuation | None) -> float:
    """Distance of the effectors from equilibrium at held displacements, by the linearization.

    Args:
        effectors: The effector term, or None.
        linear: The system condensed around the state.
        held: Actuation with all actuators held.

    Returns:
        Largest distance over the effectors [m]; NaN without effectors, and in contact.
    """
    if effectors is None or held is None or linear.contact_row_count:
        return float("nan")
    places = linear.effector_places(held.efforts, held.contact.multipliers)
    return largest_distance(
        places, linear.effectors_now, effectors.row_effector[: effectors.position_row_count],
        np.zeros(len(effectors.effectors)),
    )  # fmt: skip


def _of_contacts(loads: ContactLoads, touching: ContactForces | None) -> dict:
    """Contact entries of a report; empty without contact."""
    if not len(loads.multipliers):
        return {}
    return {
        "contact_count": len(touching.forces), "contact_sweeps": loads.sweeps,
        "contact_residual": loads.residual, "contact_force_residual": loads.force_residual,
    }  # fmt: skip


def _with_more(missed: np.ndarray, more: np.ndarray) -> np.ndarray:
    """How far each effector is from all that is asked.

    Args:
        missed: Distances from the targets [m], NaN without a target, shape (effector_count,).
        more: What a part misses; see `PartReport` [m], same shape.
    """
    both = np.hypot(np.nan_to_num(missed), more)
    return np.where(np.isnan(missed) & (more == 0.0), np.nan, both)
