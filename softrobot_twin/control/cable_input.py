"""Named cable lengths and tensions from a message: a direct command, or what a device measures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal, RefusalCounts
from softrobot_twin.control.winding import Order, Winding


class CableInput:
    """Keeps the newest value of every cable; a message that does not wind each once is refused.

    Args:
        winding: Names of cables and motors, and what each of them winds.
        settings: Timeouts.

    Attributes:
        refusals: Messages refused, by reason.
        lengths: Newest lengths [m], shape (actuator_count,), or None.
        tensions: Newest tensions [N], shape (actuator_count,), or None.
    """

    def __init__(self, winding: Winding, settings: LoopSettings):
        self.refusals = RefusalCounts()
        self._winding = winding
        self._header = HeaderCheck(None, 0.0, 0.0)
        # The names of the last message, and what they say: they seldom change.
        self._known: tuple[tuple[str, ...], Order | None] = ((), winding.order_of(()))
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
            names: Names of cables or motors, in the message's own order.
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
        self.lengths = lengths[order.places] + order.offsets if len(lengths) else None
        self.tensions = tensions[order.places] if len(tensions) else None
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
            if len(values) not in (0, len(names)):
                return Refusal.WRONG_SIZE
            if not np.isfinite(values).all():
                return Refusal.NOT_FINITE
        return None

    def _order_of(self, names: tuple[str, ...]) -> Order | None:
        """What a message's names say; None when they do not wind every cable once."""
        if names != self._known[0]:
            self._known = (names, self._winding.order_of(names))
        return self._known[1]
