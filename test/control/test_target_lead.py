"""Where a moving target will be: found where its messages show a course, and not elsewhere."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.target_lead import LONGEST_INTERVAL, SILENCE, TargetStream
from softrobot_twin.control.target_path import Circle, Lemniscate

DELAY = 0.05
STOPS = 2.003


def circle(time):
    return Circle((0.0, 0.0, 0.1), 0.02, 15.0).position(time)


def eight(time):
    return Lemniscate((0.0, 0.0, 0.1), 0.02, 10.0).position(time)


def stopping(time):
    return np.array([0.02 * min(time, STOPS), 0.0, 0.1])


def stepping(time):
    return np.array([0.01 * (time > STOPS), 0.0, 0.1])


def stairs(time):
    return np.array([0.001 * np.floor(time / 0.2), 0.0, 0.1])


def standing(time):
    return np.array([0.01, 0.0, 0.1])


def leads_along(path, rate=100.0, noise=0.0, skew=0.0, jitter=0.0, limit=0.3, seconds=4.0, seed=0):
    """Times, and the lead at each: zero where there is none; NaN before a second has passed."""
    stream, source = TargetStream(), np.random.default_rng(seed)
    times, leads = np.arange(round(seconds * rate)) / rate, []
    for time in times:
        place, late = path(time) + source.normal(0.0, noise, 3), source.uniform(0.0, jitter)
        now = time + late
        stamp = round((1000.0 + time - skew) * NANOSECONDS)
        arrival = Arrival("base_link", stamp, round((1000.0 + now) * NANOSECONDS), now)
        stream.add(place, arrival)
        lead = stream.lead(time + jitter, DELAY - jitter, limit)
        leads.append(np.zeros(3) if lead is None else lead)
    return times[round(rate) :], np.array(leads)[round(rate) :]


@pytest.mark.sampled
@pytest.mark.parametrize("path", [circle, eight])
@pytest.mark.parametrize("rate", [20.0, 30.0, 100.0, 1000.0])
def test_a_target_on_its_way_is_led_to_where_it_will_be(path, rate):
    times, leads = leads_along(path, rate)
    ways = np.array([path(time + DELAY) - path(time) for time in times])
    assert np.linalg.norm(ways, axis=1).min() > 0.2e-3
    assert np.linalg.norm(leads - ways, axis=1).max() < 0.02e-3


@pytest.mark.parametrize("rate", [30.0, 100.0])
@pytest.mark.parametrize("path", [standing, stepping, stairs])
def test_a_target_that_stands_or_jumps_is_not_led(path, rate):
    assert not leads_along(path, rate)[1].any()


def test_noise_around_a_standing_target_is_no_way(drawn_seed):
    for rate in (30.0, 100.0):
        _, leads = leads_along(standing, rate, noise=2e-4, seconds=20.0, seed=drawn_seed)
        assert leads.any(axis=1).mean() < 0.03
        # It adds next to nothing to the noise itself.
        assert np.sqrt((leads**2).sum(axis=1).mean()) < 1e-4


def test_messages_that_come_seldom_name_places_to_stand_at():
    assert not leads_along(circle, 0.9 / LONGEST_INTERVAL, seconds=10.0)[1].any()
    assert leads_along(circle, 1.1 / LONGEST_INTERVAL, seconds=10.0)[1].any(axis=1).all()


@pytest.mark.parametrize("rate", [30.0, 100.0])
def test_a_stop_is_known_by_the_first_message_that_does_not_move(rate):
    times, leads = leads_along(stopping, rate)
    led = np.linalg.norm(leads, axis=1)
    assert led[times < STOPS] == pytest.approx(0.02 * DELAY, rel=1e-3)
    assert (led[times > STOPS + max(SILENCE / rate, 0.5 * DELAY)] == 0.0).all()


def test_the_clock_of_the_sender_and_late_messages_do_not_matter():
    exact = leads_along(circle)[1]
    assert leads_along(circle, skew=0.4)[1] == pytest.approx(exact, abs=1e-7)
    assert leads_along(circle, skew=-0.05)[1] == pytest.approx(exact, abs=1e-7)
    # The messages that were least late tell how late the others are, to a millisecond.
    assert leads_along(circle, jitter=0.009)[1] == pytest.approx(exact, abs=0.02e-3)


def test_a_stream_that_has_ended_is_not_led():
    stream = TargetStream()
    for tick in range(30):
        now = 0.01 * tick
        stamp = round((1000.0 + now) * NANOSECONDS)
        stream.add(circle(now), Arrival("base_link", stamp, stamp, now))
    assert stream.lead(now, DELAY, 0.3) is not None
    assert stream.lead(now + 0.02, DELAY, 0.3) is not None
    assert stream.lead(now + 0.04, DELAY, 0.3) is None


def test_a_lead_goes_no_farther_ahead_than_its_limit():
    speed = 2.0 * np.pi * 0.02 / 15.0
    led = np.linalg.norm(leads_along(circle, limit=0.02)[1], axis=1)
    assert led == pytest.approx(0.02 * speed, rel=1e-3)
    assert not leads_along(circle, limit=0.0)[1].any()
