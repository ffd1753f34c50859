"""What is tried, one thing in each step, where friction lets effectors come no nearer."""

from __future__ import annotations

from enum import Enum

import numpy as np

# A detour is made at once where squares of misses would fall below the first share, else where they
# would fall below the second one. After so many in vain, none is tried.
NEARER, WORTH, MOST_IN_VAIN = 0.1, 0.5, 3


class Turn(Enum):
    """What a step tries."""

    STRAIGHT = "the optimum by what contacts do now"
    PROBE = "the optimum by what they do after a move of one actuator"
    DETOUR = "whether it is nearer to go somewhere else first, and back"


class Detours:
    """What is tried, one thing in each step, where the effectors come no nearer.

    Attributes:
        probe: Which move is tried.
        detour: Which move is tried as a detour.
        choices: Number of moves that may be tried.
        is_stalled: Whether the last step brought effectors hardly nearer.
    """

    def __init__(self, looks: bool):
        """Begin with nothing tried.

        Args:
            looks: Whether anything but the optimum by what contacts do now is tried.
        """
        self._looks = looks
        self.forget()

    def forget(self) -> None:
        """Begin anew, with other targets."""
        self.probe = self.detour = self.choices = self._turn = self._vain = 0
        self.is_stalled, self._least, self._goal, self._before = False, np.inf, None, np.inf

    def next(self) -> Turn:
        """What the next step tries."""
        if not (self._looks and self.is_stalled):
            return Turn.STRAIGHT
        self._turn = (self._turn + 1) % 3
        turn = tuple(Turn)[self._turn]
        if turn is Turn.PROBE:
            self.probe += 1
        if turn is Turn.DETOUR:
            if self._vain >= MOST_IN_VAIN:
                return Turn.STRAIGHT
            self.detour += 1
        return turn

    def judge(self, goal: np.ndarray, left: float, before: float) -> np.ndarray | None:
        """Choose a detour, at once where it leads much nearer, else when all were tried.

        Args:
            goal: Where it leads, displacements of the actuators, shape (actuator_count,).
            left: What is missed after it, by the linearization [m²].
            before: What is missed now [m²].

        Returns:
            Where to go; None to stay.
        """
        if left < self._least:
            self._least, self._goal = left, goal
        is_tried = self.choices and self.detour % self.choices == 0
        if self._least > NEARER * before and not is_tried:
            return None
        least, goal = self._least, self._goal
        self._least, self._goal = np.inf, None
        if least > WORTH * before:
            self._vain += MOST_IN_VAIN if is_tried else 0
            return None
        self._vain += before > WORTH * self._before
        self._before, self.is_stalled = before, False
        return goal
