"""The comparison of solvers as rows of text, for the terminal, CSV and documentation alike."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from softrobot_twin.study.compare.factorization_comparison import FactorizationComparison
from softrobot_twin.study.compare.qp_comparison import QPFigures
from softrobot_twin.study.reports.output_error import OutputError
from softrobot_twin.study.reports.terminal import table


class TextTable(NamedTuple):
    """A table in words.

    Attributes:
        title: What it shows.
        columns: Headings.
        rows: Cells.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def for_terminal(self) -> Table:
        """The table as rich prints it."""
        made = table(self.title, *self.columns)
        for row in self.rows:
            made.add_row(*row)
        return made

    def as_markdown(self) -> str:
        """The table in Markdown, numbers to the right."""
        rule = ["---", *("---:" for _ in self.columns[1:])]
        lines = [self.columns, rule, *self.rows]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)

    def write_csv(self, path: Path) -> None:
        """Writes the table as CSV.

        Raises:
            OutputError: The file cannot be written.
        """
        try:
            with path.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows([self.columns, *self.rows])
        except OSError as error:
            raise OutputError(path, error.strerror or str(error)) from error


def factorization_table(found: FactorizationComparison) -> TextTable:
    """One row for each factorization."""
    return TextTable(
        f"Factorizations of {found.scene}'s matrix, {found.dof_count} dof, "
        f"{found.row_count} rows of H",
        ("factorization", "factor, median ms", "factor, p99 ms", "W and dx, median ms",
         "together, ms", "residual of dx", "error of W"),
        tuple(
            (one.name, _ms(one.factor.median), _ms(one.factor.p99), _ms(one.solves.median),
             _ms(one.factor.median + one.solves.median), f"{one.residual:.1e}",
             f"{one.compliance_error:.1e}")
            for one in found.figures))


def qp_table(figures: Sequence[QPFigures]) -> TextTable:
    """One row for each solver on each set of problems."""
    return TextTable(
        "QP solvers on inverse problems",
        ("problems", "n", "solver", "median µs", "p99 µs", "answered", "error of λ, median",
         "error of λ, worst", "judged"),
        tuple(
            (one.problems, str(one.count), one.solver, f"{1e6 * one.time.median:.1f}",
             f"{1e6 * one.time.p99:.1f}", f"{100.0 * one.solved_share:.0f} %",
             _error(one.median_error), _error(one.worst_error), f"{one.judged}/{one.posed}")
            for one in figures))


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3f}"


def _error(value: float) -> str:
    return f"{value:.1e}" if np.isfinite(value) else "-"
