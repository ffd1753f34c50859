"""The thread that draws the newest frame into a recording; the loop never waits for it."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from softrobot_twin.view.frame import Frame

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


class EveryNth:
    """Lets through the first of every so many frames."""

    def __init__(self, interval: int):
        self._interval = interval
        self._count = 0

    def wants_next(self) -> bool:
        """Whether the frame that has come now goes on."""
        wanted = self._count == 0
        self._count = (self._count + 1) % self._interval
        return wanted


class AtMost:
    """Lets frames through up to a rate, which holds in the mean although frames come unevenly.

    Args:
        rate: Frames a second.
        clock: Present time [s].
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic):
        self._period = 1.0 / rate
        self._clock = clock
        self._due = clock()

    def wants_next(self) -> bool:
        """Whether the frame that has come now goes on."""
        now = self._clock()
        if now < self._due:
            return False
        # The next one is due on the grid, or a period from now when the grid has been lost.
        missed = now - self._due > self._period
        self._due = (now if missed else self._due) + self._period
        return True


_log = logging.getLogger(__name__)


class Thinning(Protocol):
    """Chooses the frames that go on."""

    def wants_next(self) -> bool:
        """Whether the frame that has come now goes on."""


class Canvas(Protocol):
    """What frames are drawn on."""

    def log(self, frame: Frame) -> None:
        """Draw one frame; may take its time, may fail."""

    def close(self, timeout: float) -> None:
        """Finish what was drawn, for at most so long [s]."""


class Outlet:
    """Draws the newest frame, again and again, in a daemon thread of its own.

    However long the drawing takes, and however it fails, whoever offers frames does not notice.

    Attributes:
        name: What it leads to, for messages.
        logged_count: Frames that were drawn.
        failed_count: Frames whose drawing failed.
        failure: The last failure in a sentence, or None.
    """

    def __init__(self, name: str, canvas: Canvas, thinning: Thinning):
        self.name = name
        self.logged_count = 0
        self.failed_count = 0
        self.failure: str | None = None
        self._canvas = canvas
        self._thinning = thinning
        self._slot: LatestSlot[Frame] = LatestSlot()
        self._deadline = 0.0
        self._thread = threading.Thread(target=self._run, name=f"view-{name}", daemon=True)
        self._thread.start()

    @property
    def dropped_count(self) -> int:
        """Frames that a newer one replaced before they were drawn."""
        return self._slot.dropped_count

    def offer(self, frame: Frame) -> None:
        """Leave a frame to be drawn, if it is wanted; returns at once."""
        if self._thinning.wants_next():
            self._slot.put(frame)

    def end(self, timeout: float) -> None:
        """Let no more frames in, and let the thread finish by so long from now [s]."""
        self._deadline = time.monotonic() + timeout
        self._slot.close()

    def join(self) -> None:
        """Wait for the thread, until the time given to `end` is over."""
        self._thread.join(max(0.0, self._deadline - time.monotonic()))
        if self._thread.is_alive():
            self.failure = f"{self.name}: not finished in time; the last frames may be missing"
            _log.warning(self.failure)

    def _run(self) -> None:
        while (frame := self._slot.take()) is not None:
            try:
                self._canvas.log(frame)
            except Exception as error:  # noqa: BLE001 - whatever it is, the loop must not notice.
                self._note(error)
            else:
                self.logged_count += 1
        try:
            self._canvas.close(max(0.0, self._deadline - time.monotonic()))
        except Exception as error:  # noqa: BLE001
            self._note(error)

    def _note(self, error: Exception) -> None:
        self.failed_count += 1
        if self.failure is None:
            _log.warning("%s: a frame could not be shown", self.name, exc_info=error)
        self.failure = f"{self.name}: {type(error).__name__}: {error}"
