"""Reads the CSV files of offline runs: a targets file or a commands file.

A targets file has one row per step, with targets of effectors, setpoints or efforts of actuators. A
commands file has rows at increasing times, with commands of actuators and guided bodies that are
interpolated. A table may mix lengths of cables with pressures of cavities: all columns are setpoints
if each is what that actuator's setpoint holds, and efforts if each is that actuator's effort.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.simulation import Hold, Simulation, Touched
from softrobot_twin.simulation.actuator_kinds import ActuatorKind, Quantity, actuator_kinds
from softrobot_twin.simulation.command import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
)
from softrobot_twin.simulation.pulleys import ANGLE, Pulleys


class TableFileError(SoftRobotTwinError):
    """A file of targets or commands cannot be run.

    Attributes:
        path: The file.
        row: Line of the file, counted from 1, or None for the whole file.
        column: Name of the column, or an empty string.
        value: Content of the cell, or None.
        unit: Unit the value is read in, or an empty string.
        reason: What is required.
    """

    def __init__(self, path: Path, reason: str, row: int | None = None, column: str = "",
                 value: object = None, unit: str = ""):
        self.path = path
        self.row = row
        self.column = column
        self.value = value
        self.unit = unit
        self.reason = reason
        location = f"{path}" if row is None else f"{path}, row {row}"
        stated = "" if value is None else f" = {value!r} {unit}".rstrip()
        named = f": {column}{stated}" if column else ""
        super().__init__(f"{location}{named}: {reason}")


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
    except (OSError, UnicodeDecodeError, csv.Error) as error:
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


SINGLE_ROW_TIME_STEP = 0.02
"""Time step of a file with only one row [s]."""

_AXES = ("x", "y", "z")
_TURN = ("qx", "qy", "qz", "qw")
_STIFFNESS = ("kx", "ky", "kz")
# A larger deviation from unit length is not rounding but a mistake.
_NOT_UNIT = 1.0e-2


@dataclass(frozen=True)
class TargetTable:
    """A targets file, read and checked.

    Attributes:
        kind: ``targets``, ``setpoints`` or ``efforts``.
        times: Column ``t`` [s], shape (row_count,).
        time_steps: Time since the row before [s], shape (row_count,); for the first row that of the
            second, or `SINGLE_ROW_TIME_STEP`.
        values: Effector targets [m], shape (row_count, effector_count, 3), NaN for an effector
            that the file does not name; or setpoints or efforts of the actuators, such as lengths
            [m], pressures [Pa] or tensions [N], shape (row_count, actuator_count), NaN for those
            that take no efforts.
        orientations: Wanted turns of effectors from rest as unit quaternions (x, y, z, w), shape
            (row_count, effector_count, 4), NaN where the file gives none; None in a file without.
        stiffness: Wanted stiffnesses of effectors [N/m], shape (row_count, effector_count, 3), NaN
            where the file gives none; None in a file without.
    """

    kind: str
    times: np.ndarray
    time_steps: np.ndarray
    values: np.ndarray
    orientations: np.ndarray | None = None
    stiffness: np.ndarray | None = None

    def command(self, row: int) -> Command:
        """Command of a row, counted from 0."""
        values, step = self.values[row], float(self.time_steps[row])
        if self.kind == "targets":
            turns = None if self.orientations is None else self.orientations[row]
            stiffness = None if self.stiffness is None else self.stiffness[row]
            return FollowTargets(values, step, None, turns, stiffness)
        build = {"setpoints": CommandSetpoints, "efforts": CommandEfforts}
        return build[self.kind](values, step)


def read_targets(path: Path | str, effector_names: Sequence[str],
                 kind_of: Mapping[str, ActuatorKind],
                 oriented: Sequence[bool] = (), stiff: Sequence[bool] = ()) -> TargetTable:
    """Reads and checks a targets file.

    Args:
        path: CSV file: a header, then one row a step.
        effector_names: Effectors in the simulation's order.
        kind_of: Kind of each actuator by its name, in the simulation's order.
        oriented: Whether each effector asks for an orientation, so that the file may give one; by
            default none does.
        stiff: The same for a stiffness.

    Raises:
        TableFileError: The file cannot be read, names something unknown, mixes kinds, lacks a
            column, or contains a value that is not finite, a time that does not increase, a
            quaternion that is not of unit length, a stiffness that is not positive, or a setpoint or an effort that its kind cannot
            have.
    """
    path = Path(path)
    header, lines, cells = read_cells(path, "t,tip.x,tip.y,tip.z")
    kind = _kind_of_table(path, header, kind_of)
    if kind == "targets":
        asked = {name: [Quantity(axis, "m") for axis in _AXES] for name in effector_names}
        turned = [name for name in effector_names
                  if any(f"{name}.{part}" in header for part in _TURN)]
        _refuse_turns(path, turned, effector_names, oriented)
        for name in turned:
            asked[name] += [Quantity(part, "") for part in _TURN]
        stiffened = _stiffness_columns(path, header, effector_names, stiff)
        for name, part in stiffened:
            asked[name].append(Quantity(part, "N/m"))
    else:
        asked = {name: [_commanded(made, kind)] for name, made in kind_of.items()}
    wanted = _wanted_columns(path, header, kind, asked, kind_of)
    numbers = _target_numbers(path, header, lines, cells, wanted)
    if kind != "targets":
        _refuse_impossible(path, header, lines, numbers, kind, kind_of)
    times = numbers[:, header.index("t")]
    _check_times_increase(path, lines, times)
    values = np.full((len(times), len(wanted)), np.nan)
    for position, column in enumerate(wanted):
        if column in header:
            values[:, position] = numbers[:, header.index(column)]
    if kind != "targets":
        return TargetTable(kind, times, _time_steps(times), values)
    columns = list(wanted)
    places = [[columns.index(f"{name}.{axis}") for axis in _AXES] for name in effector_names]
    orientations = None
    if turned:
        orientations = np.full((len(times), len(effector_names), 4), np.nan)
        for name in turned:
            quaternions = values[:, [columns.index(f"{name}.{part}") for part in _TURN]]
            _refuse_lengths(path, name, quaternions, lines)
            lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
            orientations[:, list(effector_names).index(name)] = quaternions / lengths
    stiffness = None
    if stiffened:
        stiffness = np.full((len(times), len(effector_names), 3), np.nan)
        for name, part in stiffened:
            own = values[:, columns.index(f"{name}.{part}")]
            if (own <= 0.0).any():
                row = int(np.argmin(own))
                raise TableFileError(path, "must be positive: it is a stiffness", lines[row],
                                     f"{name}.{part}", float(own[row]), "N/m")
            place = list(effector_names).index(name), _STIFFNESS.index(part)
            stiffness[:, place[0], place[1]] = own
    return TargetTable(
        kind, times, _time_steps(times), values[:, places], orientations, stiffness
    )


def _stiffness_columns(path: Path, header: list[str], names: Sequence[str], stiff) -> list:
    """Effector and axis of each column of a stiffness; refuses those of effectors without one."""
    asking = [name for name, asks in zip(names, stiff) if asks]
    found = [(name, part) for name in names for part in _STIFFNESS if f"{name}.{part}" in header]
    for name, part in found:
        if name not in asking:
            raise TableFileError(
                path, "the effector has no stiffness in the scene; those with one: "
                f"{', '.join(asking) or 'none'}", 1, f"{name}.{part}")
    return found


def _refuse_turns(path: Path, turned: Sequence[str], names: Sequence[str], oriented) -> None:
    """Refuses orientations of effectors that ask for none."""
    asking = [name for name, asks in zip(names, oriented) if asks]
    for name in turned:
        if name not in asking:
            raise TableFileError(
                path, "the effector has no orientation in the scene; those with one: "
                f"{', '.join(asking) or 'none'}", 1, f"{name}.qx")


def _refuse_lengths(path: Path, name: str, quaternions: np.ndarray, lines: list[int]) -> None:
    """Refuses quaternions that are not of unit length."""
    off = np.abs(np.linalg.norm(quaternions, axis=1) - 1.0)
    if off.max() > _NOT_UNIT:
        raise TableFileError(path, f"{name}'s quaternion is not of unit length",
                             lines[int(off.argmax())])


def _commanded(kind: ActuatorKind, commanded: str) -> Quantity:
    """The quantity of a kind that ``setpoints`` or ``efforts`` give."""
    return kind.setpoint if commanded == "setpoints" else kind.effort


def _refuse_impossible(path: Path, header, lines, numbers, commanded: str, kind_of) -> None:
    """Refuses setpoints and efforts that no actuator of a kind can have."""
    for name, kind in kind_of.items():
        quantity = _commanded(kind, commanded)
        column = f"{name}.{quantity.word}"
        if column not in header:
            continue
        column_values = numbers[:, header.index(column)]
        reason = _impossible(kind, commanded, column_values)
        if reason:
            row = int(np.argmin(column_values))
            raise TableFileError(path, reason, lines[row], column, float(column_values[row]),
                                 quantity.unit)


def _impossible(kind: ActuatorKind, commanded: str, values: np.ndarray) -> str:
    """Why some of the values are impossible; empty where all are possible."""
    if commanded == "efforts" and kind.one_sided and (values < 0.0).any():
        return f"must not be negative: a {kind.noun} cannot push"
    if commanded == "setpoints" and (values < kind.least_setpoint).any():
        bound = "negative" if kind.least_setpoint == 0.0 else f"below {kind.least_setpoint:g}"
        return f"must not be {bound}: the {kind.setpoint.word} of a {kind.noun} cannot be"
    return ""


def _kind_of_table(path: Path, header: list[str], kind_of: Mapping[str, ActuatorKind]) -> str:
    """Kind of the driven columns; a file has one kind."""
    if "t" not in header:
        raise TableFileError(path, "the header lacks this column of times in seconds", 1, "t")
    known = [*kind_of.values(), *actuator_kinds()]
    words = dict.fromkeys(q.word for kind in known for q in (kind.setpoint, kind.effort))
    meanings: dict[str, Collection[str]] = {}
    for column in header:
        if header.count(column) > 1:
            raise TableFileError(path, "appears twice in the header", 1, column or "''")
        if column == "t":
            continue
        name, _, word = column.rpartition(".")
        parts = (*_AXES, *_TURN, *_STIFFNESS)
        if not name or (name not in kind_of and word not in (*parts, *words)):
            valid = " or ".join(f"<actuator>.{word}" for word in words)
            raise TableFileError(
                path, f"is not a valid column; use <effector>.x, .y, .z, {valid}", 1,
                column or "''")
        if word in parts:
            meanings[column] = ("targets",)
        elif name in kind_of:
            kind = kind_of[name]
            meanings[column] = [meaning for meaning in _DIRECT
                                if _commanded(kind, meaning).word == word]
            if not meanings[column]:
                reason = f"this {kind.noun} is driven by its {kind.setpoint.word}: use {name}."
                raise TableFileError(path, f"{reason}{_with_unit(kind.setpoint)}", 1, column)
        else:  # `_wanted_columns` refuses the name.
            meanings[column] = _DIRECT
    if not meanings:
        raise TableFileError(path, "the header names nothing to drive besides t", 1)
    return _common_meaning(
        path, meanings, "a file contains effector targets, or setpoints of actuators, or their "
        f"efforts, only one of these{_setpoint_columns(kind_of, '{}.{}')}")


_DIRECT = ("setpoints", "efforts")
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


def _setpoint_columns(kind_of: Mapping[str, ActuatorKind], form: str) -> str:
    """Columns of setpoints of each actuator, for messages; empty where all have one quantity.

    Args:
        kind_of: Kind of each actuator.
        form: Form of a column, for the actuator's name, the quantity and its unit.
    """
    if len({kind.setpoint for kind in kind_of.values()}) < 2:
        return ""
    columns = [form.format(name, *kind.setpoint) for name, kind in kind_of.items()]
    return f"; setpoints of this scene are {', '.join(columns)}"


def _with_unit(quantity: Quantity) -> str:
    return f"{quantity.word} [{quantity.unit}]"


def _wanted_columns(path: Path, header: list[str], kind: str,
                    asked: Mapping[str, list[Quantity]],
                    kind_of: Mapping[str, ActuatorKind]) -> dict[str, str]:
    """Units of the columns in the simulation's order; refuses unknown and lacking columns."""
    what = "effector" if kind == "targets" else "actuator"
    driven = [column.rpartition(".")[0] for column in header if column != "t"]
    for name, column in zip(driven, (c for c in header if c != "t")):
        if name not in asked:
            known = ", ".join(asked) or "none"
            raise TableFileError(
                path, f"the scene has no {what} {name!r}; its {what}s: {known}", 1, column)
    # For an actuator that a direct run leaves out, any value would be a guess.
    needed = driven if kind == "targets" else [
        name for name, made in kind_of.items() if kind == "setpoints" or made.takes_efforts]
    for name in needed:
        for quantity in asked[name]:
            if f"{name}.{quantity.word}" not in header:
                why = ("an effector's target needs x, y and z, an orientation qx, qy, qz and qw too"
                       if quantity.word in _TURN else
                       "an effector's target needs x, y and z" if kind == "targets"
                       else "a direct run drives every actuator")
                raise TableFileError(path, f"the header lacks this column: {why}", 1,
                                       f"{name}.{quantity.word}")
    return {f"{name}.{quantity.word}": quantity.unit
            for name, quantities in asked.items() for quantity in quantities}


def _target_numbers(path: Path, header: list[str], lines: list[int], cells: list[list[str]],
                    units: Mapping[str, str]) -> np.ndarray:
    """Cells as finite numbers, shape (row_count, column_count); units are by column."""
    numbers = np.empty((len(cells), len(header)))
    for index, (line, row) in enumerate(zip(lines, cells)):
        if len(row) != len(header):
            raise TableFileError(
                path, f"has {len(row)} cells where the header has {len(header)}", line)
        for position, (column, cell) in enumerate(zip(header, row)):
            unit = "s" if column == "t" else units.get(column, "")
            try:
                number = float(cell)
            except ValueError:
                raise TableFileError(path, "must be a number", line, column, cell,
                                       unit) from None
            if not math.isfinite(number):
                raise TableFileError(path, "must be finite", line, column, cell, unit)
            numbers[index, position] = number
    return numbers


def _check_times_increase(path: Path, lines: list[int], times: np.ndarray) -> None:
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        row = int(late[0]) + 1
        raise TableFileError(path, f"must be later than {float(times[row - 1])!r} s, the row "
                               "before", lines[row], "t", float(times[row]), "s")


def _time_steps(times: np.ndarray) -> np.ndarray:
    if len(times) == 1:
        return np.array([SINGLE_ROW_TIME_STEP])
    steps = np.diff(times)
    return np.concatenate([steps[:1], steps])


TIME = "time_s"
_EXAMPLE = "time_s,<cable>_shortening_m"
_PLACE = ("x_m", "y_m", "z_m")


class Pose:
    """Commanded poses of a guided body over time."""

    def __init__(self, times: np.ndarray, positions: np.ndarray, quaternions: np.ndarray | None):
        """Stores the rows.

        Args:
            times: Of the rows [s], shape (row_count,).
            positions: Of the body's origin [m], shape (row_count, 3).
            quaternions: x, y, z, w, shape (row_count, 4); None without rotations.
        """
        self._times, self._positions = times, positions
        self._turn = None
        if quaternions is not None:
            self._turn = Slerp(times, Rotation.from_quat(quaternions))

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray | None]:
        """Position [m] and quaternion x, y, z, w (None without rotations) at a time [s]."""
        position = np.array([np.interp(time, self._times, x) for x in self._positions.T])
        return position, None if self._turn is None else self._turn([time]).as_quat()[0]


class TouchColumns:
    """Forces or displacements of a touch over time.

    A displacement is counted from where the point is when the touch begins; a force or a displacement
    of zero is no touch.
    """

    def __init__(self, times: np.ndarray, values: np.ndarray, are_forces: bool):
        """Stores the rows.

        Args:
            times: Of the rows [s], shape (row_count,).
            values: Forces [N] or displacements [m], shape (row_count, 3).
            are_forces: Which of both.
        """
        self._times, self._values, self.are_forces = times, values, are_forces

    def at(self, time: float) -> np.ndarray:
        """Force [N] or displacement [m] at a time [s], shape (3,)."""
        return np.array([np.interp(time, self._times, column) for column in self._values.T])


@dataclass(frozen=True)
class CommandTable:
    """A commands file, read and checked.

    Attributes:
        kind: ``setpoints``, ``efforts``, or ``hold`` where no actuator is driven.
        times: Times of the rows [s], shape (row_count,).
        values: Setpoints or efforts of the actuators, such as lengths [m], pressures [Pa] or
            tensions [N], shape (row_count, actuator_count); NaN for those that take no efforts.
        poses: Poses of the driven guided bodies, by name.
        is_constant: For each row but the last, whether nothing changes until the next,
            shape (row_count - 1,).
        touches: Forces or displacements of touches, by name.
    """

    kind: str
    times: np.ndarray
    values: np.ndarray
    poses: Mapping[str, Pose]
    is_constant: np.ndarray
    touches: Mapping[str, TouchColumns] = field(default_factory=dict)

    def touched(self, time: float, simulation: Simulation) -> Touched | None:
        """Touches at a time [s]; None without any.

        Args:
            time: The time [s].
            simulation: Its touches may have begun already.
        """
        before, names = simulation.state.touches, simulation.touch_names
        forces, places = (np.full((len(names), 3), np.nan) for _ in range(2))
        for name, columns in self.touches.items():
            index, value = names.index(name), columns.at(time)
            if not value.any():
                continue
            if columns.are_forces:
                forces[index] = value
            else:
                origins = before.origins if before.is_touched[index] else before.points
                places[index] = origins[index] + value
        acts = np.isfinite(forces).any() or np.isfinite(places).any()
        return Touched(forces, places) if acts else None

    def command(self, time: float, time_step: float) -> Command:
        """Command of the actuators at a time [s], for a step of a duration [s]."""
        if self.kind == "hold":
            return Hold(time_step)
        values = np.array([np.interp(time, self.times, column) for column in self.values.T])
        kinds = {"setpoints": CommandSetpoints, "efforts": CommandEfforts}
        return kinds[self.kind](values, time_step)

    @property
    def longest_hold(self) -> tuple[float, float]:
        """Start and end of the longest interval with constant commands [s]; NaN if there is
        none.
        """
        best, begin = (math.nan, math.nan), None
        for index, stands in enumerate([*self.is_constant, False]):
            if stands and begin is None:
                begin = self.times[index]
            elif not stands and begin is not None:
                if not self.times[index] - begin <= best[1] - best[0]:
                    best = (float(begin), float(self.times[index]))
                begin = None
        return best


def read_commands(path: Path | str, simulation: Simulation) -> CommandTable:
    """Reads a commands file for a simulation.

    Args:
        path: CSV file: a header, then rows at increasing times.
        simulation: Simulation with the actuators, motors and guided bodies.

    Raises:
        TableFileError: The file cannot be read, names something unknown, mixes setpoints with
            efforts, drives an actuator twice or not at all, or contains a value that is not a finite
            number, a time that does not increase, or a quaternion that is not of unit length.
    """
    path = Path(path)
    header, lines, cells = read_cells(path, _EXAMPLE)
    numbers = _command_numbers(path, header, lines, cells)
    if TIME not in header:
        raise TableFileError(path, "the header lacks this column of times in seconds", 1, TIME)
    times = numbers[:, header.index(TIME)]
    _check_times(path, lines, times)
    columns = {column: numbers[:, index] for index, column in enumerate(header)}
    if len(columns) < len(header):
        twice = next(column for column in header if header.count(column) > 1)
        raise TableFileError(path, "appears twice in the header", 1, twice)
    left = dict(columns)
    del left[TIME]
    kind, values = _actuator_values(path, simulation, left, len(times), lines)
    poses = _poses(path, simulation, left, times, lines)
    touches = _touches(path, simulation, left, times)
    if left:
        raise TableFileError(path, "is not a valid column; valid are " + _known(simulation), 1,
                             next(iter(left)))
    commanded = np.column_stack([series for name, series in columns.items() if name != TIME])
    is_constant = (np.diff(commanded, axis=0) == 0.0).all(axis=1)
    return CommandTable(kind, times, values, poses, is_constant, touches)


def _command_numbers(path: Path, header: list[str], lines: list[int], cells) -> np.ndarray:
    numbers = np.empty((len(cells), len(header)))
    for index, (line, row) in enumerate(zip(lines, cells, strict=True)):
        if len(row) != len(header):
            raise TableFileError(
                path, f"has {len(row)} cells where the header has {len(header)}", line)
        for position, (column, cell) in enumerate(zip(header, row, strict=True)):
            try:
                number = float(cell)
            except ValueError:
                raise TableFileError(path, "must be a number", line, column, cell) from None
            if not math.isfinite(number):
                raise TableFileError(path, "must be finite", line, column, cell)
            numbers[index, position] = number
    return numbers


def _check_times(path: Path, lines: list[int], times: np.ndarray) -> None:
    if len(times) < 2:
        raise TableFileError(path, "has one row; a run from the first row to the last needs two")
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if late.size:
        row = int(late[0]) + 1
        raise TableFileError(path, f"must be later than {float(times[row - 1])!r} s, the row "
                             "before", lines[row], TIME, float(times[row]), "s")


def _actuator_values(
    path, simulation, left: dict, row_count: int, lines
) -> tuple[str, np.ndarray]:
    """Values of the columns of actuators and motors, which it removes from the remaining ones."""
    actuators = simulation.actuators
    driven_by: dict[str, str] = {}
    meanings: dict[str, Collection[str]] = {}
    values = np.full((row_count, actuators.count), np.nan)
    _read_angles(path, actuators.pulleys, left)
    for name, driven, kind in _drives(simulation):
        _refuse_what_follows(path, name, kind, left)
        for quantity, meaning in _commandable(kind).items():
            column = f"{name}_{quantity.word}_{quantity.unit}"
            if column not in left:
                continue
            column_values = left.pop(column)
            if name not in actuators.names and quantity != kind.displacement:
                raise TableFileError(path, f"{name} is a motor: it shortens all its cables by the "
                                     f"same length: use {name}_shortening_m", 1, column)
            meanings[column] = meaning
            reason = _impossible(kind, meaning[0], column_values)
            if quantity != kind.displacement and reason:
                row = int(np.argmin(column_values))
                raise TableFileError(path, reason, lines[row], column, float(column_values[row]),
                                     quantity.unit)
            for one in driven:
                if one in driven_by:
                    raise TableFileError(path, f"drives {one}, as {driven_by[one]} does", 1,
                                         column)
                driven_by[one] = column
                index = actuators.names.index(one)
                values[:, index] = column_values
                if quantity == kind.displacement:
                    values[:, index] = kind.sign * column_values + actuators.rest_setpoints[index]
    commanded = "hold" if not meanings else _common_meaning(
        path, meanings, "actuators are driven by setpoint or by effort, all in the same way"
        f"{_setpoint_columns(actuators.kind_of, '{}_{}_{}')}")
    lacking = [name for name, kind in actuators.kind_of.items()
               if name not in driven_by and (commanded != "efforts" or kind.takes_efforts)]
    if lacking:
        raise TableFileError(path, f"does not drive {lacking[0]}: a direct run drives every "
                             "actuator; valid columns are " + _known(simulation), 1)
    return commanded, values


def _read_angles(path: Path, pulleys: Pulleys, left: dict) -> None:
    """Replaces columns of angles by those of the shortenings that they wind up."""
    for name, wound in zip(pulleys.names, pulleys.wound, strict=True):
        column, shortening = f"{name}_{ANGLE.word}_{ANGLE.unit}", f"{name}_shortening_m"
        if column not in left:
            continue
        if shortening in left:
            raise TableFileError(path, f"is given twice, also by {shortening}", 1, column)
        left[shortening] = wound * left.pop(column)


def _commandable(kind: ActuatorKind) -> dict[Quantity, tuple[str, ...]]:
    """Quantities by which an actuator can be commanded, and what a table of them gives."""
    if kind.is_effort_driven:
        return {kind.setpoint: _DIRECT}
    return {kind.displacement: ("setpoints",), kind.setpoint: ("setpoints",),
            kind.effort: ("efforts",)}  # fmt: skip


def _refuse_what_follows(path: Path, name: str, kind: ActuatorKind, left: dict) -> None:
    """Refuses displacements of an effort-driven actuator, which follow from its effort."""
    if not kind.is_effort_driven:
        return
    for quantity in (kind.displacement, kind.extent):
        column = f"{name}_{quantity.word}_{quantity.unit}"
        if column in left:
            use = f"{name}_{kind.setpoint.word}_{kind.setpoint.unit}"
            raise TableFileError(path, f"this {kind.noun} is driven by its {kind.setpoint.word}, "
                                 f"its {quantity.word} follows: use {use}", 1, column)


def _drives(simulation: Simulation) -> list[tuple[str, tuple[str, ...], ActuatorKind]]:
    """Names of actuators and motors, the actuators that each of them drives, and their kind."""
    kind_of = simulation.actuators.kind_of
    drives = [(name, (name,), kind) for name, kind in kind_of.items()]
    return drives + [(motor.name, motor.cables, kind_of[motor.cables[0]])
                     for motor in simulation.scene.motors]


def _poses(path, simulation, left: dict, times, lines) -> dict[str, Pose]:
    """Poses of the columns of guided bodies, which it removes from the remaining ones."""
    poses = {}
    for entry in simulation.scene.rigid_bodies:
        places = [f"{entry.name}_{axis}" for axis in _PLACE]
        turns = [f"{entry.name}_{axis}" for axis in _TURN]
        given = [column for column in (*places, *turns) if column in left]
        if not given:
            continue
        if entry.motion != "guided":
            raise TableFileError(path, f"{entry.name} is a free body; only guided bodies are "
                                 "driven", 1, given[0])
        needed = places + (turns if any(column in left for column in turns) else [])
        for column in needed:
            if column not in left:
                raise TableFileError(path, "the header lacks this column: a position needs x, y "
                                     "and z, a rotation qx, qy, qz and qw", 1, column)
        series = np.column_stack([left.pop(column) for column in needed])
        quaternions = series[:, 3:] if len(needed) > 3 else None
        if quaternions is not None:
            _refuse_lengths(path, entry.name, quaternions, lines)
        poses[entry.name] = Pose(times, series[:, :3], quaternions)
    return poses


_TOUCH = {"force_{}_N": True, "displacement_{}_m": False}
"""Ends of the columns of a touch, for each axis, and whether they give forces."""


def _touches(path, simulation, left: dict, times) -> dict[str, TouchColumns]:
    """Columns of touches, which it removes from the remaining ones."""
    touches = {}
    for name in simulation.touch_names:
        for form, are_forces in _TOUCH.items():
            given = {f"{name}_{form.format(axis)}": place for place, axis in enumerate(_AXES)}
            given = {column: place for column, place in given.items() if column in left}
            if not given:
                continue
            if name in touches:
                raise TableFileError(path, f"{name} is touched by forces or by displacements, not "
                                     "by both", 1, next(iter(given)))
            values = np.zeros((len(times), 3))
            for column, place in given.items():
                values[:, place] = left.pop(column)
            touches[name] = TouchColumns(times, values, are_forces)
    return touches


def _known(simulation: Simulation) -> str:
    """The columns that a scene accepts, as text."""
    scene, names = simulation.scene, {}
    for name, kind in simulation.actuators.kind_of.items():
        columns = " or ".join(f"<{kind.noun}>_{quantity.word}_{quantity.unit}"
                              for quantity in _commandable(kind))
        names.setdefault((columns, kind.section), []).append(name)
    known = [f"{columns} ({section}: {', '.join(own)})"
             for (columns, section), own in names.items()]
    motors = ", ".join(motor.name for motor in scene.motors) or "none"
    guided = ", ".join(e.name for e in scene.rigid_bodies if e.motion == "guided") or "none"
    return (f"{', '.join(known) or 'no actuators'}, "
            f"<motor>_shortening_m (motors: {motors}), "
            f"{_known_angles(simulation)}<body>_x_m, _y_m, _z_m and _qx, _qy, _qz, "
            f"_qw (guided bodies: {guided}){_known_touches(simulation)}")


def _known_touches(simulation: Simulation) -> str:
    """Columns of touches, as text; empty without any."""
    if not simulation.touch_names:
        return ""
    return (", <touch>_force_x_N, _y_N, _z_N or <touch>_displacement_x_m, _y_m, _z_m (touches: "
            f"{', '.join(simulation.touch_names)})")


def _known_angles(simulation: Simulation) -> str:
    """Columns of the angles of pulleys, as text; empty without any."""
    pulleys = simulation.actuators.pulleys
    if not pulleys.count:
        return ""
    return f"<pulley>_{ANGLE.word}_{ANGLE.unit} (pulleys: {', '.join(pulleys.names)}), "
