"""Time of each stage of a step."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter


class StageClock:
    """Books the time since the last mark on a named stage.

    Attributes:
        times: Time of each stage so far [s]; repeated stages add up.
    """

    def __init__(self, now: Callable[[], float] = perf_counter):
        """Start now.

        Args:
            now: Gives the time [s].
        """
        self.times: dict[str, float] = {}
        self._now = now
        self._start = self._last = now()

    def mark(self, stage: str) -> None:
        """Book the time since the last mark on `stage`."""
        now = self._now()
        self.times[stage] = self.times.get(stage, 0.0) + now - self._last
        self._last = now

    @property
    def total(self) -> float:
        """Time from the start to the last mark [s]."""
        return self._last - self._start
