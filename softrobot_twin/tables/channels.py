"""Channels: the quantities of a robot, each said once for files, Python, records and ROS.

A channel is a quantity of all objects of a kind, such as the forces of touches. Tables of runs, results
in Python, records and topics are loops over channels. One that `register_channel` adds from outside is
a column of every run and a value of every result, a topic ``~/<name>/<object>`` of the twin, and a
quantity of records, which replays compare. Where it is measured too, the twin takes messages of it on
``~/measured_<name>/<object>``, and tells the newest measured numbers in records and their tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import starmap
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.simulation.building.actuator_kinds import Quantity, column
from softrobot_twin.simulation.building.sensor_kinds import ANGLE, FORCE, LENGTH, PRESSURE, VOLUME
from softrobot_twin.simulation.command import Command
from softrobot_twin.simulation.result import StepResult
from softrobot_twin.simulation.simulation import Simulation
from softrobot_twin.tables.column_names import (
    AXES,
    base_load_columns,
    displacement_columns,
    force_columns,
    force_deviation_columns,
    holds_column,
    place_columns,
    position_columns,
    quaternion_columns,
    reaction_columns,
    reaction_torque_columns,
    stiffness_columns,
    torque_columns,
)


NOT_UNIT = 1.0e-2
"""A quaternion that is off unit length by more is not rounded but a mistake."""


class Channel(NamedTuple):
    """A quantity of all objects of a kind.

    Attributes:
        name: Its name in records and among topics, such as ``touch_forces``.
        unit: Its unit; ``1`` without one.
        objects: Attribute of a simulation with the names of the objects, such as ``touch_names``.
        parts: Names of its numbers of an object, such as x, y and z.
        columns: Gives the columns of these numbers in files, by the name of the object.
        read: Gives the numbers of all objects in a result, shape (object_count, part_count); None
            in one that does not tell them.
        asked: Attribute of a simulation that tells which of the objects have it; empty for all.
        word: Of what may be wanted, for messages; empty for what only follows.
        target: Field of `FollowTargets` with what is wanted.
        python_name: End of the name of all numbers at once in Python.
        error: Field of a result with the errors, and the end of their column; empty without one.
        most: Greatest size of a measured number, in its unit; 0 where nothing is measured.
    """

    name: str
    unit: str
    objects: str
    parts: Sequence[str]
    columns: Callable[[str], Sequence[str]]
    read: Callable[[StepResult], np.ndarray | None]
    asked: str = ""
    word: str = ""
    target: str = ""
    python_name: str = ""
    error: tuple[str, str] = ("", "")
    most: float = 0.0

    @property
    def width(self) -> int:
        """How many numbers it has of an object."""
        return len(self.parts)

    @property
    def measured_name(self) -> str:
        """Name of its measured numbers in records and among topics."""
        return f"measured_{self.name}"

    def names(self, simulation: Simulation) -> Sequence[str]:
        """Names of the objects of its kind.

        Args:
            simulation: The simulation.
        """
        return getattr(simulation, self.objects)

    def are_asked(self, simulation: Simulation) -> Sequence[bool]:
        """Whether each of the objects has it.

        Args:
            simulation: The simulation.
        """
        return getattr(simulation, self.asked) if self.asked else [True] * len(self.names(simulation))

    def of(self, result: StepResult, index: int) -> Sequence[float] | np.ndarray:
        """Its numbers of an object in a result; NaN in one that does not tell them.

        Args:
            result: The result of a step.
            index: Number of the object.
        """
        values = self.read(result)
        return [math.nan] * self.width if values is None else values[index]

    def misfits(self, measured: Mapping[str, np.ndarray], result: StepResult) -> np.ndarray:
        """Measured numbers less those of a result, NaN where unknown, shape (object_count, width).

        None at all are known in a result that does not tell them.

        Args:
            measured: Measured numbers of all objects, by the channel's name.
            result: The result of a step.
        """
        values, known = self.read(result), measured.get(self.name)
        return np.empty((0, self.width)) if values is None or known is None else known - values

    def wanted(self, command: Command | None, count: int) -> np.ndarray:
        """Which numbers a command wants of the effectors that have a target position.

        Args:
            command: The command; only one that follows targets wants any.
            count: Number of effectors.

        Returns:
            Shape (effector_count, width).
        """
        values = getattr(command, self.target, None)
        if values is None:
            return np.zeros((count, self.width), bool)
        return np.isfinite(values) & np.isfinite(command.targets).all(axis=1)[:, None]


WANTED = (
    Channel("effector_positions", "m", "effector_names", AXES, position_columns,
            attrgetter("effector_positions"), "", "position", "targets", "",
            ("effector_errors", "error_m")),
    Channel("effector_orientations", "1", "effector_names", (*AXES, "w"), quaternion_columns,
            attrgetter("effector_orientations"), "oriented_effectors", "orientation", "orientations",
            "_quaternion", ("orientation_errors", "orientation_error_rad")),
    Channel("effector_stiffness", "N/m", "effector_names", AXES, stiffness_columns,
            attrgetter("effector_stiffness"), "stiff_effectors", "stiffness", "stiffness",
            "_stiffness_N_per_m"),
)  # fmt: skip
"""What may be wanted of effectors; they have target positions where they have any."""

FIGURES = Channel(
    "figures", "1", "figure_names", ("value",), lambda name: (name.replace(".", "_"),),
    lambda result: np.array([*result.report.figures.values()])[:, None]
    if result.report.figures else None)  # fmt: skip
"""What optional effects report of a step; their names tell the units."""


def _remembered(key: str, own: Any = np.s_[:, :3]) -> Callable[[StepResult], np.ndarray | None]:
    """Reads numbers of each object that a part remembers, such as `ObservedForces`, by their index."""
    def read(result: StepResult) -> np.ndarray | None:
        found = result.state.memory.get(key)
        return None if found is None else found[own]

    return read


BUILT_IN = (
    *WANTED,
    Channel("touch_forces", "N", "touch_names", AXES, force_columns,
            lambda result: result.touches and result.touches.forces),
    Channel("touch_displacements", "m", "touch_names", AXES, displacement_columns,
            lambda result: result.touches and result.touches.displacements),
    Channel("external_forces", "N", "observed_names", AXES, force_columns, _remembered("observer.wrenches")),
    Channel("external_force_deviations", "N", "observed_names", AXES, force_deviation_columns,
            _remembered("observer.deviations")),
    Channel("external_torques", "N m", "observed_names", AXES, torque_columns,
            _remembered("observer.wrenches", np.s_[:, 3:]), "observed_with_torque"),
    Channel("external_force_places", "m", "observed_names", AXES, place_columns,
            _remembered("observer.places")),
    FIGURES,
)  # fmt: skip
"""The channels of the package that have topics of their own, or a name in other records."""

_OTHERS = ("angles", "cables", "pressures")
"""Names of quantities whose measurements have messages of their own."""


def _of_sensors(quantity: Quantity, most: float) -> Channel:
    """What the sensors of one quantity show, and what is measured of them."""
    return Channel(
        f"sensor_{quantity.word}s", quantity.unit, f"{quantity.word}_sensors", (quantity.word,),
        lambda name: (column(name, quantity),),
        lambda result: result.state.memory.get(f"sensors.{quantity.word}"), most=most,
    )  # fmt: skip


REGISTERED_CHANNELS: list[Channel] = [
    Channel("reaction_forces", "N", "reaction_names", AXES, reaction_columns,
            _remembered("reactions.wrenches")),
    Channel("reaction_torques", "N m", "reaction_names", AXES, reaction_torque_columns,
            _remembered("reactions.wrenches", np.s_[:, 3:])),
    Channel("base_loads", "m/s2", "base_names", AXES, base_load_columns, _remembered("base.load")),
    Channel("grip_forces", "N", "grip_names", AXES, force_columns, _remembered("grips.forces")),
    Channel("grip_holds", "1", "grip_names", ("holds",), lambda name: (holds_column(name),),
            _remembered("grips.holds", np.s_[:, None])),
    *starmap(_of_sensors, ((LENGTH, 1e3), (ANGLE, 1e3), (VOLUME, 1e3), (PRESSURE, 1e9), (FORCE, 1e6))),
]  # fmt: skip


def channels() -> tuple[Channel, ...]:
    """All channels, in the order of their columns."""
    return (*BUILT_IN, *REGISTERED_CHANNELS)


def registered() -> tuple[Channel, ...]:
    """Those whose topics, records and measurements are loops over channels."""
    return tuple(REGISTERED_CHANNELS)


def measured() -> tuple[Channel, ...]:
    """Those of them that are measured."""
    return tuple(one for one in REGISTERED_CHANNELS if one.most)


def register_channel(channel: Channel) -> None:
    """Adds a channel, before what shows it is built.

    Args:
        channel: The channel.

    Raises:
        ValueError: There is one of this name, or it is that of messages of the twin.
    """
    if channel.name in _OTHERS or any(one.name == channel.name for one in channels()):
        raise ValueError(f"there is a channel {channel.name} already")
    REGISTERED_CHANNELS.append(channel)
