"""One thread that draws the newest frame into one recording."""

from __future__ import annotations

import logging
import threading
import time
from typing import Protocol

from softrobot_twin.view.frame import Frame
from softrobot_twin.view.slot import LatestSlot

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
