"""Which of the frames go on, when not all of them are wanted."""

from __future__ import annotations

import time
from collections.abc import Callable


class EveryNth:
    """Lets through the first of every so many frames."""

    def __init__(self, interval: int):
        self._interval = interval
        self._count = 0

    def wants_next(self) -> bool:
        """Whether the frame that has come now goes on."""
        wanted = self._count == 0
        self._count = (self._count + 1) % self._interval
        return wanted


class AtMost:
    """Lets frames through up to a rate, which holds in the mean although frames come unevenly.

    Args:
        rate: Frames a second.
        clock: Present time [s].
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic):
        self._period = 1.0 / rate
        self._clock = clock
        self._due = clock()

    def wants_next(self) -> bool:
        """Whether the frame that has come now goes on."""
        now = self._clock()
        if now < self._due:
            return False
        # The next one is due on the grid, or a period from now when the grid has been lost.
        missed = now - self._due > self._period
        self._due = (now if missed else self._due) + self._period
        return True
