"""The columns of what runs write, in one order for all runs however they are driven.

Each column is there only where the scene or the run has what it tells: contacts, targets, reduced
bodies. Names are those of `table_columns`, so that a run's file can be given back as input.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.mechanics.rotation import quaternion_from_rotation
from softrobot_twin.simulation.building.actuator_kinds import ActuatorKind, Quantity
from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.building.pulleys import ANGLE, TORQUE
from softrobot_twin.simulation.building.table_columns import (
    DRIVEN_BY,
    STATUS,
    STEP,
    TIME,
    body_name,
    column,
    displacement_columns,
    force_columns,
    position_columns,
    quaternion_columns,
    stiffness_columns,
    target_name,
)
from softrobot_twin.simulation.command import Command, FollowTargets
from softrobot_twin.simulation.effects.coordinate_range import reduced_bodies
from softrobot_twin.simulation.effects.reduction_error import has_spare_modes
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.simulation import Simulation

PATH = Quantity("path", "m")
COMPUTE_TIME = "compute_time_s"
ACTIVE_LIMITS = "active_limits"
TEXT_COLUMNS = (ACTIVE_LIMITS, DRIVEN_BY, STATUS)
"""Columns that are no numbers; names of several active limits are separated by spaces."""
WHOLE_NUMBERS = (STEP, "contact_count", "iterations")
"""Columns that are whole numbers."""


class RunRow(NamedTuple):
    """One step of a run.

    Attributes:
        step: Steps recorded before this one; settling steps do not count.
        time: The run's time at its end [s].
        result: The simulation's result.
        command: What was asked; None where the run follows no targets.
        rigid_poses: Position of each rigid body's origin [m] and quaternion x, y, z, w, shape
            (rigid_body_count, 7).
        pair_resultants: Sum of the contact forces on the first body of each pair of `pair_names`
            [N], shape (pair_count, 3).
        pair_magnitude_sums: Sum of those forces' magnitudes [N], shape (pair_count,).
        reduction_errors: Estimated error of each reduced body that can be judged [m].
        observed: Values of further columns.
    """

    step: int
    time: float
    result: StepResult
    command: Command | None
    rigid_poses: np.ndarray
    pair_resultants: np.ndarray
    pair_magnitude_sums: np.ndarray
    reduction_errors: tuple[float, ...] = ()
    observed: tuple[float, ...] = ()


def actuator_columns(actuators: Actuators) -> list[tuple[str, Quantity]]:
    """Name and quantity of each column about actuators, in the order of `actuator_cells`.

    Of a cable: the length that its winch is set to [m], its tension [N], the winch's shortening [m],
    its length at rest [m], and the length of its path [m], which is shorter where it is slack. Of a
    cavity whose pressure is commanded: its pressure [Pa], its growth [m³] and its volume [m³]. Of a
    motor of a hinge: its angle [rad] and its torque [N m]. Last, of each pulley, its angle [rad]
    and its torque [N m].

    Args:
        actuators: The actuators of the scene.
    """
    return [
        (name, quantity) for name, kind in actuators.kind_of.items()
        for quantity in _quantities(kind)
    ] + [(name, quantity) for name in actuators.pulleys.names for quantity in (ANGLE, TORQUE)]


def _quantities(kind: ActuatorKind) -> tuple[Quantity, ...]:
    """Quantities of an actuator in a file."""
    if kind.is_effort_driven:  # The setpoint is the effort, and 0 at rest.
        return kind.setpoint, kind.displacement, kind.extent
    if kind.displacement == kind.setpoint:  # It is 0 at rest.
        return kind.setpoint, kind.effort
    rest = Quantity(f"rest_{kind.setpoint.word}", kind.setpoint.unit)
    quantities = kind.setpoint, kind.effort, kind.displacement, rest
    return (*quantities, PATH) if kind.one_sided else quantities


def actuator_cells(result: StepResult, actuators: Actuators) -> list[float]:
    """Values of the columns about actuators; see `actuator_columns`.

    Args:
        result: Result of a step.
        actuators: The actuators of the scene.
    """
    extents = actuators.extents(result.displacements)
    paths = actuators.path_lengths(result.state.positions)
    cells = []
    for index, kind in enumerate(actuators.kinds):
        setpoint, displacement = result.setpoints[index], result.displacements[index]
        if kind.displacement == kind.setpoint:
            cells += [setpoint, result.efforts[index]]
        elif kind.is_effort_driven:
            cells += [setpoint, displacement, extents[index]]
        else:
            cells += [setpoint, result.efforts[index], displacement,
                      actuators.rest_setpoints[index]]
            if kind.one_sided:
                cells.append(paths[actuators.names[index]])
    pulleys = actuators.pulleys
    for pair in zip(pulleys.angles(result.setpoints), pulleys.torques(result.efforts), strict=True):
        cells += pair
    return cells


def rigid_poses(simulation: Simulation, positions: np.ndarray | None = None) -> np.ndarray:
    """Origin [m] and quaternion x, y, z, w of each rigid body, shape (rigid_body_count, 7).

    Args:
        simulation: The scene.
        positions: Node positions [m], shape (node_count, 3); None for the present ones.
    """
    positions = simulation.state.positions if positions is None else positions
    poses = np.empty((len(simulation.model.rigid), 7))
    for pose, part in zip(poses, simulation.model.rigid, strict=True):
        origin, rotation = part.entry_pose(positions)
        pose[:3], pose[3:] = origin, quaternion_from_rotation(rotation)
    return poses


def pair_names(simulation: Simulation) -> tuple[tuple[str, str], ...]:
    """Names of the pairs that may touch, each pair once."""
    if simulation.model.contacts is None:
        return ()
    return tuple(dict.fromkeys(tuple(pair.names) for pair in simulation.model.contacts.pairs))


def magnitude_column(pair: tuple[str, str]) -> str:
    """Column of how hard two bodies press on each other [N]."""
    return f"sum_of_magnitudes_{pair[0]}_{pair[1]}_N"


class RunColumns:
    """The columns of a run, and their values in its steps.

    Attributes:
        names: The columns, in their order.
        actuators: Those that tell of actuators, as name and quantity.
    """

    def __init__(
        self, simulation: Simulation, followed: Command | None = None,
        observed: Sequence[str] = (), with_reduction_errors: bool = True,
    ):  # fmt: skip
        """Collects the columns.

        Args:
            simulation: The scene, at any state.
            followed: A command with targets, whose effectors are those of all commands of the run;
                other commands have none.
            observed: Columns of further values.
            with_reduction_errors: Whether the error of each reduced body is estimated in each row,
                which takes the time of a step with the spare modes.
        """
        self._simulation = simulation
        self._pairs, model = pair_names(simulation), simulation.model
        self.actuators = actuator_columns(simulation.actuators)
        self._effectors = simulation.effector_names
        count = len(self._effectors)
        nothing = (np.zeros(count, bool), np.zeros(count, bool), np.zeros((count, 3), bool))
        self._aimed, self._turned, self._stiffened = nothing
        if isinstance(followed, FollowTargets):
            self._aimed, self._turned, self._stiffened = _given(followed, count)
        self._oriented = np.array(simulation.oriented_effectors, bool)
        self._stiff = np.array(simulation.stiff_effectors, bool)
        self._has_ranges = simulation.has_reduced_bodies or bool(model.superelements)
        self._judged: tuple[str, ...] = ()
        if with_reduction_errors and not simulation.falls_back:
            spare = reduced_bodies(model) if has_spare_modes(model) else ()
            self._judged = (*model.superelements, *(body.name for body in spare))
        self.names: tuple[str, ...] = (STEP, TIME, *(
            one for index in range(count) for one in self._of_effector(index)
        ), *(column(*one) for one in self.actuators), *self._of_bodies(), *observed,
            *self._of_contacts(), *self._of_steps())  # fmt: skip

    def _of_effector(self, index: int) -> list[str]:
        """Columns of an effector: its place, what was wanted, and how far off it is."""
        name = self._effectors[index]
        wanted = target_name(name)
        parts = [*position_columns(name)]
        if self._oriented[index]:
            parts += quaternion_columns(name)
        if self._stiff[index]:
            parts += stiffness_columns(name)
        if self._aimed[index]:
            parts += position_columns(wanted)
        if self._turned[index]:
            parts += quaternion_columns(wanted)
        parts += [one for one, asked in zip(stiffness_columns(wanted), self._stiffened[index])
                  if asked]
        if self._aimed[index]:
            parts.append(f"{name}_error_m")
        if self._turned[index]:
            parts.append(f"{name}_orientation_error_rad")
        return parts

    def _of_bodies(self) -> list[str]:
        """Columns of rigid bodies and touches."""
        parts = []
        for body in self._simulation.model.rigid:
            name = body_name(body.name, self._effectors)
            parts += [*position_columns(name), *quaternion_columns(name)]
        for name in self._simulation.touch_names:
            parts += [*force_columns(name), *displacement_columns(name)]
        return parts

    def _of_contacts(self) -> list[str]:
        if not self._pairs:
            return []
        parts = ["contact_count"]
        for pair in self._pairs:
            parts += [f"force_on_{pair[0]}_by_{pair[1]}_{axis}_N" for axis in "xyz"]
            parts.append(magnitude_column(pair))
        return [*parts, "contact_residual_m"]

    def _of_steps(self) -> list[str]:
        parts = ["residual_N"]
        if self._effectors:
            parts.append("linearization_error_m")
        if self._has_ranges:
            parts.append("sampled_range")
        parts += [f"{name}_reduction_error_m" for name in self._judged]
        return [*parts, "iterations", COMPUTE_TIME, *TEXT_COLUMNS]

    def row(
        self, step: int, time: float, result: StepResult, command: Command | None = None,
        observed: tuple[float, ...] = (),
    ) -> RunRow:  # fmt: skip
        """The row of a step, just after it.

        Args:
            step: Steps before this one.
            time: The run's time at its end [s].
            result: Its result; the simulation is at the state that it led to.
            command: What was asked; needed where the run follows targets.
            observed: Values of further columns.
        """
        resultants, sums = np.zeros((len(self._pairs), 3)), np.zeros(len(self._pairs))
        if result.contacts is not None:
            forces = result.contacts.of_pairs()
            resultants, sums = forces.resultants, forces.magnitude_sums
        errors: tuple[float, ...] = ()
        if self._judged:
            states = self._simulation.reduction_state()
            errors = tuple(states[name].error for name in self._judged)
        poses = rigid_poses(self._simulation, result.state.positions)
        return RunRow(step, time, result, command, poses, resultants, sums, errors, observed)

    def cells(self, row: RunRow) -> list[int | float | str]:
        """Values of the columns, in their order."""
        result, report = row.result, row.result.report
        numbers = [one for index in range(len(self._effectors))
                   for one in self._effector_cells(row, index)]
        numbers += actuator_cells(result, self._simulation.actuators)
        numbers += row.rigid_poses.ravel().tolist()
        if result.touches is not None:
            touches = result.touches
            numbers += np.hstack([touches.forces, touches.displacements]).ravel().tolist()
        numbers += row.observed
        cells: list[int | float | str] = [row.step, row.time, *map(float, numbers)]
        if self._pairs:
            forces = np.column_stack([row.pair_resultants, row.pair_magnitude_sums])
            cells += [report.contact_count, *forces.ravel().tolist()]
            cells.append(float(report.contact_residual))
        cells.append(float(report.residual))
        if self._effectors:
            cells.append(float(report.linearization_error))
        if self._has_ranges:
            cells.append(float(report.sampled_range))
        return [*cells, *map(float, row.reduction_errors), report.iterations,
                float(report.compute_time), " ".join(report.active_limits), report.driven_by,
                result.status.value]

    def _effector_cells(self, row: RunRow, index: int) -> list[float]:
        """Values of the columns of an effector."""
        result, command = row.result, row.command
        cells = [*result.effector_positions[index]]
        if self._oriented[index]:
            cells += [*result.effector_orientations[index]]
        if self._stiff[index]:
            own = result.effector_stiffness
            cells += [math.nan] * 3 if own is None else [*own[index]]
        if not self._aimed[index]:
            return cells
        assert isinstance(command, FollowTargets), "a run that follows targets tells each of them"
        cells += [*np.asarray(command.targets)[index]]
        if self._turned[index]:
            cells += [*command.orientations[index]]
        if self._stiffened[index].any():
            cells += [*command.stiffness[index][self._stiffened[index]]]
        cells.append(result.effector_errors[index])
        if self._turned[index]:
            cells.append(result.orientation_errors[index])
        return cells

    def texts(self, row: RunRow) -> list[str]:
        """Cells of a row of a file; numbers are given to the last bit."""
        return [repr(cell) if isinstance(cell, float) else str(cell) for cell in self.cells(row)]


def _given(followed: FollowTargets, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which effectors have a target, which an orientation, and which axes a stiffness.

    Returns:
        Shapes (effector_count,), (effector_count,) and (effector_count, 3).
    """
    aimed = np.isfinite(followed.targets).all(axis=1)
    turned, stiffened = np.zeros(count, bool), np.zeros((count, 3), bool)
    if followed.orientations is not None:
        turned = np.isfinite(followed.orientations).all(axis=1) & aimed
    if followed.stiffness is not None:
        stiffened = np.isfinite(followed.stiffness) & aimed[:, None]
    return aimed, turned, stiffened
