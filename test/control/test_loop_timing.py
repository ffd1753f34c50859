"""Ticks on a time grid, clocks that are set, statistics, and garbage collection (hard case 38)."""

import math
import random

import pytest

from softrobot_twin.control.loop_timing import NANOSECONDS, ClockWatch, ElapsedTime, TickClock

PERIOD = 0.1


class Timer:
    """A timer like that of ROS: on a grid, and late ones fall back onto it."""

    def __init__(self):
        self.time = 0.0
        self.clock = TickClock(PERIOD, lambda: self.time)
        self.begun = []

    def tick(self, work, late=0.0):
        """The next tick, `late` after its grid point at the earliest, its work taking so long."""
        due = self.begun[-1][1] if self.begun else 0.0
        self.time = max(self.time, due + late)
        after = (math.floor(self.time / PERIOD + 1e-9) + 1) * PERIOD
        self.begun.append((self.time, after))
        self.clock.begin(after - self.time)
        self.time += work
        return self.clock.end()


def test_ticks_on_time_are_neither_skipped_nor_missed():
    timer = Timer()
    for _ in range(100):
        assert timer.tick(work=0.06) == pytest.approx(0.04)
    assert (timer.clock.ticks, timer.clock.skipped, timer.clock.missed) == (100, 0, 0)


def test_jitter_is_not_counted_as_a_skip():
    timer = Timer()
    for late in (0.0, 0.09, 0.0, 0.05, 0.0, 0.099, 0.0):
        timer.tick(work=0.0001, late=late)
    assert timer.clock.skipped == 0


def test_work_longer_than_the_period_misses_its_deadline_and_skips_ticks():
    timer = Timer()
    timer.tick(work=0.01)
    assert timer.tick(work=0.35) < 0.0
    # Due at 0.1, done at 0.45: the points 0.2 and 0.3 are gone, and 0.4 comes late.
    assert timer.tick(work=0.01) > 0.0
    assert (timer.clock.skipped, timer.clock.missed) == (2, 1)


def test_a_loop_that_is_always_too_slow_queues_nothing():
    timer = Timer()
    for _ in range(20):
        timer.tick(work=0.25)
    clock = timer.clock
    assert clock.missed == clock.ticks == 20
    # Every grid point up to the last tick was either taken or skipped, none was put off.
    assert clock.skipped + clock.ticks == math.floor(timer.begun[-1][0] / PERIOD + 1e-9) + 1
    for (begun, _), (following, _) in zip(timer.begun, timer.begun[1:], strict=False):
        assert following - begun >= 0.25 - 1e-9


SEEDS = [0, 1, 2]


def test_a_slewed_clock_is_not_treated_as_a_set_clock():
    watch = ClockWatch()
    for second in range(1000):
        assert watch.step(round((1e6 + 1.0005 * second) * NANOSECONDS), float(second)) == 0.0
    assert watch.step(round((1e6 + 1.0005 * 1000 - 7.0) * NANOSECONDS), 1000.0) == pytest.approx(
        -7.0, abs=1e-2)
    assert watch.step(round((1e6 + 1.0005 * 1001 - 7.0) * NANOSECONDS), 1001.0) == 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_elapsed_time_never_decreases(seed):
    draw = random.Random(seed)
    clock, passed = [0], 0
    elapsed = ElapsedTime(lambda: clock[0])
    assert elapsed() == 0.0
    clock[0] = 1_700_000_000 * NANOSECONDS  # A clock that begins is no time that passed.
    assert elapsed() == 0.0
    for _ in range(500):
        by = draw.choice((0, draw.randrange(10**9), -draw.randrange(10**12)))
        clock[0] += by
        passed += max(0, by)
        assert elapsed() == passed / NANOSECONDS
