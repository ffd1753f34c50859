"""Named lengths and tensions from a message: a direct command, or what a device measures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal, RefusalCounts
from softrobot_twin.control.winding import Order, Winding


class CableInput:
    """Keeps the newest value of every actuator; a message must wind each once.

    Slides take positions, no forces: a message of tensions alone may leave them out or give NaN
    for them, and they stay where they are.

    Args:
        winding: Names of cables, slides and motors, and what each of them winds.
        settings: Timeouts.

    Attributes:
        refusals: Messages refused, by reason.
        lengths: Newest lengths [m], shape (actuator_count,), or None.
        tensions: Newest tensions [N], shape (actuator_count,), or None; NaN for slides that were
            given none.
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
        self.setpoints: np.ndarray | None = None
        self.efforts: np.ndarray | None = None
        self._newest = -math.inf
        self._header.forget()

    def accept(
        self, names: Sequence[str], lengths, tensions, arrival: Arrival
    ) -> Refusal | None:
        """Takes one message, or says why not.

        Args:
            names: Names of cables, slides or motors, in the message's own order.
            lengths: A length for each name [m], or nothing.
            tensions: A tension for each name [N], or nothing; not both may be missing.
            arrival: Header and moment of the message.
        """
        lengths, tensions = np.asarray(lengths, dtype=float), np.asarray(tensions, dtype=float)
        order = self._order_of(tuple(names))
        refusal = self._header.refusal(arrival)
        if refusal is None and (order is None or not self._names_fit(order, lengths, tensions)):
            refusal = Refusal.WRONG_NAMES
        if refusal is None:
            refusal = self._refusal_of_values(order, len(names), lengths, tensions)
        if refusal is not None:
            return self.refusals.add(refusal)
        self._header.remember(arrival)
        self._newest = arrival.time
        self._take(order, lengths, tensions)
        return None

    def age(self, now: float) -> float:
        """Time since the last message that was taken [s]; infinite when there was none."""
        return now - self._newest

    def _take(self, order: Order, lengths: np.ndarray, tensions: np.ndarray) -> None:
        """Keeps what a message that was found good says."""
        self.setpoints = order.values(lengths) + order.offsets if len(lengths) else None
        self.efforts = order.values(tensions) if len(tensions) else None

    def _names_fit(self, order: Order, lengths: np.ndarray, tensions: np.ndarray) -> bool:
        """Whether a message winds all that it has to."""
        left_out = ~order.named
        if len(tensions) and not len(lengths):
            left_out &= ~self._winding.slides
        return not left_out.any()

    def _refusal_of_values(
        self, order: Order, count: int, lengths: np.ndarray, tensions: np.ndarray
    ) -> Refusal | None:
        """What is wrong with the values of a message whose names are."""
        if len(lengths) not in (0, count) or len(tensions) not in (0, count):
            return Refusal.WRONG_SIZE
        if not len(lengths) and not len(tensions):
            return Refusal.WRONG_SIZE
        slides = self._winding.slides
        pulled = order.values(tensions)
        asked = order.named & ~slides if len(tensions) else np.zeros_like(slides)
        if not np.isfinite(lengths).all() or np.isinf(pulled).any():
            return Refusal.NOT_FINITE
        if np.isnan(pulled[asked]).any():
            return Refusal.NOT_FINITE
        by_force = np.isfinite(pulled[slides]).any() and not len(lengths)
        return Refusal.WRONG_FIELDS if by_force else None

    def _order_of(self, names: tuple[str, ...]) -> Order | None:
        """What a message's names say; None when they cannot be meant."""
        if names != self._known[0]:
            self._known = (names, self._winding.order_of(names))
        return self._known[1]


class ChosenInput(CableInput):
    """Keeps the lengths of those actuators that are commanded while others follow targets.

    Each message says anew which ones these are, by name; one without names sets all of them free.

    Attributes:
        lengths: Commanded lengths [m], NaN where free, shape (actuator_count,); None when all are.
    """

    def _take(self, order: Order, lengths: np.ndarray, tensions: np.ndarray) -> None:
        self.setpoints = order.values(lengths) + order.offsets if len(lengths) else None

    def _names_fit(self, order: Order, lengths: np.ndarray, tensions: np.ndarray) -> bool:
        return True

    def _refusal_of_values(
        self, order: Order, count: int, lengths: np.ndarray, tensions: np.ndarray
    ) -> Refusal | None:
        if not count and not len(lengths) and not len(tensions):
            return None
        if len(tensions) and not len(lengths):
            # No actuator can be taken out of the optimisation by its tension.
            return Refusal.WRONG_FIELDS
        return super()._refusal_of_values(order, count, lengths, tensions)

    def is_too_old(self, now: float, timeout: float) -> bool:
        """True when actuators are commanded and nobody repeated it for a timeout [s]; 0: never."""
        return self.setpoints is not None and 0.0 < timeout < self.age(now)
