"""The header of a message, the moment it arrived, and the reasons to refuse a message."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from enum import Enum
from functools import wraps
from typing import NamedTuple

import numpy as np

from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS, ClockWatch

SENDER_ACCEPT_AFTER = 0.5
"""When a sender's stamps increase but are all older than the newest accepted one, its clock was set
back. Its messages are accepted again after this time [s]. Messages that the network delivers in the
wrong order do not form such a sequence, because newer stamps come between them."""


class Refusal(Enum):
    """Why a message was not used. The value is the word that diagnostics and warnings show."""

    NOT_FINITE = "not_finite"
    STALE = "stale"
    FROM_THE_FUTURE = "from_the_future"
    OUT_OF_ORDER = "out_of_order"
    WRONG_FRAME = "wrong_frame"
    WRONG_SIZE = "wrong_size"
    TOO_LARGE = "too_large"
    UNREADABLE = "unreadable"
    WRONG_FIELDS = "wrong_fields"
    WRONG_NAMES = "wrong_names"
    DUPLICATE_ID = "duplicate_id"
    NO_ROTATION = "no_rotation"
    OUT_OF_RANGE = "out_of_range"
    BELOW_VACUUM = "below_vacuum"
    VOLUME_CONTROLLED = "volume_controlled"
    NOT_POSITIVE = "not_positive"
    TWO_PUBLISHERS = "two_publishers"

    @property
    def hint(self) -> str:
        """What the sender should do; empty where the word says it."""
        return _HINTS.get(self, "")


_HINTS = {
    Refusal.STALE: "its stamp is older than message_timeout; do the clocks of both machines agree?",
    Refusal.FROM_THE_FUTURE: "its stamp is later than now; do the clocks of both machines agree?",
    Refusal.TOO_LARGE: "it has more bytes than any message needs that is meant for this topic",
    Refusal.UNREADABLE: "its bytes are no message of this topic's type",
    Refusal.WRONG_NAMES: "its names must be those of the scene's actuators",
    Refusal.TWO_PUBLISHERS: "another publisher sends on this topic: end all but one",
    Refusal.BELOW_VACUUM: "the pressure must be absolute, in Pa, and above 0",
    Refusal.VOLUME_CONTROLLED: "the scene controls this cavity by volume: command its volume [m³] "
    "on ~/command/cables",
    Refusal.NOT_POSITIVE: "a stiffness must be above 0 N/m, or NaN along an axis without a target",
}


class RefusalCounts:
    """Counts refused messages by reason. Its memory does not grow with the number of messages."""

    def __init__(self) -> None:
        self._counts: dict[Refusal, int] = {}

    def add(self, refusal: Refusal) -> Refusal:
        """Counts one refused message and returns the reason.

        Args:
            refusal: The reason.
        """
        self._counts[refusal] = self._counts.get(refusal, 0) + 1
        return refusal

    def of(self, refusal: Refusal) -> int:
        """Number of messages refused for one reason.

        Args:
            refusal: The reason.
        """
        return self._counts.get(refusal, 0)

    @property
    def total(self) -> int:
        """Number of messages refused for any reason."""
        return sum(self._counts.values())

    def by_word(self) -> dict[str, int]:
        """Counts by the word of each reason that has occurred."""
        return {refusal.value: count for refusal, count in self._counts.items()}

    def in_words(self) -> str:
        """Counts and reasons, such as ``78 wrong_names, 1 stale``; empty where there are none."""
        return ", ".join(f"{count} {word}" for word, count in self.by_word().items())


class Arrival(NamedTuple):
    """The header of a message and the moment it arrived.

    Attributes:
        frame_id: Frame in the header; empty when the header has none.
        stamp: Time in the header [ns]; 0 when the header has none.
        ros_time: Time of arrival on the clock of the stamps [ns].
        time: Time of arrival on a monotonic clock [s]; ages are measured on it.
    """

    frame_id: str
    stamp: int
    ros_time: int
    time: float

    @property
    def age(self) -> float:
        """Time from stamp to arrival [s]; 0 without a stamp, negative for a stamp in the future."""
        return (self.ros_time - self.stamp) / NANOSECONDS if self.stamp else 0.0


class HeaderCheck:
    """Refuses messages in a wrong frame, too old, from the future, or older than an accepted one.

    Stamps from before and after a change of a clock cannot be compared. When this machine's clock
    was set between two arrivals, the check restarts at once; when a sender's clock was set back,
    the check restarts after `SENDER_ACCEPT_AFTER`.

    Args:
        frame_id: The only accepted frame, or None for messages without a frame.
        settings: How old a stamp may be, and how far in the future, because clocks of two machines
            differ slightly; they may be replaced.
    """

    def __init__(self, frame_id: str | None, settings: LoopSettings):
        self.frame_id, self.settings = frame_id, settings
        self._clock = ClockWatch()
        self.forget()

    def refusal(self, arrival: Arrival) -> Refusal | None:
        """The reason to refuse a message, or None. A stamp of zero counts as the present time.

        Args:
            arrival: Header and time of arrival of the message.
        """
        if self._clock.step(arrival.ros_time, arrival.time):
            self.forget()
        if self.frame_id is not None and arrival.frame_id != self.frame_id:
            return Refusal.WRONG_FRAME
        if 0.0 < self.settings.message_timeout < arrival.age:
            return Refusal.STALE
        if arrival.age < -self.settings.future_tolerance:
            return Refusal.FROM_THE_FUTURE
        if 0 < arrival.stamp < self._newest_stamp and not self._was_set_back(arrival):
            return Refusal.OUT_OF_ORDER
        return None

    def remember(self, arrival: Arrival) -> None:
        """Records an accepted message: older stamps are refused from now on.

        Args:
            arrival: Header and time of arrival of the message.
        """
        self._newest_stamp = arrival.stamp or arrival.ros_time
        self._older_since = self._older_stamp = None

    def forget(self) -> None:
        """Restarts the check: the next message may have any stamp."""
        self._newest_stamp = 0
        self._older_since: float | None = None
        self._older_stamp: int | None = None

    def _was_set_back(self, arrival: Arrival) -> bool:
        """True when for `SENDER_ACCEPT_AFTER` only older stamps came, in increasing order."""
        increases = self._older_stamp is not None and arrival.stamp > self._older_stamp
        if not increases:
            self._older_since = arrival.time
        self._older_stamp = arrival.stamp
        return arrival.time - self._older_since >= SENDER_ACCEPT_AFTER


def refusal_of_vector(vector: np.ndarray, may_be_nan: bool = False) -> Refusal | None:
    """The reason to refuse three numbers, or None.

    Args:
        vector: What is there of them, of any shape.
        may_be_nan: Whether NaN has a meaning.
    """
    if vector.shape != (3,):
        return Refusal.WRONG_SIZE
    is_right = ~np.isinf(vector) if may_be_nan else np.isfinite(vector)
    return None if is_right.all() else Refusal.NOT_FINITE


class Input:
    """Keeps the newest valid message about each object; each kind of message is a `latched` method.

    Args:
        settings: Limits and timeouts.
        frame_id: The only accepted frame, or None where it is not checked.
        keys: What messages may be about: the stamps of each are in order for themselves. None where
            each message is about all.
        refusals: Counts refused messages; None for counts of its own.

    Attributes:
        refusals: Refused messages, by reason.
        settings: Limits and timeouts.
        clamped: How often a place was limited to the workspace.
    """

    clamped = 0

    def __init__(
        self, settings: LoopSettings, frame_id: str | None, keys: Iterable | None = None,
        refusals: RefusalCounts | None = None,
    ):  # fmt: skip
        self.refusals = RefusalCounts() if refusals is None else refusals
        self._is_of_all = keys is None
        keys = (None,) if keys is None else keys
        self._headers = {key: HeaderCheck(frame_id, settings) for key in keys}
        self.apply(settings)
        self.reset()

    def apply(self, settings: LoopSettings) -> None:
        """Uses changed limits and timeouts from now on.

        Args:
            settings: The changed settings.
        """
        self.settings = settings
        for header in self._headers.values():
            header.settings = settings

    def reset(self) -> None:
        """Forgets what was received; the counts stay."""
        self._newest = -math.inf
        for header in self._headers.values():
            header.forget()

    def age(self, now: float) -> float:
        """Time since the last accepted message [s]; infinite before the first.

        Args:
            now: Time on the clock of `Arrival.time` [s].
        """
        return now - self._newest

    def _inside(self, position: np.ndarray) -> np.ndarray:
        """A position [m], shape (3,), limited to the workspace."""
        inside = self.settings.in_workspace(position)
        self.clamped += bool((inside != position).any())
        return inside

    def _header_of(self, key: object, method: str) -> HeaderCheck | None:
        """Checks headers of messages about an object; None where there is no such object."""
        return self._headers[None] if self._is_of_all else self._headers.get(key)


def latched(take: Callable[..., Refusal | None]) -> Callable[..., Refusal | None]:
    """Makes an input of messages from a method that checks and keeps the values of one.

    The header is checked first: its frame, its age, and its order among those of the same sender.
    Values reach the method as arrays of its own. A message that it refuses is counted, and so is one
    about an object that the input does not have; another one is the newest of its sender.

    Args:
        take: Method of an `Input`. Its arguments are what the message is about, values, and the
            `Arrival`. It returns the reason to refuse the values, and then keeps none of them; or
            None.
    """

    @wraps(take)
    def accept(self: Input, key: object, *values: object) -> Refusal | None:
        *values, arrival = values
        header = self._header_of(key, take.__name__)
        if header is None:
            return self.refusals.add(Refusal.WRONG_NAMES)
        arrays = (np.array(one, dtype=float) for one in values)
        refusal = header.refusal(arrival) or take(self, key, *arrays, arrival)
        if refusal is not None:
            return self.refusals.add(refusal)
        header.remember(arrival)
        self._newest = arrival.time
        return None

    return accept
