"""Where the model had the markers a moment ago: a measurement is always a little old."""

from __future__ import annotations

import numpy as np


class MarkerHistory:
    """A ring of the model's markers at its last ticks.

    A camera, its network and a device's own delay make measured markers late. Compared with the
    markers of the same moment they tell the model's error; compared with those of now they would
    tell mostly how fast the robot moves, and correcting that would make the loop swing.

    Args:
        marker_count: Markers of the scene.
        capacity: Ticks remembered.
    """

    def __init__(self, marker_count: int, capacity: int = 256):
        self._times = np.zeros(capacity, dtype=np.int64)
        self._markers = np.empty((capacity, marker_count, 3))
        self._count = 0

    def add(self, time: int, markers: np.ndarray) -> None:
        """Remembers a tick, in the place of the oldest.

        Args:
            time: Time of the tick [ns]; a clock that was set back begins a new history.
            markers: Markers of the model [m], shape (marker_count, 3).
        """
        capacity = len(self._times)
        if self._count and time < self._times[(self._count - 1) % capacity]:
            self._count = 0
        self._times[self._count % capacity] = time
        self._markers[self._count % capacity] = markers
        self._count += 1

    def at(self, time: int) -> np.ndarray:
        """Markers of the model at a time [ns], between two ticks on a straight line.

        Before the oldest tick they are those of the oldest, after the newest those of the newest.

        Returns:
            Positions [m], shape (marker_count, 3).

        Raises:
            LookupError: No tick is remembered yet.
        """
        if not self._count:
            raise LookupError("no tick is remembered yet")
        capacity = len(self._times)
        filled = min(self._count, capacity)
        order = np.arange(self._count - filled, self._count) % capacity
        times = self._times[order]
        after = int(np.searchsorted(times, time))
        if after == 0:
            return self._markers[order[0]].copy()
        if after == filled:
            return self._markers[order[-1]].copy()
        left, right = order[after - 1], order[after]
        share = (time - self._times[left]) / (self._times[right] - self._times[left])
        return (1.0 - share) * self._markers[left] + share * self._markers[right]

    def forget(self) -> None:
        """Begins a new history."""
        self._count = 0
