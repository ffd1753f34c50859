"""Time in the loop: the grid of ticks, changes of clocks, statistics, garbage collection.

Late ticks are skipped and counted, never queued. All memory is fixed.
"""

from __future__ import annotations

import gc
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

NANOSECONDS = 1_000_000_000
CLOCK_STEP = 0.1
"""One of two clocks was set when their difference changes by at least this [s]. Slewing changes a
clock by about 0.0005 s per second, and on a busy machine some milliseconds may pass between the
readings of the two clocks."""


class LoopSummary(NamedTuple):
    """Statistics of the last ticks, all in seconds; NaN before the first tick.

    Attributes:
        period_mean: Mean time between the starts of two ticks [s].
        period_max: Longest time between the starts of two ticks [s].
        compute_p50: Median duration of a tick's work [s].
        compute_p99: Its 99th percentile [s].
        compute_max: Its maximum [s].
    """

    period_mean: float
    period_max: float
    compute_p50: float
    compute_p99: float
    compute_max: float


class LoopStatistics:
    """A ring buffer with the periods and compute times of the last 1024 ticks."""

    def __init__(self):
        self._ticks: deque[tuple[float, float]] = deque(maxlen=1024)

    def record(self, period: float, compute_time: float) -> None:
        """Adds one tick [s, s] in place of the oldest. The first tick's period is NaN.

        Args:
            period: Time since the tick before [s].
            compute_time: How long its work took [s].
        """
        self._ticks.append((period, compute_time))

    def summary(self) -> LoopSummary:
        """Statistics of the kept ticks."""
        nan = float("nan")
        if not self._ticks:
            return LoopSummary(nan, nan, nan, nan, nan)
        periods, compute_times = np.array(self._ticks).T
        periods = periods[np.isfinite(periods)]
        mean, longest = (periods.mean(), periods.max()) if len(periods) else (nan, nan)
        p50, p99 = np.percentile(compute_times, (50, 99))
        return LoopSummary(*map(float, (mean, longest, p50, p99, compute_times.max())))

    def clear(self) -> None:
        """Forgets all ticks."""
        self._ticks.clear()


class TickClock:
    """Counts ticks, skips and misses against a fixed time grid.

    A late timer returns to its grid and drops the grid points that it missed, without reporting
    them. They are counted here by the time of its next call, which increases by one period from
    tick to tick when nothing was missed.

    Args:
        period: Distance of two grid points [s].
        clock: Monotonic clock of the grid [s].
        stopwatch: Monotonic clock for the duration of the work [s], because simulated time does not
            advance during a tick. When omitted, `clock`.

    Attributes:
        ticks: Ticks begun.
        skipped: Grid points without a tick.
        missed: Ticks whose work was not finished before the next grid point.
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
        """Starts a new grid; the counts continue.

        Args:
            period: Time between two ticks [s].
        """
        self.period = period
        self._due_next: float | None = None
        self._began: float | None = None
        self._until_next = self._work_began = 0.0
        self._period_measured = float("nan")
        self.statistics.clear()

    def now(self) -> float:
        """Time on the clock of the ticks [s]."""
        return self._clock()

    def begin(self, until_next: float) -> float:
        """Marks the start of a tick.

        Args:
            until_next: Time until the next call of the timer [s].

        Returns:
            The time now, on the clock of the ticks [s].
        """
        now = self.now()
        due_next = now + until_next
        if self._due_next is not None:
            self.skipped += max(0, round((due_next - self._due_next) / self.period) - 1)
        self._period_measured = float("nan") if self._began is None else now - self._began
        self._due_next, self._began = due_next, now
        self._until_next, self._work_began = until_next, self._stopwatch()
        self.ticks += 1
        return now

    def end(self) -> float:
        """Marks the end of the work of the tick that `begin` started.

        Returns:
            Time left to the next grid point [s]; negative when the tick missed it.
        """
        compute_time = self._stopwatch() - self._work_began
        spare_time = self._until_next - compute_time
        self.missed += spare_time < 0.0
        self.statistics.record(self._period_measured, compute_time)
        return spare_time


class ClockWatch:
    """Detects when a clock was set, by comparison with a monotonic clock."""

    def __init__(self) -> None:
        self._offset: float | None = None

    def step(self, settable: int, time: float) -> float:
        """How far the clock was set since the last call.

        Args:
            settable: The clock that may be set [ns].
            time: The monotonic clock, read at the same moment [s].

        Returns:
            The step [s], positive when set forward; 0 when it was not set, and at the first call.
        """
        offset = settable / NANOSECONDS - time
        before, self._offset = self._offset, offset
        if before is None or abs(offset - before) < CLOCK_STEP:
            return 0.0
        return offset - before


class ElapsedTime:
    """Monotonic time [s] from a clock that may be paused or set back.

    A step forward counts as elapsed time, so that timeouts expire. A step back counts as no time. A
    clock at zero has not started.

    Args:
        clock: The clock, such as simulated time [ns].
    """

    def __init__(self, clock: Callable[[], int]):
        self._clock = clock
        self._last = self._elapsed = 0

    def __call__(self) -> float:
        """Time elapsed since the clock started [s]."""
        now = self._clock()
        if self._last:
            self._elapsed += max(0, now - self._last)
        self._last = now
        return self._elapsed / NANOSECONDS


# After this time without enough spare time garbage is collected in any case [s].
LONGEST_WAIT = 60.0


class GarbageCollection:
    """Collects garbage only when a tick leaves enough time for it.

    It is a context manager: inside the context, Python's automatic collection is off, and the
    objects that exist at its start are excluded, so that a collection examines newer objects only.

    Args:
        interval: Least time between two collections [s].
    """

    def __init__(self, interval: float = 1.0):
        self._interval, self._last = interval, time.monotonic()
        self._duration, self._was_enabled = 0.0, True

    def __enter__(self) -> GarbageCollection:
        self._was_enabled = gc.isenabled()
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(self, *exception: object) -> None:
        gc.unfreeze()
        if self._was_enabled:
            gc.enable()

    def offer(self, spare_time: float) -> bool:
        """Collects when it is due and twice the duration of the last collection fits.

        Args:
            spare_time: Time left before the next tick [s].

        Returns:
            True when it collected.
        """
        began = time.monotonic()
        waited = began - self._last
        if waited < self._interval:
            return False
        fits = spare_time > 2.0 * self._duration and spare_time > 0.0
        if not fits and waited < LONGEST_WAIT:
            return False
        gc.collect()
        self._last = time.monotonic()
        self._duration = self._last - began
        return True
