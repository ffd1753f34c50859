"""A CSV file that drives an offline run, as text, and the error of one that cannot."""

from __future__ import annotations

import csv
from pathlib import Path

from softrobot_twin.errors import SoftRobotTwinError


class TableFileError(SoftRobotTwinError):
    """A file of targets or commands cannot be run.

    Attributes:
        path: The file.
        row: Line of the file, counted from 1, or None when the whole file is meant.
        column: Name of the column, or an empty string.
        value: What stands there, or None.
        unit: Unit the value is read in, or an empty string.
        reason: What would be right.
    """

    def __init__(self, path: Path, reason: str, row: int | None = None, column: str = "",
                 value: object = None, unit: str = ""):
        self.path = path
        self.row = row
        self.column = column
        self.value = value
        self.unit = unit
        self.reason = reason
        place = f"{path}" if row is None else f"{path}, row {row}"
        stated = "" if value is None else f" = {value!r} {unit}".rstrip()
        named = f": {column}{stated}" if column else ""
        super().__init__(f"{place}{named}: {reason}")


def read_cells(path: Path, example: str) -> tuple[list[str], list[int], list[list[str]]]:
    """Reads a CSV file as text.

    Args:
        path: The file.
        example: Header that would do, for who gives an empty file.

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
        raise TableFileError(path, f"is empty; a header such as {example} is needed")
    first = rows[0][1]
    separator = next((mark for mark in ";\t" if len(first) == 1 and mark in first[0]), None)
    if separator:
        raise TableFileError(path, f"separates its cells by {separator!r}, not by commas", 1)
    if len(rows) == 1:
        raise TableFileError(path, "has a header but no row to run")
    (_, header), *body = rows
    return header, [line for line, _ in body], [row for _, row in body]
