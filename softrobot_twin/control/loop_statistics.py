"""What the loop took, over its last ticks. Fixed memory, whatever the length of the run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class LoopSummary(NamedTuple):
    """The last ticks in figures, all in seconds; NaN before the first tick.

    Attributes:
        period_mean: Mean time between the starts of two ticks [s].
        period_max: Longest time between the starts of two ticks [s].
        compute_p50: Median time of a tick's work [s].
        compute_p99: 99th percentile of it [s].
        compute_max: Longest [s].
    """

    period_mean: float
    period_max: float
    compute_p50: float
    compute_p99: float
    compute_max: float


class LoopStatistics:
    """A ring of the periods and compute times of the last ticks.

    Args:
        capacity: Ticks remembered.
    """

    def __init__(self, capacity: int = 1024):
        self._periods = np.full(capacity, np.nan)
        self._compute_times = np.full(capacity, np.nan)
        self._next = 0
        self._filled = 0

    def record(self, period: float, compute_time: float) -> None:
        """Adds one tick [s, s], in the place of the oldest. The first tick's period is NaN."""
        self._periods[self._next] = period
        self._compute_times[self._next] = compute_time
        self._next = (self._next + 1) % len(self._periods)
        self._filled = min(self._filled + 1, len(self._periods))

    def summary(self) -> LoopSummary:
        """The remembered ticks in figures."""
        compute_times = self._compute_times[: self._filled]
        periods = self._periods[: self._filled]
        periods = periods[np.isfinite(periods)]
        if not len(compute_times):
            return LoopSummary(*[float("nan")] * 5)
        p50, p99 = np.percentile(compute_times, (50, 99))
        return LoopSummary(
            float(periods.mean()) if len(periods) else float("nan"),
            float(periods.max()) if len(periods) else float("nan"),
            float(p50),
            float(p99),
            float(compute_times.max()),
        )

    def clear(self) -> None:
        """Forgets every tick."""
        self._next = self._filled = 0
