"""A place for the newest of something, passed from one thread to another without waiting."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class LatestSlot(Generic[Item]):
    """Holds one item; a newer one takes its place.

    One thread puts, another takes. Putting takes no lock that the taker could hold: a deque of one
    place drops its old item by itself, and a lock that is only ever *released* by the putting
    thread serves as the bell. So the control loop cannot be held up by a taker that the
    interpreter paused in the wrong place.
    """

    def __init__(self) -> None:
        self._place: deque[Item] = deque(maxlen=1)
        self._bell = threading.Lock()
        self._bell.acquire()
        self._closed = False
        self.put_count = 0
        self.taken_count = 0

    @property
    def dropped_count(self) -> int:
        """Items that a newer one replaced before they were taken."""
        return max(0, self.put_count - self.taken_count - len(self._place))

    @property
    def closed(self) -> bool:
        """Whether nothing more will be put."""
        return self._closed

    def put(self, item: Item) -> None:
        """Leave an item for the other thread; returns at once, whatever that thread does."""
        if self._closed:
            return
        self._place.append(item)
        self.put_count += 1
        self._ring()

    def take(self) -> Item | None:
        """Wait for an item and take it; None once the slot is closed and empty."""
        while True:
            try:
                item = self._place.popleft()
            except IndexError:
                if self._closed:
                    return None
                self._bell.acquire()
                continue
            self.taken_count += 1
            return item

    def close(self) -> None:
        """Let nothing more in; the item that is still there can be taken."""
        self._closed = True
        self._ring()

    def _ring(self) -> None:
        try:
            self._bell.release()
        except RuntimeError:
            pass  # The bell has already been rung, and not been heard yet.
