"""Threads that work on one list of tasks, in compiled code and with the same bits for any number.

A list says which tasks a task waits for, all earlier in the list. Each thread takes the next task,
waits for those, and runs it. So a list never stalls: the tasks that the first unfinished one waits
for are done, and somebody runs it. The calling thread runs the list alone while its helpers wake up
or have other work; it waits for nothing but tasks that a helper has begun.

A kernel that works on a list takes a task by `take`, waits by `wait_for` and ends it by `finish`.
It runs without Python's lock. What tasks compute must not depend on who runs them: each writes what
no other one writes, and sums have one order.

Helpers wait in Python. They belong to a team, which all that ask for as many threads share; they
end with the last of these. They take the priority of the thread that calls them.

Arguments of the kernels here:
    state: State of the list, shape (STATE_SIZE,).
    done: Whether each task is done, shape (task_count,).
    task: Place of a task in the list.
"""

from __future__ import annotations

import os
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from softrobot_twin.kernels.compilation import INNER, njit

MOST_BY_DEFAULT = 4
"""Threads that are used where nobody says how many, at most."""
NEXT, STOPPED, NOTED, STATE_SIZE = 0, 8, 9, 16
"""Places in the state of a list: of the next task, and apart from it by a cache line, of a flag and of
what a kernel notes; all begin with zero."""
# Looks at a task that is not done before the thread lets others run for once, how often it does so
# before it sleeps, and for how long [us]. A sleep costs more than most waits, which end within 0.1 ms.
_LOOKS, _YIELDS, _NAP = 4000, 200, 50
# Most runs without helpers that have saved no time, until they get another chance.
_MOST_ALONE = 256
_yield = types.ExternalFunction("sched_yield", types.int32())
_sleep = types.ExternalFunction("usleep", types.int32(types.uint32))
_WORD = ir.IntType(64)


def _pointer(builder: ir.IRBuilder, address: ir.Value) -> ir.Value:
    return builder.inttoptr(address, _WORD.as_pointer())


@intrinsic
def _fetch_and_add(typing_context, address, value):
    """Add to a word at once, for all threads; what it was before."""

    def generate(context, builder, signature, values):
        return builder.atomic_rmw("add", _pointer(builder, values[0]), values[1], "seq_cst")

    return types.int64(types.int64, types.int64), generate


@intrinsic
def _read(typing_context, address):
    """A word, and all that was written before it."""

    def generate(context, builder, signature, values):
        return builder.load_atomic(_pointer(builder, values[0]), "acquire", 8)

    return types.int64(types.int64), generate


@intrinsic
def _write(typing_context, address, value):
    """Write a word after all that was written before."""

    def generate(context, builder, signature, values):
        builder.store_atomic(values[1], _pointer(builder, values[0]), "seq_cst", 8)

    return types.void(types.int64, types.int64), generate


@njit(**INNER)
def take(state):
    """The next task of the list; at its end a number beyond them."""
    return _fetch_and_add(state.ctypes.data + 8 * NEXT, 1)


@njit(**INNER)
def wait_for(task, state, done):
    """Wait until a task is done.

    Returns:
        False where a thread has stopped with an exception.
    """
    place, looks = done.ctypes.data + 8 * task, 0
    while _read(place) == 0:
        if _read(state.ctypes.data + 8 * STOPPED) != 0:
            return False
        looks += 1
        if looks > _LOOKS * _YIELDS:
            _sleep(np.uint32(_NAP))
        elif looks % _LOOKS == 0:
            _yield()
    return True


@njit(**INNER)
def finish(task, done):
    """Tell all threads that a task is done."""
    _write(done.ctypes.data + 8 * task, 1)


@njit(**INNER)
def note(number, place, state):
    """Add to what a kernel notes at one of the places behind `NOTED`; the sum of all threads."""
    return _fetch_and_add(state.ctypes.data + 8 * (NOTED + place), number) + number


NO_TASKS = np.zeros(0, np.int64)


def run_alone(kernel: Callable, *arguments):
    """Run a kernel of a list without a list, in this thread; see `Team.run`."""
    return kernel(True, NO_TASKS, NO_TASKS, *arguments)


_most_by_default = MOST_BY_DEFAULT


def default_thread_count() -> int:
    """How many threads a large system takes: the cores of this process, at most four."""
    return min(_most_by_default, len(os.sched_getaffinity(0)))


def use_one_thread() -> None:
    """Let one thread be the default in this process: others like it work on the other cores."""
    global _most_by_default
    _most_by_default = 1


class _Job:
    """One run of a list, as helpers see it."""

    def __init__(self, state: np.ndarray, kernel: Callable, arguments: tuple):
        self.state, self.kernel, self.arguments = state, kernel, arguments
        self.error: BaseException | None = None
        # Policy, real-time priority and nice value of the calling thread.
        self.priority = (
            os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, os.getpriority(os.PRIO_PROCESS, 0))

    def work(self) -> None:
        """Take tasks of the list until its end."""
        try:
            self.kernel(False, *self.arguments)
        except BaseException as error:
            self.error = error
            self.state[STOPPED] = 1


def _take_priority(wanted: tuple[int, int, int]) -> None:
    """Give the calling thread a priority, where that is allowed."""
    policy, priority, nice = wanted
    with suppress(OSError):
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, nice)


_helper_ids: set[int] = set()


def helper_ids() -> set[int]:
    """System's ids of the helpers, which take the priority of who calls them."""
    return set(_helper_ids)


def _help(jobs: SimpleQueue) -> None:
    """Work on jobs until there is none instead of one."""
    priority, own = None, threading.get_native_id()
    _helper_ids.add(own)
    while (job := jobs.get()) is not None:
        if job.priority != priority:
            priority = job.priority
            _take_priority(priority)
        job.work()
        job = None  # Its arrays are not kept while the helper waits.
    _helper_ids.discard(own)


class Team:
    """The calling thread and its helpers.

    Attributes:
        count: How many threads they are.
    """

    def __init__(self, count: int):
        """Start the helpers.

        Args:
            count: How many threads, the calling one included.
        """
        self.count = count
        self._process = None
        self._start()

    def _start(self) -> None:
        """Start helpers: those of a process are not in one that was forked from it."""
        self._process = os.getpid()
        self._jobs = [SimpleQueue() for _ in range(self.count - 1)]
        for jobs in self._jobs:
            threading.Thread(target=_help, args=(jobs,), name="step helper", daemon=True).start()
        weakref.finalize(self, _dismiss, self._jobs, self._process)

    def __reduce__(self):
        return team_of, (self.count,)

    def run(self, task_count: int, kernel: Callable, *arguments, is_alone: bool = False):
        """Run a list by all threads of the team.

        Args:
            task_count: Tasks of the list.
            kernel: Takes tasks. Its first arguments are whether it is to wait for all of them,
                the state of the list, and which are done.
            *arguments: The others.
            is_alone: Whether the calling thread runs the list without helpers.

        Returns:
            What the kernel returns.

        Raises:
            BaseException: What a kernel raised, in any thread.
        """
        if self._process != os.getpid():
            self._start()
        # A helper that comes late finds the end of its own list, not another one's tasks.
        state, done = np.zeros(STATE_SIZE, np.int64), np.zeros(task_count, np.int64)
        arguments = (state, done, *arguments)
        job = _Job(state, kernel, arguments)
        for jobs in () if is_alone else self._jobs:
            jobs.put(job)
        try:
            result = kernel(True, *arguments)
        except BaseException:
            state[STOPPED] = 1
            raise
        if job.error is not None:
            raise job.error
        return result


class WatchedTeam:
    """A team that runs the same lists again and again, without its helpers while they save no time.

    Where other programs take the cores, a thread waits for helpers that do not run: a factorization took
    ten times as long as alone. So a run by all that takes longer than the calling thread needs alone is
    followed by one without helpers, which is measured, the next such one by two, by four and so on.

    Args:
        team: The threads.
    """

    def __init__(self, team: Team):
        self._team = team
        self._watches: dict[Callable, _Watch] = {}

    def run(self, task_count: int, kernel: Callable, *arguments):
        """See `Team.run`."""
        watch = self._watches.setdefault(kernel, _Watch())
        clock = time.thread_time if watch.left else time.perf_counter
        begin = clock()
        result = self._team.run(task_count, kernel, *arguments, is_alone=watch.left > 0)
        watch.see(clock() - begin)
        return result


class _Watch:
    """Whether helpers save time in one kernel; `left` are runs without them that are still to come."""

    def __init__(self) -> None:
        self.left, self._pause, self._alone_time = 0, 1, 0.0

    def see(self, spent: float) -> None:
        """Take the time of a run: processor time of one without helpers, else elapsed time [s]."""
        if self.left:
            self._alone_time = spent
            self.left -= 1
        elif spent > self._alone_time:
            self.left, self._pause = self._pause, min(2 * self._pause, _MOST_ALONE)
        else:
            self._pause = 1


def _dismiss(jobs: list[SimpleQueue], process: int) -> None:
    """Let helpers end."""
    if process == os.getpid():
        for one in jobs:
            one.put(None)


_teams: weakref.WeakValueDictionary[int, Team] = weakref.WeakValueDictionary()


def team_of(count: int) -> Team:
    """The team of so many threads, which ends with the last that holds it.

    Args:
        count: How many threads, the calling one included.
    """
    team = _teams.get(count)
    if team is None:
        team = _teams[count] = Team(count)
    return team
