"""Ticks, skips and misses, on a clock that the test turns (hard case 38)."""

import math

import pytest

from softrobot_twin.control.tick_clock import TickClock

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
        tick = timer.tick(work=0.06)
        assert tick.slack == pytest.approx(0.04) and not tick.missed
    assert (timer.clock.ticks, timer.clock.skipped, timer.clock.missed) == (100, 0, 0)


def test_jitter_is_no_skip():
    timer = Timer()
    for late in (0.0, 0.09, 0.0, 0.05, 0.0, 0.099, 0.0):
        timer.tick(work=0.0001, late=late)
    assert timer.clock.skipped == 0


def test_work_longer_than_the_period_is_missed_and_what_it_covers_is_skipped():
    timer = Timer()
    timer.tick(work=0.01)
    assert timer.tick(work=0.35).missed
    after = timer.tick(work=0.01)
    # Due at 0.1, done at 0.45: the points 0.2 and 0.3 are gone, and 0.4 comes late.
    assert after.skipped == 2 and not after.missed
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


def test_the_period_is_measured():
    timer = Timer()
    for late in (0.0, 0.02, 0.0):
        timer.tick(work=0.001, late=late)
    summary = timer.clock.statistics.summary()
    assert summary.period_max == pytest.approx(0.12)
    assert summary.period_mean == pytest.approx(0.1)


def test_another_period_goes_on_counting_on_another_grid():
    timer = Timer()
    timer.tick(work=0.001)
    timer.clock.restart(0.03)
    timer.time = 1.0
    timer.clock.begin(0.03)
    assert timer.clock.end().skipped == 0
    assert timer.clock.ticks == 2


def test_an_end_needs_a_beginning():
    with pytest.raises(RuntimeError):
        TickClock(PERIOD).end()
