"""When and where a message comes from, and whether that alone is reason to refuse it."""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.control.clock_steps import NANOSECONDS, ClockWatch
from softrobot_twin.control.refusal import Refusal

SENDER_PATIENCE = 0.5
"""A sender whose stamps grow, all older than the newest one taken, had its clock set back: after
so long it is believed [s]. What the network delivers out of order comes among newer messages."""


class Arrival(NamedTuple):
    """The header of a message and the moment it arrived.

    Attributes:
        frame_id: Frame that the message states; empty when it states none.
        stamp: Time that the message states [ns]; 0 when it states none.
        ros_time: Arrival on the clock that stamps are read on [ns].
        time: Arrival on a clock that never jumps [s]; ages are measured on it.
    """

    frame_id: str
    stamp: int
    ros_time: int
    time: float

    @property
    def age(self) -> float:
        """Time from stamp to arrival [s]; 0 without a stamp, negative from the future."""
        return (self.ros_time - self.stamp) / NANOSECONDS if self.stamp else 0.0


class HeaderCheck:
    """Refuses what is in another frame, too old, from the future, or overtaken by a newer one.

    The order of stamps says nothing across a clock that was set. Where this machine's clock was,
    between two arrivals, the order begins anew at once; where a sender's was, after
    `SENDER_PATIENCE`.

    Args:
        frame_id: The one frame that is accepted, or None when the message has no use for one.
        message_timeout: Oldest stamp accepted [s]; 0 accepts any age.
        future_tolerance: How far ahead a stamp may be, for clocks that differ a little [s].
    """

    def __init__(self, frame_id: str | None, message_timeout: float, future_tolerance: float):
        self.frame_id = frame_id
        self.message_timeout = message_timeout
        self.future_tolerance = future_tolerance
        self._clock = ClockWatch()
        self.forget()

    def refusal(self, arrival: Arrival) -> Refusal | None:
        """The reason to refuse a message, or None. A stamp of zero counts as now."""
        if self._clock.step(arrival.ros_time, arrival.time):
            self.forget()
        if self.frame_id is not None and arrival.frame_id != self.frame_id:
            return Refusal.WRONG_FRAME
        if self.message_timeout > 0.0 and arrival.age > self.message_timeout:
            return Refusal.STALE
        if arrival.age < -self.future_tolerance:
            return Refusal.FROM_THE_FUTURE
        if 0 < arrival.stamp < self._newest_stamp and not self._was_set_back(arrival):
            return Refusal.OUT_OF_ORDER
        return None

    def remember(self, arrival: Arrival) -> None:
        """Makes an accepted message the one that no older one may follow."""
        self._newest_stamp = arrival.stamp or arrival.ros_time
        self._overtaken_since = self._overtaken_stamp = None

    def forget(self) -> None:
        """Accepts any order again, as at the start."""
        self._newest_stamp = 0
        self._overtaken_since: float | None = None
        self._overtaken_stamp: int | None = None

    def _was_set_back(self, arrival: Arrival) -> bool:
        """Whether overtaken messages have come in order, and no newer one, for long enough."""
        grows = self._overtaken_stamp is not None and arrival.stamp > self._overtaken_stamp
        if not grows:
            self._overtaken_since = arrival.time
        self._overtaken_stamp = arrival.stamp
        return arrival.time - self._overtaken_since >= SENDER_PATIENCE
