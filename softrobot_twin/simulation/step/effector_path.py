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
        has_turned: Whether effectors are led back along it, or were.
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
        self._places: deque[np.ndarray] = deque(maxlen=MOST_PLACES)
        self._back: deque[np.ndarray] = deque()

    @property
    def leads_back(self) -> bool:
        """Whether effectors are led back along it."""
        return bool(self._back)

    def turn(self) -> None:
        """Lead effectors back from now on."""
        self._back, self._places, self.has_turned = self._places, deque(maxlen=MOST_PLACES), True

    def clear(self) -> None:
        """Forget the places on the way."""
        self._places.clear()

    def follow(self, now: np.ndarray, target_rows: np.ndarray) -> None:
        """Note where effectors are on their way; or go on to the place before, where they are led back.

        Args:
            now: Where they are [m], shape (effector_row_count,).
            target_rows: Wanted coordinates [m], same shape.
        """
        asked = target_rows[self._asking].tobytes()
        if asked != self._asked:
            self._asked, self.has_turned = asked, False
            self._back.clear()
        path, positions, missed = self._back or self._places, self._positions, np.inf
        if path:
            missed = longest_move(now[positions], path[-1][positions], self._ones)
        is_near = missed <= self._apart
        if not self._back:
            if not is_near:
                place = now.copy()
                place[positions.stop :] = np.nan
                path.append(place)
            return
        self._since += 1
        if is_near or self._since >= STEPS_TO_A_PLACE:
            path.pop()
            self._since = 0

    def rows(self, target_rows: np.ndarray) -> np.ndarray:
        """Where effectors are led: to the place before, or to their targets [m], shape (effector_row_count,).

        Args:
            target_rows: The targets [m], same shape.
        """
        return self._back[-1] if self._back else target_rows
