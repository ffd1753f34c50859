"""The time of a step: how long its stages take, and what fits into a budget.

What fits is several Newton iterations, one, or only a correction with the factor of an earlier
step.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

# Weight of the newest duration in what a linearization is expected to take.
NEWEST = 0.2
# In overload no whole linearization is measured; its expected time shrinks by this factor in each
# step, so that one is tried again now and then.
OPTIMISM = 0.99
# Most linearizations of a step under a budget.
MOST_ITERATIONS = 50


class TimeBudget:
    """Learns how long a linearization takes, and decides by it what fits into a step.

    Attributes:
        expected: Time that a whole linearization and what follows it should take [s].
    """

    def __init__(self):
        """Know nothing yet: the first step is never cut short."""
        self.expected = 0.0

    def learn(self, duration: float) -> None:
        """Take in how long a whole linearization took [s]."""
        known = self.expected if self.expected > 0.0 else duration
        self.expected = known + NEWEST * (duration - known)

    def must_hurry(self, budget: float | None) -> bool:
        """Say whether even one whole linearization would be late.

        Args:
            budget: Time for the step [s], or None without a limit.

        Returns:
            True in overload.
        """
        if budget is None or self.expected <= budget:
            return False
        self.expected *= OPTIMISM
        return True

    def has_time(
        self, iterations: int, elapsed: float, budget: float | None, most: int
    ) -> bool:
        """Say whether one more linearization fits.

        Args:
            iterations: Linearizations done in this step.
            elapsed: Time since it began [s].
            budget: Time for the step [s], or None: then only `most` counts.
            most: Most linearizations in a step without a budget.

        Returns:
            True when there is time.
        """
        if budget is None:
            return iterations < most
        return iterations < MOST_ITERATIONS and elapsed + self.expected <= budget


class StageClock:
    """Adds up the time that each stage of a step takes.

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
