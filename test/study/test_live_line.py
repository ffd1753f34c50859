"""The status line of the demo, through a pipe."""

import io
import math

import pytest

from softrobot_twin.study import terminal
from softrobot_twin.study.terminal import LiveLine


@pytest.fixture
def line(monkeypatch):
    """A line, its stream, and a clock that a test controls."""
    clock = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: clock[0])
    stream = io.StringIO()
    return LiveLine(stream), stream, clock


def test_a_line_is_printed_at_intervals_and_at_each_phase(line):
    live, stream, clock = line
    for tick in range(100):
        clock[0] = 0.1 * tick
        live.show(clock[0], "open loop" if tick < 50 else "closed loop", 0.003, math.nan, 2)
    told = stream.getvalue().splitlines()
    assert len(told) == 2
    assert "error   3.00 mm" in told[0] and "missed 2" in told[0] and "cause" not in told[0]


def test_the_first_cause_of_a_large_error_is_printed_at_once(line):
    live, stream, clock = line
    for tick in range(20):
        clock[0] = 0.1 * tick
        live.show(clock[0], "open loop", 0.023, 0.001, 0, "late: 40 of 100 ticks" * (tick > 5))
    told = stream.getvalue().splitlines()
    assert len(told) == 2
    assert told[1].endswith("missed 0  cause: late: 40 of 100 ticks")
