"""Output on a terminal or through a pipe: tables, progress, warnings and a status line."""

from __future__ import annotations

import math
import sys
import time
from typing import TextIO

from rich import box
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.status import Status
from rich.table import Table
from rich.text import Text

_PIPED_WIDTH = 200
"""Columns of a piped table: wide enough that nothing is cut or wrapped."""


def console(stream: TextIO | None = None) -> Console:
    """A console on a stream (standard output by default), without colours when piped."""
    stream = stream or sys.stdout
    return Console(file=stream, width=None if stream.isatty() else _PIPED_WIDTH, highlight=False)


def table(title: str, *columns: str, piped: bool | None = None) -> Table:
    """An empty table: with a frame on a terminal, plain columns through a pipe."""
    plain = not sys.stdout.isatty() if piped is None else piped
    made = Table(title=title, title_justify="left", title_style="" if plain else "bold",
                 box=None if plain else box.ROUNDED, pad_edge=not plain,
                 min_width=len(title) + 2)
    for column in columns:
        made.add_column(column)
    return made


# Widest first column of a listing on a terminal.
_KEYS = 24


def listing(title: str, rows, piped: bool | None = None) -> Table:
    """Rows of a name and a text without a frame; on a terminal long texts go on below themselves."""
    plain = not sys.stdout.isatty() if piped is None else piped
    made = Table(title=title, title_justify="left", title_style="" if plain else "bold",
                 box=None, show_header=False, padding=(0, 0, 0, 2), min_width=len(title) + 2)
    made.add_column(max_width=None if plain or all(not text for _, text in rows) else _KEYS,
                    style="" if plain else "cyan", overflow="fold")
    made.add_column(overflow="fold")
    for name, text in rows:
        made.add_row(Text(name), Text(text))
    return made


def progress() -> Progress:
    """A progress bar on standard error; silent when that is no terminal."""
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                    TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
                    console=Console(stderr=True, quiet=not sys.stderr.isatty()),
                    disable=not sys.stderr.isatty())


def terminal_status(text: str) -> Status:
    """Shows an activity on standard error while it lasts; silent when that is no terminal."""
    return Console(stderr=True, quiet=not sys.stderr.isatty()).status(text)


def warn(text: str) -> None:
    """One line of warning on standard error."""
    print(f"warning: {text}", file=sys.stderr)


_PIPED_PERIOD = 5.0
"""Time between two lines through a pipe [s]; a new phase and the first cause of a large error are
printed at once.
"""


class LiveLine:
    """Shows the progress of a demo as one line. Use as a context manager.

    Args:
        stream: Output stream; standard error by default, so that tables can be piped.
    """

    def __init__(self, stream=None):
        self._stream = stream or sys.stderr
        self._live: Live | None = None
        self._printed_phase = self._printed_cause = ""
        self._printed_at = -math.inf

    def __enter__(self) -> LiveLine:
        if self._stream.isatty():
            self._live = Live(console=console(self._stream), auto_refresh=False)
            self._live.start()
        return self

    def __exit__(self, *_) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, elapsed: float, phase: str, error: float, compute_time: float,
             missed_ticks: int, cause: str = "") -> None:
        """Shows one status.

        Args:
            elapsed: Time since the beginning [s].
            phase: Present phase.
            error: Distance from the target [m]; NaN when not known.
            compute_time: Time of a step [s]; NaN when not known.
            missed_ticks: Ticks missed so far.
            cause: Why the error is large; empty when it is not.
        """
        line = (f"{elapsed:6.1f} s  {phase:<11}  error {_millimetres(error)}  "
                f"step {_milliseconds(compute_time)}  missed {missed_ticks}")
        if cause:
            line += f"  cause: {cause}"
        if self._live is not None:
            self._live.update(Text(line, no_wrap=True, overflow="crop"), refresh=True)
            return
        now = time.monotonic()
        is_new = phase != self._printed_phase or (cause and not self._printed_cause)
        if is_new or now - self._printed_at >= _PIPED_PERIOD:
            self._printed_phase, self._printed_at = phase, now
            self._printed_cause = cause
            print(line, file=self._stream, flush=True)


def _millimetres(value: float) -> str:
    return "   –   mm" if math.isnan(value) else f"{1e3 * value:6.2f} mm"


def _milliseconds(value: float) -> str:
    return "   –   ms" if math.isnan(value) else f"{1e3 * value:6.2f} ms"
