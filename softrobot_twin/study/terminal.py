"""How results and refusals look on a terminal, and through a pipe."""

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


_PIPED_PERIOD = 5.0
"""Time between two lines through a pipe [s]; a change of phase and the first cause of a large error
are told at once."""


class LiveLine:
    """Shows how a demo goes. Use as a context manager.

    Args:
        stream: Where to; standard error by default, so that tables can be piped.
    """

    def __init__(self, stream=None):
        self._stream = stream or sys.stderr
        self._live: Live | None = None
        self._told_phase = self._told_cause = ""
        self._told_at = -math.inf

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
            phase: What is being done.
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
        is_new = phase != self._told_phase or (cause and not self._told_cause)
        if is_new or now - self._told_at >= _PIPED_PERIOD:
            self._told_phase, self._told_at = phase, now
            self._told_cause = cause
            print(line, file=self._stream, flush=True)


def _millimetres(value: float) -> str:
    return "   –   mm" if math.isnan(value) else f"{1e3 * value:6.2f} mm"


def _milliseconds(value: float) -> str:
    return "   –   ms" if math.isnan(value) else f"{1e3 * value:6.2f} ms"
