"""Named cable lengths and tensions from a message: a direct command, or what a device measures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal, RefusalCounts


class CableInput:
    """Keeps the newest value of every cable; a message that does not name each once is refused.

    Args:
        actuator_names: Names of the cables, in the order of the simulation.
        settings: Timeouts.

    Attributes:
        refusals: Messages refused, by reason.
        lengths: Newest lengths [m], shape (actuator_count,), or None.
        tensions: Newest tensions [N], shape (actuator_count,), or None.
    """

    def __init__(self, actuator_names: Sequence[str], settings: LoopSettings):
        self.refusals = RefusalCounts()
        self._names = tuple(actuator_names)
        self._header = HeaderCheck(None, 0.0, 0.0)
        self._known_order: tuple[tuple[str, ...], list[int]] = (self._names, list(range(len(self._names))))
        self.apply(settings)
        self.reset()

    def apply(self, settings: LoopSettings) -> None:
        """Takes up changed timeouts."""
        self._header.message_timeout = settings.message_timeout
        self._header.future_tolerance = settings.future_tolerance

    def reset(self) -> None:
        """Forgets what came in; the counts stay."""
        self.lengths: np.ndarray | None = None
        self.tensions: np.ndarray | None = None
        self._newest = -math.inf
        self._header.forget()

    def accept(
        self, names: Sequence[str], lengths, tensions, arrival: Arrival
    ) -> Refusal | None:
        """Takes one message, or says why not.

        Args:
            names: Cable names, in the message's own order.
            lengths: A length for each name [m], or nothing.
            tensions: A tension for each name [N], or nothing; not both may be missing.
            arrival: Header and moment of the message.
        """
        lengths, tensions = np.asarray(lengths, dtype=float), np.asarray(tensions, dtype=float)
        refusal = self._header.refusal(arrival) or self._content_refusal(names, lengths, tensions)
        if refusal is not None:
            return self.refusals.add(refusal)
        self._header.remember(arrival)
        order = self._order_of(tuple(names))
        self.lengths = lengths[order] if len(lengths) else None
        self.tensions = tensions[order] if len(tensions) else None
        self._newest = arrival.time
        return None

    def age(self, now: float) -> float:
        """Time since the last message that was taken [s]; infinite when there was none."""
        return now - self._newest

    def _content_refusal(self, names, lengths, tensions) -> Refusal | None:
        if self._order_of(tuple(names)) is None:
            return Refusal.WRONG_NAMES
        if not len(lengths) and not len(tensions):
            return Refusal.WRONG_SIZE
        for values in (lengths, tensions):
            if len(values) not in (0, len(self._names)):
                return Refusal.WRONG_SIZE
            if not np.isfinite(values).all():
                return Refusal.NOT_FINITE
        return None

    def _order_of(self, names: tuple[str, ...]) -> list[int] | None:
        """Places of our cables in a message's names; None when they are not the same names."""
        if names != self._known_order[0]:
            if sorted(names) != sorted(self._names):
                return None
            self._known_order = (names, [names.index(name) for name in self._names])
        return self._known_order[1]
