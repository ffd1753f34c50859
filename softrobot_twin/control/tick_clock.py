"""Where the loop stands on its time grid: late ticks are skipped and counted, never queued."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

from softrobot_twin.control.loop_statistics import LoopStatistics


class Tick(NamedTuple):
    """One tick, when its work is done.

    Attributes:
        skipped: Grid points since the last tick that had no tick of their own.
        compute_time: Time of the work [s].
        missed: True when the work was not done before the next grid point.
        slack: Time left to the next grid point [s]; negative when missed.
    """

    skipped: int
    compute_time: float
    missed: bool
    slack: float


class TickClock:
    """Counts ticks, skips and misses against a fixed grid.

    A timer that was late falls back onto its grid and drops what it missed; it does not tell.
    What tells is when it is due next: between two ticks that must move by one period.

    Args:
        period: Distance of two grid points [s].
        clock: Seconds that never go back, on which the grid lies.
        stopwatch: Seconds of this machine, for the time of the work: simulated time stands still
            meanwhile. Without one, `clock`.

    Attributes:
        ticks: Ticks begun.
        skipped: Grid points without a tick.
        missed: Ticks whose work was not done before the next grid point.
        statistics: Periods and compute times of the last ticks.
    """

    def __init__(
        self,
        period: float,
        clock: Callable[[], float] = time.monotonic,
        stopwatch: Callable[[], float] | None = None,
    ):
        self.statistics = LoopStatistics()
        self.ticks = self.skipped = self.missed = 0
        self._clock = clock
        self._stopwatch = stopwatch or clock
        self.restart(period)

    def restart(self, period: float) -> None:
        """Takes up a new grid; the counts go on."""
        self.period = period
        self._due_next: float | None = None
        self._began: float | None = None
        self._until_next = self._work_began = 0.0
        self._period_measured = float("nan")
        self._skipped_now = 0
        self.statistics.clear()

    def now(self) -> float:
        """Time on the clock of the ticks [s]."""
        return self._clock()

    def begin(self, until_next: float) -> float:
        """Marks the start of a tick.

        Args:
            until_next: Time until the timer is due again [s].

        Returns:
            The time now, on the clock of the ticks [s].
        """
        now = self.now()
        due_next = now + until_next
        self._skipped_now = 0
        if self._due_next is not None:
            self._skipped_now = max(0, round((due_next - self._due_next) / self.period) - 1)
        self._period_measured = float("nan") if self._began is None else now - self._began
        self._due_next, self._began = due_next, now
        self._until_next, self._work_began = until_next, self._stopwatch()
        self.ticks += 1
        self.skipped += self._skipped_now
        return now

    def end(self) -> Tick:
        """Marks the end of the work of the tick that `begin` started."""
        if self._began is None:
            raise RuntimeError("end() without begin()")
        compute_time = self._stopwatch() - self._work_began
        slack = self._until_next - compute_time
        missed = slack < 0.0
        self.missed += missed
        self.statistics.record(self._period_measured, compute_time)
        return Tick(self._skipped_now, compute_time, missed, slack)
