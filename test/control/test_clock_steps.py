"""Clocks that are set, and what is measured all the same."""

import random

import pytest

from softrobot_twin.control.arrival import Arrival, HeaderCheck, SENDER_PATIENCE
from softrobot_twin.control.clock_steps import NANOSECONDS
from softrobot_twin.control.clock_steps import ClockWatch, ElapsedTime
from softrobot_twin.control.refusal import Refusal

SEEDS = [0, 1, 2]


def stream(check, times, offset, own=0.0, start=1.0e6):
    """Refusals of messages at times [s], stamped by a clock set by `offset`, ours by `own`."""
    refusals = []
    for time in times:
        stamp, here = (round((start + time + by) * NANOSECONDS) for by in (offset, own))
        arrival = Arrival("base_link", stamp, here, time)
        refusals.append(check.refusal(arrival))
        if refusals[-1] is None:
            check.remember(arrival)
    return refusals


def ticks(start, end, step=0.02):
    return [start + step * k for k in range(round((end - start) / step))]


@pytest.mark.parametrize("seconds", [-3600.0, -5.0, -0.2, 60.0])
def test_the_order_begins_anew_when_all_clocks_are_set(seconds):
    check = HeaderCheck("base_link", 0.5, 0.1)
    assert not any(stream(check, ticks(0.0, 1.0), 0.0))
    assert not any(stream(check, ticks(1.0, 3.0), seconds, own=seconds))


@pytest.mark.parametrize("timeout", [0.0, 20.0])
def test_a_sender_whose_clock_was_set_back_is_believed_after_a_while(timeout):
    check = HeaderCheck("base_link", timeout, 0.1)
    stream(check, ticks(0.0, 1.0), 0.0)
    times = ticks(1.0, 3.0)
    refusals = stream(check, times, -10.0)
    assert set(refusals) == {None, Refusal.OUT_OF_ORDER}
    first = refusals.index(None)
    assert times[first] - 1.0 == pytest.approx(SENDER_PATIENCE, abs=0.03)
    assert not any(refusals[first:])


@pytest.mark.parametrize("seed", SEEDS)
def test_what_the_network_delivers_late_among_newer_ones_stays_refused(seed):
    draw = random.Random(seed)
    check = HeaderCheck("base_link", 20.0, 0.1)
    stream(check, [0.0], 0.0)
    for time in ticks(0.02, 5.0):
        assert stream(check, [time], 0.0) == [None]
        late = draw.uniform(0.05, 10.0)
        assert stream(check, [time + 0.001], -late) == [Refusal.OUT_OF_ORDER]


def test_a_clock_that_is_slewed_is_not_taken_for_one_that_was_set():
    watch = ClockWatch()
    for second in range(1000):
        assert watch.step(round((1e6 + 1.0005 * second) * NANOSECONDS), float(second)) == 0.0
    assert watch.step(round((1e6 + 1.0005 * 1000 - 7.0) * NANOSECONDS), 1000.0) == pytest.approx(
        -7.0, abs=1e-2)
    assert watch.step(round((1e6 + 1.0005 * 1001 - 7.0) * NANOSECONDS), 1001.0) == 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_elapsed_time_never_goes_back(seed):
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
