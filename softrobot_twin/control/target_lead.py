"""Where a moving target will be when a command is executed.

A robot executes a command some time after it was sent. Measured setpoints tell this delay. A target
that comes as a stream of messages has a course, so that its place after the delay can be expected. A
course is found only where the messages prove it: places that jump, stand or are noisy have none.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_timing import NANOSECONDS

KEPT, APART = 128, 0.008
"""Messages that are kept of a stream, and the time that they are apart at least [s]."""
LEAST = 6
"""A course is found by at least so many messages."""
LONGEST_INTERVAL = 0.1
"""Messages that come more seldom than this are no stream: each names a place to stand at [s]."""
SILENCE = 3.0
"""A stream has ended when no message came for so many of its intervals."""
BACK, LEAST_BACK = 3.0, 2.0
"""A course is found by the messages of this multiple of the time that it is followed ahead; they must
span the lesser multiple."""
SURPRISE = 0.5
"""A place that is farther from the expected one than this share of the lead begins a new course."""
CERTAINTY = 9.0
"""A lead counts in full where its square is far above this multiple of its variance, and not below."""
DELAY_TIME = 0.5
"""Time constant with which the delay is averaged [s]."""


class _Course(NamedTuple):
    """A parabola through the last places of a target: place + c₀ + c₁ s + c₂ s², s = (t - time) / scale.

    Attributes:
        coefficients: The coefficients c [m], shape (3, 3).
        time: Time of the newest message [s].
        place: Its place [m], shape (3,).
        scale: Time that the course is followed ahead [s].
    """

    coefficients: np.ndarray
    time: float
    place: np.ndarray
    scale: float

    def at(self, time: float | np.ndarray) -> np.ndarray:
        """The expected places [m], shape (..., 3), at times on the clock of the sender [s]."""
        share = (time - self.time) / self.scale
        powers = np.stack([np.ones_like(share), share, share * share], axis=-1)
        return self.place + powers @ self.coefficients


class TargetStream:
    """The last messages of one target, and how far ahead of the newest one the target will be.

    Stamps tell how the messages are apart in time. How long ago they were sent is counted from their
    arrival, so that a sender whose clock is wrong is no other than one whose clock is right.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begins a new stream."""
        # Of each message: when it was sent, when it arrived, and x, y, z.
        self._messages: deque[tuple[float, ...]] = deque(maxlen=KEPT)
        self._course: _Course | None = None
        self._full_lead = 0.0

    def add(self, place: np.ndarray, arrival: Arrival) -> None:
        """Takes a message.

        Args:
            place: The target [m], shape (3,).
            arrival: Its header and time of arrival.
        """
        sent = (arrival.stamp or arrival.ros_time) / NANOSECONDS
        if self._messages and sent <= self._messages[-1][0]:
            self.forget()
        course = self._course
        if course is not None and math.dist(course.at(sent), place) > SURPRISE * self._full_lead:
            self.forget()
        if len(self._messages) > 1 and sent - self._messages[-2][0] < APART:
            self._messages.pop()
        self._messages.append((sent, arrival.time, *place.tolist()))

    def lead(self, now: float, delay: float | np.ndarray, limit: float) -> np.ndarray | None:
        """From the newest place to where the target will be [m], shape (3,), or (n, 3).

        Args:
            now: Time on the clock of `Arrival.time` [s].
            delay: Time from now [s], or several, the longest one last, shape (n,).
            limit: Longest time from the newest message for which a course is followed [s].

        Returns:
            The way; None where there is no course.
        """
        self._course = None
        if limit == 0.0 or len(self._messages) < LEAST:
            return None
        messages = np.array(self._messages)
        sent, arrived, places = messages[:, 0], messages[:, 1], messages[:, 2:]
        interval = (sent[-1] - sent[-LEAST]) / (LEAST - 1)
        if interval > LONGEST_INTERVAL or now - arrived[-1] > SILENCE * interval:
            return None
        ahead = np.clip(now - sent[-1] - (arrived - sent).min() + delay, 0.0, limit)
        scale = max(float(np.max(ahead)), interval)
        count = max(int((sent >= sent[-1] - BACK * scale).sum()), LEAST)
        times, offsets = (sent[-count:] - sent[-1]) / scale, places[-count:] - places[-1]
        if -times[0] < LEAST_BACK or not offsets.any():
            return None
        powers = np.vander(times, 3, increasing=True)
        orthogonal, triangle = np.linalg.qr(powers)
        course = _Course(np.linalg.solve(triangle, orthogonal.T @ offsets), sent[-1], places[-1], scale)
        way = course.at(sent[-1] + scale) - places[-1]
        variance = ((offsets - powers @ course.coefficients) ** 2).sum() / (count - 3)
        variance *= (np.linalg.solve(triangle.T, np.ones(3)) ** 2).sum()
        self._course, self._full_lead = course, math.hypot(*way)
        certainty = 1.0 - CERTAINTY * variance / max(way @ way, np.finfo(float).tiny)
        return certainty * (course.at(sent[-1] + ahead) - places[-1]) if certainty > 0.0 else None


class TargetLead:
    """By how much each target is led, and the delay of the robot.

    Args:
        effector_count: Number of effectors of the simulation.

    Attributes:
        ways: From each target to where it is led [m], shape (effector_count, 3).
        delay: How long after a command was sent the robot executes it [s].
    """

    def __init__(self, effector_count: int):
        self.ways, self._is_led = np.zeros((effector_count, 3)), False
        self.reset()

    def reset(self) -> None:
        """Forgets the delay and leads no target."""
        self.delay, self._stamp = 0.0, 0
        if self._is_led:
            self.ways[:], self._is_led = 0.0, False

    def follow(self, leads: np.ndarray) -> None:
        """Takes the leads of a tick.

        Args:
            leads: See `TargetInput.leads`.
        """
        self._is_led = bool(np.isfinite(leads).any())
        self.ways = np.nan_to_num(leads)

    def see(self, delay: float, stamp: int) -> None:
        """Averages the delay that a measurement tells, while a target moves on a course.

        Args:
            delay: The delay [s]; NaN where the measurement does not tell it.
            stamp: Time of the measurement [ns].
        """
        since = abs(stamp - self._stamp) / NANOSECONDS if self._stamp else 0.0
        self._stamp = stamp
        if self._is_led and math.isfinite(delay):
            self.delay -= math.expm1(-min(since / DELAY_TIME, 1.0)) * (delay - self.delay)
