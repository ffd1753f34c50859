"""One setting with its error and its time, and a file of them."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from softrobot_twin.study.accuracy.accuracy_error import AccuracyError
from softrobot_twin.study.reports.output_error import OutputError

MESH, NEWTON, QP, PRECISION = "mesh", "newton", "qp tolerance", "factor precision"
"""Knobs. Rows of the first carry whole errors, the others only what the knob adds."""


@dataclass(frozen=True)
class AccuracyRow:
    """One setting of one knob. Errors are relative to the reference's displacement from rest.

    Attributes:
        knob: Which knob is turned.
        setting: What it is turned to.
        mesh: Name of the mesh.
        element: ``linear`` or ``quadratic``.
        law: ``corotational`` or ``linear``.
        node_count: Nodes, those on edges too.
        dof_count: Unknowns.
        step_ms: Median time of a step of one linearization, or as the setting says [ms].
        step_p99_ms: Its 99th percentile [ms].
        error_lengths: Error with displacements prescribed.
        error_tensions: Error with forces prescribed.
        error_weightless: Error with displacements prescribed and no gravity.
        error_added: What the knob adds to the error, all else the same.
        uncertainty_lengths: Uncertainty of the reference `error_lengths` is taken against.
        uncertainty_tensions: The same of `error_tensions`.
        uncertainty_weightless: The same of `error_weightless`.
        displacement_mm: Displacement of the reference's effectors, displacements prescribed [mm].
    """

    knob: str
    setting: str
    mesh: str
    element: str
    law: str
    node_count: int
    dof_count: int
    step_ms: float
    step_p99_ms: float
    error_lengths: float = np.nan
    error_tensions: float = np.nan
    error_weightless: float = np.nan
    error_added: float = np.nan
    uncertainty_lengths: float = np.nan
    uncertainty_tensions: float = np.nan
    uncertainty_weightless: float = np.nan
    displacement_mm: float = np.nan

    @property
    def error(self) -> float:
        """What a setting is judged by, displacements prescribed: the larger with and without
        gravity. A coarse mesh may be right by luck in one of them, where errors cancel.
        """
        return max(self.error_lengths, self.error_weightless)

    @property
    def uncertainty(self) -> float:
        """Of the reference that `error` is taken against."""
        return max(self.uncertainty_lengths, self.uncertainty_weightless)


def write_rows(path: Path, rows: Sequence[AccuracyRow]) -> None:
    """Writes rows as CSV; what is not known is left empty.

    Raises:
        OutputError: The file cannot be written.
    """
    names = [field.name for field in fields(AccuracyRow)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            writer.writerows([_cell(getattr(row, name)) for name in names] for row in rows)
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error


def read_rows(path: Path) -> list[AccuracyRow]:
    """Reads what `write_rows` wrote.

    Raises:
        AccuracyError: It is no such file.
    """
    names = [field.name for field in fields(AccuracyRow)]
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = [name for name in names if name not in (reader.fieldnames or ())]
            if missing:
                raise AccuracyError(str(path), f"is no file of 'accuracy': it lacks {missing[0]}")
            return [AccuracyRow(**{field.name: _value(line[field.name], str(field.type))
                                   for field in fields(AccuracyRow)}) for line in reader]
    except (OSError, UnicodeDecodeError, ValueError) as error:
        raise AccuracyError(str(path), f"cannot be read as a file of 'accuracy': {error}") from None


def _cell(value) -> str:
    if isinstance(value, float):
        return f"{value:.6g}" if np.isfinite(value) else ""
    return str(value)


def _value(cell: str, kind: str):
    if kind == "str":
        return cell
    return int(cell) if kind == "int" else float(cell or "nan")
