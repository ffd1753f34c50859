"""Why a message is refused, and how often that happened."""

from __future__ import annotations

from enum import Enum


class Refusal(Enum):
    """Why a message was not used. The value is the word that diagnostics and warnings show."""

    NOT_FINITE = "not_finite"
    STALE = "stale"
    FROM_THE_FUTURE = "from_the_future"
    OUT_OF_ORDER = "out_of_order"
    WRONG_FRAME = "wrong_frame"
    WRONG_SIZE = "wrong_size"
    WRONG_FIELDS = "wrong_fields"
    WRONG_NAMES = "wrong_names"
    DUPLICATE_ID = "duplicate_id"
    NO_ROTATION = "no_rotation"
    OUT_OF_RANGE = "out_of_range"


class RefusalCounts:
    """Counts refused messages by reason. Its size never grows with what it counts."""

    def __init__(self) -> None:
        self._counts: dict[Refusal, int] = {}

    def add(self, refusal: Refusal) -> Refusal:
        """Counts one refused message and gives the reason back."""
        self._counts[refusal] = self._counts.get(refusal, 0) + 1
        return refusal

    def of(self, refusal: Refusal) -> int:
        """Messages refused for one reason."""
        return self._counts.get(refusal, 0)

    @property
    def total(self) -> int:
        """Messages refused for any reason."""
        return sum(self._counts.values())

    def by_word(self) -> dict[str, int]:
        """Counts under the word of each reason met so far."""
        return {refusal.value: count for refusal, count in self._counts.items()}
