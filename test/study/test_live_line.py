"""The status line of the demo, through a pipe."""

import io
import math

import pytest

from softrobot_twin.study import terminal
from softrobot_twin.study.terminal import LiveLine


@pytest.fixture
def line(monkeypatch):
    """A line, its stream, and a clock that a test controls [s]."""
    clock = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: clock[0])
    stream = io.StringIO()
    return LiveLine(stream), stream, clock


def test_a_line_is_printed_at_intervals_at_each_phase_and_at_the_first_cause(line):
    live, stream, clock = line
    for tick in range(100):
        clock[0] = 0.125 * tick
        phase = "open loop" if tick < 24 else "closed loop"
        live.show(clock[0], phase, 0.003, math.nan, 2, "late: 40 of 100 ticks" * (tick >= 36))
    rest = "error   3.00 mm  step    –   ms  missed 2"
    assert stream.getvalue().splitlines() == [
        f"   0.0 s  open loop    {rest}",
        f"   3.0 s  closed loop  {rest}",
        f"   4.5 s  closed loop  {rest}  cause: late: 40 of 100 ticks",
        f"   9.5 s  closed loop  {rest}  cause: late: 40 of 100 ticks",
    ]
