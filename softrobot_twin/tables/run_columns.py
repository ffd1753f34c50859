"""The columns of what runs write, in one order for all runs however they are driven.

Each column is there only where the scene or the run has what it tells: contacts, targets, reduced
bodies. Names are those of `column_names`, so that a run's file can be given back as input.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np

from softrobot_twin.analysis.reduction_error import ReductionStates, has_spare_modes
from softrobot_twin.simulation import appearance
from softrobot_twin.simulation.building.actuator_kinds import ActuatorKind, Quantity, column
from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.building.limits import ANGLE, TORQUE
from softrobot_twin.simulation.command import Command, FollowTargets
from softrobot_twin.simulation.effects.trusted_ranges import reduced_bodies
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.tables.channels import Channel, channels
from softrobot_twin.tables.column_names import (
    DRIVEN_BY,
    STATUS,
    STEP,
    TIME,
    body_name,
    position_columns,
    quaternion_columns,
    target_column,
    target_name,
)

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


class Cells(NamedTuple):
    """Columns that stand beside each other, and their values.

    Attributes:
        names: Their names.
        values: Gives the value of each in a row.
    """

    names: Sequence[str]
    values: Callable[[RunRow], Iterable]


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
        for quantity in _readings(kind)
    ] + [(name, quantity) for name in actuators.pulleys.names for quantity in (ANGLE, TORQUE)]


def _readings(kind: ActuatorKind) -> dict[Quantity, str]:
    """Quantities of an actuator in a file, and which values of a result each of them has."""
    if kind.is_effort_driven:  # The setpoint is the effort, and 0 at rest.
        return {kind.setpoint: "setpoints", kind.displacement: "displacements", kind.extent: "extents"}
    readings = {kind.setpoint: "setpoints", kind.effort: "efforts"}
    if kind.displacement != kind.setpoint:  # Else it is 0 at rest.
        rest = Quantity(f"rest_{kind.setpoint.word}", kind.setpoint.unit)
        readings |= {kind.displacement: "displacements", rest: "rest"}
        if kind.one_sided:
            readings[PATH] = "paths"
    return readings


def actuator_cells(result: StepResult, actuators: Actuators) -> list[float]:
    """Values of the columns about actuators; see `actuator_columns`.

    Args:
        result: Result of a step.
        actuators: The actuators of the scene.
    """
    paths = actuators.path_lengths(result.state.positions)
    values = {
        "setpoints": result.setpoints, "efforts": actuators.told_efforts(result.efforts),
        "displacements": result.displacements, "rest": actuators.rest_setpoints,
        "extents": actuators.extents(result.displacements),
        "paths": [paths.get(name, math.nan) for name in actuators.names],
    }  # fmt: skip
    cells = [values[reading][index] for index, kind in enumerate(actuators.kinds)
             for reading in _readings(kind).values()]  # fmt: skip
    pulleys = actuators.pulleys
    turned = np.stack([pulleys.angles(result.setpoints), pulleys.torques(result.efforts)], axis=1)
    return [*cells, *turned.ravel()]


def rigid_poses(simulation: Simulation, positions: np.ndarray | None = None) -> np.ndarray:
    """Origin [m] and quaternion x, y, z, w of each rigid body, shape (rigid_body_count, 7).

    Args:
        simulation: The scene.
        positions: Node positions [m], shape (node_count, 3); None for the present ones.
    """
    positions = simulation.state.positions if positions is None else positions
    return np.hstack(appearance.rigid_poses(simulation.model, positions))


def pair_names(simulation: Simulation) -> tuple[tuple[str, str], ...]:
    """Names of the pairs that may touch, each pair once.

    Args:
        simulation: The simulation.
    """
    if not simulation.model.contacts:
        return ()
    return tuple(dict.fromkeys(tuple(pair.names) for pair in simulation.model.contacts.pairs))


def magnitude_column(pair: tuple[str, str]) -> str:
    """Column of how hard two bodies press on each other [N].

    Args:
        pair: Names of the two bodies.
    """
    return f"sum_of_magnitudes_{pair[0]}_{pair[1]}_N"


class RunColumns:
    """The columns of a run, and their values in its steps.

    Attributes:
        names: The columns, in their order.
        reduction: Tells how far reduced bodies can be believed.
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
        self._simulation, model = simulation, simulation.model
        self._pairs = pair_names(simulation)
        self._judged, self.reduction = tuple[str, ...](), ReductionStates(simulation)
        if with_reduction_errors and has_spare_modes(model):
            self._judged = tuple(body.name for body in reduced_bodies(model))
        self._parts = [
            Cells((STEP, TIME), lambda row: (row.step, row.time)),
            *self._of_channels("effector_names", followed),
            Cells([column(*one) for one in actuator_columns(simulation.actuators)],
                  lambda row: actuator_cells(row.result, simulation.actuators)),
            self._of_bodies(), *self._of_sensor_targets(followed),
            *(cells for kind in dict.fromkeys(one.objects for one in channels())
              if kind != "effector_names" for cells in self._of_channels(kind)),
            self._of_markers(),
            Cells(observed, lambda row: map(float, row.observed)),
            *self._of_contacts(), *self._of_steps(),
        ]  # fmt: skip
        self.names = tuple(name for part in self._parts for name in part.names)

    def _of_channels(self, kind: str, followed: Command | None = None) -> Iterator[Cells]:
        """What is told of each object of a kind, what a command wants of it, and how far off it is.

        Args:
            kind: Attribute of a simulation with the names of the objects.
            followed: The command.
        """
        simulation = self._simulation
        names = getattr(simulation, kind)
        own = [(one, one.are_asked(simulation), one.wanted(followed, len(names)))
               for one in channels() if one.objects == kind]
        for i, name in enumerate(names):
            for one, asked, _ in own:
                if asked[i]:
                    yield Cells(one.columns(name), lambda row, one=one, i=i: one.of(row.result, i))
            own_wanted = [(one, wanted[i]) for one, _, wanted in own if wanted[i].any()]
            for one, wanted in own_wanted:
                yield Cells(list(compress(one.columns(target_name(name)), wanted)),
                            lambda row, one=one, at=(i, wanted): _asked(row, one)[at])
            for one, _ in own_wanted:
                field, end = one.error
                if field:
                    yield Cells([f"{name}_{end}"],
                                lambda row, field=field, i=i: [getattr(row.result, field)[i]])

    def _of_sensor_targets(self, followed: Command | None) -> Iterator[Cells]:
        """What a command wants of sensors."""
        wanted = getattr(followed, "sensors", None)
        for i, (own, name) in enumerate(self._simulation.sensor_columns.items()):
            if wanted is not None and np.isfinite(wanted[i]):
                yield Cells([target_column(name, own)], lambda row, i=i: [row.command.sensors[i]])

    def _of_bodies(self) -> Cells:
        """Poses of rigid bodies."""
        simulation = self._simulation
        names = [body_name(name, simulation.effector_names) for name in simulation.rigid_names]
        poses = [(*position_columns(name), *quaternion_columns(name)) for name in names]
        return Cells(sum(poses, ()), lambda row: row.rigid_poses.ravel())

    def _of_markers(self) -> Cells:
        """Where the cameras see the markers, as `calibrate` reads them, and the effectors if their frame is another."""
        simulation, frame = self._simulation, self._simulation.scene.marker_frame
        seen = [] if frame.is_usual else simulation.effector_names
        names = [f"marker_{one}" for one in simulation.marker_ids] + [f"{one}_by_cameras" for one in seen]
        return Cells([axis for name in names for axis in position_columns(name)], lambda row: frame.of_cameras(
            np.vstack([simulation.marker_positions(), row.result.effector_positions[:len(seen)]])).ravel())  # fmt: skip

    def _of_contacts(self) -> Iterator[Cells]:
        if not self._pairs:
            return
        yield Cells(["contact_count"], lambda row: [row.result.report.contact_count])
        for k, pair in enumerate(self._pairs):
            forces = [f"force_on_{pair[0]}_by_{pair[1]}_{axis}_N" for axis in "xyz"]
            yield Cells([*forces, magnitude_column(pair)],
                        lambda row, k=k: (*row.pair_resultants[k], row.pair_magnitude_sums[k]))  # fmt: skip
        yield _reported("contact_residual_m", "contact_residual")

    def _of_steps(self) -> Iterator[Cells]:
        yield _reported("residual_N", "residual")
        if self._simulation.effector_names:
            yield _reported("linearization_error_m", "linearization_error")
        if self._simulation.has_reduced_bodies or self._simulation.model.superelements:
            yield _reported("sampled_range", "sampled_range")
        yield Cells([f"{name}_reduction_error_m" for name in self._judged],
                    lambda row: map(float, row.reduction_errors))  # fmt: skip
        yield Cells(["iterations"], lambda row: [row.result.report.iterations])
        yield _reported(COMPUTE_TIME, "compute_time")
        yield Cells(TEXT_COLUMNS, lambda row: (
            " ".join(row.result.report.active_limits), row.result.report.driven_by,
            row.result.status.value))  # fmt: skip

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
        states = self.reduction.read() if self._judged else {}
        errors = tuple(states[name].error for name in self._judged)
        poses = rigid_poses(self._simulation, result.state.positions)
        return RunRow(step, time, result, command, poses, resultants, sums, errors, observed)

    def cells(self, row: RunRow) -> list[int | float | str]:
        """Values of the columns, in their order.

        Args:
            row: The row.
        """
        cells = (cell for part in self._parts for cell in part.values(row))
        return [cell.item() if isinstance(cell, np.generic) else cell for cell in cells]

    def texts(self, row: RunRow) -> list[str]:
        """Cells of a row of a file; numbers are given to the last bit.

        Args:
            row: The row.
        """
        return [repr(cell) if isinstance(cell, float) else str(cell) for cell in self.cells(row)]


def _reported(name: str, field: str) -> Cells:
    """A column of a number of the report of a step."""
    return Cells([name], lambda row: [float(getattr(row.result.report, field))])


def _asked(row: RunRow, channel: Channel) -> np.ndarray:
    """What the targets of a row want of the effectors."""
    assert isinstance(row.command, FollowTargets), "a run that follows targets tells each of them"
    return np.asarray(getattr(row.command, channel.target), float)
