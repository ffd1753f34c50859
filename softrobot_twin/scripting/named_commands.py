"""Commands by names and units, as in the columns of a commands file, and their reading for a scene.

`targets`, `setpoints`, `efforts` and `hold` know no robot: they check numbers and shapes. A
`CommandReader` knows the names of one scene, and makes the arrays of a `Command`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import compress
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from softrobot_twin.errors import CommandError
from softrobot_twin.scene.refusal_messages import nearest
from softrobot_twin.simulation import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    Touched,
)
from softrobot_twin.simulation.building.actuator_kinds import column
from softrobot_twin.simulation.command import EFFORTS, SETPOINTS
from softrobot_twin.tables.channels import NOT_UNIT, WANTED, Channel
from softrobot_twin.tables.input_tables import as_given, drives_of, real_array

Numbers: TypeAlias = tuple[float, ...]
Aim: TypeAlias = tuple[np.ndarray, np.ndarray | None]
"""Where a guided body goes: position [m] and quaternion, None for that at rest."""
NOTHING: Mapping[str, Numbers] = MappingProxyType({})

# Names in a message, at most.
_MOST_NAMES = 16
# Ends of the names that targets take for an effector: all numbers at once, and one by one.
_PARTS = {channel.python_name: channel for channel in WANTED}


@dataclass(frozen=True, repr=False)
class NamedCommand:
    """What a step is asked for, by names.

    Attributes:
        values: The numbers by their names, such as ``tip`` or ``north_shortening_m``.
    """

    values: Mapping[str, Numbers] = field(default_factory=lambda: NOTHING)

    def __repr__(self) -> str:
        word = type(self).__name__.lower()
        given = (f"{name}={_shown(numbers)}" for name, numbers in self.values.items())
        return f"{word}({', '.join(given)})"

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuilt, (type(self), dict(self.values))


class Targets(NamedCommand):
    """Effectors follow targets; see `targets`."""


class Setpoints(NamedCommand):
    """Actuators go to setpoints; see `setpoints`."""


class Efforts(NamedCommand):
    """Actuators act with efforts; see `efforts`."""


class HoldAll(NamedCommand):
    """Actuators keep their setpoints; see `hold`."""

    def __repr__(self) -> str:
        return "hold()"


def targets(positions: Mapping[str, Any] | None = None, /, **named: Any) -> Targets:
    """Where effectors shall go: the step finds the actuation, by the inverse problem.

    An effector without a target is free, and actuators without a command are optimised.

    Args:
        positions: The same as the keywords, as a mapping.
        **named: By name, all in SI units:

            - ``tip=[x, y, z]``: position of the effector ``tip`` [m];
            - ``tip_quaternion=[qx, qy, qz, qw]``: its turn from rest, if it asks for orientation;
            - ``tip_stiffness_N_per_m=[kx, ky, kz]``: its stiffness, None along a free axis;
            - ``spine_length_m=0.1``: a sensor with a weight, by its column;
            - ``north_shortening_m=0.01`` and all names of `setpoints`: an actuator that is
              commanded while the others are optimised around it.

    Raises:
        CommandError: Nothing is named, or a value is not a finite number or has another shape.
    """
    return Targets(_numbers_of("targets", positions, named, may_be_free="stiffness"))


def setpoints(values: Mapping[str, Any] | None = None, /, **named: Any) -> Setpoints:
    """Setpoints of actuators: lengths, pressures, positions. The others keep theirs.

    Args:
        values: The same as the keywords, as a mapping.
        **named: As in a commands file, such as ``north_shortening_m=0.01``,
            ``north_length_m=0.09``, ``left_pressure_Pa=20e3``; names of motors and pulleys too.

    Raises:
        CommandError: Nothing is named, or a value is not a finite number.
    """
    return Setpoints(_numbers_of("setpoints", values, named))


def efforts(values: Mapping[str, Any] | None = None, /, **named: Any) -> Efforts:
    """Efforts of actuators: tensions, pressures, torques. The others hold their setpoints.

    Args:
        values: The same as the keywords, as a mapping.
        **named: As in a commands file, such as ``north_tension_N=2.0``.

    Raises:
        CommandError: Nothing is named, or a value is not a finite number.
    """
    return Efforts(_numbers_of("efforts", values, named))


def hold() -> HoldAll:
    """All actuators keep their setpoints while the bodies settle."""
    return HoldAll()


def _rebuilt(kind: type[NamedCommand], values: dict[str, Numbers]) -> NamedCommand:
    return kind(MappingProxyType(values))


def _shown(numbers: Numbers) -> str:
    texts = [f"{number:.6g}" for number in numbers]
    return texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"


def _numbers_of(
    word: str, first: Mapping[str, Any] | None, named: Mapping[str, Any], may_be_free: str = ""
) -> Mapping[str, Numbers]:
    """Checked numbers of all names, those of the mapping first."""
    if first is not None:
        check_given(word, first, Mapping, "names, such as tip=[0, 0, 0.1]")
    given = dict(first or {})
    for twice in (name for name in named if name in given):
        raise CommandError(twice, "is given twice")
    given.update(named)
    if not given:
        raise CommandError(word, "names nothing; hold() keeps all actuators where they are")
    return MappingProxyType({
        str(name): finite_numbers(str(name), value, bool(may_be_free) and may_be_free in str(name))
        for name, value in given.items()})


def finite_numbers(name: str, value: Any, may_be_free: bool = False) -> Numbers:
    """A number or a list of them.

    Args:
        name: For messages.
        value: The value.
        may_be_free: Whether None is allowed in a list; it becomes NaN.

    Raises:
        CommandError: It is no finite number, or no list of them.
    """
    try:
        given = np.atleast_1d(as_given(value))
        numbers = real_array(given)
        if numbers.ndim > 1:
            raise TypeError
    except (TypeError, ValueError, OverflowError):
        reason = f"must be a number or a list of numbers, not {_kind(value)}"
        raise CommandError(name, reason) from None
    free = np.array([may_be_free and one is None for one in given], bool)
    for bad in numbers[~(np.isfinite(numbers) | free)]:
        raise CommandError(name, f"holds {bad}, which is not finite")
    return tuple(numbers.tolist())


def _checked(channel: Channel, name: str, numbers: Numbers) -> np.ndarray:
    """What is wanted of an effector as an array; a turn of unit length."""
    wanted = np.array(numbers)
    if channel.word == "orientation":
        if abs(np.linalg.norm(wanted) - 1.0) > NOT_UNIT:
            raise CommandError(name, f"{_shown(numbers)} is not of unit length")
        wanted /= np.linalg.norm(wanted)
    if channel.word == "stiffness" and (wanted <= 0.0).any():
        raise CommandError(name, f"{_shown(numbers)} N/m must be positive")
    return wanted


def check_given(word: str, given: Any, kind: Any, what: str) -> None:
    """Refuses what is of another kind.

    Args:
        word: Name of the argument, for the error.
        given: What is given.
        kind: What it must be.
        what: The same in words.

    Raises:
        CommandError: It is something else.
    """
    if not isinstance(given, kind) or isinstance(given, np.ndarray) and not given.ndim:
        raise CommandError(word, f"takes {what}, not {_kind(given)}")


def _kind(value: Any) -> str:
    is_array = isinstance(value, np.ndarray) and value.ndim
    return f"an array of shape {value.shape}" if is_array else f"{value!r:.60}"


class CommandReader:
    """Reads named commands for one simulation.

    Attributes:
        drives: What actuators, motors and pulleys are commanded by, by its name.
    """

    def __init__(self, simulation: Simulation):
        """Collect the names.

        Args:
            simulation: The simulation.
        """
        self._simulation = simulation
        self._effectors = {name: i for i, name in enumerate(simulation.effector_names)}
        self.drives = {one.name: one for one in drives_of(simulation)
                       if SETPOINTS in one.gives or one.kind.takes_efforts}  # fmt: skip

    @property
    def setpoint_names(self) -> tuple[str, ...]:
        """Names that `setpoints` takes."""
        return tuple(name for name, one in self.drives.items() if SETPOINTS in one.gives)

    @property
    def effort_names(self) -> tuple[str, ...]:
        """Names that `efforts` takes."""
        return tuple(name for name, one in self.drives.items() if EFFORTS in one.gives)

    @property
    def target_names(self) -> tuple[str, ...]:
        """Names of effectors that `targets` takes, each with what else it asks for."""
        simulation = self._simulation
        asked = {part: channel.are_asked(simulation) for part, channel in _PARTS.items()}
        names = [f"{name}{part}" for name, place in self._effectors.items()
                 for part in _PARTS if asked[part][place]]  # fmt: skip
        return *names, *simulation.sensor_columns

    def read(self, command: NamedCommand | Command, time_step: float) -> Command:
        """The command as arrays of the scene.

        Args:
            command: By names, or in arrays already.
            time_step: Duration of the step [s].

        Raises:
            CommandError: A name is unknown, or a value does not fit it.
        """
        if isinstance(command, Targets):
            return self._targets(command.values, time_step)
        if isinstance(command, Setpoints):
            return CommandSetpoints(self._setpoints(command.values, "setpoints"), time_step)
        if isinstance(command, Efforts):
            return CommandEfforts(self._efforts(command.values), time_step)
        if isinstance(command, HoldAll):
            return Hold(time_step)
        if isinstance(command, Command):
            return command
        raise CommandError(_kind(command), "is no command: use targets(...), setpoints(...), "
                           "efforts(...) or hold()")

    # --- actuators -------------------------------------------------------------------------------

    def _setpoints(self, values: Mapping[str, Numbers], word: str) -> np.ndarray:
        """Setpoints, the present ones where none is given."""
        wanted = self._simulation.state.setpoints.copy()
        for place, number in self._driven(values, word, self.setpoint_names):
            wanted[place] = number
        return wanted

    def _efforts(self, values: Mapping[str, Numbers]) -> np.ndarray:
        """Efforts, NaN where none is given."""
        actuators = self._simulation.actuators
        told = np.full(actuators.count, np.nan)
        for place, number in self._driven(values, "efforts", self.effort_names):
            told[place] = number
        return actuators.efforts(told)

    def _driven(
        self, values: Mapping[str, Numbers], word: str, allowed: tuple[str, ...]
    ) -> Iterator[tuple[int, float]]:
        """Each driven actuator, and its setpoint or effort, as it is told."""
        actuators, driven_by = self._simulation.actuators, dict[int, str]()
        for name, numbers in values.items():
            drive = self.drives.get(name)
            if drive is None or name not in allowed:
                raise self._refused(name, word, allowed)
            number = one_number(name, numbers)
            if reason := drive.impossible(number):
                raise CommandError(name, f"{number:g} {drive.quantity.unit} {reason}")
            for place, told in drive.told(number):
                if place in driven_by:
                    raise CommandError(name, f"drives {actuators.names[place]}, as {driven_by[place]} does")
                driven_by[place] = name
                yield place, told

    def _refused(self, name: str, word: str, allowed: tuple[str, ...]) -> CommandError:
        simulation = self._simulation
        if name in self.drives:
            other = "setpoints" if word == "efforts" else "efforts"
            return CommandError(name, f"is no name of {word}(...); use {other}({name}=...)")
        if name in simulation.effector_names:
            return CommandError(name, f"is an effector: use targets({name}=[x, y, z])")
        if name in simulation.guided_names:
            return CommandError(name, f"is a guided body: use poses={{{name!r}: [x, y, z]}}")
        for actuator, kind in simulation.actuators.kind_of.items():
            follows = column(actuator, kind.displacement)
            if kind.is_effort_driven and name == follows:
                return CommandError(name, f"follows from the {kind.effort.word}: use "
                                    f"{column(actuator, kind.setpoint)}")
            if name == column(actuator, kind.effort):
                return CommandError(name, f"a {kind.noun} is not driven by its {kind.effort.word}")
        return unknown(name, f"{simulation.scene.name} takes", allowed)

    # --- effectors -------------------------------------------------------------------------------

    def _targets(self, values: Mapping[str, Numbers], time_step: float) -> FollowTargets:
        simulation, count = self._simulation, len(self._effectors)
        columns = simulation.sensor_columns
        sensors = np.array([one_number(own, values[own]) if own in values else np.nan for own in columns])
        values = {name: numbers for name, numbers in values.items() if name not in columns}
        forms = {f"{name}{part}": (name, part) for name in self._effectors for part in _PARTS}
        positions, turns, stiffness = wanted = [
            np.full((count, channel.width), np.nan) for channel in WANTED]
        commanded = dict[str, Numbers]()
        for name, numbers in values.items():
            if name not in forms:
                if name not in self.drives:
                    raise self._refused(name, "targets", self.target_names + self.setpoint_names)
                commanded[name] = numbers
                continue
            effector, part = forms[name]
            channel, place = _PARTS[part], self._effectors[effector]
            if len(numbers) != channel.width:
                raise CommandError(name, f"must be {channel.width} numbers, not {len(numbers)}")
            self._needs(channel, place, name)
            wanted[WANTED.index(channel)][place] = _checked(channel, name, numbers)
        kept = None
        if commanded:
            kept = np.full(simulation.actuators.count, np.nan)
            for place, number in self._driven(commanded, "setpoints", self.setpoint_names):
                kept[place] = number
        return FollowTargets(
            positions, time_step, kept,
            turns if np.isfinite(turns).any() else None,
            # An effector that the command does not name keeps the stiffness that the scene asks.
            np.where(np.isfinite(stiffness).any(axis=1)[:, None], stiffness,
                     simulation.scene_stiffness) if np.isfinite(stiffness).any() else None,
            sensors=sensors if np.isfinite(sensors).any() else None,
        )  # fmt: skip

    def _needs(self, channel: Channel, place: int, name: str) -> None:
        asks = channel.are_asked(self._simulation)
        if not asks[place]:
            names = ", ".join(compress(self._effectors, asks)) or "none"
            raise CommandError(name, f"the effector asks for no {channel.word} in the scene; those "
                               f"with one: {names}")

    # --- guided bodies and touches ---------------------------------------------------------------

    def poses(self, poses: Mapping[str, Any]) -> dict[str, Aim]:
        """Position [m] and quaternion of each pose; checked before any of them is used.

        Args:
            poses: By name of a guided body: a position, or a pair of position and quaternion.

        Raises:
            CommandError: A body is not guided, or a pose is not one.
        """
        guided, read = self._simulation.guided_names, dict[str, Aim]()
        check_given("poses", poses, Mapping, "names, such as palm=[0, 0, 0.1]")
        for name, pose in poses.items():
            read[guided[place_of(name, "guided bodies:", guided)]] = read_pose(name, pose)
        return read

    def touches(self, touches: Mapping[str, Any]) -> Touched | None:
        """The touches of a step; None without any.

        Args:
            touches: By name and unit: ``fingertip_force_N``, ``fingertip_displacement_m`` from
                where its touch began, or ``fingertip_place_m``, each 3 numbers.

        Raises:
            CommandError: A name is unknown, or a value is not 3 finite numbers.
        """
        check_given("touches", touches, Mapping, "names, such as fingertip_force_N=[0, 0, -1]")
        before, names = self._simulation.touches, self._simulation.touch_names
        known = {f"{name}_{word}": (index, word) for index, name in enumerate(names)
                 for word in ("force_N", "displacement_m", "place_m")}
        if not touches:
            return None
        touched = Touched.none(len(names))
        for name, value in touches.items():
            if name not in known or before is None:
                raise unknown(name, "touches:", tuple(known))
            index, word = known[name]
            numbers = array_of(name, value, (3,))
            if np.isfinite([one[index] for one in touched]).any():
                raise CommandError(name, f"{names[index]} is given twice: give one of force, "
                                   "displacement and place")
            if word == "force_N":
                touched.forces[index] = numbers
            elif word == "place_m":
                touched.places[index] = numbers
            else:
                touched.displace(index, numbers, before)
        return touched

    def markers(self, markers: Any) -> np.ndarray:
        """Measured places of all markers [m], NaN where hidden, shape (marker_count, 3).

        Args:
            markers: By marker id, or an array of this shape.

        Raises:
            CommandError: A marker is unknown, or a value does not fit it.
        """
        ids = [str(one) for one in self._simulation.marker_ids]
        places = np.full((len(ids), 3), np.nan)
        if not isinstance(markers, Mapping):
            return array_of("markers", markers, places.shape, may_be_open=True)
        for marker, place in markers.items():
            places[place_of(marker, "markers:", ids)] = array_of(f"marker {marker}", place, (3,), may_be_open=True)
        return places


def array_of(name: str, value: Any, shape: tuple[int, ...], may_be_open: bool = False) -> np.ndarray:
    """Numbers as an array.

    Args:
        name: Name of the value, for the error.
        value: The value.
        shape: The shape that it must have.
        may_be_open: Whether numbers may be NaN or infinite.

    Raises:
        CommandError: It is no array of numbers of this shape.
    """
    with suppress(TypeError, ValueError, OverflowError):
        array = real_array(value)
        if array.shape == shape and (may_be_open or np.isfinite(array).all()):
            return array
    what = f"{shape[0]} numbers" if len(shape) == 1 else f"{'' if may_be_open else 'finite '}numbers of shape {shape}"
    raise CommandError(name, f"must be {what}, not {_kind(value)}")


def read_pose(name: str, pose: Any) -> Aim:
    """Position [m] and quaternion of a pose, None where it gives no rotation.

    Args:
        name: Whose pose it is.
        pose: A position, or a pair of position and quaternion.

    Raises:
        CommandError: It is no pose.
    """
    position, quaternion = pose, None
    if isinstance(pose, Sequence) and len(pose) == 2:
        position, quaternion = pose
    point = np.array(finite_numbers(name, position))
    if point.shape != (3,):
        raise CommandError(name, "a pose is a position of 3 numbers [m], or the pair of a "
                           "position and a quaternion (qx, qy, qz, qw)")
    turn = None
    if quaternion is not None:
        turn = np.array(finite_numbers(name, quaternion))
        if turn.shape != (4,) or abs(np.linalg.norm(turn) - 1.0) > NOT_UNIT:
            raise CommandError(name, f"{_shown(tuple(turn))} is no quaternion (qx, qy, qz, "
                               "qw) of unit length")
    return point, turn


def unknown(name: str, known_as: str, known: Sequence[str]) -> CommandError:
    """The error about an unknown name, with the nearest known one.

    Args:
        name: The name.
        known_as: Begin of the list of what is known.
        known: The known names.
    """
    listed = ", ".join(known[:_MOST_NAMES]) or "none"
    more = len(known) - _MOST_NAMES
    listed += f" and {more} more" if more > 0 else ""
    hint = nearest(name, known) or ";"
    return CommandError(name, f"is unknown here{hint} {known_as} {listed}")


def place_of(name: Any, known_as: str, known: Sequence[str]) -> int:
    """Place of a name among those that are known.

    Args:
        name: The name.
        known_as: See `unknown`.
        known: The known names.

    Raises:
        CommandError: It is unknown.
    """
    if str(name) not in known:
        raise unknown(str(name), known_as, known)
    return known.index(str(name))


def one_number(name: str, value: Any) -> float:
    """A number.

    Args:
        name: Name of the value, for the error.
        value: The value.

    Raises:
        CommandError: It is no finite number, or there are several.
    """
    numbers = finite_numbers(name, value)
    if len(numbers) != 1:
        raise CommandError(name, f"must be one number, not {len(numbers)}")
    return numbers[0]


def positive_number(name: str, value: Any, unit: str = "") -> float:
    """A number above zero.

    Args:
        name: Name of the value, for the error.
        value: The value.
        unit: Its unit.

    Raises:
        CommandError: It is no finite number above zero.
    """
    number = one_number(name, value)
    if number <= 0.0:
        raise CommandError(name, f"{value} {unit}".rstrip() + " must be above 0")
    return number


def whole_number(name: str, value: Any, least: int = 1, most: int = 10**9, more: str = "") -> int:
    """A whole number.

    Args:
        name: Name of the value, for the error.
        value: The value.
        least: Least value.
        most: Greatest value.
        more: What else is possible, for the error.

    Raises:
        CommandError: It is no whole number, or out of range.
    """
    with suppress(TypeError, ValueError, OverflowError):
        if np.ndim(real_array(value)) == 0 and least <= value <= most and not value % 1:
            return int(value)
    raise CommandError(name, f"{value!r:.60} must be a whole number from {least:,} to {most:,}{more}")
