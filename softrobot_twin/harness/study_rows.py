"""CSV files of what studies measure, a row of a dataclass for each case."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any, TypeVar

from softrobot_twin.harness.output_file import cell, csv_output

Row = TypeVar("Row")


def write_rows(path: Path, rows: Sequence[Any]) -> None:
    """Writes rows as CSV; unknown values are left empty.

    Args:
        path: The CSV file.
        rows: At least one row, all of the same columns: dataclasses, or values by their columns.

    Raises:
        OutputError: The file cannot be written.
    """
    cells = [row if isinstance(row, Mapping) else asdict(row) for row in rows]
    with csv_output(path, list(cells[0])) as write:
        for row in cells:
            write(map(cell, row.values()))


def read_rows(path: Path, kind: type[Row]) -> list[Row]:
    """Reads a file of `write_rows`; further columns are passed over.

    Args:
        path: The CSV file.
        kind: A dataclass of texts, integers and numbers; a column whose field has a default may be
            missing.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not text, lacks a column, or a cell is no number.
    """
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        for field in fields(kind):  # type: ignore[arg-type]
            if field.default is MISSING and field.name not in (reader.fieldnames or ()):
                raise ValueError(f"it lacks {field.name}")
        return [kind(**{field.name: _value(line.get(field.name, ""), str(field.type))
                        for field in fields(kind)}) for line in reader]  # type: ignore[arg-type]


def _value(text: str, kind: str) -> str | int | float:
    if kind == "str":
        return text
    return int(text or 0) if kind == "int" else float(text or "nan")
