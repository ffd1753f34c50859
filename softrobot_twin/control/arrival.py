"""When and where a message comes from, and whether that alone is reason to refuse it."""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.control.refusal import Refusal

NANOSECONDS = 1_000_000_000


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


class HeaderCheck:
    """Refuses what is in another frame, too old, from the future, or overtaken by a newer one.

    Args:
        frame_id: The one frame that is accepted, or None when the message has no use for one.
        message_timeout: Oldest stamp accepted [s]; 0 accepts any age.
        future_tolerance: How far ahead a stamp may be, for clocks that differ a little [s].
    """

    def __init__(self, frame_id: str | None, message_timeout: float, future_tolerance: float):
        self.frame_id = frame_id
        self.message_timeout = message_timeout
        self.future_tolerance = future_tolerance
        self._newest_stamp = 0

    def refusal(self, arrival: Arrival) -> Refusal | None:
        """The reason to refuse a message, or None. A stamp of zero counts as now."""
        if self.frame_id is not None and arrival.frame_id != self.frame_id:
            return Refusal.WRONG_FRAME
        if arrival.stamp == 0:
            return None
        age = (arrival.ros_time - arrival.stamp) / NANOSECONDS
        if self.message_timeout > 0.0 and age > self.message_timeout:
            return Refusal.STALE
        if age < -self.future_tolerance:
            return Refusal.FROM_THE_FUTURE
        if arrival.stamp < self._newest_stamp:
            return Refusal.OUT_OF_ORDER
        return None

    def remember(self, arrival: Arrival) -> None:
        """Makes an accepted message the one that no older one may follow."""
        self._newest_stamp = arrival.stamp or arrival.ros_time

    def forget(self) -> None:
        """Accepts any order again, as at the start."""
        self._newest_stamp = 0
