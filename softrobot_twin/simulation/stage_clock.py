"""Time of each stage of a step."""

from __future__ import annotations

from time import perf_counter


class StageClock:
    """Books the time since the last mark on a named stage.

    Attributes:
        times: Time of each stage so far [s]; repeated stages add up.
    """

    def __init__(self):
        """Start now."""
        self.times: dict[str, float] = {}
        self._start = self._last = perf_counter()

    def mark(self, stage: str) -> None:
        """Book the time since the last mark on `stage`."""
        now = perf_counter()
        self.times[stage] = self.times.get(stage, 0.0) + now - self._last
        self._last = now

    @property
    def total(self) -> float:
        """Time from the start to the last mark [s]."""
        return self._last - self._start
