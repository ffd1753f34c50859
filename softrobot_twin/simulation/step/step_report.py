"""The result of a step: its status, active limits, and figures."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.result import (
    RATE,
    UNSTABLE,
    ContactForces,
    Status,
    StepReport,
    StepResult,
    contact_forces,
)
from softrobot_twin.simulation.state import State, made
from softrobot_twin.simulation.step.actuation import INVERSION, Actuation, ContactLoads
from softrobot_twin.simulation.step.goals import REACH, Goal
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.newton import Newton
from softrobot_twin.simulation.step.step_part import PartReport, StepPart, those_with
from softrobot_twin.simulation.step.time_budget import StageClock

# What one linearization may leave out of balance on a node, as a share of all loads together: at
# full speed it leaves a seventh.
NEAR_BALANCE = 0.25
# Named where a step is not in balance after all linearizations that the scene allows.
ITERATIONS = "solver.newton_iterations"
# What a pair with friction does, told where targets are missed.
STICKS, SLIPS, LOST = "sticks", "slips", "lost"


class Balance(Enum):
    """How near to balance the linearizations of a step came."""

    REACHED = "within the tolerance"
    NEAR = "near, and more linearizations were not allowed"
    MISSED = "not near enough"


def judge(
    actuation: Actuation, inverted_count: int, reached: Balance, met: bool,
    active_limits: tuple[str, ...], following: bool,
) -> Status:  # fmt: skip
    """Say how a step ended: the gravest that is true. What it hides stands in the report.

    Args:
        actuation: What was done.
        inverted_count: Elements that are flat or inside out.
        reached: How near to balance it came.
        met: Whether what was asked is so, see `Goal.is_met`.
        active_limits: Names of the limits that bind.
        following: Whether effectors were led to targets.

    Returns:
        The status.
    """
    if not actuation.solved:
        return Status.UNSOLVED
    if inverted_count:
        return Status.INVERTED
    if reached is Balance.MISSED:
        return Status.NOT_CONVERGED
    if met:
        return Status.OK if reached is Balance.REACHED else Status.LINEARIZED
    if any(limit.endswith(RATE) or limit == REACH for limit in active_limits):
        return Status.RATE_LIMITED
    if active_limits or not following:
        return Status.SATURATED
    return Status.UNREACHABLE


def what_touches(contacts: Contacts, multipliers: np.ndarray) -> tuple[str, ...]:
    """What pairs with friction do, such as ``finger.rod.sticks``.

    Args:
        contacts: The contact term.
        multipliers: λ of its rows [N], shape (contact_row_count,).

    Returns:
        One name for each pair that presses, or pressed where the step began.
    """
    presses, slips = contacts.touch(multipliers)
    pressed, _ = contacts.touch(contacts.memory.at_start)
    pair_of, found = contacts.pair[: contacts.count], []
    for pair in np.unique(pair_of[(presses | pressed) & (contacts.friction > 0.0)]):
        own = pair_of == pair
        does = STICKS if presses[own].any() else LOST
        does = SLIPS if slips[own].any() else does
        found.append(".".join((*contacts.pair_names[pair], does)))
    return tuple(found)


class Outcome(NamedTuple):
    """Result of the linearizations of one step.

    Attributes:
        positions: Node positions [m], shape (node_count, 3).
        actuation: Efforts and displacements of the actuators.
        held: The same with all actuators held; None where nothing asked for it.
        linear: The last linearization.
        balance: Residual forces of the state.
        residual: Largest residual force on a node [N].
        iterations: Linearizations done.
        first: The first linearization, and the actuation there with all actuators held, or None.
        pressed: Whether the budget left no time for a linearization.
    """

    positions: np.ndarray
    actuation: Actuation
    held: Actuation | None
    linear: Linearized
    balance: Balance
    residual: float
    iterations: int
    first: tuple[Linearized, Actuation | None]
    pressed: bool


class StepResults:
    """Makes the results of a simulation's steps."""

    def __init__(self, model: Model, parts: tuple[StepPart, ...], newton: Newton):
        """Store the objects from which results are read.

        Args:
            model: The built scene.
            parts: Its optional effects.
            newton: Linearizes it.
        """
        self._model, self._parts, self._newton = model, those_with(parts, "report"), newton

    def of_step(
        self, goal: Goal, outcome: Outcome, clock: StageClock, before: State, state: State
    ) -> dict[str, object]:
        """The result of a step with a new state but for that state, before the model changes again.

        Args:
            goal: What was asked.
            outcome: What the linearizations came to.
            clock: Booked the stages.
            before: The state that it began with.
            state: The new state.

        Returns:
            The fields of a `StepResult` beside its state, by their names.
        """
        model, newton, actuation = self._model, self._newton, outcome.actuation
        balance, tangent = newton.balance, newton.tangent
        places = model.effectors.positions(state.positions)
        told = [part.report(state, newton) for part in self._parts]
        errors, angles, missed = self._missed(goal, places, outcome.positions, told, 0)
        active = goal.limits_met(actuation)
        if balance.is_nearly_flat and INVERSION not in active:
            active = (*active, INVERSION)
        is_trusted = not balance.is_nearly_flat
        for own in told:
            if not own.is_trusted:
                active, is_trusted = (*active, *own.limits), False
        met = is_trusted and goal.is_met(actuation, missed)
        if goal.follows and not met and not any(limit.endswith(RATE) for limit in active):
            was_at = model.effectors.positions(before.positions)
            _, _, missed_before = self._missed(goal, was_at, before.positions, told, 1)
            active = (*active, *goal.what_else_holds(outcome.linear, outcome.held, missed_before, missed))
        status = judge(actuation, balance.inverted_count, outcome.balance, met, active, goal.follows)
        if status is Status.NOT_CONVERGED and outcome.iterations >= model.scene.solver.newton_iterations:
            active = (*active, ITERATIONS)
        if tangent.is_projected and goal.held is None:
            active = (*active, UNSTABLE)
        if goal.follows and not met and model.rubs:
            active = (*active, *what_touches(model.contacts, actuation.contact.multipliers))
        figures, entries, readings = {}, {}, {}
        for part, own in zip(self._parts, told):
            if own.limits:
                active = (*active, *(limit for limit in own.limits if limit not in active))
            for figure in part.figures:
                figures[f"{part.name}.{figure}"] = own.figures[figure]
            entries.update(own.entries)
            readings.update(own.readings)
        touching = None
        if model.rows.varies:
            loads = model.actuators.load(actuation.efforts) + actuation.contact.load
            touching = contact_forces(model.contacts, actuation.contact.multipliers,
                                      outcome.positions, balance.constant_load + loads)  # fmt: skip
            entries.update(_of_contacts(actuation.contact, touching))
        report = made(
            StepReport, stage_times=clock.times, compute_time=clock.total, residual=outcome.residual,
            iterations=outcome.iterations, active_limits=active, projected_tangent=tangent.is_projected,
            inverted_count=balance.inverted_count, factor_age=tangent.factor_age,
            is_late=outcome.pressed and tangent.factor_age == 0, qp_solver=actuation.qp_solver,
            linearization_error=imbalance(model.effectors, *outcome.first), driven_by=goal.driven_by,
            figures=figures, **entries,
        )  # fmt: skip
        # The rows were evaluated last where the step ended; the next one evaluates them anew,
        # in the same array.
        reached = model.rows.values[model.rows.groups.actuators]
        return {
            "status": status, "setpoints": state.setpoints, "efforts": state.efforts,
            "displacements": model.actuators.displacements_at(state.setpoints, reached),
            "effector_positions": places, "effector_errors": errors, "report": report, "contacts": touching,
            "effector_orientations": self._quaternions(outcome.positions), "orientation_errors": angles,
            "effector_stiffness": None, "stiffness_errors": None, **readings,
        }  # fmt: skip

    def _missed(
        self, goal: Goal, places: np.ndarray, positions: np.ndarray, told: list[PartReport], when: int
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
        """Distances and angles as of `Goal.errors`, and all misses [m]: of effectors, then of sensors.

        Args:
            goal: What was asked.
            places: Where the effectors are [m], shape (effector_count, 3).
            positions: Node positions [m], shape (node_count, 3).
            told: What parts tell, and with it what is missed beside the targets.
            when: 0 after the step, 1 before it; see `PartReport.misses`.
        """
        errors, angles = goal.errors(places, positions)
        missed = errors if angles is None else self._model.effectors.misses(errors, angles)
        for more in (part.misses[when] for part in told if part.misses):
            both = np.hypot(np.nan_to_num(missed), more)
            missed = np.where(np.isnan(missed) & (more == 0.0), np.nan, both)
        of_sensors = goal.misses_of_sensors(positions)
        return errors, angles, np.concatenate([missed, of_sensors]) if len(of_sensors) else missed

    def _quaternions(self, positions: np.ndarray) -> np.ndarray | None:
        """Turns of the effectors from rest; None in a scene without orientations."""
        effectors = self._model.effectors
        return effectors.quaternions(positions) if effectors.orientations else None

    def of_failure(
        self, goal: Goal, clock: StageClock, iterations: int, status: Status,
        limits: tuple[str, ...], state: State, places: np.ndarray,
    ) -> StepResult:  # fmt: skip
        """The result of a step that kept the last state.

        Args:
            goal: What was asked.
            clock: Booked the stages.
            iterations: Linearizations done.
            status: Why.
            limits: Names of active limits.
            state: The state that was kept.
            places: Where the effectors are [m], shape (effector_count, 3).
        """
        errors, angles = goal.errors(places, state.positions)
        report = StepReport(clock.times, clock.total, math.nan, iterations, limits, driven_by=goal.driven_by,
                            projected_tangent=self._newton.tangent.is_projected)  # fmt: skip
        displacements = self._model.actuators.displacements(state.setpoints, state.positions)
        return StepResult(
            state, status, state.setpoints, state.efforts, displacements, places, errors, report,
            None, self._quaternions(state.positions), angles,
        )  # fmt: skip


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
    largest = 0.0
    for k in range(len(squares)):
        if squares[k] > largest or np.isnan(squares[k]):
            largest = squares[k]
    return np.sqrt(largest)


def imbalance(effectors, linear: Linearized, held: Actuation | None) -> float:
    """Distance of the effectors from equilibrium at held displacements, by the linearization.

    Args:
        effectors: The effector term.
        linear: The system condensed around the state.
        held: Actuation with all actuators held.

    Returns:
        Largest distance over the effectors [m]; NaN without effectors, and in contact.
    """
    if not effectors.effectors or held is None or linear.contact_row_count:
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
