"""The loop with a device: enabled at its position, held or not when it is lost."""

import numpy as np
import pytest

from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import WhenLost

RATE = 0.05
STEP = 0.05
INSIDE = (0.008, 0.004, 0.134)
ROUNDING = 1.0e-9


def test_a_device_is_not_moved_before_it_is_enabled(drive):
    driver = drive(use_device=True)
    driver.target(*INSIDE)
    driver.measure(driver.loop.simulation.rest_setpoints)
    outcome = driver.tick(5)
    assert outcome.activity is Activity.DISABLED
    assert len(driver.commands) == 0


def test_a_silent_device_cannot_be_enabled(drive):
    driver = drive(use_device=True)
    done, why = driver.loop.enable(driver.time)
    assert not done and "measured setpoints" in why
    driver.measure(driver.loop.simulation.rest_setpoints)
    driver.time += 1.0
    assert not driver.loop.enable(driver.time)[0]


def test_enabling_starts_from_the_device_s_position_without_a_jump(drive):
    driver = drive(use_device=True)
    wound = driver.loop.simulation.rest_setpoints - [0.010, 0.003, 0.0, 0.006]
    driver.target(*INSIDE)
    driver.measure(wound)
    assert driver.loop.enable(driver.time)[0]
    while driver.tick().activity is Activity.RESYNCHRONISING:
        driver.measure(wound)
    assert len(driver.outcomes) < 10
    assert driver.commands[0] == pytest.approx(wound, abs=1e-6)
    # Targets from before it was enabled are cleared.
    assert driver.tick().cause == "no target yet"
    driver.measure(wound)
    driver.target(*INSIDE)
    driver.tick(20)
    assert np.abs(np.diff(driver.commands, axis=0)).max() <= RATE * STEP + ROUNDING


def test_a_device_outside_its_limits_is_enabled_at_the_limit(drive):
    driver = drive(use_device=True)
    rest = driver.loop.simulation.rest_setpoints
    driver.measure(rest + 0.001)
    driver.loop.enable(driver.time)
    while driver.tick().activity is Activity.RESYNCHRONISING:
        driver.measure(rest + 0.001)
    assert driver.commands[0] == pytest.approx(rest, abs=1e-6)


def test_a_device_further_outside_than_its_rate_allows_returns_and_then_follows(drive):
    driver, beyond = drive(use_device=True, rate=100.0), 0.0012
    rest = driver.loop.simulation.rest_setpoints
    driver.measure(rest + beyond)
    driver.loop.enable(driver.time)
    lengths = rest + beyond
    for _ in range(30):
        driver.measure(lengths)
        driver.target(*INSIDE)
        outcome = driver.tick()
        lengths = lengths if outcome.command is None else outcome.command.setpoints
    moves = np.abs(np.diff(np.vstack([rest + beyond, driver.commands]), axis=0))
    assert moves[:2] == pytest.approx(RATE / 100.0), "as fast as the rates allow"
    assert moves.max() <= RATE / 100.0 + ROUNDING
    assert driver.commands[2] == pytest.approx(rest, abs=1e-6)
    assert outcome.activity is Activity.FOLLOWING
    assert np.abs(driver.commands[-1] - rest).max() > beyond


def test_a_disabled_device_is_not_moved_and_is_enabled_again_at_its_position(drive):
    driver = drive(use_device=True)
    rest = driver.loop.simulation.rest_setpoints
    driver.measure(rest)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.loop.disable()
    before = len(driver.commands)
    driver.tick(3)
    assert len(driver.commands) == before
    driver.measure(rest - 0.004)
    driver.loop.enable(driver.time)
    while driver.tick().activity is Activity.RESYNCHRONISING:
        driver.measure(rest - 0.004)
    assert driver.commands[before] == pytest.approx(rest - 0.004, abs=1e-6)


def test_reset_does_not_move_a_device(drive):
    driver = drive(use_device=True)
    driver.measure(driver.loop.simulation.rest_setpoints)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.measure(driver.loop.simulation.rest_setpoints)
    driver.target(*INSIDE)
    driver.tick(4)
    published = len(driver.commands)
    assert "disabled" in driver.loop.reset()
    assert driver.tick().activity is Activity.DISABLED
    assert len(driver.commands) == published


@pytest.mark.parametrize(
    ("policy", "activity"), [("hold", Activity.HOLDING), ("open_loop", Activity.FOLLOWING)]
)
def test_a_lost_device_is_handled_according_to_the_parameter(drive, policy, activity):
    driver = drive(use_device=True, on_lost_device=WhenLost(policy), device_timeout=0.2)
    driver.measure(driver.loop.simulation.rest_setpoints)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.target(*INSIDE)
    driver.measure(driver.loop.simulation.rest_setpoints)
    assert driver.tick().activity is Activity.FOLLOWING
    outcome = driver.tick(6)
    assert driver.loop.device_is_lost(driver.time)
    assert outcome.activity is activity
    assert outcome.cause == ("device lost" if policy == "hold" else "")
