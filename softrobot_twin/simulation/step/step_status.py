"""How a step ended, in one word."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum

import numpy as np

from softrobot_twin.compilation import KERNEL, njit
from softrobot_twin.scene import Scene
from softrobot_twin.scene.schema import Solver
from softrobot_twin.simulation.building.limits import ActuatorLimits
from softrobot_twin.simulation.command import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
)
from softrobot_twin.simulation.result import RATE, Status
from softrobot_twin.simulation.step.actuation import Actuation
from softrobot_twin.simulation.step.interpretation import Asked

# What one linearization may leave out of balance on a node, as a share of all loads together: at
# full speed it leaves a seventh.
NEAR_BALANCE = 0.25
# Named where a target is further away than one step leads, or the steps are not there yet.
REACH = "effectors.reach"
# Named where less weight of the energy would bring an effector nearer.
ENERGY = "solver.energy_weight"
# A demand is met when a displacement is this near to it, as a share of the actuator's scale.
DISPLACEMENT_MET = 1.0e-6
# And an effort, as a share of the demand and of the actuator's scale.
EFFORT_MET, EFFORT_NOTICED = 1.0e-4, 5.0e-6


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
    """Whether no two numbers differ by more than their slack, all of shape (n,); NaN does."""
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
