"""Headers of messages: frame, age, order, and clocks that are set."""

import random

import pytest

from softrobot_twin.control.arrival import SENDER_ACCEPT_AFTER, Arrival, HeaderCheck, Refusal
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS

NOW = 1_700_000_000 * NANOSECONDS


def arrived(age=0.0, frame_id="base_link", stamp=None):
    stamp = NOW - round(age * NANOSECONDS) if stamp is None else stamp
    return Arrival(frame_id, stamp, NOW, 12.0)


def header_check(frame_id, message_timeout):
    settings = LoopSettings(message_timeout=message_timeout, future_tolerance=0.1)
    return HeaderCheck(frame_id, settings)


@pytest.fixture
def check():
    return header_check("base_link", 0.5)


@pytest.mark.parametrize("arrival, refusal", [
    (arrived(), None),
    (arrived(age=0.49), None),
    (arrived(age=0.51), Refusal.STALE),
    (arrived(age=-0.09), None),
    (arrived(age=-0.11), Refusal.FROM_THE_FUTURE),
    (arrived(frame_id="map"), Refusal.WRONG_FRAME),
    (arrived(frame_id=""), Refusal.WRONG_FRAME),
    (arrived(stamp=0), None),
])  # fmt: skip
def test_a_header_is_refused_for_its_frame_and_its_age(check, arrival, refusal):
    assert check.refusal(arrival) is refusal


def test_a_message_older_than_the_last_one_is_refused(check):
    check.remember(arrived(age=0.1))
    assert check.refusal(arrived(age=0.2)) is Refusal.OUT_OF_ORDER
    assert check.refusal(arrived(age=0.1)) is None


def test_a_message_without_a_stamp_is_stamped_on_arrival(check):
    check.remember(arrived(stamp=0))
    assert check.refusal(arrived(age=0.001)) is Refusal.OUT_OF_ORDER
    check.forget()
    assert check.refusal(arrived(age=0.001)) is None


def test_no_message_is_stale_without_a_timeout():
    assert header_check("base_link", 0.0).refusal(arrived(age=1e6)) is None


def test_a_message_that_needs_no_frame_may_state_any_frame():
    assert header_check(None, 0.5).refusal(arrived(frame_id="map")) is None


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
def test_the_message_order_restarts_when_all_clocks_are_set(seconds):
    check = header_check("base_link", 0.5)
    assert not any(stream(check, ticks(0.0, 1.0), 0.0))
    assert not any(stream(check, ticks(1.0, 3.0), seconds, own=seconds))


@pytest.mark.parametrize("timeout", [0.0, 20.0])
def test_a_sender_whose_clock_was_set_back_is_accepted_after_a_while(timeout):
    check = header_check("base_link", timeout)
    stream(check, ticks(0.0, 1.0), 0.0)
    times = ticks(1.0, 3.0)
    refusals = stream(check, times, -10.0)
    assert set(refusals) == {None, Refusal.OUT_OF_ORDER}
    first = refusals.index(None)
    assert times[first] - 1.0 == pytest.approx(SENDER_ACCEPT_AFTER, abs=0.03)
    assert not any(refusals[first:])


@pytest.mark.parametrize("seed", SEEDS)
def test_late_messages_among_newer_ones_stay_refused(seed):
    draw = random.Random(seed)
    check = header_check("base_link", 20.0)
    stream(check, [0.0], 0.0)
    for time in ticks(0.02, 5.0):
        assert stream(check, [time], 0.0) == [None]
        late = draw.uniform(0.05, 10.0)
        assert stream(check, [time + 0.001], -late) == [Refusal.OUT_OF_ORDER]
