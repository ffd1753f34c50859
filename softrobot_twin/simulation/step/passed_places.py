"""Places that a robot passed on its way to targets, and when it is to go back to the nearest one.

A robot goes back where it came no nearer for long, and at once where its body snapped. From the nearest
place in stable balance it goes on a few times; then it stays there, or at the nearest stable place of all
these tries, which was perhaps no balance.
"""

from __future__ import annotations

from collections import deque
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from softrobot_twin.simulation.step.situation import Situation, longest_move

# Places in balance that are kept, at most.
MOST_PLACES = 256
# Steps in which T falls by less than this share, until the robot goes back to the nearest place.
PATIENCE, PROGRESS = 12, 1.0e-5
# What is not in balance may come and go, and falls by this share; it is the one, too, after which the robot
# has come much nearer.
MUCH_NEARER = 5.0e-3
# The body snaps where T has risen in so many steps in a row, to this multiple of the nearest place's.
RISES, SNAPPED = 3, 4.0
# So often the robot goes on from there, unless it has come much nearer; then it stays there.
MOST_RETURNS = 2


class Place(NamedTuple):
    """Where the actuators were.

    Attributes:
        drives: Where they were, shape (actuator_count,).
        now: T there [m²].
    """

    drives: np.ndarray
    now: float


NOWHERE = Place(np.empty(0), np.inf)


class PassedPlaces:
    """The places of one way.

    Attributes:
        balanced: Where it began, then places in stable balance, each nearer than the one before.
        since: Steps since T was least.
        returns: How often the robot went back since it came much nearer.
    """

    def __init__(self) -> None:
        """Nothing is passed yet."""
        self.since = self.returns = self._rises = 0
        self.balanced: deque[Place] = deque(maxlen=MOST_PLACES)
        # The nearest place with a stable tangent, and those of the tries before.
        self._stable, self._stable_before = NOWHERE, list[Place]()
        self._least = self._judged = self._last = np.inf

    @property
    def nearest(self) -> Place:
        """The nearest place in stable balance."""
        return self.balanced[-1]

    @property
    def is_over(self) -> bool:
        """Whether the robot went on from the nearest place often enough."""
        return self.returns >= MOST_RETURNS

    def pass_by(self, situation: Situation, now: float, reached: float, settles: bool) -> bool:
        """Take the place where a step begins.

        Args:
            situation: What the step begins with.
            now: T there [m²].
            reached: T at which targets count as reached [m²].
            settles: Whether the actuators wait for the body.

        Returns:
            Whether the robot is to go back.
        """
        is_balanced, is_stable = situation.is_balanced, situation.is_stable
        if is_balanced and is_stable and now < self.balanced[-1].now:
            self.balanced.append(Place(situation.displacements, now))
        elif is_stable and now < self._stable.now:
            self._stable = Place(situation.displacements, now)
        # Where a body is not stable, its linearization does not tell where it goes.
        self._rises = self._rises + 1 if is_stable and now > self._last else 0
        self._last = now
        # At its targets, what they leave open may go on for long, but in balance.
        self.since += not (settles or (now <= reached and is_balanced))
        if now < (1.0 - MUCH_NEARER) * self._judged:
            self._judged, self.returns = now, 0
        # What is not in balance may come and go, a little nearer each time.
        if now < (1.0 - (PROGRESS if is_balanced else MUCH_NEARER)) * self._least:
            self._least, self.since = now, 0
        return (self._rises >= RISES and self.has_snapped(now, reached)) or self.since > PATIENCE

    def has_snapped(self, now: float, reached: float) -> bool:
        """Whether the body is much further away than the nearest place was.

        Args:
            now: T [m²].
            reached: T at which targets count as reached [m²].
        """
        return now > max(SNAPPED * self.nearest.now, reached)

    def go_back(self) -> bool:
        """Go back to `nearest`; gives whether the robot is to stay there."""
        is_over, self.returns = self.is_over, self.returns + 1
        self._stable_before.append(self._stable)
        self._stable = NOWHERE
        if is_over:
            for place in sorted(self._stable_before, key=attrgetter("now"), reverse=True):
                if place.now < self.nearest.now:
                    self.balanced.append(place)
            self._stable_before.clear()
        return is_over

    def leave(self, drives: np.ndarray, scales: np.ndarray, share: float) -> None:
        """Forget places beside one where the body cannot even stay, but for where it began.

        Args:
            drives: Where the actuators are, shape (actuator_count,).
            scales: Their scales, same shape.
            share: How far is beside, as a share of these.
        """
        while len(self.balanced) > 1 and longest_move(self.nearest.drives, drives, scales) <= share:
            self.balanced.pop()

    def drop_lost(self, now: float, reached: float, stays: bool) -> bool:
        """Drop the nearest place where it is none: no balance, or the body has not come back from another one.

        Args:
            now: T where the actuators have gone back to it [m²].
            reached: T at which targets count as reached [m²].
            stays: Whether the robot is to stay there.

        Returns:
            Whether it is dropped; where the robot began is kept.
        """
        places = self.balanced
        is_lost = len(places) > 1 and (self.has_snapped(now, reached) or (stays and now > places[-2].now))
        if is_lost:
            places.pop()
        return is_lost
