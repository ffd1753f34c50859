"""The CSV file that drives an offline run: where to go, or what each cable does, row by row.

Three kinds of file, never mixed: effector targets (``t,tip.x,tip.y,tip.z``), cable lengths
(``t,north.length,…``) and cable tensions (``t,north.tension,…``). Seconds, metres, newtons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softrobot_twin.simulation.command import (
    Command,
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
)
from softrobot_twin.study.offline.table_file import TableFileError, read_cells

SINGLE_ROW_TIME_STEP = 0.02
"""Time step of a file with one row only, which has no difference to take it from [s]."""

_AXES = ("x", "y", "z")
_KIND_OF_QUANTITY = {"x": "targets", "y": "targets", "z": "targets",
                     "length": "lengths", "tension": "tensions"}
_UNIT_OF_KIND = {"targets": "m", "lengths": "m", "tensions": "N"}


@dataclass(frozen=True)
class TargetTable:
    """A targets file, read and checked.

    Attributes:
        kind: ``targets``, ``lengths`` or ``tensions``.
        times: Column ``t`` [s], shape (row_count,).
        time_steps: Time since the row before [s], shape (row_count,); the first row takes that of
            the second, or `SINGLE_ROW_TIME_STEP`.
        values: Effector targets [m], shape (row_count, effector_count, 3), NaN for an effector
            that the file does not name; or lengths [m] or tensions [N], shape
            (row_count, actuator_count).
    """

    kind: str
    times: np.ndarray
    time_steps: np.ndarray
    values: np.ndarray

    def command(self, row: int) -> Command:
        """Command of a row, counted from 0."""
        build = {"targets": FollowTargets, "lengths": CommandSetpoints, "tensions": CommandEfforts}
        return build[self.kind](self.values[row], float(self.time_steps[row]))


def read_targets(path: Path | str, effector_names: Sequence[str],
                 actuator_names: Sequence[str]) -> TargetTable:
    """Reads a targets file for a simulation with these effectors and actuators.

    Args:
        path: CSV file: a header, then one row a step.
        effector_names: Effectors in the simulation's order.
        actuator_names: Actuators in the simulation's order.

    Raises:
        TableFileError: The file cannot be read, names something unknown, mixes kinds, lacks a
            column, or holds a value that is no finite number, a time that does not grow, or a
            negative length or tension.
    """
    path = Path(path)
    header, lines, cells = read_cells(path, "t,tip.x,tip.y,tip.z")
    kind = _kind_of(path, header)
    names = effector_names if kind == "targets" else actuator_names
    wanted = _wanted_columns(path, header, kind, names)
    numbers = _numbers(path, header, lines, cells, kind)
    times = numbers[:, header.index("t")]
    _refuse_time_that_stands_still(path, lines, times)
    values = np.full((len(times), len(wanted)), np.nan)
    for position, column in enumerate(wanted):
        if column in header:
            values[:, position] = numbers[:, header.index(column)]
    if kind == "targets":
        values = values.reshape(len(times), len(names), 3)
    return TargetTable(kind, times, _time_steps(times), values)


def _kind_of(path: Path, header: list[str]) -> str:
    """What the columns drive; one kind a file."""
    if "t" not in header:
        raise TableFileError(path, "the header lacks this column of times in seconds", 1, "t")
    kinds: dict[str, str] = {}
    for column in header:
        if header.count(column) > 1:
            raise TableFileError(path, "stands twice in the header", 1, column or "''")
        if column == "t":
            continue
        name, _, quantity = column.rpartition(".")
        if not name or quantity not in _KIND_OF_QUANTITY:
            raise TableFileError(
                path, "is no column to drive; use <effector>.x, .y, .z, <actuator>.length or "
                "<actuator>.tension", 1, column or "''")
        kinds.setdefault(_KIND_OF_QUANTITY[quantity], column)
    if not kinds:
        raise TableFileError(path, "the header names nothing to drive beside t", 1)
    if len(kinds) > 1:
        first, second = list(kinds.values())[:2]
        raise TableFileError(
            path, f"cannot stand beside {first}: a file holds effector targets, lengths or "
            "tensions, one kind only", 1, second)
    return next(iter(kinds))


def _wanted_columns(path: Path, header: list[str], kind: str, names: Sequence[str]) -> list[str]:
    """Columns in the simulation's order; refuses unknown names and lacking columns."""
    quantities = {"targets": _AXES, "lengths": ("length",), "tensions": ("tension",)}[kind]
    what = "effector" if kind == "targets" else "actuator"
    driven = [column.rpartition(".")[0] for column in header if column != "t"]
    for name, column in zip(driven, (c for c in header if c != "t")):
        if name not in names:
            known = ", ".join(names) or "none"
            raise TableFileError(
                path, f"the scene has no {what} {name!r}; its {what}s: {known}", 1, column)
    # A cable left out of a direct run has no value that would not be a guess.
    needed = driven if kind == "targets" else names
    for name in needed:
        for quantity in quantities:
            if f"{name}.{quantity}" not in header:
                why = ("an effector's target needs x, y and z" if kind == "targets"
                       else "a direct run drives every actuator")
                raise TableFileError(path, f"the header lacks this column: {why}", 1,
                                       f"{name}.{quantity}")
    return [f"{name}.{quantity}" for name in names for quantity in quantities]


def _numbers(path: Path, header: list[str], lines: list[int], cells: list[list[str]],
             kind: str) -> np.ndarray:
    """Cells as finite numbers, shape (row_count, column_count)."""
    numbers = np.empty((len(cells), len(header)))
    for index, (line, row) in enumerate(zip(lines, cells)):
        if len(row) != len(header):
            raise TableFileError(
                path, f"has {len(row)} cells where the header has {len(header)}", line)
        for position, (column, cell) in enumerate(zip(header, row)):
            unit = "s" if column == "t" else _UNIT_OF_KIND[kind]
            try:
                number = float(cell)
            except ValueError:
                raise TableFileError(path, "must be a number", line, column, cell,
                                       unit) from None
            if not math.isfinite(number):
                raise TableFileError(path, "must be finite", line, column, cell, unit)
            if number < 0.0 and column != "t" and kind != "targets":
                raise TableFileError(path, "must not be negative: a cable cannot push", line,
                                       column, number, unit)
            numbers[index, position] = number
    return numbers


def _refuse_time_that_stands_still(path: Path, lines: list[int], times: np.ndarray) -> None:
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
