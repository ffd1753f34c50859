"""Progress through a pipe, and tables."""

import io
import sys

import pytest

from softrobot_twin.harness import terminal
from softrobot_twin.harness.terminal import PipedProgress, console, table

pytestmark = pytest.mark.libraries


@pytest.fixture
def clock(monkeypatch):
    """A clock that a test controls [s]."""
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(("total", "step_time", "count", "completed", "line_count", "told"), [
    (1000, 0.004, 1000, 0, 0, {}),  # a short run
    (1000, 0.125, 1000, 0, 10, {0: "robot: 40 of 1000, about 2 minutes left, ok",
                                5: "robot: 540 of 1000, about 60 s left, ok"}),
    (100_000, 0.125, 3000, 0, 13, {1: "robot: 280 of 100000, about 3.5 hours left, ok"}),
    (1000, 1.0, 6, 500, 1, {0: "robot: 505 of 1000, about 8 minutes left, ok"}),  # goes on
])  # fmt: skip
def test_a_long_run_prints_a_line_for_each_tenth_or_half_minute_with_the_time_left(
    clock, total, step_time, count, completed, line_count, told
):
    stream = io.StringIO()
    lines = PipedProgress("robot", total, completed, stream)
    for _ in range(count):
        clock[0] += step_time
        lines.add(1, "ok")
    lines = stream.getvalue().splitlines()
    assert len(lines) == line_count
    assert {place: lines[place] for place in told} == told


def test_an_activity_that_takes_long_is_named_through_a_pipe(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(terminal, "FIRST_LINE", 0.0)
    monkeypatch.setattr(sys, "stderr", stream)
    with terminal.terminal_status("building the scene"):
        for thread in terminal.threading.enumerate():
            if isinstance(thread, terminal.threading.Timer):
                thread.join()
    assert stream.getvalue() == "building the scene …\n"


@pytest.mark.parametrize("is_tty", [False, True])
def test_units_and_names_in_brackets_are_printed(monkeypatch, is_tty):
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: is_tty, raising=False)
    made = table("Places [mm]", "effector", "x [mm]", "median [ms]", piped=not is_tty)
    made.add_row("a [red] tip", "1", "2")
    console(stream).print(made)
    console(stream).print("my [new] robot.yaml")
    for text in ("Places [mm]", "x [mm]", "median [ms]", "a [red] tip", "my [new] robot.yaml"):
        assert text in stream.getvalue()
