"""Two publishers, and two devices, are told from one that was started again or loses messages."""

import numpy as np
import pytest

from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.twin_loop import CONTESTED, DISPUTED
from softrobot_twin.control.voices import CONTESTED_TIME, PlaceWatch, PublisherWatch

INSIDE = (0.01, 0.0, 0.134)


def stream(draw, begin, end, first=1, losses=(0.0, 0.3)):
    """Numbers and times of a publisher of a drawn rate, of whose messages a drawn share is lost."""
    interval = 10.0 ** draw.uniform(-2.5, 0.0)
    times = np.arange(begin + draw.uniform(0.0, interval), end, interval)
    times = times + draw.uniform(-0.2, 0.2, len(times)) * interval
    kept = draw.random(len(times)) > draw.choice(losses)
    return [(time, first + k, interval) for k, (time, own) in enumerate(zip(times, kept)) if own]


@pytest.mark.parametrize("case", range(20))
def test_one_publisher_that_loses_messages_and_is_started_again_is_never_contested(case, drawn_rng):
    draw, watch = drawn_rng, PublisherWatch()
    # Each begins to count anew after the one before has ended.
    for begin, losses in ((0.0, (0.0, 0.3)), (11.0, (0.0,)), (20.0, (0.0,))):
        end, first = begin + draw.uniform(1.0, 8.0), int(draw.choice((1, 1, 500)))
        for time, number, _ in stream(draw, begin, end, first, losses):
            watch.hear(number, time, time)
            assert not watch.is_contested(time)


@pytest.mark.parametrize("case", range(20))
def test_one_publisher_whose_listener_stops_again_and_again_is_never_contested(case, drawn_rng):
    draw, watch = drawn_rng, PublisherWatch()
    interval, number = 10.0 ** draw.uniform(-2.5, -1.0), 0
    for pause in (0.0, 0.0, *draw.uniform(0.0, 1.5, 40)):
        # A message that came before a pause is heard after it, just before the newest of the queue.
        end = number + 1 + max(1, round(pause / interval))
        for number in (number + 1, end):
            assert watch.hear(number, number * interval, end * interval) and not watch.is_contested(end * interval)


def of_two(draw, first, second):
    """Times, numbers and publishers of what is heard of two that begin to count at these numbers."""
    streams = stream(draw, 0.0, 8.0, first), stream(draw, 3.0, 8.0, second)
    return sorted((time, number, who) for who in (0, 1) for time, number, _ in streams[who])


@pytest.mark.parametrize("case", range(20))
def test_two_publishers_are_contested_after_each_turn_and_neither_is_used(case, drawn_rng):
    """So it is at any rates and losses, where neither's numbers can be the other's next ones."""
    draw, watch = drawn_rng, PublisherWatch()
    counts, last, turned = [0, 0], None, -np.inf
    for time, number, who in of_two(draw, *[(10**4, 1), (10**4, 40), (1, 10**4)][case % 3]):
        used, counts[who] = watch.hear(number, time, time), counts[who] + 1
        if counts[who] > 1 and who != last:
            turned = time
        last, contested = who, time - turned < CONTESTED_TIME
        assert watch.is_contested(time) == contested
        assert not (used and contested)


@pytest.mark.parametrize("case", range(20))
def test_two_publishers_whose_numbers_meet_are_noticed(case, drawn_rng):
    draw, watch = drawn_rng, PublisherWatch()
    noticed, counts = False, [0, 0]
    for time, number, who in of_two(draw, 1, (1, 40)[case % 2]):
        watch.hear(number, time, time)
        noticed |= watch.is_contested(time)
        counts[who] += time >= 3.0
    assert noticed or min(counts) < 3


def test_the_next_publisher_is_used_once_the_one_before_is_silent():
    watch = PublisherWatch()
    assert all(watch.hear(number, 0.02 * number, 0.02 * number) for number in range(1, 50))
    assert not watch.hear(1, 1.0, 1.0) and not watch.hear(2, 1.02, 1.02)
    assert watch.hear(3, 1.2, 1.2) and watch.hear(4, 1.22, 1.22)


def test_middleware_that_numbers_nothing_is_not_contested():
    watch = PublisherWatch()
    assert all(watch.hear(None, 0.0, 0.01 * k) for k in range(10)) and not watch.is_contested(0.1)


RATE, TRAVEL = 0.05, 0.04


def device(draw, count, interval, noise, end, moves=True):
    """Times and measurements of a device whose actuators go to and fro within their rates."""
    times = np.arange(interval, end, interval) + draw.uniform(-0.2, 0.2) * interval
    period, phases = draw.uniform(1.0, 6.0), draw.uniform(0.0, 2.0 * np.pi, count)
    angles = 2.0 * np.pi * times[:, None] / period + phases
    swing = moves * 0.9 * RATE * period / (2.0 * np.pi) * np.sin(angles)
    return times, swing + draw.normal(0.0, noise, (len(times), count))


def watch_of(count):
    """A watch over so many actuators."""
    return PlaceWatch(np.full(count, RATE), np.full(count, 0.02 * TRAVEL)), np.ones(count, bool)


@pytest.mark.parametrize("case", range(8))
def test_noise_of_one_device_is_not_two_devices(case, drawn_rng):
    """Up to a fortieth of the travel, 1 mm of 40; its first second it may be taken for two."""
    draw, count = drawn_rng, (1, 2, 4, 12)[case % 4]
    noise, interval = 10.0 ** draw.uniform(-5.0, -3.0), 10.0 ** draw.uniform(-2.3, -1.0)
    (watch, every), refused = watch_of(count), 0
    times, measured = device(draw, count, interval, noise, 800 * interval)
    for time, one in zip(times, measured):
        refused += not watch.hear(every, one, time)
        assert time < 60 * interval + 1.0 or not watch.is_contested(time)
    assert refused < 0.02 * len(times)


@pytest.mark.parametrize("case", range(8))
def test_two_noisy_devices_are_noticed_where_they_are_further_apart_than_noise(case, drawn_rng):
    draw, count = drawn_rng, (1, 2, 4, 12)[case % 4]
    noise, interval = 10.0 ** draw.uniform(-5.0, -3.5), 10.0 ** draw.uniform(-2.3, -1.5)
    watch, every = watch_of(count)
    times, measured = device(draw, count, interval, noise, 1.0 + 1500 * interval)
    begin, share = int(0.4 * len(times)), draw.choice((0.2, 0.5))
    apart = np.zeros(count)
    apart[draw.integers(count)] = 0.1 + 25.0 * noise
    is_other = (np.arange(len(times)) > begin) & (draw.random(len(times)) < share)
    noticed = False
    for time, one, other in zip(times, measured, is_other):
        watch.hear(every, one + apart * other, time)
        noticed |= watch.is_contested(time)
    assert noticed


@pytest.fixture
def enabled(drive):
    """A driver of a Diamond with device, enabled and at its target."""
    driver = drive(use_device=True, rate=50.0, message_timeout=0.0)
    driver.loop.device.accept(
        driver.loop.simulation.actuator_names, driver.loop.simulation.rest_setpoints, [],
        driver.arrival(),
    )
    assert driver.loop.enable(driver.time)[0]
    driver.lengths = driver.loop.simulation.rest_setpoints
    follow(driver, 30)
    assert driver.outcomes[-1].activity is Activity.FOLLOWING
    driver.outcomes.clear()
    return driver


def follow(driver, count, measure=True, false=None):
    """Ticks in which the device is measured, then another one."""
    for _ in range(count):
        if measure:
            driver.measure(driver.lengths)
        if false is not None:
            driver.measure(false)
        driver.target(*INSIDE)
        outcome = driver.tick()
        if outcome.command is not None:
            driver.lengths = outcome.command.setpoints
    return driver.outcomes[-1]


def false_lengths(driver):
    """Lengths far from those of the device."""
    return driver.lengths - 0.5 * driver.loop.simulation.limits.drive_max


def test_a_second_device_disables_and_is_told(enabled):
    false = false_lengths(enabled)
    before = enabled.lengths
    assert follow(enabled, 10, false=false).activity is Activity.DISABLED
    assert enabled.loop.why_given_up == CONTESTED
    assert np.abs(enabled.lengths - before).max() < 0.05 * 10 / 50
    assert not len(enabled.commands)
    assert enabled.loop.enable(enabled.time) == (False, CONTESTED)
    follow(enabled, 60)
    assert enabled.loop.enable(enabled.time)[0]
    assert follow(enabled, 30).activity is Activity.FOLLOWING


def test_a_device_that_measures_with_a_millimetre_of_noise_is_driven(drive, drawn_rng):
    driver, draw = drive(use_device=True, rate=50.0, message_timeout=0.0), drawn_rng
    true = driver.loop.simulation.rest_setpoints
    seen = set()
    for tick in range(150):
        driver.measure(true + draw.normal(0.0, 0.001, 4))
        if tick == 60:
            assert driver.loop.enable(driver.time)[0]
        driver.target(*INSIDE)
        outcome = driver.tick()
        if outcome.command is not None:
            true = outcome.command.setpoints
            seen.add(outcome.activity)
    assert outcome.activity is Activity.FOLLOWING
    assert not seen & {Activity.DISABLED, Activity.RESYNCHRONISING}


def test_a_second_device_before_enable_refuses_it(drive):
    driver = drive(use_device=True, rate=50.0, message_timeout=0.0)
    driver.lengths = driver.loop.simulation.rest_setpoints
    follow(driver, 10, false=false_lengths(driver))
    assert driver.loop.enable(driver.time) == (False, CONTESTED)


def test_one_wrong_measurement_stops_the_commands_until_the_next_right_one(enabled):
    false = false_lengths(enabled)
    enabled.measure(false)
    outcome = follow(enabled, 1, measure=False)
    assert (outcome.cause, outcome.command) == (DISPUTED, None)
    assert follow(enabled, 2).activity is Activity.FOLLOWING
    assert follow(enabled, 30).command is not None


def test_a_device_that_was_started_again_is_resynchronised(enabled):
    enabled.lengths = false_lengths(enabled)
    seen = set()
    for _ in range(100):
        outcome = follow(enabled, 1)
        seen.add(outcome.activity)
    assert Activity.RESYNCHRONISING in seen and Activity.DISABLED not in seen
    assert outcome.activity is Activity.FOLLOWING


def test_two_publishers_of_targets_hold_until_one_is_left(drive):
    driver = drive(message_timeout=0.0)
    driver.target(*INSIDE)
    assert driver.tick(3).activity is Activity.FOLLOWING
    driver.loop.targets.accept_velocity((1.0, 0.0, 0.0), driver.time)
    driver.loop.contest("/twin/target/tip", "two publishers on it", False, driver.time)
    before = driver.outcomes[-1].command.setpoints
    outcome = driver.tick(3)
    assert (outcome.activity, outcome.cause) == (Activity.HOLDING, "two publishers on it")
    assert np.array_equal(outcome.command.setpoints, before)
    driver.tick(round(CONTESTED_TIME * 20))
    assert driver.tick().activity is Activity.FOLLOWING
    assert driver.outcomes[-1].reading.targets[0] == pytest.approx(INSIDE)
