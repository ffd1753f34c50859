"""The clock of a simulation whose readings decide how many linearizations a step makes."""

from __future__ import annotations

from time import perf_counter


class RecordedClock:
    """Reads the clock and keeps the readings of a tick."""

    def __init__(self) -> None:
        self._readings: list[float] = []

    def __call__(self) -> float:
        reading = perf_counter()
        self._readings.append(reading)
        return reading

    def take(self) -> list[float]:
        """The readings since the last call of this function [s]."""
        taken, self._readings = self._readings, []
        return taken


class PlayedClock:
    """Gives recorded readings again; before the first tick it reads the clock.

    A step of another scene may read it more often than the recorded one. It then goes on by the
    mean time from reading to reading, as if each stage took as long as those that were recorded.
    """

    def __init__(self) -> None:
        self._readings: list[float] | None = None
        self._place, self._mean = 0, 0.0

    def play(self, readings: list[float]) -> None:
        """Gives these readings from now on [s].

        Args:
            readings: The readings in their order [s].
        """
        self._readings, self._place = readings, 0
        if len(readings) > 1:
            self._mean = (readings[-1] - readings[0]) / (len(readings) - 1)

    def __call__(self) -> float:
        readings = self._readings
        if readings is None:
            return perf_counter()
        place, self._place = self._place, self._place + 1
        if place < len(readings):
            return readings[place]
        last = readings[-1] if readings else 0.0
        return last + (place + 1 - len(readings)) * self._mean
