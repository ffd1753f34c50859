"""Clocks that are set: told, and kept from what counts elapsed time."""

from __future__ import annotations

from collections.abc import Callable

NANOSECONDS = 1_000_000_000
STEP = 0.1
"""What a clock is off by when it was set and not merely slewed [s]: slewing changes it by some
0.0005 s a second, and two readings may lie a few milliseconds apart on a busy machine."""


class ClockWatch:
    """Tells when a clock that may be set was, by comparing it with one that never goes back."""

    def __init__(self) -> None:
        self._offset: float | None = None

    def step(self, settable: int, time: float) -> float:
        """How far the clock was set since the last look.

        Args:
            settable: The clock that may be set [ns].
            time: The clock that never goes back, read at the same moment [s].

        Returns:
            The step [s], positive when set ahead; 0 when it was not set, or at the first look.
        """
        offset = settable / NANOSECONDS - time
        before, self._offset = self._offset, offset
        if before is None or abs(offset - before) < STEP:
            return 0.0
        return offset - before


class ElapsedTime:
    """Seconds that never go back, from a clock that may be paused or set back.

    A step ahead counts as time that passed: what timed out meanwhile did. A step back counts as
    none. A clock at zero has not begun.

    Args:
        clock: The clock, such as simulated time [ns].
    """

    def __init__(self, clock: Callable[[], int]):
        self._clock = clock
        self._last = self._elapsed = 0

    def __call__(self) -> float:
        """Time that passed since the clock began [s]."""
        now = self._clock()
        if self._last:
            self._elapsed += max(0, now - self._last)
        self._last = now
        return self._elapsed / NANOSECONDS
