"""A thread that draws the newest frame into a recording, so that the control loop never waits.

`LatestItem` passes frames to the thread, `every_nth` and `RateLimit` choose frames, and
`DrawingThread` draws the chosen ones.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import cycle
from typing import TYPE_CHECKING, Generic, TypeVar

from softrobot_twin.view.frame import Frame

if TYPE_CHECKING:
    from softrobot_twin.view.picture import Picture

Item = TypeVar("Item")


class LatestItem(Generic[Item]):
    """Passes items from one thread to another; a newer item replaces one that was not yet taken.

    One thread puts items, another thread takes them. `put` acquires no lock that the taking thread
    could hold: a deque of length one drops its old item by itself, and a lock that the putting
    thread only *releases* serves as the signal. Therefore the control loop never waits for a thread
    that the interpreter has paused.
    """

    def __init__(self) -> None:
        self._item: deque[Item] = deque(maxlen=1)
        self._signal = threading.Lock()
        self._signal.acquire()
        self._closed = False
        self.put_count = 0
        self.taken_count = 0

    @property
    def dropped_count(self) -> int:
        """Items that were replaced before they were taken."""
        return max(0, self.put_count - self.taken_count - len(self._item))

    def put(self, item: Item) -> None:
        """Passes an item to the other thread; returns at once.

        Args:
            item: The item; one that was not taken yet is dropped.
        """
        if self._closed:
            return
        self._item.append(item)
        self.put_count += 1
        self._notify()

    def take(self) -> Item | None:
        """Waits for an item and takes it; None when no item is left and no more are accepted."""
        while True:
            try:
                item = self._item.popleft()
            except IndexError:
                if self._closed:
                    return None
                self._signal.acquire()
                continue
            self.taken_count += 1
            return item

    def close(self) -> None:
        """Accepts no more items; a remaining item can still be taken."""
        self._closed = True
        self._notify()

    def _notify(self) -> None:
        with suppress(RuntimeError):  # The signal is already set.
            self._signal.release()


def every_nth(interval: int) -> Callable[[], bool]:
    """Chooses the first of every `interval` frames: says of each whether it is chosen.

    Args:
        interval: How many frames one is chosen of.
    """
    return cycle([True, *[False] * (interval - 1)]).__next__


class RateLimit:
    """Chooses frames up to a mean rate [Hz], also when frames arrive unevenly."""

    def __init__(self, rate: float):
        self._period = 1.0 / rate
        self._due = -math.inf

    def passes(self, now: float) -> bool:
        """Whether a frame of this time [s] is chosen; the clock may be set back.

        The next one is due a period after this one was, or, when it came very late, a period from
        now.

        Args:
            now: Time of the frame [s].
        """
        # Two periods: of one, round-off would let a frame through twice.
        if now < self._due <= now + 2.0 * self._period:
            return False
        missed = abs(now - self._due) > self._period
        self._due = (now if missed else self._due) + self._period
        return True


_log = logging.getLogger(__name__)


class DrawingThread:
    """Draws the newest frame repeatedly in a daemon thread.

    Slow or failing drawing does not affect the thread that offers frames.

    Attributes:
        name: Name of the output, for messages.
        logged_count: Frames that were drawn.
        failed_count: Frames whose drawing failed.
        failure: The last failure as a sentence, or None.
        latest: The frame to draw next.
    """

    def __init__(self, name: str, canvas: Picture, is_chosen: Callable[[], bool]):
        self.name = name
        self.logged_count = 0
        self.failed_count = 0
        self.failure: str | None = None
        self._canvas = canvas
        self._is_chosen = is_chosen
        self.latest: LatestItem[Frame] = LatestItem()
        self._deadline = 0.0
        self._thread = threading.Thread(target=self._run, name=f"view-{name}", daemon=True)
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        """Whether frames that were chosen are still to be drawn."""
        done = self.logged_count + self.failed_count + self.latest.dropped_count
        return done < self.latest.put_count

    def offer(self, frame: Frame) -> None:
        """Passes a frame to the thread, if it is chosen; returns at once.

        Args:
            frame: The frame; must not be changed any more.
        """
        if self._is_chosen():
            self.latest.put(frame)

    def end(self, timeout: float) -> None:
        """Accepts no more frames; the thread has this time to finish [s].

        Args:
            timeout: Longest time that it may take [s].
        """
        self._deadline = time.monotonic() + timeout
        self.latest.close()

    def join(self) -> None:
        """Waits for the thread until the time given to `end` is over."""
        self._thread.join(max(0.0, self._deadline - time.monotonic()))
        if self._thread.is_alive():
            self.failure = f"{self.name}: not finished in time; the last frames may be missing"
            _log.warning(self.failure)

    def _run(self) -> None:
        while (frame := self.latest.take()) is not None:
            try:
                self._canvas.log(frame)
            except Exception as error:  # noqa: BLE001 - no error may reach the loop
                self._record_failure(error)
            else:
                self.logged_count += 1
        try:
            self._canvas.close(max(0.0, self._deadline - time.monotonic()))
        except Exception as error:  # noqa: BLE001
            self._record_failure(error)

    def _record_failure(self, error: Exception) -> None:
        self.failed_count += 1
        if self.failure is None:
            _log.warning("%s: a frame could not be shown", self.name, exc_info=error)
        self.failure = f"{self.name}: {type(error).__name__}: {error}"
