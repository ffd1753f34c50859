"""A matrix whose rows and columns have names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from softrobot_twin.scripting.named_commands import place_of


@dataclass(frozen=True, repr=False, eq=False)
class LabelledMatrix:
    """A matrix with names, which numpy takes as an ordinary array.

    ``matrix["north_shortening_m"]`` is a column, and ``numpy.asarray(matrix)`` all of it.

    Attributes:
        values: The numbers, shape (row_count, column_count).
        rows: Names of the rows.
        columns: Names of the columns.
        meaning: What the numbers are, with their unit.
    """

    values: np.ndarray
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    meaning: str

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return len(self.rows), len(self.columns)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.values, dtype) if dtype is not None or copy else self.values

    def __getitem__(self, column: str) -> np.ndarray:
        """A column, shape (row_count,).

        Raises:
            CommandError: There is no column of this name.
        """
        found: np.ndarray = self.values[:, place_of(column, "columns:", self.columns)]
        return found

    def __matmul__(self, other: Any) -> Any:
        return self.values @ np.asarray(other)

    def __repr__(self) -> str:
        cells = [["", *self.columns]]
        cells += [[row, *(f"{value:.4g}" for value in own)]
                  for row, own in zip(self.rows, self.values, strict=True)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
                 for row in cells]
        return "\n".join([f"{self.meaning}:", *lines])
