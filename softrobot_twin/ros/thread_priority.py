"""Priority of the thread that runs the ticks.

It is raised where the system allows it, reported, and lowered to a nice value while the thread uses
almost a whole core.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from pathlib import Path

from softrobot_twin.kernels.worker_threads import helper_ids

_REAL_TIME = 5
"""Priority in SCHED_FIFO's range 1 to 99: above all ordinary threads, below the kernel's."""
_HELPER = 4
"""That of the other threads of the process, below the tick's."""
_NICE = -10
_ORDINARY = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK
THROTTLE = Path("/proc/sys/kernel/sched_rt_runtime_us")
_WINDOW = 0.5
"""Time over which the thread's share of a core is measured [s]."""
_LARGEST_SHARE = 0.9
"""Above this share of a core the thread, or all others together, leave too little time to other
programs."""
_PAUSE = 5.0
"""Time after which a lowered priority is raised again [s]."""


class Priority(Enum):
    """Requested priority of the ticks. The value is the word used in the parameter."""

    REAL_TIME = "real_time"
    """SCHED_FIFO; a negative nice value where that is not allowed or not safe."""
    NICE = "nice"
    """A negative nice value."""
    NORMAL = "normal"
    """The ordinary priority."""


class ThreadPriority:
    """Raises the priority of the calling thread, and lowers it again when the thread uses a whole
    core.

    A SCHED_FIFO thread that never sleeps would block all other programs on its core. Three rules
    prevent this. Real-time priority is used only if the kernel limits the time of such threads
    (`sched_rt_runtime_us`). It is used only if there is a second core. And `offer`, called after
    each tick, lowers it to a nice value for some seconds when the thread used more than nine tenths
    of a core, as a loop that is always late does: the kernel would stop it at 95 %. Child processes
    do not inherit the priority.

    The other threads of the process, those of the middleware and of the view, get a priority just
    below, because a tick waits while one of them holds Python's lock or a lock of the middleware,
    also when another program has taken that thread's core. Helpers of a step take its own priority
    by themselves. Threads that start later follow within half a second.

    Args:
        wanted: Requested priority.
        clock: Monotonic time [s].
        thread_time: Processor time of the calling thread [s].
        process_time: Processor time of all threads of the process [s].

    Attributes:
        state: The present priority, or the reason why it is not raised, as text.
        is_granted: True when the system granted the request, or there was none.
        times_given_back: How often the priority was lowered.
    """

    def __init__(
        self,
        wanted: Priority,
        clock: Callable[[], float] = time.monotonic,
        thread_time: Callable[[], float] = time.thread_time,
        process_time: Callable[[], float] = time.process_time,
    ):
        self.state, self.is_granted = "normal", wanted is Priority.NORMAL
        self.times_given_back = 0
        self._wanted = wanted
        self._clock, self._thread_time, self._process_time = clock, thread_time, process_time
        self._is_raised = self._is_real_time = False
        self._others: dict[int, int] = {}
        self._nice_before = os.getpriority(os.PRIO_PROCESS, 0)
        self._retake_at = float("inf")
        self._begin_window()

    def take(self) -> None:
        """Requests the priority for the calling thread."""
        if self._wanted is Priority.NORMAL:
            return
        self._begin_window()
        self._retake_at = float("inf")
        reason = self._take_real_time() if self._wanted is Priority.REAL_TIME else ""
        if self._is_real_time:
            self._raise_others()
        else:
            self._take_nice(reason)

    def _take_nice(self, reason: str) -> None:
        """Requests a negative nice value; `reason` is why it is no real-time priority."""
        self._raise_others()
        try:
            _set_ordinary(0, _NICE)
        except OSError as error:
            self._is_raised, self.is_granted = False, False
            self.state = f"normal: {reason or f'nice {_NICE} refused: {error.strerror}'}"
            return
        self._is_raised, self.is_granted = True, self._wanted is Priority.NICE
        self.state = f"nice {_NICE}" + (f": {reason}" if reason else "")

    def _take_real_time(self) -> str:
        """Requests real-time priority; returns the reason of a refusal, or an empty text."""
        if reason := why_unsafe():
            return reason
        try:
            _set_real_time(0, _REAL_TIME)
        except OSError as error:
            return f"real-time priority refused: {error.strerror}"
        self._is_raised = self._is_real_time = self.is_granted = True
        self.state = f"real-time, SCHED_FIFO {_REAL_TIME}"
        return ""

    def give_back(self) -> None:
        """Lowers the thread to ordinary priority."""
        if self._is_raised:
            # Only a privileged process can clear this flag again, so it stays set.
            _set_ordinary(0, self._nice_before)
            for thread, nice in self._others.items():
                with suppress(OSError):  # It has ended.
                    _set_ordinary(thread, nice)
            self._others.clear()
            self._is_raised = self._is_real_time = False

    def offer(self) -> str:
        """Checks the thread's use of its core; called after each tick, in the same thread.

        Returns:
            What changed, in one sentence; empty when nothing changed.
        """
        now = self._clock()
        if now >= self._retake_at:
            self.take()
            return f"priority raised again: {self.state}"
        if not self._is_real_time or now - self._window_began < _WINDOW:
            return ""
        elapsed = now - self._window_began
        computed = self._thread_time() - self._computed_before
        share = computed / elapsed
        share_of_others = (self._process_time() - self._process_before - computed) / elapsed
        self._begin_window()
        self._raise_others()
        who = "the ticks"
        if share < _LARGEST_SHARE:
            if share_of_others < _LARGEST_SHARE:
                return ""
            who, share = "the other threads", share_of_others
        self.give_back()
        # A nice value keeps other programs from no core: they go on with a tenth of it at least.
        reason = f"{who} took {100 * share:.0f} % of a core"
        self._take_nice(reason)
        self.times_given_back += 1
        self._retake_at = now + _PAUSE
        return f"priority lowered for {_PAUSE:g} s: {self.state}"

    def _begin_window(self) -> None:
        self._window_began, self._computed_before = self._clock(), self._thread_time()
        self._process_before = self._process_time()

    def _raise_others(self) -> None:
        """Raises the priority of the other threads of the process, where that is allowed."""
        threads = other_threads() - helper_ids()
        for thread in threads - self._others.keys():
            try:
                nice = os.getpriority(os.PRIO_PROCESS, thread)
                if self._is_real_time:
                    _set_real_time(thread, _HELPER)
                else:
                    os.setpriority(os.PRIO_PROCESS, thread, _NICE)
            except OSError:
                continue  # It is not allowed, or the thread has ended.
            self._others[thread] = nice
        for thread in self._others.keys() - threads:
            del self._others[thread]


def other_threads() -> set[int]:
    """Ids of all threads of the process but the calling one."""
    return {int(name) for name in os.listdir("/proc/self/task")} - {threading.get_native_id()}


def _set_ordinary(thread: int, nice: int) -> None:
    """Gives a thread ordinary priority with a nice value."""
    os.sched_setscheduler(thread, _ORDINARY, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, thread, nice)


def _set_real_time(thread: int, priority: int) -> None:
    """Gives a thread real-time priority, which its children do not inherit."""
    flags = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(thread, flags, os.sched_param(priority))


def why_unsafe() -> str:
    """Why real-time priority could freeze this machine; empty when it could not."""
    # Counts the machine's cores, not only those of this process: other programs may use the others.
    if (os.cpu_count() or 1) < 2:
        return "no real-time priority on a single core: it would block all other programs"
    try:
        limit = int(THROTTLE.read_text())
    except (OSError, ValueError):
        return ""
    if limit < 0:
        return f"no real-time priority without the kernel's limit on its time ({THROTTLE} is -1)"
    return ""
