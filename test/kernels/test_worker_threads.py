"""Threads that work on one list of tasks."""

import copy
import gc
import multiprocessing
import os
import pickle
import threading
import time

import numpy as np
import pytest

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.kernels.worker_threads import (
    STOPPED,
    Team,
    WatchedTeam,
    default_thread_count,
    finish,
    helper_ids,
    take,
    team_of,
    wait_for,
)


@njit(**KERNEL)
def _sum_up(waits_for_all, state, done, numbers):
    """Each task works for some microseconds, then adds one to the number of the task before."""
    number = take(state)
    while number < len(done):
        worked = 0.0
        for k in range(1000 * (number % 3)):
            worked += np.sqrt(k)
        if number > 0 and not wait_for(number - 1, state, done):
            return -1
        numbers[number] = (number > 0 and numbers[number - 1]) + (worked >= 0.0)
        finish(number, done)
        number = take(state)
    if waits_for_all and not wait_for(len(done) - 1, state, done):
        return -1
    return numbers[-1]


def _run(team, count=500):
    numbers = np.zeros(count, np.int64)
    assert team.run(count, _sum_up, numbers) == count
    return numbers


def _helpers():
    return [thread for thread in threading.enumerate() if thread.name == "step helper"]


def _wait_until(is_so, seconds=30.0):
    end = time.monotonic() + seconds
    while not is_so() and time.monotonic() < end:
        time.sleep(0.01)
    return is_so()


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_tasks_wait_for_those_before_them(count):
    team = Team(count)
    for _ in range(50):
        np.testing.assert_array_equal(_run(team), np.arange(1, 501))


def test_what_a_helper_raises_reaches_the_caller():
    def kernel(is_caller, state, done):
        if not is_caller:
            raise ValueError("a helper failed")
        assert _wait_until(lambda: state[STOPPED])

    team = Team(2)
    with pytest.raises(ValueError, match="a helper failed"):
        team.run(1, kernel)
    assert _run(team)[-1] == 500


def test_what_the_caller_raises_stops_the_helpers():
    seen = []

    def kernel(is_caller, state, done):
        if is_caller:
            raise ValueError("the caller failed")
        seen.append(_wait_until(lambda: state[STOPPED]))

    with pytest.raises(ValueError, match="the caller failed"):
        Team(2).run(1, kernel)
    assert _wait_until(lambda: seen) == [True]


def test_helpers_end_with_their_team():
    # Those of other teams may end meanwhile.
    before, team = set(_helpers()), Team(3)
    _run(team)
    own = set(_helpers()) - before
    assert len(own) == 2 and len(helper_ids()) >= 2
    del team
    gc.collect()
    assert _wait_until(lambda: not own & set(_helpers()))


def test_all_that_ask_share_a_team():
    team = team_of(2)
    assert team_of(2) is team and copy.deepcopy(team) is team
    assert pickle.loads(pickle.dumps(team)) is team


def _answer_in_child(team, pipe):
    pipe.send((_run(team)[-1], len(_helpers())))


def test_a_forked_process_has_helpers_of_its_own():
    team = Team(2)
    _run(team)
    context = multiprocessing.get_context("fork")
    pipe, other = context.Pipe()
    child = context.Process(target=_answer_in_child, args=(team, other))
    child.start()
    assert pipe.poll(60.0)
    assert pipe.recv() == (500, 1)
    child.join()


def test_helpers_take_the_priority_of_the_caller():
    team, found, wanted = Team(2), [], min(os.getpriority(os.PRIO_PROCESS, 0) + 3, 19)

    def kernel(is_caller, state, done):
        if is_caller:
            assert _wait_until(lambda: found)
        else:
            found.append(os.getpriority(os.PRIO_PROCESS, 0))

    def call():
        os.setpriority(os.PRIO_PROCESS, 0, wanted)  # of this thread
        team.run(1, kernel)

    caller = threading.Thread(target=call)
    caller.start()
    caller.join()
    assert found == [wanted]


class _NotedTeam(Team):
    """Notes which runs have helpers."""

    def __init__(self):
        super().__init__(2)
        self.has_helpers = []

    def run(self, task_count, kernel, *arguments, is_alone=False):
        self.has_helpers.append(not is_alone)
        return super().run(task_count, kernel, *arguments, is_alone=is_alone)


@pytest.mark.parametrize("alone, waited, with_helpers", [
    (0.3, 0.0, [0, 2, 3, 4, 5, 6, 7, 8, 9]), (0.0, 0.001, [0, 2, 5, 10, 19, 36, 69, 134, 263, 520]),
], ids=["they save time", "they save none"])  # fmt: skip
def test_helpers_are_left_out_ever_longer_while_they_save_no_time(alone, waited, with_helpers):
    """Alone, a run takes processor time [s]; with helpers it waits as long [s], as where their cores are busy."""
    team = _NotedTeam()
    watched = WatchedTeam(team)

    def kernel(is_caller, state, done):
        end = time.thread_time() + (0.0 if team.has_helpers[-1] else alone)
        time.sleep(waited)
        while time.thread_time() < end:
            pass

    for _ in range(with_helpers[-1] + 1):
        watched.run(1, kernel)
    np.testing.assert_array_equal(np.flatnonzero(team.has_helpers), with_helpers)


def test_threads_are_the_cores_of_the_process_at_most_four():
    assert default_thread_count() == min(4, len(os.sched_getaffinity(0)))
