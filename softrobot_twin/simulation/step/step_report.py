"""The result of a step: its status, active limits, and figures."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from softrobot_twin.compilation import KERNEL, njit
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.scene import Scene
from softrobot_twin.scene.schema import Solver
from softrobot_twin.simulation.building.limits import ActuatorLimits
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
from softrobot_twin.simulation.step.time_budget import StageClock

# What one linearization may leave out of balance on a node, as a share of all loads together: at
# full speed it leaves a seventh.
NEAR_BALANCE = 0.25
# Named where a target is further away than one step leads, or the steps are not there yet.
REACH = "effectors.reach"
# Named where less weight of the energy would bring an effector nearer.
ENERGY = "solver.energy_weight"
# Named where a step is not in balance after all linearizations that the scene allows.
ITERATIONS = "solver.newton_iterations"
# What a pair with friction does, told where targets are missed.
STICKS, SLIPS, LOST = "sticks", "slips", "lost"
# A demand is met when a displacement is this near to it, as a share of the actuator's scale.
DISPLACEMENT_MET = 1.0e-6
# And an effort, as a share of the demand and of the actuator's scale.
EFFORT_MET, EFFORT_NOTICED = 1.0e-4, 5.0e-6
_DRIVEN_BY = {
    FollowTargets: TARGETS, CommandSetpoints: SETPOINTS, CommandEfforts: EFFORTS, Hold: HOLD,
}  # fmt: skip


def effector_errors(effectors, command: Command, places: np.ndarray) -> np.ndarray:
    """Distance of each effector from its target, over the directions it is controlled along.

    Args:
        effectors: The effector term, or None.
        command: The command.
        places: Where the effectors are [m], shape (effector_count, 3).

    Returns:
        Distances [m], NaN without a target, shape (effector_count,).
    """
    if effectors is None:
        return np.empty(0)
    if not isinstance(command, FollowTargets):
        return np.full(len(effectors.effectors), np.nan)
    misses, count = effectors.rows_of(places - command.targets), len(effectors.effectors)
    owners = effectors.row_effector[: len(misses)]
    errors = np.sqrt(np.bincount(owners, misses * misses, count))
    if effectors.orientations:
        errors[np.setdiff1d(np.arange(count), owners)] = np.nan
    return errors


def orientation_errors(effectors, command: Command, positions: np.ndarray) -> np.ndarray | None:
    """Angle of each effector from its target, over what its orientation asks for.

    Args:
        effectors: The effector term, or None.
        command: The command.
        positions: Node positions [m], shape (node_count, 3).

    Returns:
        Angles [rad], NaN without a target, shape (effector_count,); None in a scene without
        orientations.
    """
    if effectors is None or not effectors.orientations:
        return None
    if not isinstance(command, FollowTargets):
        return np.full(len(effectors.effectors), np.nan)
    return effectors.angles(positions)


def misses(effectors, errors: np.ndarray, angles: np.ndarray | None) -> np.ndarray:
    """How far each effector is from its target, orientations counted by their length per radian.

    Args:
        effectors: The effector term, or None.
        errors: Distances [m]; see `effector_errors`.
        angles: See `orientation_errors`.

    Returns:
        Distances [m], NaN without a target, shape (effector_count,).
    """
    return errors if angles is None else effectors.misses(errors, angles)


class Balance(Enum):
    """How near to balance the linearizations of a step came."""

    REACHED = "within the tolerance"
    NEAR = "near, and more linearizations were not allowed"
    MISSED = "not near enough"


def balance(
    residual: float, whole: bool, may_stop_near: bool, solver: Solver, weight: float,
    load: Callable[[], float],
) -> Balance:  # fmt: skip
    """Judge a step's residual.

    Args:
        residual: Largest force out of balance on a node [N].
        whole: Whether the last move was made as a whole and contacts are solved as exactly as the
            scene asks for.
        may_stop_near: Whether the scene or the deadline stopped the linearizations before they
            could converge.
        solver: The scene's settings.
        weight: Sum of the forces at rest [N], the least load.
        load: Gives the sum of the other loads' sizes [N], where it is needed.
    """
    if whole and residual <= solver.residual_tolerance:
        return Balance.REACHED
    if whole and may_stop_near and (
        residual <= NEAR_BALANCE * weight or residual <= NEAR_BALANCE * (weight + load())
    ):
        return Balance.NEAR
    return Balance.MISSED


def judge(
    actuation: Actuation, inverted_count: int, reached: Balance, met: bool,
    active_limits: tuple[str, ...], following: bool,
) -> Status:  # fmt: skip
    """Say how a step ended: the gravest that is true. What it hides stands in the report.

    Args:
        actuation: What was done.
        inverted_count: Elements that are flat or inside out.
        reached: How near to balance it came.
        met: Whether what was asked is so, see `is_met`.
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


@njit(**KERNEL)
def are_within(first, second, slack):
    """Whether `first` and `second` are within `slack`, all of shape (n,); NaN is not."""
    for i in range(len(first)):
        if not abs(first[i] - second[i]) <= slack[i]:
            return False
    return True


@njit(**KERNEL)
def are_near(displacements, made, scales):
    """Whether no displacement is off by more than `DISPLACEMENT_MET` of its scale; NaN is not.

    Args:
        displacements: Displacements wanted, in the actuators' units, shape (actuator_count,).
        made: Displacements made, same shape.
        scales: Scale of each, same shape.
    """
    for i in range(len(made)):
        if abs(displacements[i] - made[i]) > DISPLACEMENT_MET * scales[i]:
            return False
    return True


def is_met(
    scene: Scene, limits: ActuatorLimits, command: Command, asked: Asked, actuation: Actuation,
    errors: np.ndarray,
) -> bool:  # fmt: skip
    """Whether what was asked is so.

    Args:
        scene: The scene, for its tolerances.
        limits: Limits of the actuators, for their scales.
        command: What was asked.
        asked: The same, read.
        actuation: What was done.
        errors: Distance of each effector from its target, see `misses` [m],
            shape (effector_count,).
    """
    wanted, made = asked.wanted, actuation.drives(limits)

    def are_there(drives: np.ndarray) -> bool:
        """Whether actuators are where they should be; NaN asks nothing."""
        return are_near(drives, made, limits.drive_scale)

    if isinstance(command, FollowTargets):
        missed = [miss for miss in errors.tolist() if math.isfinite(miss)]
        reached = all(miss <= scene.solver.reach_tolerance for miss in missed)
        return reached and (asked.commanded is None or are_there(asked.commanded))
    if isinstance(command, CommandSetpoints):
        return are_there(wanted)
    if isinstance(command, CommandEfforts):
        prescribed = np.isfinite(wanted)
        slack = EFFORT_MET * np.abs(wanted) + EFFORT_NOTICED * limits.effort_scale
        return bool(np.all(np.abs(wanted - actuation.efforts)[prescribed] <= slack[prescribed]))
    return isinstance(command, Hold)


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
        doubted = [part for part in told if not part.is_trusted]
        active = (*active, *(limit for part in doubted for limit in part.limits))
        met = not newton.is_nearly_flat and not doubted and is_met(
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
        if status is Status.NOT_CONVERGED and outcome.iterations >= model.scene.solver.newton_iterations:
            active = (*active, ITERATIONS)
        if isinstance(command, CommandEfforts) and newton.projected_tangent:
            active = (*active, UNSTABLE)
        if following and not met and model.contacts is not None and model.contacts.rubs:
            active = (*active, *what_touches(model.contacts, actuation.contact.multipliers))
        figures, entries, readings = {}, {}, {}
        for part, own in zip(self._parts, told):
            active = (*active, *(limit for limit in own.limits if limit not in active))
            figures |= {f"{part.name}.{figure}": own.figures[figure] for figure in part.figures}
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
            linearization_error=imbalance(model.effectors, *outcome.first),
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
        actuators, efforts = self._model.actuators, actuation.efforts

        def is_slack() -> np.ndarray:
            slack = actuators.one_sided & (efforts <= NO_EFFORT * efforts.max(initial=0.0))
            return slack if asked.commanded is None else slack & np.isnan(asked.commanded)

        follows = isinstance(command, FollowTargets)
        return actuators.limits.binding(
            actuation.displacements, efforts, asked.reach, is_slack if follows else None
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
        most = np.fmax.reduce(before, initial=0.0)
        nearer = most - np.fmax.reduce(after, initial=0.0)
        if nearer > tolerance or nearer > self._inverse.least_progress * most:
            return (REACH,)
        if outcome.held is None:
            # The bodies moved on since actuators were sought.
            return ()
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
    largest = 0.0
    for k in range(len(squares)):
        if squares[k] > largest or np.isnan(squares[k]):
            largest = squares[k]
    return np.sqrt(largest)


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
