"""Headers: frames, ages and order."""

import pytest

from softrobot_twin.control.arrival import Arrival, HeaderCheck
from softrobot_twin.control.clock_steps import NANOSECONDS
from softrobot_twin.control.refusal import Refusal

NOW = 1_700_000_000 * NANOSECONDS


def arrived(age=0.0, frame_id="base_link", stamp=None):
    stamp = NOW - round(age * NANOSECONDS) if stamp is None else stamp
    return Arrival(frame_id, stamp, NOW, 12.0)


@pytest.fixture
def check():
    return HeaderCheck("base_link", message_timeout=0.5, future_tolerance=0.1)


@pytest.mark.parametrize(
    ("arrival", "refusal"),
    [
        (arrived(), None),
        (arrived(age=0.49), None),
        (arrived(age=0.51), Refusal.STALE),
        (arrived(age=-0.09), None),
        (arrived(age=-0.11), Refusal.FROM_THE_FUTURE),
        (arrived(frame_id="map"), Refusal.WRONG_FRAME),
        (arrived(frame_id=""), Refusal.WRONG_FRAME),
        (arrived(stamp=0), None),
    ],
)
def test_a_header_is_refused_for_its_frame_and_its_age(check, arrival, refusal):
    assert check.refusal(arrival) is refusal


def test_a_message_that_a_newer_one_has_overtaken_is_refused(check):
    check.remember(arrived(age=0.1))
    assert check.refusal(arrived(age=0.2)) is Refusal.OUT_OF_ORDER
    assert check.refusal(arrived(age=0.1)) is None


def test_a_message_without_a_stamp_counts_as_of_now(check):
    check.remember(arrived(stamp=0))
    assert check.refusal(arrived(age=0.001)) is Refusal.OUT_OF_ORDER
    check.forget()
    assert check.refusal(arrived(age=0.001)) is None


def test_no_message_is_stale_without_a_timeout():
    assert HeaderCheck("base_link", 0.0, 0.1).refusal(arrived(age=1e6)) is None


def test_a_message_without_a_use_for_a_frame_may_state_any():
    assert HeaderCheck(None, 0.5, 0.1).refusal(arrived(frame_id="map")) is None
