"""The priority of the thread that ticks: taken where the system allows it, told, given back."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from enum import Enum
from pathlib import Path

_REAL_TIME = 5
"""Of SCHED_FIFO's 1 to 99: above every ordinary thread, below those of the kernel."""
_NICE = -10
_ORDINARY = os.SCHED_OTHER | os.SCHED_RESET_ON_FORK
_THROTTLE = Path("/proc/sys/kernel/sched_rt_runtime_us")
_WINDOW = 0.5
"""Time over which the thread's share of a core is measured [s]."""
_GREEDY = 0.9
"""Share of a core from which on the thread does not leave enough to others."""
_PAUSE = 5.0
"""Time after which a priority that was given back is taken again [s]."""


class Priority(Enum):
    """What the ticks ask the system for. The value is the word of the parameter."""

    REAL_TIME = "real_time"
    """SCHED_FIFO; a negative nice value where that is not allowed or not safe."""
    NICE = "nice"
    """A negative nice value."""
    NORMAL = "normal"
    """Nothing."""


class ThreadPriority:
    """Takes a priority for the thread that calls, and gives it back when the thread is greedy.

    A thread of SCHED_FIFO that never sleeps would keep every other program from its core. Three
    things prevent that: real-time priority is taken only where the kernel stops such threads for
    a part of each second (`sched_rt_runtime_us`), and where there is another core; and `offer`,
    called after each tick, gives it back for some seconds when the thread took more than nine
    tenths of a core, as a loop does that is always late. What the thread starts gets none of it.

    The other threads of the process get the nice value: while one of them has Python's lock, the
    ticks wait for it, and for whatever program has taken its core.

    Args:
        wanted: What to ask for.
        clock: Seconds that never go back.
        thread_time: Seconds that the calling thread has computed for.

    Attributes:
        state: What was taken, or why nothing was, in a few words.
        is_granted: True when the system gave what was asked for, or nothing was asked for.
        times_given_back: How often the thread was greedy.
    """

    def __init__(
        self,
        wanted: Priority,
        clock: Callable[[], float] = time.monotonic,
        thread_time: Callable[[], float] = time.thread_time,
    ):
        self.state, self.is_granted = "normal", wanted is Priority.NORMAL
        self.times_given_back = 0
        self._wanted = wanted
        self._clock, self._thread_time = clock, thread_time
        self._is_raised = False
        self._others: dict[int, int] = {}
        self._nice_before = os.getpriority(os.PRIO_PROCESS, 0)
        self._retake_at = float("inf")
        self._begin_window()

    def take(self) -> None:
        """Asks the system, for the thread that calls."""
        if self._wanted is Priority.NORMAL:
            return
        self._others = _nice_other_threads(_NICE)
        self._begin_window()
        self._retake_at = float("inf")
        reason = ""
        if self._wanted is Priority.REAL_TIME:
            reason = self._take_real_time()
            if not reason:
                return
        try:
            os.sched_setscheduler(0, _ORDINARY, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, 0, _NICE)
        except OSError as error:
            self._is_raised, self.is_granted = False, False
            self.state = f"normal: {reason or f'no nice {_NICE}: {error.strerror}'}"
            return
        self._is_raised, self.is_granted = True, self._wanted is Priority.NICE
        self.state = f"nice {_NICE}" + (f": {reason}" if reason else "")

    def _take_real_time(self) -> str:
        """Why it was not taken; empty when it was."""
        if reason := why_unsafe():
            return reason
        try:
            flags = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(0, flags, os.sched_param(_REAL_TIME))
        except OSError as error:
            return f"no real-time priority: {error.strerror}"
        self._is_raised = self.is_granted = True
        self.state = f"real-time, SCHED_FIFO {_REAL_TIME}"
        return ""

    def give_back(self) -> None:
        """Goes on as an ordinary thread."""
        if self._is_raised:
            # Once set, the flag can be cleared by the privileged only.
            os.sched_setscheduler(0, _ORDINARY, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, 0, self._nice_before)
            for thread, nice in self._others.items():
                _set_nice(thread, nice)
            self._is_raised = False

    def offer(self) -> str:
        """Called after each tick, in the thread that ticks.

        Returns:
            What changed, in a sentence; empty when nothing did.
        """
        now = self._clock()
        if now >= self._retake_at:
            self.take()
            return f"priority taken again: {self.state}"
        if not self._is_raised or now - self._window_began < _WINDOW:
            return ""
        share = (self._thread_time() - self._computed_before) / (now - self._window_began)
        self._begin_window()
        if share < _GREEDY:
            return ""
        self.give_back()
        self.times_given_back += 1
        self._retake_at = now + _PAUSE
        self.is_granted = False
        self.state = f"normal: the ticks took {100 * share:.0f} % of a core"
        return f"priority given back for {_PAUSE:g} s: the ticks took {100 * share:.0f} % of a core"

    def _begin_window(self) -> None:
        self._window_began, self._computed_before = self._clock(), self._thread_time()


def _nice_other_threads(nice: int) -> dict[int, int]:
    """Gives the threads that the process has beside this one a nice value, where that is allowed.

    Returns:
        The value that each one had that was changed, by thread id.
    """
    own, before = threading.get_native_id(), {}
    for entry in Path("/proc/self/task").iterdir():
        thread = int(entry.name)
        if thread == own:
            continue
        try:
            had = os.getpriority(os.PRIO_PROCESS, thread)
        except OSError:
            continue
        if _set_nice(thread, nice):
            before[thread] = had
    return before


def _set_nice(thread: int, nice: int) -> bool:
    """Whether it could be done: it may not be allowed, and the thread may have ended."""
    try:
        os.setpriority(os.PRIO_PROCESS, thread, nice)
    except OSError:
        return False
    return True


def why_unsafe() -> str:
    """Why real-time priority could freeze this machine; empty when it could not."""
    # Counts the machine's cores, not those of this process: other programs may use the others.
    if (os.cpu_count() or 1) < 2:
        return "no real-time priority with a single core, which it would keep from all others"
    try:
        limit = int(_THROTTLE.read_text())
    except (OSError, ValueError):
        return ""
    if limit < 0:
        return f"no real-time priority without the kernel's limit on it ({_THROTTLE} is -1)"
    return ""
