"""Reads the CSV files of offline runs: a targets file or a commands file.

A targets file has one row per step, with targets of effectors, setpoints or efforts of actuators. A
commands file has rows at increasing times, with commands of actuators and guided bodies that are
interpolated. A table may mix lengths of cables with pressures of cavities: all columns are
setpoints if each is what that actuator's setpoint holds, and efforts if each is that actuator's
effort. Actuators without a column hold their setpoints.

Both have the columns of `column_names`. What a run wrote can be given back as either: the columns
that drove it are read, the others are results and are left out.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from itertools import compress
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from softrobot_twin.errors import NamedError, SoftRobotTwinError
from softrobot_twin.scene.refusal_messages import nearest
from softrobot_twin.simulation import Hold, Simulation, Touched
from softrobot_twin.simulation.building.actuator_kinds import ActuatorKind, Quantity, actuator_kinds, column
from softrobot_twin.simulation.building.actuators import Actuators
from softrobot_twin.simulation.building.limits import ANGLE
from softrobot_twin.simulation.command import (
    DEFAULT_TIME_STEP,
    EFFORTS,
    HOLD,
    SETPOINTS,
    TARGETS,
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
)
from softrobot_twin.tables.channels import NOT_UNIT, WANTED, Channel
from softrobot_twin.tables.column_names import (
    DRIVEN_BY,
    TIME,
    body_name,
    displacement_columns,
    force_columns,
    holds_column,
    is_output,
    position_columns,
    quaternion_columns,
    target_column,
    target_name,
    unit_of,
)


class TableFileError(SoftRobotTwinError):
    """A file of targets or commands cannot be run.

    Attributes:
        path: The file.
        row: Line of the file, counted from 1, or None for the whole file.
        column: Name of the column, or an empty string.
        value: Content of the cell, or None.
        unit: Unit the value is read in, or an empty string.
        reason: What is required.
        what: The message without the file.
    """

    def __init__(self, path: Path, reason: str, row: int | None = None, column: str = "",
                 value: object = None, unit: str = ""):
        self.path = path
        self.row = row
        self.column = column
        self.value = value
        self.unit = unit
        self.reason = reason
        place = "" if row is None else f"row {row}"
        stated = "" if value is None else f" = {value!r} {unit}".rstrip()
        named = f": {column}{stated}" if column else ""
        told = f"{named}: {reason}"
        self.what = f"{place}{told}".removeprefix(": ")
        super().__init__(f"{path}{place and ', '}{place}{told}")


def real_array(value: Any) -> np.ndarray:
    """Numbers that Python code gives as an array of floats, NaN for None.

    Args:
        value: A number, an array or lists of them.

    Raises:
        TypeError: Others are among them: texts, dates, truth values, complex or masked numbers.
    """
    given = as_given(value)
    if given.dtype.kind in "iuf" and not np.ma.is_masked(given):
        return np.array(given, float)
    return np.array([np.nan if one is None else _real(one) for one in np.ravel(given)]).reshape(given.shape)


def as_given(value: Any) -> np.ndarray:
    """An array in which each value is still what it was: a list of all kinds becomes one of objects.

    Args:
        value: A value, an array or lists.
    """
    return np.asanyarray(value, None if hasattr(value, "__array__") else object)


def _real(value: Any) -> float:
    if hasattr(value, "__array__") and not isinstance(value, Real):
        value = np.asanyarray(value)[()]
    if not isinstance(value, Real | Decimal) or isinstance(value, bool | np.timedelta64):
        raise TypeError(f"{value!r:.60} is no number")
    return float(value)


def read_cells(path: Path, example: str) -> tuple[list[str], list[int], list[list[str]]]:
    """Reads a CSV file as text.

    Args:
        path: The file.
        example: A valid header, for the message about an empty file.

    Returns:
        Header, line number of each row, and the rows' cells.

    Raises:
        TableFileError: The file cannot be read, or has no header or no row.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise TableFileError(path, f"cannot be read as CSV text: {reason}") from error
    rows = [(line, row) for line, row in rows if any(row)]
    if not rows:
        raise TableFileError(path, f"is empty; a header such as {example} is required")
    first = rows[0][1]
    separator = next((mark for mark in ";\t" if len(first) == 1 and mark in first[0]), None)
    if separator:
        raise TableFileError(path, f"cells must be separated by commas, not by {separator!r}", 1)
    if len(rows) == 1:
        raise TableFileError(path, "has a header but no row of values")
    (_, header), *body = rows
    return header, [line for line, _ in body], [row for _, row in body]


class Columns:
    """The columns of a file or a table, which readers take out by name.

    Attributes:
        source: The file; of a table its name.
        lines: Line of each row in the file.
        is_output: Whether a run wrote it.
        taken: Values of the columns that were taken out, by name.
    """

    def __init__(self, source: Path, header: Sequence[str], lines: Sequence[int],
                 cells: Sequence[Sequence[object]]):
        """Stores the rows.

        Args:
            source: The file.
            header: Name of each column.
            lines: Line of each row in the file.
            cells: Cells of each row.

        Raises:
            TableFileError: A column is given twice, or a row has not one cell for each column.
        """
        self.source, self.lines, self._cells = source, list(lines), cells
        self.taken: dict[str, np.ndarray] = {}
        self.is_output = is_output(header)
        self._given = {name: name for name in header}
        if len(self._given) < len(header):
            twice = next(name for name in header if list(header).count(name) > 1)
            raise TableFileError(source, "appears twice in the header", 1, twice or "''")
        for line, row in zip(self.lines, cells, strict=True):
            if len(row) != len(header):
                raise TableFileError(source, f"has {len(row)} cells where the header has {len(header)}", line)
        self._places = {name: place for place, name in enumerate(header)}
        self._signs: dict[str, float] = {}

    def __len__(self) -> int:
        return len(self.lines)

    def __contains__(self, name: str) -> bool:
        return name in self._places

    @property
    def left(self) -> list[str]:
        """Names of the columns that nobody has taken out."""
        return list(self._places)

    def given(self, name: str) -> str:
        """Name of a column in the file, which may name axes otherwise.

        Args:
            name: Name of the column here.
        """
        return self._given.get(name, name)

    def rename(self, names: Mapping[str, str]) -> None:
        """Gives columns other names.

        Args:
            names: New name of each column, by that which it has.
        """
        self._given = {names.get(new, new): old for new, old in self._given.items()}
        self._places = {names.get(old, old): place for old, place in self._places.items()}

    def turn_round(self, signs: Mapping[str, float]) -> None:
        """Multiplies columns, when they are taken out.

        Args:
            signs: Factor of each column; others stay.
        """
        self._signs = dict(signs)

    def keep(self, names: Collection[str]) -> None:
        """Leaves out all other columns.

        Args:
            names: Names of the columns that stay.
        """
        self._places = {name: place for name, place in self._places.items() if name in names}

    def begin_earlier(self) -> None:
        """Adds a row where the first step of a run began: its rows are at the ends of steps."""
        place, cells = self._places[TIME], self._cells
        first, second = (self._number(TIME, line, row[place])
                         for line, row in zip(self.lines[:2], cells[:2], strict=True))
        begin = list(cells[0])
        begin[place] = first - (second - first)
        self._cells, self.lines = [begin, *cells], [self.lines[0], *self.lines]

    def texts(self, name: str) -> list[str]:
        """Cells of a column, which stays.

        Args:
            name: Name of the column.
        """
        return [str(row[self._places[name]]) for row in self._cells]

    def pop(self, name: str, may_be_open: bool = False) -> np.ndarray:
        """Takes a column out.

        Args:
            name: One of `left`.
            may_be_open: Whether values may be infinite, or NaN where they are unknown.

        Returns:
            Its values, shape (row_count,).

        Raises:
            TableFileError: A cell is not a number, or is not finite.
        """
        place = self._places.pop(name)
        values = self._signs.get(name, 1.0) * np.array([
            self._number(name, line, row[place], may_be_open)
            for line, row in zip(self.lines, self._cells, strict=True)])
        self.taken[name] = values
        return values

    def _number(self, name: str, line: int, cell, may_be_open: bool = False) -> float:
        try:
            # Whether a grip holds may be a truth value.
            is_plain = isinstance(cell, str) or isinstance(cell, bool | np.bool_) and not unit_of(name)
            number, fault = (float if is_plain else _real)(cell), "" if may_be_open else "must be finite"
        except (TypeError, ValueError, OverflowError):
            number, fault = math.nan, "must be a number"
        if fault and not math.isfinite(number):
            raise TableFileError(self.source, fault, line, self.given(name), cell, unit_of(name))
        return number

    def error(
        self, name: str, reason: str, row: int | None = None, value: object = None, unit: str = ""
    ) -> TableFileError:  # fmt: skip
        """What is wrong with a column.

        Args:
            name: The column.
            reason: Why it is refused.
            row: Index of the row of a wrong value; None where the header is wrong.
            value: That value.
            unit: Its unit.
        """
        line = 1 if row is None else self.lines[row]
        return TableFileError(self.source, reason, line, self.given(name) or "''", value, unit)

    def pop_all(self, names: Sequence[str]) -> np.ndarray:
        """Values of several columns, which are taken, shape (row_count, name_count).

        Args:
            names: Names of the columns.
        """
        return np.column_stack([self.pop(name) for name in names])

    def pop_given(self, names: Sequence[str], otherwise: float) -> np.ndarray | None:
        """Values of those of some columns that are there, which are taken.

        Args:
            names: The columns.
            otherwise: Value of those that are missing.

        Returns:
            Shape (row_count, name_count); None where all are missing.
        """
        if not any(name in self for name in names):
            return None
        missing = np.full(len(self), otherwise)
        return np.column_stack([self.pop(name) if name in self else missing for name in names])

    def times(self) -> np.ndarray:
        """Takes the times of the rows out [s], shape (row_count,).

        Raises:
            TableFileError: There is no such column, or a time is not later than the one before.
        """
        if TIME not in self:
            raise TableFileError(self.source, "the header lacks this column of times in seconds", 1, TIME)
        times = self.pop(TIME)
        late = np.flatnonzero(np.diff(times) <= 0.0)
        if late.size:
            row = int(late[0]) + 1
            raise self.error(TIME, f"must be later than {float(times[row - 1])!r} s, the row before",
                             row, float(times[row]), "s")
        return times


def open_columns(source: Path | str | Mapping, example: str) -> Columns:
    """Opens a CSV file, or a table of columns by name such as a dict or a pandas DataFrame.

    Args:
        source: The file, or the table.
        example: A valid header, for the message about an empty file.

    Raises:
        TableFileError: The file cannot be read or has no rows, or the columns differ in length.
    """
    if isinstance(source, (str, Path)):
        path = Path(source)
        return Columns(path, *read_cells(path, example))
    if not hasattr(source, "keys"):
        raise TableFileError(Path("table"), f"must be a file, or columns by name, not {source!r:.60}")
    table, names = Path("table"), [str(name) for name in source.keys()]
    columns = [np.atleast_1d(as_given(source[name])) for name in source.keys()]
    if not columns or not len(columns[0]):
        raise TableFileError(table, f"has no rows; columns such as {example} are required")
    for name, values in zip(names, columns, strict=True):
        if values.shape != columns[0].shape or values.ndim != 1:
            raise TableFileError(table, f"has the shape {values.shape}, {names[0]} has "
                                 f"{columns[0].shape}", None, name)
    return Columns(table, names, range(1, len(columns[0]) + 1), list(zip(*columns, strict=True)))


_ALONG_AXIS = re.compile(r"(.+_([qk]?))([xyz])((?:_(?:m|N|Nm|N_m|N_per_m|m_per_s2))?)")


class Axes(NamedTuple):
    """How tables of somebody else name axes and turn motors.

    Attributes:
        order: Which of their axes is x, y and z of the scene.
        signs: Its direction.
        backwards: Names of actuators whose displacements and efforts have the other sign.
    """

    order: tuple[int, ...] = (0, 1, 2)
    signs: tuple[float, ...] = (1.0, 1.0, 1.0)
    backwards: tuple[str, ...] = ()

    @classmethod
    def read(cls, words: str, backwards: Iterable[str] = ()) -> Axes:
        """Reads what a user wrote.

        Args:
            words: Axes of the table that are x, y and z of the scene, such as ``z,x,y`` or ``-y,x,z``.
            backwards: See `backwards`.

        Raises:
            AxesError: They are no three axes of one right-handed frame.
        """
        parts = [one.strip() for one in words.split(",")]
        if sorted(one.lstrip("-+") for one in parts) != ["x", "y", "z"]:
            raise AxesError(words, "must name x, y and z once each, such as z,x,y or -y,x,z")
        order = tuple("xyz".index(one.lstrip("-+")) for one in parts)
        signs = tuple(-1.0 if one.startswith("-") else 1.0 for one in parts)
        if np.linalg.det(np.eye(3)[list(order)] * np.array(signs)[:, None]) < 0.0:
            raise AxesError(words, "is left-handed: such a table mirrors the robot; turn one axis round with -")
        return cls(order, signs, tuple(backwards))

    def turn(self, columns: Columns, actuators: Actuators) -> None:
        """Names the columns of a table by the axes of the scene, and turns signs.

        Args:
            columns: The table.
            actuators: Those of the scene.

        Raises:
            AxesError: The scene has no actuator of a name.
        """
        names, signs = dict[str, str](), dict[str, float]()
        for match in filter(None, map(_ALONG_AXIS.fullmatch, columns.left)):
            what, part, axis, unit = match.groups()
            own = self.order.index("xyz".index(axis))
            names[match[0]] = new = f"{what}{'xyz'[own]}{unit}"
            signs[new] = 1.0 if part == "k" else self.signs[own]
        for one in self.backwards:
            if one not in actuators.names:
                raise AxesError(one, f"is no actuator of the scene, which has {', '.join(actuators.names)}")
            kind = actuators.kind_of[one]
            signs |= dict.fromkeys((column(one, each) for each in (kind.setpoint, kind.displacement, kind.effort)), -1.0)
        columns.rename(names)
        columns.turn_round(signs)


class AxesError(NamedError):
    """Axes or actuators of a table that do not fit; its name is what was written."""


_OF_ACTUATORS = {SETPOINTS: CommandSetpoints, EFFORTS: CommandEfforts}
TARGETS_EXAMPLE = ",".join((TIME, *position_columns("tip")))


@dataclass(frozen=True)
class TargetTable:
    """A targets file, read and checked.

    Attributes:
        kind: ``targets``, ``setpoints`` or ``efforts``.
        times: Column ``time_s`` [s], shape (row_count,).
        time_steps: Time since the row before [s], shape (row_count,); for the first row that of the
            second, or `DEFAULT_TIME_STEP`.
        values: Effector targets [m], shape (row_count, effector_count, 3), NaN for an effector
            that the file does not name; or setpoints or efforts of the actuators, such as lengths
            [m], pressures [Pa] or tensions [N], shape (row_count, actuator_count), NaN for those
            that hold.
        wanted: What the file asks for beside targets, a row for each of its rows, NaN where it gives
            none: `orientations`, `stiffness` and `sensors` of `FollowTargets`.
    """

    kind: str
    times: np.ndarray
    time_steps: np.ndarray
    values: np.ndarray
    wanted: Mapping[str, Any]

    def command(self, row: int) -> Command:
        """Command of a row, counted from 0.

        Args:
            row: Number of the row.
        """
        values, step = self.values[row], float(self.time_steps[row])
        if self.kind == TARGETS:
            return FollowTargets(values, step, **{name: rows[row] for name, rows in self.wanted.items()})
        return _OF_ACTUATORS[self.kind](values, step)


@dataclass(frozen=True)
class Waypoints:
    """Points with times, joined by straight lines; after the last time the position stays.

    Attributes:
        times: Increasing times [s], shape (n,).
        points: Positions [m], shape (n, 3).
        quaternions: Orientations (x, y, z, w), shape (n, 4), joined by turns about fixed axes, the
            shorter way round; None without.
    """

    times: np.ndarray
    points: np.ndarray
    quaternions: np.ndarray | None = None

    @cached_property
    def _turns(self) -> Slerp:
        return Slerp(self.times, Rotation.from_quat(self.quaternions))

    def position(self, time: float) -> np.ndarray:
        """Position [m], shape (3,), at a time since the path began [s].

        Args:
            time: Time since the path began [s].
        """
        return between_rows(time, self.times, self.points)

    def orientation(self, time: float) -> np.ndarray | None:
        """Orientation (x, y, z, w) at a time since the path began [s], or None.

        Args:
            time: Time since the path began [s].
        """
        if self.quaternions is None or len(self.times) == 1:
            return None if self.quaternions is None else self.quaternions[0]
        return self._turns(np.clip(time, self.times[0], self.times[-1])).as_quat()

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray | None]:
        """Position and orientation at a time [s]; see both.

        Args:
            time: Time since the path began [s].
        """
        return self.position(time), self.orientation(time)


def read_targets(source: Path | str | Mapping, simulation: Simulation, axes: Axes = Axes()) -> TargetTable:
    """Reads and checks a targets file.

    Args:
        source: CSV file with a header and one row a step, or a table of columns by name.
        simulation: Simulation with the effectors and actuators.
        axes: How the table names them.

    Raises:
        TableFileError: The file cannot be read, names something unknown, mixes kinds, lacks a
            column, or contains a value that is not finite, a time that does not increase, a
            quaternion that is not of unit length, a stiffness that is not positive, or a setpoint
            or an effort that its kind cannot have.
    """
    columns = open_columns(source, TARGETS_EXAMPLE)
    axes.turn(columns, simulation.actuators)
    if columns.is_output and not keep_targets(columns, simulation.effector_names, simulation.sensor_columns):
        _keep_what_drove(columns, simulation)
    times = columns.times()
    kind, wanted = TARGETS, {}
    if any(own in columns for own in target_columns(simulation)):
        _refuse_partial(columns, simulation.effector_names)
        given = {one.target: _targets_of(columns, simulation, one) for one in WANTED}
        names = simulation.sensor_columns
        for own, name in names.items():
            if own in columns and not simulation.wanted_sensors[name]:
                raise columns.error(own, "the sensor has no weight in the scene: it is told, not wanted")
        given["sensors"] = columns.pop_given(list(names), np.nan)
        wanted = {name: rows for name, rows in given.items() if rows is not None}
        values = wanted.pop(TARGETS, np.full((len(columns), len(simulation.effector_names), 3), np.nan))
    else:
        kind, values = _actuator_values(columns, simulation)
    if columns.left:
        _refuse_column(columns, simulation)
    if kind == HOLD:
        raise TableFileError(columns.source, f"the header names nothing to drive besides {TIME}", 1)
    return TargetTable(kind, times, _time_steps(times), values, wanted)


def read_path(source: Path | str, effector: str) -> Waypoints:
    """Reads the targets of one effector from a targets file, whatever else that drives.

    Args:
        source: CSV file with a header; of what a run wrote the targets are read where it has some,
            the places that the effector reached where it has none.
        effector: The effector.

    Raises:
        TableFileError: The file cannot be read or contains no path of the effector.
    """
    columns = open_columns(source, ",".join((TIME, *position_columns(effector))))
    if columns.is_output:
        keep_targets(columns, (effector,))
    times = columns.times()
    if not any(own in columns for own in _columns_of_targets(effector)):
        raise columns.error(position_columns(effector)[0], "the header lacks this column")
    _refuse_partial(columns, (effector,))
    wanted = (_wanted(columns, effector, channel) for channel in WANTED[:2])
    return Waypoints(times, *wanted)


def target_columns(simulation: Simulation) -> list[str]:
    """All columns of targets that a scene may have: those of effectors, then those of sensors.

    Args:
        simulation: The simulation.
    """
    own = [one for name in simulation.effector_names for one in _columns_of_targets(name)]
    return [*own, *simulation.sensor_columns]


def keep_targets(
    columns: Columns, effectors: Sequence[str], sensors: Mapping[str, str] = MappingProxyType({})
) -> bool:
    """Leaves of what a run wrote the targets that it followed, as a targets file has them.

    Args:
        columns: Those of the run; a run that followed no targets stays as it is.
        effectors: Names of the effectors.
        sensors: Name of each sensor by its column.

    Returns:
        Whether it followed targets.
    """
    told = {target_column(name, own): own for own, name in sensors.items()}
    names = {old: new for old, new in told.items() if old in columns}
    for name in effectors:
        told = dict(zip(_columns_of_targets(target_name(name)), _columns_of_targets(name)))
        names.update((old, new) for old, new in told.items() if old in columns)
    if names:
        columns.keep([TIME, *names])
        columns.rename(names)
    return bool(names)


def _keep_what_drove(columns: Columns, simulation: Simulation, surroundings: bool = False) -> None:
    """Leaves of what a run wrote the setpoints or efforts by which it was driven.

    Args:
        columns: Those of the run. A run by targets is left its setpoints.
        simulation: The scene.
        surroundings: Whether poses of guided bodies and forces of touches are left too.
    """
    by_effort = DRIVEN_BY in columns and set(columns.texts(DRIVEN_BY)) == {EFFORTS}
    names = {TIME: TIME}
    for name, kind in simulation.actuators.kind_of.items():
        if kind.takes_efforts or not by_effort:
            own = column(name, kind.effort if by_effort else kind.setpoint)
            names[own] = own
    if surroundings:
        for name in (body.name for body in simulation.scene.guided_bodies):
            for columns_of in (position_columns, quaternion_columns):
                told = columns_of(body_name(name, simulation.effector_names))
                names.update(zip(told, columns_of(name), strict=True))
        for name in simulation.touch_names:
            names.update((own, own) for own in force_columns(name))
        names.update((own, own) for own in map(holds_column, simulation.grip_names))
    columns.keep(names)
    columns.rename(names)


def _columns_of_targets(name: str) -> tuple[str, ...]:
    """All columns that tell what is wanted of an effector."""
    return tuple(own for channel in WANTED for own in channel.columns(name))


def _targets_of(columns: Columns, simulation: Simulation, channel: Channel) -> np.ndarray | None:
    """Takes what is wanted of the effectors out, of which no column is missing.

    Args:
        columns: Those of the file.
        simulation: The scene.
        channel: The quantity.

    Returns:
        Shape (row_count, effector_count, width), NaN where nothing is wanted; None without any.
    """
    names = simulation.effector_names
    asking = list(compress(names, channel.are_asked(simulation)))
    for one in (own for name in names if name not in asking for own in channel.columns(name)):
        if one in columns:
            raise columns.error(one, f"the effector has no {channel.word} in the scene; those with "
                                f"one: {', '.join(asking) or 'none'}")  # fmt: skip
    values = [_wanted(columns, name, channel) for name in names]
    missing = np.full((len(columns), channel.width), np.nan)
    if all(own is None for own in values):
        return None
    return np.stack([missing if own is None else own for own in values], axis=1)


def _wanted(columns: Columns, name: str, channel: Channel) -> np.ndarray | None:
    """Takes what is wanted of an effector out, shape (row_count, width); None without."""
    values = columns.pop_given(channel.columns(name), np.nan)
    if values is None:
        return None
    if channel.word == "orientation":
        _refuse_lengths(columns.source, name, values, columns.lines)
        return values / np.linalg.norm(values, axis=1, keepdims=True)
    if channel.word == "stiffness" and (values <= 0.0).any():
        row, axis = np.unravel_index(np.nanargmin(values), values.shape)
        raise columns.error(channel.columns(name)[axis], "must be positive: it is a stiffness",
                            row, float(values[row, axis]), channel.unit)  # fmt: skip
    return values


def _refuse_partial(columns: Columns, effectors: Sequence[str]) -> None:
    """Refuses positions and turns of effectors of which columns are missing."""
    others = [left for left in columns.left
              if not any(left in _columns_of_targets(name) for name in effectors)]
    for name in effectors:
        if any(own in columns for own in _columns_of_targets(name)):
            _refuse_missing(columns, name, "an effector's target needs x, y and z",
                            ", an orientation qx, qy, qz and qw too", others)  # fmt: skip


def _refuse_missing(
    columns: Columns, name: str, rule: str, rule_of_turns: str, others: Sequence[str] = ()
) -> None:
    """Refuses a position without all of its columns, or a turn without those or all of its own.

    Args:
        columns: Those of the file.
        name: Whose position it is.
        rule: Which columns a position needs.
        rule_of_turns: Follows that where a column of the turn is missing.
        others: Columns that may be meant in place of the missing one.
    """
    turns = quaternion_columns(name)
    needed = position_columns(name) + (turns if any(one in columns for one in turns) else ())
    for one in needed:
        if one not in columns:
            raise columns.error(one, f"the header lacks this column: {rule}"
                                f"{rule_of_turns if one in turns else ''}{nearest(one, others)}")  # fmt: skip


def _refuse_column(columns: Columns, simulation: Simulation) -> None:
    """Refuses a column of a targets file that is left when all others were taken."""
    name = columns.left[0]
    kinds = simulation.actuators.kinds
    quantities = dict.fromkeys(quantity for one in (*kinds, *actuator_kinds())
                               for quantity in (one.setpoint, one.displacement, one.effort))
    quantities[ANGLE] = None
    ends = {column("", quantity): "actuator" for quantity in quantities}
    ends.update((end, "effector") for end in _columns_of_targets(""))
    what, owner = next(
        ((what, name[:-len(end)]) for end, what in ends.items() if name.endswith(end)), ("", ""))
    actuators = simulation.actuators
    known = {"effector": simulation.effector_names, "actuator": actuators.names}
    motors = (*(motor.name for motor in simulation.scene.motors), *actuators.pulleys.names)
    kind = actuators.kind_of.get(owner) if what == "actuator" else None
    if kind and name not in [column(owner, one) for one in _commandable(kind)]:
        raise columns.error(name, f"this {kind.noun} is driven by its {kind.setpoint.word}: use "
                            f"{column(owner, kind.setpoint)}")  # fmt: skip
    if what and owner in (*known[what], *(motors if what == "actuator" else ())):
        others = ", ".join(columns.given(one) for one in columns.taken if one != TIME)
        raise columns.error(
            name, f"cannot be combined with {others}: a file contains effector targets, or "
            "setpoints of actuators, or their efforts, only one of these"
            f"{_setpoint_columns(actuators.kind_of)}")
    if what:
        listed = ", ".join(known[what]) or "none"
        raise columns.error(name, f"the scene has no {what} {owner!r}; its {what}s: {listed}")
    near = nearest(name, (TIME, *(one.name for one in drives_of(simulation)),
                          *target_columns(simulation)))
    raise columns.error(
        name, f"is not a valid column; valid are {TIME}, <effector>_x_m, _y_m, _z_m (effectors: "
        f"{', '.join(simulation.effector_names) or 'none'}), {_known_actuators(simulation)}{near}")


def _refuse_lengths(path: Path, name: str, quaternions: np.ndarray, lines: list[int]) -> None:
    """Refuses quaternions that are not of unit length."""
    off = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0)
    if off.max() > NOT_UNIT:
        raise TableFileError(path, f"{name}'s quaternion is not of unit length", lines[int(off.argmax())])


_DIRECT = (SETPOINTS, EFFORTS)
"""What columns of actuators give. A pressure is both where it is what the setpoint holds."""


def _common_meaning(path: Path, meanings: Mapping[str, Collection[str]], rule: str) -> str:
    """What all columns of a table give.

    Args:
        path: The file, for errors.
        meanings: What each column can give, by its name; at least one.
        rule: What may be combined, for errors.
    """
    columns = list(meanings)
    common = list(meanings[columns[0]])
    for column, possible in meanings.items():
        left = [meaning for meaning in common if meaning in possible]
        if not left:
            other = next(c for c in columns if not set(meanings[c]) & set(possible))
            raise TableFileError(path, f"cannot be combined with {other}: {rule}", 1, column)
        common = left
    return common[0]


def _setpoint_columns(kind_of: Mapping[str, ActuatorKind]) -> str:
    """Columns of setpoints of each actuator, for messages; empty where all have one quantity."""
    if len({kind.setpoint for kind in kind_of.values()}) < 2:
        return ""
    columns = [column(name, kind.setpoint) for name, kind in kind_of.items()]
    return f"; setpoints of this scene are {', '.join(columns)}"


def _time_steps(times: np.ndarray) -> np.ndarray:
    if len(times) == 1:
        return np.array([DEFAULT_TIME_STEP])
    steps = np.diff(times)
    return np.concatenate([steps[:1], steps])


_EXAMPLE = f"{TIME},<cable>_shortening_m"


class TouchColumns(NamedTuple):
    """Forces or displacements of a touch over time.

    A displacement is counted from where the point is when the touch begins; a force or a
    displacement of zero is no touch.

    Attributes:
        values: Forces [N] or displacements [m], shape (row_count, 3).
        are_forces: Which of both.
    """

    values: np.ndarray
    are_forces: bool


def between_rows(
    time: ArrayLike, times: np.ndarray, values: np.ndarray, outside: float | None = None
) -> np.ndarray:
    """Values at times between rows, interpolated linearly, shape (*shape of time, column_count).

    Args:
        time: The time or times [s].
        times: Of the rows [s], shape (row_count,).
        values: Of the rows, shape (row_count, column_count).
        outside: Value before the first and after the last row; None for the values there.
    """
    return np.array([np.interp(time, times, column, outside, outside) for column in values.T]).T


@dataclass(frozen=True)
class CommandTable:
    """A commands file, read and checked.

    Attributes:
        kind: ``setpoints``, ``efforts``, or ``hold`` where no actuator is driven.
        times: Times of the rows [s], shape (row_count,).
        values: Setpoints or efforts of the actuators, such as lengths [m], pressures [Pa] or
            tensions [N], shape (row_count, actuator_count); NaN for those that hold.
        poses: Poses of the driven guided bodies, by name.
        is_constant: For each row but the last, whether nothing changes until the next,
            shape (row_count - 1,).
        touches: Forces or displacements of touches, by name.
        grips: Whether each driven grip holds, by name, each of shape (row_count,).
        base: Poses of the moving base; None without.
    """

    kind: str
    times: np.ndarray
    values: np.ndarray
    poses: Mapping[str, Waypoints]
    is_constant: np.ndarray
    touches: Mapping[str, TouchColumns] = field(default_factory=dict)
    grips: Mapping[str, np.ndarray] = field(default_factory=dict)
    base: Waypoints | None = None

    def held(self, time: float) -> Iterator[tuple[str, bool]]:
        """What grips are told at a time: that of the last row before it.

        Args:
            time: Time since the run began [s].
        """
        row = max(0, int(np.searchsorted(self.times, time, side="right")) - 1)
        for name, holds in self.grips.items():
            yield name, bool(holds[row])

    def touched(self, time: float, simulation: Simulation) -> Touched | None:
        """Touches at a time [s]; None without any.

        Args:
            time: The time [s].
            simulation: Its touches may have begun already.
        """
        names = simulation.touch_names
        touched = Touched.none(len(names))
        for name, columns in self.touches.items():
            index, value = names.index(name), between_rows(time, self.times, columns.values)
            if columns.are_forces:
                touched.forces[index] = value if value.any() else np.nan
            else:
                touched.displace(index, value, simulation.touches)
        return touched if np.isfinite([*touched]).any() else None

    def command(self, time: float, time_step: float) -> Command:
        """Command of the actuators at a time [s], for a step of a duration [s].

        Args:
            time: Time since the run began [s].
            time_step: Duration of the step [s].
        """
        if self.kind == HOLD:
            return Hold(time_step)
        return _OF_ACTUATORS[self.kind](between_rows(time, self.times, self.values), time_step)

    @property
    def longest_hold(self) -> tuple[float, float]:
        """Start and end of the longest interval with constant commands [s]; NaN if there is
        none.
        """
        edges = np.flatnonzero(np.diff([False, *self.is_constant, False]))
        holds = self.times[edges].reshape(-1, 2)
        if not len(holds):
            return math.nan, math.nan
        begin, end = holds[np.argmax(holds[:, 1] - holds[:, 0])]
        return float(begin), float(end)


def read_commands(source: Path | str | Mapping, simulation: Simulation, axes: Axes = Axes()) -> CommandTable:
    """Reads a commands file for a simulation.

    Args:
        source: CSV file with a header, then rows at increasing times, or a table of columns by
            name. A file that a run wrote begins where its first step began.
        simulation: Simulation with the actuators, motors and guided bodies.
        axes: How the table names them.

    Raises:
        TableFileError: The file cannot be read, names something unknown, mixes setpoints with
            efforts, drives an actuator twice, or contains a value that is not a
            finite number, a time that does not increase, or a quaternion that is not of unit length.
    """
    columns = open_columns(source, _EXAMPLE)
    axes.turn(columns, simulation.actuators)
    if TIME in columns and len(columns) < 2:
        raise TableFileError(columns.source, "has one row; a run from the first row to the last needs two")
    if columns.is_output:
        _keep_what_drove(columns, simulation, surroundings=True)
        columns.begin_earlier()
    times = columns.times()
    kind, values = _actuator_values(columns, simulation)
    poses = {
        entry.name: pose for entry in simulation.scene.rigid_bodies
        if (pose := _pose(columns, entry.name, entry.motion == "guided", times))
    }  # fmt: skip
    base = next((_pose(columns, name, True, times) for name in simulation.base_names), None)
    touches, grips = _touches(columns, simulation), _grips(columns, simulation)
    if columns.left:
        guided = [entry.name for entry in simulation.scene.rigid_bodies]
        near = nearest(columns.left[0], (
            TIME, *(one.name for one in drives_of(simulation)),
            *(one for own in guided for one in position_columns(own) + quaternion_columns(own)),
            *(one for own in simulation.touch_names
              for one in force_columns(own) + displacement_columns(own)),
            *map(holds_column, simulation.grip_names)))
        raise columns.error(columns.left[0], f"is not a valid column; valid are {_known(simulation)}{near}")
    commanded = [series for name, series in columns.taken.items() if name != TIME]
    changes = np.diff(np.column_stack([np.zeros(len(times)), *commanded]), axis=0)
    is_constant = (changes == 0.0).all(axis=1)
    return CommandTable(kind, times, values, poses, is_constant, touches, grips, base)


def _actuator_values(columns: Columns, simulation: Simulation) -> tuple[str, np.ndarray]:
    """Takes the columns of actuators and motors out.

    Returns:
        What they give, and the setpoints or efforts, shape (row_count, actuator_count).
    """
    actuators, path = simulation.actuators, columns.source
    driven_by: dict[str, str] = {}
    meanings: dict[str, Collection[str]] = {}
    values = np.full((len(columns), actuators.count), np.nan)
    for name, kind in actuators.kind_of.items():
        _refuse_what_follows(columns, name, kind)
    _refuse_motors(columns, simulation)
    for drive in drives_of(simulation):
        if drive.name not in columns:
            continue
        given, series = columns.given(drive.name), columns.pop(drive.name)
        meanings[given] = drive.gives
        if reason := drive.impossible(series):
            row = int(np.argmin(series))
            raise columns.error(drive.name, reason, row, float(series[row]), drive.quantity.unit)
        for place, told in drive.told(series):
            one = actuators.names[place]
            if one in driven_by:
                by = driven_by[one]  # An angle of a pulley is a shortening.
                is_twice = drive.quantity == ANGLE and by.endswith("_shortening_m")
                raise columns.error(drive.name, f"is given twice, also by {by}" if is_twice
                                    else f"drives {one}, as {by} does")  # fmt: skip
            driven_by[one] = given
            values[:, place] = told
    commanded = HOLD if not meanings else _common_meaning(
        path, meanings, "actuators are driven by setpoint or by effort, all in the same way"
        f"{_setpoint_columns(actuators.kind_of)}")
    return commanded, actuators.efforts(values) if commanded == EFFORTS else values


def _refuse_motors(columns: Columns, simulation: Simulation) -> None:
    """Refuses what a motor cannot be told: its cables have lengths and tensions of their own."""
    for motor in simulation.scene.motors:
        kind = simulation.actuators.kind_of[motor.cables[0]]
        for quantity in (kind.setpoint, kind.effort):
            if (own := column(motor.name, quantity)) in columns:
                raise columns.error(own, f"{motor.name} is a motor: it shortens all its cables by "
                                    f"the same length: use {motor.name}_shortening_m")  # fmt: skip


def _commandable(kind: ActuatorKind) -> dict[Quantity, tuple[str, ...]]:
    """Quantities by which an actuator can be commanded, and what a table of them gives."""
    if kind.is_effort_driven:
        return {kind.setpoint: _DIRECT}
    return {kind.displacement: ("setpoints",), kind.setpoint: ("setpoints",),
            kind.effort: ("efforts",)}  # fmt: skip


def _refuse_what_follows(columns: Columns, name: str, kind: ActuatorKind) -> None:
    """Refuses displacements of an effort-driven actuator, which follow from its effort."""
    if not kind.is_effort_driven:
        return
    for quantity in (kind.displacement, kind.extent):
        own = column(name, quantity)
        if own in columns:
            raise columns.error(own, f"this {kind.noun} is driven by its {kind.setpoint.word}, its "
                                f"{quantity.word} follows: use {column(name, kind.setpoint)}")  # fmt: skip


class Drive(NamedTuple):
    """A quantity by which actuators are commanded: a column of files, and a name in Python.

    Attributes:
        name: The column, such as ``north_shortening_m``.
        quantity: The quantity.
        places: The actuators among all of the scene.
        kind: Their kind.
        gives: What is given: `SETPOINTS`, `EFFORTS`, or both where the setpoint is the effort.
        lines: Setpoint of each of the actuators where the quantity is 0, and its change by one unit;
            empty where the setpoint or the effort itself is given, as it is told.
    """

    name: str
    quantity: Quantity
    places: tuple[int, ...]
    kind: ActuatorKind
    gives: tuple[str, ...] = (SETPOINTS,)
    lines: tuple[tuple[float, float], ...] = ()

    def impossible(self, values: ArrayLike) -> str:
        """Why some values cannot be; empty where all can.

        Args:
            values: Values of the quantity.
        """
        kind, is_setpoint = self.kind, SETPOINTS in self.gives
        if not is_setpoint and kind.one_sided and np.any(np.less(values, 0.0)):
            return f"must not be negative: a {kind.noun} cannot push"
        if is_setpoint and not self.lines and np.any(np.less(values, kind.least_setpoint)):
            bound = "negative" if kind.least_setpoint == 0.0 else f"below {kind.least_setpoint:g}"
            return f"must not be {bound}: the {kind.setpoint.word} of a {kind.noun} cannot be"
        return ""

    def told[Values: (float, np.ndarray)](self, values: Values) -> Iterator[tuple[int, Values]]:
        """Each of its actuators, with its setpoints or efforts as they are told.

        Args:
            values: Values of the quantity.
        """
        for place, (zero, slope) in zip(self.places, self.lines or ((0.0, 1.0),), strict=True):
            yield place, zero + slope * values if self.lines else values


def drives_of(simulation: Simulation) -> Iterator[Drive]:
    """All by which actuators, motors and pulleys of a scene are commanded.

    Args:
        simulation: The simulation.
    """
    actuators, pulleys = simulation.actuators, simulation.actuators.pulleys
    moved = list(zip(actuators.rest_setpoints.tolist(), actuators.limits.slopes.tolist(), strict=True))
    for place, (name, kind) in enumerate(actuators.kind_of.items()):
        for quantity, gives in _commandable(kind).items():
            # The angle of a motor is its displacement too, but is told from the motor's own zero.
            is_moved = quantity == kind.displacement != kind.setpoint
            yield Drive(column(name, quantity), quantity, (place,), kind, gives,
                        (moved[place],) if is_moved else ())  # fmt: skip
    for motor in simulation.scene.motors:
        places = tuple(map(actuators.names.index, motor.cables))
        kind = actuators.kinds[places[0]]
        yield Drive(column(motor.name, kind.displacement), kind.displacement, places, kind,
                    lines=tuple(moved[place] for place in places))  # fmt: skip
    for pulley, name in enumerate(pulleys.names):
        places = tuple(map(int, pulleys.driven[pulley]))
        zeros, slope = pulleys.lengths(pulley, 0.0).tolist(), -float(pulleys.wound[pulley])
        yield Drive(column(name, ANGLE), ANGLE, places, actuators.kinds[places[0]],
                    lines=tuple((zero, slope) for zero in zeros))  # fmt: skip


def _pose(columns: Columns, name: str, is_driven: bool, times: np.ndarray) -> Waypoints | None:
    """Takes the columns of a body or of the base out; gives its poses, None without any."""
    own = position_columns(name) + quaternion_columns(name)
    given = next((one for one in own if one in columns), None)
    if not given:
        return None
    if not is_driven:
        raise columns.error(given, f"{name} is a free body; only guided bodies are driven")
    _refuse_missing(columns, name, "a position needs x, y and z, a rotation qx, qy, qz and qw", "")
    positions, turns = columns.pop_all(own[:3]), None
    if own[3] in columns:
        turns = columns.pop_all(own[3:])
        _refuse_lengths(columns.source, name, turns, columns.lines)
    return Waypoints(times, positions, turns)


def _touches(columns: Columns, simulation: Simulation) -> dict[str, TouchColumns]:
    """Takes the columns of touches out."""
    touches: dict[str, TouchColumns] = {}
    for name in simulation.touch_names:
        for own, are_forces in ((force_columns(name), True), (displacement_columns(name), False)):
            given = next((one for one in own if one in columns), None)
            if given and name in touches:
                raise columns.error(given, f"{name} is touched by forces or by displacements, not by both")
            values = columns.pop_given(own, 0.0)
            if values is not None:
                touches[name] = TouchColumns(values, are_forces)
    return touches


def _grips(columns: Columns, simulation: Simulation) -> dict[str, np.ndarray]:
    """Takes the columns of grips out; gives whether each holds, in each row."""
    grips = {}
    for name in simulation.grip_names:
        own = holds_column(name)
        if own in columns:
            values = columns.pop(own)
            wrong = np.flatnonzero((values != 0.0) & (values != 1.0))
            if wrong.size:
                row = int(wrong[0])
                raise columns.error(own, "must be 1 to hold or 0 to let go", row, float(values[row]))
            grips[name] = values > 0.0
    return grips


def _known(simulation: Simulation) -> str:
    """The columns of a commands file that a scene accepts, as text."""
    guided = ", ".join(body.name for body in simulation.scene.guided_bodies) or "none"
    grips = ", ".join(simulation.grip_names)
    touches = (", <touch>_force_x_N, _y_N, _z_N or <touch>_displacement_x_m, _y_m, _z_m (touches: "
               f"{', '.join(simulation.touch_names)})")
    return (f"{_known_actuators(simulation)}, <body>_x_m, _y_m, _z_m and _qx, _qy, _qz, "
            f"_qw (guided bodies: {guided})"
            f"{touches if simulation.touch_names else ''}"
            f"{f', <grip>_holds (grips: {grips})' if grips else ''}")


def _known_actuators(simulation: Simulation) -> str:
    """Columns of actuators, motors and pulleys, as text."""
    names: dict[tuple[str, str], list[str]] = {}
    for name, kind in simulation.actuators.kind_of.items():
        columns = " or ".join(column(f"<{kind.noun}>", quantity) for quantity in _commandable(kind))
        names.setdefault((columns, kind.section), []).append(name)
    known = [f"{columns} ({section}: {', '.join(own)})"
             for (columns, section), own in names.items()]
    motors = ", ".join(motor.name for motor in simulation.scene.motors) or "none"
    pulleys = simulation.actuators.pulleys
    angles = f", {column('<pulley>', ANGLE)} (pulleys: {', '.join(pulleys.names)})"
    return (f"{', '.join(known) or 'no actuators'}, <motor>_shortening_m (motors: {motors})"
            f"{angles if pulleys.count else ''}")
