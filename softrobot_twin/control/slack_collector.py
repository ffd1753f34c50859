"""Python's garbage collector, kept out of the ticks."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable


class SlackCollector:
    """Collects garbage only where a tick leaves time for it.

    Use it as a context: inside, automatic collection is off and everything that is already there
    is set aside, so that a collection looks only at what the loop made.

    Args:
        interval: Time between two collections [s].
        patience: After so long without enough slack it collects all the same [s].
        clock: Seconds that never jump.
        collect: What collects.

    Attributes:
        collections: Collections done.
        forced: Collections among them that had no slack to fit in.
    """

    def __init__(
        self,
        interval: float = 1.0,
        patience: float = 60.0,
        clock: Callable[[], float] = time.monotonic,
        collect: Callable[[], object] = gc.collect,
    ):
        self.collections = self.forced = 0
        self._interval, self._patience = interval, patience
        self._clock, self._collect = clock, collect
        self._last = clock()
        self._duration = 0.0
        self._was_enabled = True

    def __enter__(self) -> SlackCollector:
        self._was_enabled = gc.isenabled()
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(self, *exception: object) -> None:
        gc.unfreeze()
        if self._was_enabled:
            gc.enable()

    def offer(self, slack: float) -> bool:
        """Collects when it is time to and a collection like the last fits twice into the slack.

        Args:
            slack: Time left before the next tick [s].

        Returns:
            True when it collected.
        """
        began = self._clock()
        waited = began - self._last
        if waited < self._interval:
            return False
        fits = slack > 2.0 * self._duration and slack > 0.0
        if not fits and waited < self._patience:
            return False
        self._collect()
        self._last = self._clock()
        self._duration = self._last - began
        self.collections += 1
        self.forced += not fits
        return True
