"""Records a run while the loop ticks. A thread writes the file, and the loop never waits.

The tick only puts what happened since the last one into a queue; numbers become text, and messages
bytes, in the thread. Where the queue is full, because the disk does not follow, whole ticks are
dropped and counted: from there on the run cannot be replayed, which the file says.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop
from softrobot_twin.record.loop_calls import Call, listen
from softrobot_twin.record.run_clock import RecordedClock
from softrobot_twin.record.run_description import RunDescription
from softrobot_twin.record.run_file import CALL, END, TICK, RunWriter, Topic
from softrobot_twin.record.run_values import tick_values

MOST_WAITING = 500
"""Ticks that wait to be written, at most: ten seconds at 50 Hz."""
MOST_PENDING = 200
"""Calls and messages between two ticks that are put into the queue together, at most."""
FLUSH_PERIOD = 0.5
"""A process that is killed loses at most what happened in this time [s]."""
END_TIMEOUT = 10.0

_log = logging.getLogger(__name__)


class Noted(NamedTuple):
    """Something that happened.

    Attributes:
        sequence: Number of an entry; -1 for a message.
        time: When, on the clock of the stamps [ns].
        content: A `Call`, a `Tick` or a `Said`.
    """

    sequence: int
    time: int
    content: object


class Tick(NamedTuple):
    """One tick.

    Attributes:
        number: Its number, from 0.
        now: Time on the monotonic clock [s].
        ros_time: Time on the clock of the stamps [ns].
        clock: Readings of the clock in its step [s].
        outcome: What it gave.
    """

    number: int
    now: float
    ros_time: int
    clock: list[float]
    outcome: TickOutcome

    def to_json(self) -> dict[str, object]:
        """The tick as JSON."""
        return {
            "tick": self.number, "now": self.now, "ros_time": self.ros_time, "clock": self.clock,
            "values": tick_values(self.outcome),
        }  # fmt: skip


class Said(NamedTuple):
    """A message.

    Attributes:
        topic: Its topic.
        message: It.
    """

    topic: Topic
    message: object


class BoundedQueue:
    """Passes items from one thread to another; what does not fit is dropped.

    `put` acquires no lock that the taking thread could hold; see `LatestItem` of the view.

    Attributes:
        dropped: Items that did not fit.
    """

    def __init__(self, most: int):
        self._most, self.dropped = most, 0
        self._items: deque = deque()
        self._signal = threading.Lock()
        self._signal.acquire()
        self._closed = False

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: object) -> bool:
        """Passes an item on and returns at once; false where it was dropped."""
        if self._closed or len(self._items) >= self._most:
            self.dropped += 1
            return False
        self._items.append(item)
        self._notify()
        return True

    def take(self, timeout: float) -> object | None:
        """The oldest item; None where none came in this time [s], or no more will."""
        deadline = time.monotonic() + timeout
        while not self._items:
            left = deadline - time.monotonic()
            if self._closed or left <= 0.0:
                return None
            self._signal.acquire(timeout=left)
        return self._items.popleft()

    @property
    def is_over(self) -> bool:
        """Whether it is empty and takes no more."""
        return self._closed and not self._items

    def close(self) -> None:
        """Takes no more items; those inside can still be taken."""
        self._closed = True
        self._notify()

    def _notify(self) -> None:
        try:
            self._signal.release()
        except RuntimeError:
            pass  # The signal is already set.


class RunRecorder:
    """Records one run.

    Attributes:
        path: The file.
        ticks: Ticks that were noted.
        lost: Calls and ticks that were dropped; from the first on the run cannot be replayed.
        failure: Why nothing is written any more; empty while it is.
        writer: Writes the file, in the recorder's thread.
    """

    def __init__(
        self, path: Path, loop: TwinLoop, clock: RecordedClock, description: RunDescription,
        ros_time: Callable[[], int], to_bytes: Callable[[object], bytes],
        most_waiting: int = MOST_WAITING,
    ):  # fmt: skip
        """Opens the file, and notes all that reaches the loop from now on.

        Args:
            path: The file.
            loop: The loop, warmed up and before its first tick.
            clock: The clock of its simulation.
            description: What the run begins with.
            ros_time: The clock of the stamps [ns].
            to_bytes: Writes a message of ROS in CDR.
            most_waiting: Ticks that wait to be written, at most.

        Raises:
            RunFileError: The file cannot be written.
        """
        self.path, self.ticks, self.lost, self.failure = path, 0, 0, ""
        self._clock, self._ros_time, self._to_bytes = clock, ros_time, to_bytes
        self._sequence, self._pending, self._newest = 1, [], description.began
        self._queue = BoundedQueue(most_waiting)
        self.writer = RunWriter(path, f"{description.node}/record")
        self.writer.begin(description)
        listen(loop, self._note_call)
        self._tick_of_loop, loop.tick = loop.tick, self._tick
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Ticks that wait to be written."""
        return len(self._queue)

    def note_message(self, topic: Topic, message: object) -> None:
        """Notes a message that came or went; it must not be changed any more."""
        self._add(-1, self._ros_time(), Said(topic, message))

    def pass_on(self) -> None:
        """Passes on what was noted; called after each tick."""
        pending, self._pending = self._pending, []
        if pending and not self._queue.put(pending):
            self.lost += sum(noted.sequence >= 0 for noted in pending)

    def close(self, timeout: float = END_TIMEOUT) -> None:
        """Writes the rest and closes the file.

        Args:
            timeout: Longest time that it waits for this [s]; then the file has no end.
        """
        self.pass_on()
        self._queue.close()
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._fail(f"{self.path}: not finished in {timeout:g} s; its end is missing")

    def _note_call(self, call: Call) -> None:
        self._add(self._next(), self._ros_time(), call)

    def _tick(self, now: float, ros_time: int) -> TickOutcome:
        self._clock.take()  # What the clock was read for beside steps.
        outcome = self._tick_of_loop(now, ros_time)
        tick = Tick(self.ticks, now, ros_time, self._clock.take(), outcome)
        self.ticks += 1
        self._add(self._next(), ros_time, tick)
        return outcome

    def _next(self) -> int:
        sequence, self._sequence = self._sequence, self._sequence + 1
        return sequence

    def _add(self, sequence: int, time_ns: int, content: object) -> None:
        # MCAP has no times before its epoch.
        self._pending.append(Noted(sequence, max(0, time_ns), content))
        if len(self._pending) >= MOST_PENDING:
            self.pass_on()

    # --- in the thread ---

    def _run(self) -> None:
        due = time.monotonic() + FLUSH_PERIOD
        while not self._queue.is_over:
            batch = self._queue.take(FLUSH_PERIOD)
            if self.failure:
                continue
            try:
                for noted in batch or ():
                    self.write(noted)
                if time.monotonic() >= due:
                    self.writer.flush()
                    due = time.monotonic() + FLUSH_PERIOD
            except Exception as error:  # noqa: BLE001 - no error may reach the loop
                self._fail(f"{self.path}: {type(error).__name__}: {error}")
        if self.failure:
            self.writer.abandon()
            return
        try:
            end = {"kind": END, "ticks": self.ticks}
            self.writer.add_entry(self._sequence, self._newest, end)
            self.writer.finish()
        except Exception as error:  # noqa: BLE001
            self._fail(f"{self.path}: {type(error).__name__}: {error}")

    def write(self, noted: Noted) -> None:
        """Writes what was noted, in the recorder's thread."""
        sequence, self._newest, content = noted
        if isinstance(content, Said):
            data = self._to_bytes(content.message)
            self.writer.add_message(content.topic, noted.time, data)
        elif isinstance(content, Call):
            self.writer.add_entry(sequence, noted.time, {"kind": CALL, **content.to_json()})
        else:
            self.writer.add_entry(sequence, noted.time, {"kind": TICK, **content.to_json()})

    def _fail(self, failure: str) -> None:
        if not self.failure:
            self.failure = failure
            _log.warning("record: %s", failure)
