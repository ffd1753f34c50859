"""What fits into the time of a step: more Newton iterations, one, or only a stale factor."""

from __future__ import annotations

# Weight of the newest duration in what a linearization is expected to take.
NEWEST = 0.2
# In overload nobody measures a whole linearization; its expected time shrinks by this factor a
# step, so that it is tried again now and then.
OPTIMISM = 0.99
# Under a budget no more than so many linearizations make sense.
MOST_ITERATIONS = 50


class Pace:
    """Learns what a linearization takes, and decides by it.

    Attributes:
        expected: Time that a whole linearization and what follows it should take [s].
    """

    def __init__(self):
        """Know nothing: the first step is never cut short."""
        self.expected = 0.0

    def learn(self, duration: float) -> None:
        """Take in what a whole linearization took [s]."""
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
