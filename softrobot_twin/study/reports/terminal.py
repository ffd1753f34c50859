"""How results and refusals look on a terminal, and through a pipe."""

from __future__ import annotations

import sys
from typing import TextIO

from rich import box
from rich.console import Console
from rich.progress import (BarColumn, MofNCompleteColumn, Progress, TextColumn,
                           TimeRemainingColumn)
from rich.status import Status
from rich.table import Table

_PIPED_WIDTH = 200
"""Columns of a piped table: wide enough that nothing is cut or wrapped."""


def console(stream: TextIO | None = None) -> Console:
    """A console on a stream (standard output by default) that is plain when piped."""
    stream = stream or sys.stdout
    return Console(file=stream, width=None if stream.isatty() else _PIPED_WIDTH, highlight=False)


def table(title: str, *columns: str, piped: bool | None = None) -> Table:
    """An empty table: framed on a terminal, bare columns through a pipe."""
    plain = not sys.stdout.isatty() if piped is None else piped
    made = Table(title=title, title_justify="left", title_style="" if plain else "bold",
                 box=None if plain else box.ROUNDED, pad_edge=not plain,
                 min_width=len(title) + 2)
    for column in columns:
        made.add_column(column)
    return made


def progress() -> Progress:
    """A progress bar on standard error that stays silent when that is no terminal."""
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                    TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
                    console=Console(stderr=True, quiet=not sys.stderr.isatty()),
                    disable=not sys.stderr.isatty())


def terminal_status(words: str) -> Status:
    """What is being done, on standard error while it lasts, silent when that is no terminal."""
    return Console(stderr=True, quiet=not sys.stderr.isatty()).status(words)


def warn(words: str) -> None:
    """One line of warning on standard error."""
    print(f"warning: {words}", file=sys.stderr)
