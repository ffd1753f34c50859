"""The time of a step: duration of its stages, and number of linearizations within a budget.

A budget allows several Newton iterations, one, or only a correction with the factor of an earlier
step.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

# Weight of the newest duration in the expected duration of a linearization.
NEWEST = 0.2
# In overload no whole linearization is measured; its expected time shrinks by this factor in each
# step, so that one is tried again from time to time.
OPTIMISM = 0.99
# Most linearizations of a step under a budget.
MOST_ITERATIONS = 50


class TimeBudget:
    """Measures the duration of a linearization, and decides how many fit into a step.

    Attributes:
        expected: Expected time of a whole linearization and the stages after it [s].
    """

    def __init__(self):
        """No duration is known yet: the first step is not shortened."""
        self.expected = 0.0

    def learn(self, duration: float) -> None:
        """Record the duration of a whole linearization [s].

        Args:
            duration: The duration [s].
        """
        known = self.expected if self.expected > 0.0 else duration
        self.expected = known + NEWEST * (duration - known)

    def must_hurry(self, budget: float | None) -> bool:
        """Whether even one whole linearization would be late.

        Args:
            budget: Time for the step [s], or None without a limit.

        Returns:
            True in overload.
        """
        if budget is None or self.expected <= budget:
            return False
        self.expected *= OPTIMISM
        return True

    def has_time(self, iterations: int, elapsed: float, budget: float | None, most: int) -> bool:
        """Whether one more linearization fits.

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
    """Measures the time that each stage of a step takes."""

    def __init__(self, now: Callable[[], float] = perf_counter):
        """Start now.

        Args:
            now: Gives the time [s].
        """
        self._now, self._marks = now, []
        self._start = self._last = now()

    def mark(self, stage: str) -> None:
        """Book the time since the last mark to `stage`.

        Args:
            stage: Name of the stage.
        """
        self._last = self._now()
        self._marks.append((stage, self._last))

    @property
    def times(self) -> dict[str, float]:
        """Time of each stage so far [s]; repeated stages add up."""
        times: dict[str, float] = {}
        before = self._start
        for stage, now in self._marks:
            times[stage] = times.get(stage, 0.0) + now - before
            before = now
        return times

    @property
    def total(self) -> float:
        """Time from the start to the last mark [s]."""
        return self._last - self._start
