"""How a step ended, in one word."""

from __future__ import annotations

import math

import numpy as np

from softrobot_twin.scene import Scene
from softrobot_twin.scene.schema import Solver
from softrobot_twin.simulation.actuation import Actuation
from softrobot_twin.simulation.command import (
    Command,
    FollowTargets,
    Hold,
    SetLengths,
    SetTensions,
)
from softrobot_twin.simulation.interpretation import Asked
from softrobot_twin.simulation.result import Status

# What one linearization may leave out of balance on a node, as a share of all loads together: at
# full speed it leaves a seventh.
NEAR_BALANCE = 0.25
# A demand is met when a length [m] and a tension (relative) are this near to it.
LENGTH_MET = 1.0e-7
TENSION_MET = 1.0e-4


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
    misses = (places - command.targets).tolist()
    return np.array([
        math.sqrt(sum(miss[axis] * miss[axis] for axis in effector.directions))
        for effector, miss in zip(effectors.effectors, misses, strict=True)
    ])  # fmt: skip


def is_near_balance(residual: float, solver: Solver, load: float) -> bool:
    """Whether a step of a single linearization, which never quite converges, is near enough.

    Args:
        residual: Largest force out of balance on a node [N].
        solver: The scene's settings.
        load: Sum of all loads' sizes [N].
    """
    return residual <= max(solver.residual_tolerance, NEAR_BALANCE * load)


def judge(
    scene: Scene,
    command: Command,
    asked: Asked,
    actuation: Actuation,
    active_limits: tuple[str, ...],
    errors: np.ndarray,
    inverted_count: int,
    converged: bool,
) -> Status:
    """Say how a step ended.

    Args:
        scene: The scene, for its tolerances.
        command: What was asked.
        asked: The same, read.
        actuation: What was done.
        active_limits: Names of the limits that bind.
        errors: Effector errors [m], shape (effector_count,).
        inverted_count: Elements that are flat or inside out.
        converged: False when the residual stayed above its tolerance.

    Returns:
        The status.
    """
    if not actuation.solved:
        return Status.UNSOLVED
    if inverted_count:
        return Status.INVERTED
    met = _is_met(scene, command, asked, actuation, errors)
    if not met and any(limit.endswith(".rate") for limit in active_limits):
        return Status.RATE_LIMITED
    if not met and active_limits:
        return Status.SATURATED
    if not converged:
        return Status.NOT_CONVERGED
    if not met:
        return Status.UNREACHABLE if isinstance(command, FollowTargets) else Status.SATURATED
    return Status.OK


def _is_met(scene, command, asked: Asked, actuation: Actuation, errors: np.ndarray) -> bool:
    wanted, shortening = asked.wanted, actuation.shortening
    if isinstance(command, FollowTargets):
        misses = [miss for miss in errors.tolist() if math.isfinite(miss)]
        reached = all(miss <= scene.solver.reach_tolerance for miss in misses)
        return reached and (asked.commanded is None or _is_wound(asked.commanded, shortening))
    if isinstance(command, SetLengths):
        return _is_wound(wanted, shortening)
    if isinstance(command, SetTensions):
        pulled = np.isfinite(wanted)
        slack = TENSION_MET * (1.0 + np.abs(wanted[pulled]))
        return bool(np.all(np.abs(wanted - actuation.tensions)[pulled] <= slack))
    return isinstance(command, Hold)


def _is_wound(wanted: np.ndarray, shortening: np.ndarray) -> bool:
    """Whether actuators are where they should be; NaN asks nothing."""
    return not bool((np.abs(wanted - shortening) > LENGTH_MET).any())
