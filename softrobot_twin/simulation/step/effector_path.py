"""The path of effectors on their way to targets, and the way back along it.

A robot that was caught, and was not freed by letting go, is led back through the places where its
effectors were.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from softrobot_twin.simulation.step.passed_places import MOST_PLACES
from softrobot_twin.simulation.step.situation import longest_move

# How far apart places are, as a share of the longest step of effectors; and steps that lead back to one.
APART, STEPS_TO_A_PLACE = 0.2, 10


class EffectorPath:
    """Places of effectors on the way to the same targets.

    Attributes:
        places: Places on the way [m], each of shape (effector_row_count,), at most `MOST_PLACES`.
        has_turned: Whether effectors are led back along it, or were.
        back: Places that are left on the way back [m], each of shape (effector_row_count,), the next one last.
    """

    def __init__(self, asking: slice, position_row_count: int, longest: float):
        """Nothing is passed yet.

        Args:
            asking: Rows of the effectors by which targets are the same as before.
            position_row_count: Number of the first rows, those of places; on the way back others are free.
            longest: Longest step of effectors [m].
        """
        self._asking, self._positions = asking, slice(position_row_count)
        self._apart, self._ones = APART * longest, np.ones(position_row_count)
        self._asked, self._since, self.has_turned = b"", 0, False
        self.places: deque[np.ndarray] = deque(maxlen=MOST_PLACES)
        self.back: deque[np.ndarray] = deque()

    def turn(self) -> None:
        """Lead effectors back from now on."""
        self.back, self.places, self.has_turned = self.places, deque(maxlen=MOST_PLACES), True

    def follow(self, now: np.ndarray, target_rows: np.ndarray) -> None:
        """Note where effectors are on their way; or go on to the place before, where they are led back.

        Args:
            now: Where they are [m], shape (effector_row_count,).
            target_rows: Wanted coordinates [m], same shape.
        """
        asked = target_rows[self._asking].tobytes()
        if asked != self._asked:
            self._asked, self.has_turned = asked, False
            if self.back:
                self.back.clear()
        path, positions, missed = self.back or self.places, self._positions, np.inf
        if path:
            missed = longest_move(now[positions], path[-1][positions], self._ones)
        is_near = missed <= self._apart
        if not self.back:
            if not is_near:
                place = now.copy()
                place[positions.stop :] = np.nan
                path.append(place)
            return
        self._since += 1
        if is_near or self._since >= STEPS_TO_A_PLACE:
            path.pop()
            self._since = 0
