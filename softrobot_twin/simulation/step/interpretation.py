"""A command as one checked array, with the bounds of the step."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.simulation.building.limits import ActuatorLimits
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.command import (
    Command,
    CommandSetpoints,
    FollowTargets,
    Hold,
)
from softrobot_twin.simulation.state import State
from softrobot_twin.solvers.inverse_problem import Bounds


class Asked(NamedTuple):
    """A checked command, with the bounds of the step.

    Attributes:
        wanted: Drives or efforts (each in the unit of its kind) or target rows [m].
        bounds: Bounds of this step, in which commanded actuators are fixed.
        reach: Bounds of this step by the hardware alone.
        drives: Those of the setpoints at its beginning, shape (actuator_count,).
        commanded: Drives commanded beside targets, NaN where free; None if none is commanded,
            shape (actuator_count,). A drive is what a setpoint holds; see `Actuators.drives`.
    """

    wanted: np.ndarray
    bounds: Bounds
    reach: Bounds
    drives: np.ndarray
    commanded: np.ndarray | None = None


class Interpretation:
    """Reads commands for one scene."""

    def __init__(self, model: Model):
        """Store the properties of the scene that commands must fit.

        Args:
            model: The built scene.
        """
        self._model, self._actuators = model, model.actuators
        self._why_not_followed = why_not_followed(model)

    def read(self, command: Command, state: State) -> Asked:
        """Check a command, and compute the bounds of this step.

        Args:
            command: The command.
            state: State at the beginning of the step.

        Returns:
            It, checked.

        Raises:
            CommandError: The command does not fit this scene, or is not finite.
        """
        actuators = self._actuators
        limits, count = actuators.limits, actuators.count
        drives = actuators.drives(state.setpoints)
        if not isinstance(command, Command):
            raise CommandError(type(command).__name__, "is not a command")
        if not (math.isfinite(command.time_step) and command.time_step >= 0.0):
            raise CommandError("time_step", f"{command.time_step} s is not a duration")
        if self._model.is_dynamic and command.time_step == 0.0:
            raise CommandError("time_step", "0 s: a scene that moves in time needs a time step")
        if isinstance(command, Hold):
            still = limits.bounds(drives, 0.0)
            return Asked(drives, still, still, drives)
        moving = command.time_step if command.reach_time is None else command.reach_time
        if not (math.isfinite(moving) and moving >= 0.0):
            raise CommandError("reach_time", f"{moving} s is not a duration")
        bounds = limits.bounds(drives, moving)
        if limits.has_flow and moving > 0.0:
            grown = actuators.displacements(state.setpoints, state.positions)
            bounds = limits.with_flow(bounds, grown, moving)
        if isinstance(command, FollowTargets):
            rows = self._target_rows(command, state)
            if command.stiffness is not None:
                self._check_stiffness(command.stiffness)
            if command.commanded is None:
                return Asked(rows, bounds, bounds, drives)
            setpoints = fitting("commanded", command.commanded, (count,), True)
            commanded = actuators.drives(setpoints)
            within = _with_commanded(commanded, bounds, limits)
            return Asked(rows, within, bounds, drives, commanded)
        if isinstance(command, CommandSetpoints):
            setpoints = fitting("setpoints", command.setpoints, (count,), False)
            return Asked(actuators.drives(setpoints), bounds, bounds, drives)
        efforts = fitting("efforts", command.efforts, (count,), True)
        if np.isnan(efforts[actuators.takes_efforts]).any():
            raise CommandError("efforts", f"holds {np.nan}")
        return Asked(efforts, bounds, bounds, drives)

    def _check_stiffness(self, stiffness: np.ndarray) -> None:
        """Refuse wanted stiffnesses [N/m] that are none, or of effectors that ask for none."""
        shape = (len(self._model.effectors.effectors), 3)
        wanted = fitting("stiffness", stiffness, shape, True)
        if not (np.isnan(wanted) | (wanted > 0.0)).all():
            worst = np.nanmin(wanted)
            raise CommandError("stiffness", f"{worst} N/m is not a positive stiffness")
        for effector, own in zip(self._model.scene.effectors, wanted, strict=True):
            if effector.stiffness is None and np.isfinite(own).any():
                raise CommandError(effector.name, "asks for no stiffness in the scene")

    def _target_rows(self, command: FollowTargets, state: State) -> np.ndarray:
        """Wanted effector coordinates; orientations are aimed at their targets."""
        if self._why_not_followed:
            raise CommandError("targets", self._why_not_followed)
        term = self._model.effectors
        count = len(term.effectors)
        wanted = term.rows_of(fitting("targets", command.targets, (count, 3), True))
        if command.orientations is None and not term.orientations:
            return wanted
        quaternions = np.full((count, 4), np.nan)
        if command.orientations is not None:
            quaternions = fitting("orientations", command.orientations, (count, 4), True)
        if not term.orientations:
            raise CommandError("orientations", "no effector of this scene asks for an orientation")
        return np.concatenate([wanted, term.aim(quaternions, state.positions)])


def _with_commanded(commanded: np.ndarray, bounds: Bounds, limits: ActuatorLimits) -> Bounds:
    """Bounds in which the commanded actuators are fixed, by displacement or by effort."""
    within = limits.drives_within(commanded, bounds)
    is_moved = ~np.isnan(commanded) & ~limits.is_effort_driven
    is_loaded = ~np.isnan(commanded) & limits.is_effort_driven
    return Bounds(
        np.where(is_moved, within, bounds.displacement_min),
        np.where(is_moved, within, bounds.displacement_max),
        np.where(is_loaded, within, bounds.effort_min),
        np.where(is_loaded, within, bounds.effort_max),
    )


def why_not_followed(model: Model) -> str:
    """Reason why a scene's effectors cannot follow targets; empty if they can.

    Args:
        model: The model of a simulation.
    """
    if model.effectors is None or not model.actuators.count:
        return "this scene has no effectors or no actuators"
    return ""


def fitting(name: str, array, shape: tuple[int, ...], nan_allowed: bool) -> np.ndarray:
    """An array of a command, checked.

    Args:
        name: Its name, for errors.
        array: Its values.
        shape: The shape that it must have.
        nan_allowed: Whether it may hold NaN; it must not hold infinite values in any case.

    Raises:
        CommandError: It does not fit.
    """
    array = np.asarray(array, dtype=float)
    if array.shape != shape:
        raise CommandError(name, f"must have shape {shape}, not {array.shape}")
    # Faster than a check of the array, which has few entries.
    if all(map(math.isfinite, array.ravel().tolist())):
        return array
    bad = np.isinf(array) if nan_allowed else ~np.isfinite(array)
    if bad.any():
        raise CommandError(name, f"holds {array[bad][0]}")
    return array
