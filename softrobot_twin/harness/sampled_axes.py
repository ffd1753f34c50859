"""What offline runs sample: the box of the actuators' bounds, and points in it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import NamedError
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.actuator_kinds import Quantity, column


class ActuationError(NamedError):
    """An actuation that an option gives does not fit the scene."""


class WorkspaceError(NamedError):
    """A scene has no workspace that can be sampled."""


class Axis(NamedTuple):
    """What one coordinate of a sample moves.

    Attributes:
        name: Name of the actuator, or of the motor of several cables.
        places: Places of the actuators, all of which it moves alike.
        least: Least displacement, or effort of what is driven by its effort.
        most: The greatest.
        rate: Its greatest change in a second; infinite without a limit.
    """

    name: str
    places: tuple[int, ...]
    least: float
    most: float
    rate: float


def sampled_axes(simulation: Simulation, ranges: Sequence[str] = ()) -> tuple[Axis, ...]:
    """The box of setpoints that is sampled.

    Args:
        simulation: The scene.
        ranges: Narrower or missing bounds in the form ``<column>=<low>:<high>``, with columns of a
            commands file.

    Returns:
        One axis for each actuator, and for each motor in place of its cables.

    Raises:
        ActuationError: A range does not fit the scene, or two move the same actuator.
        WorkspaceError: There is nothing to sample, or an actuator has no bounds.
    """
    low, high = simulation.limits.drive_min.copy(), simulation.limits.drive_max.copy()
    for places, bounds in column_drives(simulation, "--range", ranges, 2):
        low[places], high[places] = bounds
    axes = sorted(joint_axes(simulation, low, high), key=lambda axis: axis.places)
    for axis in (one for one in axes if not np.isfinite([one.least, one.most]).all()):
        section, quantity = simulation.actuators.kinds[axis.places[0]].section, driven_by(simulation, axis)
        end = "greatest" if np.isfinite(axis.least) else "least"
        raise WorkspaceError(
            simulation.scene.path,
            f"{section}: {axis.name} has no {end} {quantity.word} [{quantity.unit}]; name it in "
            f"the scene, or by --range {column(axis.name, quantity)}=LOW:HIGH",
        )  # fmt: skip
    if not axes:
        raise WorkspaceError(simulation.scene.path, "there are no actuators to sample")
    return tuple(axes)


def joint_axes(simulation: Simulation, low: np.ndarray, high: np.ndarray) -> list[Axis]:
    """What moves together: the cables of each motor, then each other actuator.

    Args:
        simulation: The scene.
        low: Least displacements, or efforts, shape (actuator_count,).
        high: The greatest ones.
    """
    names = list(simulation.actuators.names)
    groups = {motor: [names.index(cable) for cable in cables]
              for motor, cables in simulation.motors.items()}
    taken = {place for own in groups.values() for place in own}
    groups |= {name: [place] for place, name in enumerate(names) if place not in taken}
    rate = simulation.limits.drive_rate
    return [Axis(name, tuple(own), float(low[own].max()), float(high[own].min()),
                 float(rate[own].min())) for name, own in groups.items()]


def driven_by(simulation: Simulation, axis: Axis) -> Quantity:
    """The quantity whose limits are those of an axis, a displacement or an effort.

    Args:
        simulation: The scene.
        axis: One of its axes.
    """
    actuators = simulation.actuators
    return actuators.driven_quantities(actuators.is_effort_driven)[axis.places[0]]


def shifted_sobol(dimension: int, count: int, seed: int) -> np.ndarray:
    """Sobol's sequence, shifted by a random vector; more points begin with the same ones.

    Args:
        dimension: Number of coordinates.
        count: Number of points.
        seed: Seed of the shift.

    Returns:
        Points of the unit cube, shape (count, dimension).
    """
    from scipy.stats import qmc  # it loads slowly

    shift = np.random.default_rng(seed).random(dimension)
    exponent = max(1, math.ceil(math.log2(count + 1)))
    points = qmc.Sobol(dimension, scramble=False).random_base2(exponent)
    return (points[:count] + shift) % 1.0


def sampled_setpoints(simulation: Simulation, axes: Sequence[Axis], count: int, seed: int) -> np.ndarray:
    """Setpoints of the samples; more samples begin with the same ones.

    Args:
        simulation: The scene.
        axes: What is sampled.
        count: Number of samples, that at rest included.
        seed: Seed of the shift.

    Returns:
        Each in the unit of its kind, shape (count, actuator_count).
    """
    setpoints = np.tile(simulation.rest_setpoints, (count, 1))
    if count > 1:
        shares = shifted_sobol(len(axes), count - 1, seed)
        setpoints[1:] = setpoints_between(simulation, axes, shares)
    return setpoints


def setpoints_between(simulation: Simulation, axes: Sequence[Axis], shares: np.ndarray) -> np.ndarray:
    """Setpoints at shares of the axes of a box.

    Args:
        simulation: The simulation.
        axes: Of the box.
        shares: From 0 at the lower to 1 at the upper bound, shape (count, axis_count).

    Returns:
        Shape (count, actuator_count).
    """
    actuators = simulation.actuators
    drives = np.tile(actuators.drives(simulation.rest_setpoints), (len(shares), 1))
    for axis, share in zip(axes, shares.T, strict=True):
        drives[:, list(axis.places)] = (axis.least + share * (axis.most - axis.least))[:, None]
    return actuators.setpoints(drives)


_ENDS = "a number", "two numbers, LOW:HIGH"


def column_drives(
    simulation: Simulation, option: str, texts: Iterable[str], count: int = 1
) -> Iterator[tuple[list[int], list[float]]]:
    """The actuators that columns of a commands file drive, and what holds them at their values.

    Args:
        simulation: The scene.
        option: Option that has the texts.
        texts: Each ``<column>=<number>``, or ``<column>=<low>:<high>``.
        count: How many numbers each has.

    Yields:
        Places of the actuators, and increasing displacements or efforts; see `Actuators.drives`.

    Raises:
        ActuationError: A column is unknown or moves what another one moves, or the numbers are none,
            not finite or not in order.
    """
    columns, set_by = _actuator_column_places(simulation), dict[int, str]()
    for text in texts:
        named, _, ends = text.partition("=")
        given = f"{option} {text}"
        if named not in columns:
            raise ActuationError(given, f"is no column of {', '.join(columns)}")
        try:
            numbers = list(map(float, ends.split(":")))
            if len(numbers) != count:
                raise ValueError
        except ValueError:
            raise ActuationError(given, f"must end with {_ENDS[count - 1]}") from None
        if not np.isfinite(numbers).all() or numbers != sorted(numbers):
            raise ActuationError(given, f"must be finite{', the lower one first' * (count > 1)}")
        places, is_setpoint = columns[named]
        setpoints, drives = np.tile(simulation.rest_setpoints, (count, 1)), numbers
        if is_setpoint:
            setpoints[:, places] = np.array(numbers)[:, None]
            drives = simulation.actuators.drives(setpoints)[:, places[0]].tolist()
        for other in (set_by[place] for place in places if place in set_by):
            raise ActuationError(given, f"moves what {other} moves")
        set_by |= dict.fromkeys(places, text)
        yield places, sorted(drives)


def _actuator_column_places(simulation: Simulation) -> dict[str, tuple[list[int], bool]]:
    """Columns of a commands file: the actuators that each moves, and whether it is a setpoint."""
    actuators, columns = simulation.actuators, {}
    names = list(actuators.names)
    for place, (name, kind) in enumerate(actuators.kind_of.items()):
        if not kind.is_effort_driven:
            columns[column(name, kind.displacement)] = [place], False
        columns[column(name, kind.setpoint)] = [place], True
    for motor, cables in simulation.motors.items():
        columns[f"{motor}_shortening_m"] = [names.index(cable) for cable in cables], False
    return columns
