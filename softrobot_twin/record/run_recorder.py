"""Records a run while the loop ticks. A thread writes the file, and the loop never waits.

The tick only puts what happened since the last one into a queue; numbers become text, and messages
bytes, in the thread. Where the queue is full, because the disk does not follow, whole ticks are
dropped and counted: from there on the run cannot be replayed, which the file says.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from softrobot_twin.control.twin_loop import TickOutcome, TwinLoop
from softrobot_twin.record.loop_calls import call_to_json
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
        is_entry: Whether a replay needs it: a call or a tick, no message.
        time: When, on the clock of the stamps [ns].
        write: Writes it.
    """

    is_entry: bool
    time: int
    write: Callable[[], None]


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
        self._queue: SimpleQueue[list[Noted] | None] = SimpleQueue()
        self._most_waiting = most_waiting
        self.writer = RunWriter(path, f"{description.node}/record")
        self.writer.begin(description)
        loop.listeners.append(self._note_call)
        self._tick_of_loop, loop.tick = loop.tick, self._tick
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Ticks that wait to be written."""
        return self._queue.qsize()

    def note_message(self, topic: Topic, message: object) -> None:
        """Notes a message that came or went; it must not be changed any more.

        Args:
            topic: Where it came or went.
            message: The message.
        """
        time = max(0, self._ros_time())  # MCAP has no times before its epoch.
        self._add(Noted(False, time, lambda: self.writer.add_message(topic, time, self._to_bytes(message))))

    def pass_on(self) -> None:
        """Passes on what was noted; called after each tick."""
        pending, self._pending = self._pending, []
        if self.waiting >= self._most_waiting:
            self.lost += sum(noted.is_entry for noted in pending)
        elif pending:
            self._queue.put(pending)

    def close(self, timeout: float = END_TIMEOUT) -> None:
        """Writes the rest and closes the file.

        Args:
            timeout: Longest time that it waits for this [s]; then the file has no end.
        """
        self.pass_on()
        self._queue.put(None)
        self._thread.join(timeout)
        if self._thread.is_alive():
            self._fail(f"{self.path}: not finished in {timeout:g} s; its end is missing")

    def _note_call(self, *call: Any) -> None:
        self._note_entry(self._ros_time(), lambda: {"kind": CALL, **call_to_json(*call)})

    def _tick(self, now: float, ros_time: int) -> TickOutcome:
        self._clock.take()  # What the clock was read for beside steps.
        outcome = self._tick_of_loop(now, ros_time)
        number, clock = self.ticks, self._clock.take()
        self.ticks += 1
        self._note_entry(ros_time, lambda: {
            "kind": TICK, "tick": number, "now": now, "ros_time": ros_time, "clock": clock,
            "values": tick_values(outcome),
        })  # fmt: skip
        return outcome

    def _note_entry(self, time: int, content: Callable[[], dict[str, Any]]) -> None:
        """Notes an entry, whose content is found in the thread."""
        sequence, self._sequence = self._sequence, self._sequence + 1
        time = max(0, time)
        self._add(Noted(True, time, lambda: self.writer.add_entry(sequence, time, content())))

    def _add(self, noted: Noted) -> None:
        self._pending.append(noted)
        if len(self._pending) >= MOST_PENDING:
            self.pass_on()

    # --- in the thread ---

    def _run(self) -> None:
        due = time.monotonic() + FLUSH_PERIOD
        while (batch := self._take()) is not None:
            if self.failure:
                continue
            try:
                for noted in batch:
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

    def _take(self) -> list[Noted] | None:
        """What was passed on; nothing where nothing came for `FLUSH_PERIOD`, None at the end."""
        try:
            return self._queue.get(timeout=FLUSH_PERIOD)
        except Empty:
            return []

    def write(self, noted: Noted) -> None:
        """Writes what was noted, in the recorder's thread.

        Args:
            noted: What was noted.
        """
        self._newest = noted.time
        noted.write()

    def _fail(self, failure: str) -> None:
        if not self.failure:
            self.failure = failure
            _log.warning("record: %s", failure)
