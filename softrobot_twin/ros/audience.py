"""Who receives a topic, without asking the middleware in every tick."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable

from rclpy.publisher import Publisher

PERIOD = 1.0
"""Time after which publishers are asked again [s]: whoever subscribes waits no longer than that."""


class Audience:
    """Which publishers have subscribers.

    Attributes:
        rounds: How often all were to be asked anew.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic):
        """Ask nobody yet.

        Args:
            now: Gives the time [s].
        """
        self._now, self._due, self.rounds = now, -math.inf, 0
        self._heard: dict[Publisher, bool] = {}

    def hears(self, publisher: Publisher) -> bool:
        """Whether somebody has subscribed to it, as asked at most `PERIOD` ago.

        Args:
            publisher: The publisher.
        """
        self.begin_round()
        heard = self._heard.get(publisher)
        if heard is None:
            heard = self._heard[publisher] = publisher.get_subscription_count() > 0
        return heard

    def begin_round(self) -> int:
        """Forgets the answers that are older than `PERIOD`; gives `rounds`."""
        now = self._now()
        if now >= self._due:
            self._heard.clear()
            self._due, self.rounds = now + PERIOD, self.rounds + 1
        return self.rounds

    def hears_any(self, publishers: Iterable[Publisher]) -> bool:
        """Whether somebody has subscribed to one of them.

        Args:
            publishers: The publishers.
        """
        return any(map(self.hears, publishers))
