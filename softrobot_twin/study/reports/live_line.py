"""One line that lives: rewritten in place on a terminal, a line now and then through a pipe."""

from __future__ import annotations

import math
import sys
import time

from rich.live import Live
from rich.text import Text

from softrobot_twin.study.reports.terminal import console

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
