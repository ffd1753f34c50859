"""The priority of the ticks is raised, reported and lowered."""

import os
import subprocess
import sys

import pytest

from softrobot_twin.ros import thread_priority
from softrobot_twin.ros.thread_priority import Priority, ThreadPriority, why_unsafe


class System:
    """A system that grants chosen requests, and a thread with a chosen processor time."""

    def __init__(self, monkeypatch, grants_real_time=True, grants_nice=True):
        self.policy, self.nice, self.time, self.computed = os.SCHED_OTHER, 0, 0.0, 0.0
        self.computed_by_others, self.threads, self.others = 0.0, set(), {}
        self.grants_real_time, self.grants_nice = grants_real_time, grants_nice
        monkeypatch.setattr(os, "sched_setscheduler", self._set_policy)
        monkeypatch.setattr(os, "setpriority", self._set_nice)
        monkeypatch.setattr(os, "getpriority", lambda which, who: self.nice)
        monkeypatch.setattr(thread_priority, "other_threads", lambda: set(self.threads))
        monkeypatch.setattr(thread_priority, "why_unsafe", lambda: "")

    def _set_policy(self, thread, policy, parameter):
        assert policy & os.SCHED_RESET_ON_FORK
        if thread:
            self.others[thread] = policy & ~os.SCHED_RESET_ON_FORK, parameter.sched_priority
            return
        policy &= ~os.SCHED_RESET_ON_FORK
        if policy == os.SCHED_FIFO and not self.grants_real_time:
            raise PermissionError(1, "Operation not permitted")
        self.policy = policy

    def _set_nice(self, which, who, nice):
        if nice < 0 and not self.grants_nice:
            raise PermissionError(13, "Permission denied")
        if not who:
            self.nice = nice

    def priority(self, wanted=Priority.REAL_TIME):
        return ThreadPriority(
            wanted, lambda: self.time, lambda: self.computed,
            lambda: self.computed + self.computed_by_others,
        )  # fmt: skip

    def run(self, priority, seconds, share, step=0.01, share_of_others=0.0):
        """Runs ticks that use a share of the time; returns the reported changes."""
        told = []
        for _ in range(round(seconds / step)):
            self.time += step
            self.computed += share * step
            self.computed_by_others += share_of_others * step
            told += [sentence] if (sentence := priority.offer()) else []
        return told


def test_real_time_priority_is_taken_and_reported(monkeypatch):
    system = System(monkeypatch)
    priority = system.priority()
    assert priority.state == "normal" and not priority.is_granted
    priority.take()
    assert system.policy == os.SCHED_FIFO
    assert priority.state == "real-time, SCHED_FIFO 5" and priority.is_granted


def test_without_permission_the_next_best_priority_is_taken_and_the_reason_reported(monkeypatch):
    system = System(monkeypatch, grants_real_time=False)
    priority = system.priority()
    priority.take()
    assert (system.policy, system.nice) == (os.SCHED_OTHER, -10)
    assert priority.state == "nice -10: real-time priority refused: Operation not permitted"
    system.grants_nice, system.nice = False, 0
    priority = system.priority()
    priority.take()
    assert system.nice == 0 and not priority.is_granted
    assert priority.state == "normal: real-time priority refused: Operation not permitted"


def test_a_thread_that_never_sleeps_drops_real_time_priority_and_retakes_it_later(monkeypatch):
    system = System(monkeypatch)
    system.nice = 3
    priority = system.priority()
    priority.take()
    assert system.run(priority, 10.0, 0.7) == []
    assert system.policy == os.SCHED_FIFO
    told = system.run(priority, 1.0, 1.0)
    assert told == ["priority lowered for 5 s: nice -10: the ticks took 100 % of a core"]
    assert (system.policy, system.nice) == (os.SCHED_OTHER, -10)
    assert priority.times_given_back == 1 and not priority.is_granted
    told = system.run(priority, 5.5, 0.5)
    assert told == ["priority raised again: real-time, SCHED_FIFO 5"]
    assert system.policy == os.SCHED_FIFO
    # While it uses a whole core it has real-time priority for at most a tenth of the time.
    raised = 0
    for _ in range(6000):
        system.run(priority, 0.01, 1.0)
        raised += system.policy == os.SCHED_FIFO
    assert raised <= 0.11 * 6000


def test_other_threads_get_real_time_priority_below_that_of_the_ticks(monkeypatch):
    system = System(monkeypatch)
    system.threads = {11, 12}
    priority = system.priority()
    priority.take()
    assert system.others == {11: (os.SCHED_FIFO, 4), 12: (os.SCHED_FIFO, 4)}
    # A thread that starts later gets it too.
    system.threads = {11, 13}
    assert system.run(priority, 1.0, 0.1) == []
    assert system.others[13] == (os.SCHED_FIFO, 4)
    priority.give_back()
    assert system.others[11] == system.others[13] == (os.SCHED_OTHER, 0)


@pytest.mark.parametrize(("cores", "limit", "reason"), [
    (1, "950000\n", "single core"), (2, "-1\n", "without the kernel's limit"),
    (2, "950000\n", ""),
])
def test_real_time_priority_is_not_requested_where_it_could_freeze_the_machine(
    monkeypatch, tmp_path, cores, limit, reason
):
    file = tmp_path / "sched_rt_runtime_us"
    file.write_text(limit)
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    monkeypatch.setattr(thread_priority, "THROTTLE", file)
    why = why_unsafe()
    assert reason in why and bool(why) == bool(reason)


def test_other_threads_get_a_raised_priority_that_is_restored_afterwards():
    """Runs in a separate process, because a raised priority would stay for later tests."""
    code = """
import os, threading
from softrobot_twin.ros.thread_priority import Priority, ThreadPriority
started, end = threading.Event(), threading.Event()
def wait():
    started.set(); end.wait()
other = threading.Thread(target=wait); other.start(); started.wait()
nices = lambda: (os.getpriority(os.PRIO_PROCESS, other.native_id))
priority = ThreadPriority(Priority.NICE)
before = nices()
priority.take()
during, is_granted = nices(), priority.is_granted
priority.give_back()
print(before, during, nices(), os.getpriority(os.PRIO_PROCESS, 0), is_granted)
end.set()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60,
                          check=True)
    before, during, after, own, is_granted = done.stdout.split()
    assert before == after == own
    assert int(during) == (-10 if is_granted == "True" else int(before))
