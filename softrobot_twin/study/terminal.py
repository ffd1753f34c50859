"""Output on a terminal or through a pipe: tables, progress, durations, warnings, a status line."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TextIO, TypeVar

from rich import box
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from softrobot_twin.errors import printable_lines

Key, Value = TypeVar("Key"), TypeVar("Value")
_PIPED_WIDTH = 200
"""Columns of a piped table: wide enough that nothing is cut or wrapped."""


def console(stream: TextIO | None = None) -> Console:
    """A console on a stream (standard output by default), without colours when piped.

    What is in brackets, such as a unit, is text and no markup.

    Args:
        stream: Where it writes; None for standard output.
    """
    stream = stream or sys.stdout
    width = None if stream.isatty() else _PIPED_WIDTH
    return Console(file=stream, width=width, highlight=False, markup=False)


def table(
    title: str, *columns: str, rows: Iterable[Iterable[str]] = (), piped: bool | None = None
) -> Table:  # fmt: skip
    """A table: with a frame on a terminal, plain columns through a pipe.

    Args:
        title: The title above.
        *columns: Titles of the columns.
        rows: Cells of each row.
        piped: Whether it is shown as through a pipe; None to see.
    """
    plain = not sys.stdout.isatty() if piped is None else piped
    made = Table(title=title, title_justify="left", title_style="" if plain else "bold",
                 box=None if plain else box.ROUNDED, pad_edge=not plain,
                 min_width=len(title) + 2)
    for column in columns:
        made.add_column(column)
    for row in rows:
        made.add_row(*row)
    return made


def print_apart(*shown: Table | str | None) -> None:
    """Prints tables and texts with an empty line behind each; None is left out.

    Args:
        *shown: Tables and texts in order.
    """
    for one in shown:
        if one is not None:
            console().print(one)
            console().print()


def by_key(pairs: Iterable[tuple[Key, Value]]) -> dict[Key, list[Value]]:
    """Values by their keys, in order: what is alike shares a row.

    Args:
        pairs: Keys and values.
    """
    found: dict[Key, list[Value]] = {}
    for key, value in pairs:
        found.setdefault(key, []).append(value)
    return found


# Widest first column of a listing on a terminal.
_KEYS = 24


def listing(title: str, rows, piped: bool | None = None) -> Table:
    """Rows of a name and a text without a frame; on a terminal long texts go on below themselves.

    Args:
        title: The title above.
        rows: Name and text of each row.
        piped: Whether it is shown as through a pipe; None to see.
    """
    plain = not sys.stdout.isatty() if piped is None else piped
    made = Table(title=title, title_justify="left", title_style="" if plain else "bold",
                 box=None, show_header=False, padding=(0, 0, 0, 2), min_width=len(title) + 2)
    made.add_column(max_width=None if plain or all(not text for _, text in rows) else _KEYS,
                    style="" if plain else "cyan", overflow="fold")
    made.add_column(overflow="fold")
    for name, text in rows:
        made.add_row(Text(name), Text(text))
    return made


def progress(tells_ends: bool = False) -> Progress | PipedProgress:
    """A progress bar on standard error, or a line now and then where that is no terminal.

    Args:
        tells_ends: Whether there are lines at the beginning and at the end too.
    """
    if not sys.stderr.isatty():
        return PipedProgress(sys.stderr, tells_ends)
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                    TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
                    console=Console(stderr=True))


FIRST_LINE, NEXT_LINE = 5.0, 30.0
"""Time until the first line of progress through a pipe, and from then on the longest between two
lines [s].
"""
_TENTH = 0.1
"""A line is printed too when so much more of the whole is done, at most every `FIRST_LINE`."""


class PipedProgress:
    """Progress as lines of text, for standard error that is no terminal.

    It has what is used of `rich.progress.Progress`. Work of less than some seconds prints nothing,
    or its beginning and its end.
    """

    def __init__(self, stream: TextIO, tells_ends: bool = False):
        """Begins to count the time.

        Args:
            stream: Where lines are printed.
            tells_ends: Whether there are lines at the beginning and at the end too.
        """
        self._stream, self._tells_ends, self._begin = stream, tells_ends, time.monotonic()
        self._printed_at, self._printed = self._begin, 0.0
        self._title, self._total, self._first, self._done, self._note = "", 0.0, 0.0, 0.0, ""

    def __enter__(self) -> PipedProgress:
        return self

    def __exit__(self, *_) -> None:
        if self._tells_ends:
            self._print()

    def add_task(self, description: str, total: float, completed: float = 0, note: str = "") -> int:
        """Begins the one task.

        Args:
            description: What is done.
            total: Number of its parts.
            completed: Parts that were done before.
            note: Text behind the numbers.
        """
        self._title, self._total, self._note = description, total, note
        self._first = self._done = self._printed = completed
        if self._tells_ends:
            self._print()
        return 0

    def update(self, task: int, *, advance: float = 0, completed: float | None = None,
               note: str | None = None) -> None:
        """Counts parts that are done, and prints a line if it is time.

        Args:
            task: What `add_task` returned.
            advance: Further parts that are done.
            completed: All parts that are done, in place of `advance`.
            note: Text behind the numbers.
        """
        self._done = self._done + advance if completed is None else completed
        self._note = self._note if note is None else note
        since = time.monotonic() - self._printed_at
        is_more = self._done - self._printed >= _TENTH * self._total
        is_first = self._printed == self._first
        if since >= NEXT_LINE or since >= FIRST_LINE and (is_more or is_first):
            self._print()

    def _print(self) -> None:
        now = time.monotonic()
        line = f"{self._title}: {self._done:g} of {self._total:g}"
        computed = self._done - self._first
        if computed > 0 and self._done < self._total:
            left = (now - self._begin) * (self._total - self._done) / computed
            line += f", {approximate_duration(left)} left"
        print(f"{line}, {self._note}" if self._note else line, file=self._stream, flush=True)
        self._printed_at, self._printed = now, self._done


def terminal_status(text: str) -> AbstractContextManager:
    """Shows an activity on standard error while it lasts; through a pipe a line if it is long.

    Args:
        text: What is done.
    """
    if sys.stderr.isatty():
        return Console(stderr=True).status(text)
    return _piped_status(text, sys.stderr)


@contextmanager
def _piped_status(text: str, stream: TextIO) -> Iterator[None]:
    """Prints a line when an activity takes some seconds."""
    timer = threading.Timer(FIRST_LINE, lambda: print(f"{text} …", file=stream, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def approximate_duration(seconds: float) -> str:
    """A duration as rounded text.

    Args:
        seconds: The duration [s].
    """
    if seconds < 90.0:
        return f"about {max(5, 5 * round(seconds / 5.0))} s"
    if seconds < 5400.0:
        return f"about {seconds / 60.0:.0f} minutes"
    return f"about {seconds / 3600.0:.1f} hours"


LONG_WORK = 30.0
"""Work that takes longer than this is announced [s]."""


def announce(seconds: float, what: str, shorter: str) -> None:
    """Says on standard error how long work takes about; nothing where that is short.

    Args:
        seconds: The estimate [s].
        what: The work, with the numbers that it depends on.
        shorter: What makes it shorter.
    """
    if seconds > LONG_WORK:
        print_to_stderr(f"{what}: {approximate_duration(seconds)} on this machine; {shorter}")


class FirstSteps:
    """Tells from the first steps of a run how long the whole takes."""

    _LEAST_STEPS, _LEAST_TIME = 5, 1.0

    def __init__(self, total: int, what: str, shorter: str,
                 tell: Callable[[float, str, str], None] = announce):
        """Begins to count the time.

        Args:
            total: Number of steps.
            what: What the steps are called.
            shorter: What makes the run shorter.
            tell: Tells the estimate.
        """
        self._total, self._what, self._shorter, self._tell = total, what, shorter, tell
        self._done, self._begin, self._is_told = 0, time.monotonic(), False

    def add(self, count: int = 1) -> None:
        """Counts steps that are done.

        Args:
            count: How many.
        """
        self._done += count
        if self._is_told or self._done < self._LEAST_STEPS:
            return
        elapsed = time.monotonic() - self._begin
        if elapsed >= self._LEAST_TIME:
            self._is_told = True
            each = elapsed / self._done
            self._tell(each * (self._total - self._done),
                       f"{self._total} {self._what} of {1e3 * each:.3g} ms", self._shorter)


def tracked(
    items: Iterable[Value], title: str, total: int, what: str, shorter: str,
    note: Callable[[Value], str] = lambda _: "",
) -> Iterator[Value]:  # fmt: skip
    """Items of long work, with its progress, and from the first ones how long the whole takes.

    Args:
        items: What is computed one by one; each is counted when the next one is asked for.
        title: What is done.
        total: Number of items.
        what: What they are called.
        shorter: What makes the work shorter.
        note: Text behind the numbers.
    """
    with progress() as bar:
        task = bar.add_task(title, total=total, note="")
        first = FirstSteps(total, what, shorter)
        for item in items:
            yield item
            bar.update(task, advance=1, note=note(item))
            first.add()


def print_to_stderr(text: str) -> None:
    """Prints a line on standard error, also when it is no terminal.

    Args:
        text: The line.
    """
    print(text, file=sys.stderr, flush=True)


def report_activity(text: str) -> None:
    """Prints the present activity on standard error.

    Args:
        text: What is done.
    """
    print_to_stderr(f"{text} …")


def warn(text: str) -> None:
    """One line of warning on standard error.

    Args:
        text: What is wrong.
    """
    print(f"warning: {printable_lines(text)}", file=sys.stderr)


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
        line = (f"{elapsed:6.1f} s  {phase:<11}  error {_thousandth(error, 'mm')}  "
                f"step {_thousandth(compute_time, 'ms')}  missed {missed_ticks}")
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


def _thousandth(value: float, unit: str) -> str:
    return f"   –   {unit}" if math.isnan(value) else f"{1e3 * value:6.2f} {unit}"
