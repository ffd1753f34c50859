"""Output on a terminal or through a pipe: tables, progress, durations, warnings, a status line."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TextIO, TypeVar

from rich import box
from rich.console import Console
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


def table(title: str, *columns: str, rows: Iterable[Iterable[str]] = (), piped: bool | None = None) -> Table:
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


def listing(title: str, rows) -> Table:
    """Rows of a name and a text without a frame; on a terminal long texts go on below themselves.

    Args:
        title: The title above.
        rows: Name and text of each row.
    """
    plain = not sys.stdout.isatty()
    made = Table(title=title, title_justify="left", title_style="" if plain else "bold",
                 box=None, show_header=False, padding=(0, 0, 0, 2), min_width=len(title) + 2)
    made.add_column(max_width=None if plain or all(not text for _, text in rows) else _KEYS,
                    style="" if plain else "cyan", overflow="fold")
    made.add_column(overflow="fold")
    for name, text in rows:
        made.add_row(Text(name), Text(text))
    return made


@contextmanager
def progress(
    title: str, total: float, done: float = 0, tells_ends: bool = False
) -> Iterator[Callable[[float, str], None]]:
    """A progress bar on standard error, or a line now and then where that is no terminal.

    Args:
        title: What is done.
        total: Number of its parts.
        done: Parts that were done before.
        tells_ends: Whether there are lines at the beginning and at the end too.

    Yields:
        A function that counts further parts, with a text behind the numbers.
    """
    if sys.stderr.isatty():
        with Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
                      TimeRemainingColumn(), TextColumn("{task.fields[note]}"),
                      console=Console(stderr=True)) as bar:
            task = bar.add_task(title, total=total, completed=done, note="")
            yield lambda count, note: bar.update(task, advance=count, note=note)
        return
    lines = PipedProgress(title, total, done, sys.stderr)
    if tells_ends:
        lines.show()
    try:
        yield lines.add
    finally:
        if tells_ends:
            lines.show()


FIRST_LINE, NEXT_LINE = 5.0, 30.0
"""Time until the first line of progress through a pipe, and from then on the longest between two
lines [s].
"""
_TENTH = 0.1
"""A line is printed too when so much more of the whole is done, at most every `FIRST_LINE`."""


class PipedProgress:
    """Progress as lines of text, for standard error that is no terminal.

    Work of less than some seconds prints nothing.
    """

    def __init__(self, title: str, total: float, done: float, stream: TextIO):
        """Begins to count the time.

        Args:
            title: What is done.
            total: Number of its parts.
            done: Parts that were done before.
            stream: Where lines are printed.
        """
        self._title, self._total, self._stream, self._note = title, total, stream, ""
        self._first = self._done = self._shown = done
        self._begin = self._shown_at = time.monotonic()

    def add(self, count: float, note: str) -> None:
        """Counts parts that are done, and prints a line if it is time.

        Args:
            count: Further parts that are done.
            note: Text behind the numbers.
        """
        self._done, self._note = self._done + count, note
        since = time.monotonic() - self._shown_at
        is_more = self._done - self._shown >= _TENTH * self._total
        is_first = self._shown == self._first
        if since >= NEXT_LINE or since >= FIRST_LINE and (is_more or is_first):
            self.show()

    def show(self) -> None:
        """Prints a line, with the time left where parts were done since the beginning."""
        now = time.monotonic()
        line = f"{self._title}: {self._done:g} of {self._total:g}"
        computed = self._done - self._first
        if computed > 0 and self._done < self._total:
            left = (now - self._begin) * (self._total - self._done) / computed
            line += f", {approximate_duration(left)} left"
        print(f"{line}, {self._note}" if self._note else line, file=self._stream, flush=True)
        self._shown_at, self._shown = now, self._done


@contextmanager
def terminal_status(text: str) -> Iterator[None]:
    """Shows an activity on standard error while it lasts; through a pipe a line if it is long.

    Args:
        text: What is done.
    """
    if sys.stderr.isatty():
        with Console(stderr=True).status(text):
            yield
        return
    stream = sys.stderr
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


def tracked(
    items: Iterable[Value], title: str, total: int, note: Callable[[Value], str] = lambda _: ""
) -> Iterator[Value]:
    """Items of long work, with its progress.

    Args:
        items: What is computed one by one; each is counted when the next one is asked for.
        title: What is done.
        total: Number of items.
        note: Text behind the numbers.
    """
    with progress(title, total) as count:
        for item in items:
            yield item
            count(1, note(item))


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
"""Time between two lines through a pipe [s]."""


@contextmanager
def live_line() -> Iterator[Callable[[str, bool], None]]:
    """One line on standard error that changes; through a pipe a line now and then.

    Yields:
        A function that shows a text, through a pipe at once if that is asked for.
    """
    if sys.stderr.isatty():
        with Console(stderr=True).status("") as line:
            yield lambda text, at_once: line.update(Text(text, no_wrap=True, overflow="crop"))
        return
    shown_at = -math.inf

    def show(text: str, at_once: bool) -> None:
        nonlocal shown_at
        now = time.monotonic()
        if at_once or now - shown_at >= _PIPED_PERIOD:
            shown_at = now
            print_to_stderr(text)

    yield show
