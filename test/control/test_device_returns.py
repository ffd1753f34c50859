"""After a device was away or was restarted, commands continue from its measured setpoints."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import WhenLost
from softrobot_twin.simulation import Hold, Status

RATE = 0.05
STEP = 0.01
TARGET = (0.012, 0.004, 0.134)
SEEDS = [0, 1, 2]


class Robot:
    """A twin and a device that follows commands at once."""

    def __init__(self, drive, **settings):
        self.driver = drive(
            use_device=True, **{"rate": 1.0 / STEP, "approach_speed": 0.03, **settings}
        )
        self.lengths = np.array(self.driver.loop.simulation.rest_setpoints)
        self.moves = []
        self.driver.measure(self.lengths)
        self.driver.loop.enable(0.0)

    def tick(self, count=1, present=True, target=TARGET):
        """Ticks; keeps how far each command is from what left or was measured before it [m]."""
        for _ in range(count):
            if present:
                self.driver.measure(self.lengths)
            if target is not None:
                self.driver.target(*target)
            outcome = self.driver.tick()
            if outcome.command is not None and present:
                self.moves.append(np.abs(outcome.command.setpoints - self.lengths).max())
                self.lengths = np.array(outcome.command.setpoints)
        return outcome

    def put(self, lengths):
        """The device is somewhere else now; what it did before counts no more."""
        self.lengths = np.array(lengths, dtype=float)
        self.moves.clear()


def elsewhere(simulation, seed):
    """Lengths that the actuators may have, anywhere [m]."""
    print(f"seed {seed}")
    share = np.random.default_rng(seed).uniform(0.0, 0.6, 4)
    share[seed % 4] = 0.6
    return simulation.rest_setpoints - share * simulation.limits.displacement_max


@pytest.mark.sampled
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("policy", WhenLost)
def test_a_device_that_returns_at_another_position_is_resynchronised(drive, simulation, policy, seed):
    robot = Robot(drive, on_lost_device=policy)
    robot.tick(80)
    assert robot.driver.outcomes[-1].activity is Activity.FOLLOWING
    robot.tick(70, present=False)
    robot.put(elsewhere(simulation, seed))
    outcome = robot.tick()
    assert outcome.activity is Activity.RESYNCHRONISING and outcome.command is None
    assert outcome.cause == "the device is not where it was sent"
    robot.tick(150)
    assert robot.moves and max(robot.moves) <= RATE * STEP + 1e-9
    assert robot.driver.outcomes[-1].activity is Activity.FOLLOWING


def test_a_device_that_returns_at_its_commanded_position_continues(drive):
    robot = Robot(drive)
    robot.tick(80)
    robot.tick(70, present=False, target=None)
    assert robot.driver.outcomes[-1].cause == "device lost"
    outcome = robot.tick(target=None)
    assert outcome.activity is Activity.FOLLOWING
    assert max(robot.moves) <= RATE * STEP + 1e-9


@pytest.mark.parametrize("seed", SEEDS)
def test_a_device_restarted_before_its_timeout_is_detected_by_its_jump(drive, simulation, seed):
    robot = Robot(drive)
    robot.tick(80)
    robot.tick(10, present=False)
    assert not robot.driver.loop.device_is_lost(robot.driver.time)
    robot.put(elsewhere(simulation, seed))
    assert robot.tick().activity is Activity.RESYNCHRONISING
    robot.tick(150)
    assert max(robot.moves) <= RATE * STEP + 1e-9


def test_a_late_and_slow_device_is_never_treated_as_restarted(drive):
    """150 ms late, half as fast as its commands, 0.2 mm of noise."""
    robot = Robot(drive)
    driver, noise = robot.driver, np.random.default_rng(3)
    sent, place = [robot.lengths] * 15, robot.lengths.copy()
    for tick in range(400):
        asked = sent[-15]
        place += np.clip(asked - place, -0.5 * RATE * STEP, 0.5 * RATE * STEP)
        driver.measure(place + noise.normal(0.0, 2e-4, 4))
        driver.target(0.02 * np.cos(tick / 20.0), 0.02 * np.sin(tick / 20.0), 0.134)
        outcome = driver.tick()
        if outcome.command is not None:
            sent.append(outcome.command.setpoints)
    activities = [outcome.activity for outcome in driver.outcomes]
    first = activities.index(Activity.FOLLOWING)
    assert first < 5 and set(activities[first:]) == {Activity.FOLLOWING}


@pytest.mark.parametrize("length", [1e6, -5.0, np.inf])
def test_a_device_with_impossible_measurements_is_not_enabled(drive, length):
    driver = drive(use_device=True)
    assert driver.measure(np.full(4, length)) is not None
    done, why = driver.loop.enable(driver.time)
    assert not done
    if np.isfinite(length):
        assert f"north measures {length:.6g} m" in why and "accepted are" in why
    driver.tick(20)
    assert len(driver.commands) == 0


def test_a_device_that_starts_to_send_impossible_measurements_counts_as_lost(drive):
    robot = Robot(drive, device_timeout=0.1)
    robot.tick(40)
    before = robot.lengths
    for _ in range(20):
        robot.driver.measure(np.full(4, 1e6))
        outcome = robot.driver.tick()
    assert outcome.activity is Activity.HOLDING and outcome.cause == "device lost"
    assert np.array_equal(robot.driver.commands[-1], robot.driver.commands[-5])
    assert robot.driver.loop.device.implausible.name == "north"
    robot.put(before)
    robot.tick(40)
    assert max(robot.moves) <= RATE * STEP + 1e-9


def test_a_model_that_cannot_reach_the_device_disables_the_loop_and_reports_it(drive, monkeypatch):
    robot = Robot(drive)
    robot.tick(30)
    driver = robot.driver
    monkeypatch.setattr(driver.loop.simulation, "step", failing_step(driver.loop.simulation))
    robot.tick(70, present=False)
    robot.put(driver.loop.simulation.rest_setpoints - 0.02)
    robot.tick(60)
    assert not driver.loop.is_enabled
    assert "cannot be moved to where the robot is: diverged" in driver.loop.why_given_up
    assert driver.outcomes[-1].cause == driver.loop.why_given_up
    assert robot.moves == []
    monkeypatch.undo()
    driver.loop.disable()
    assert driver.loop.why_given_up == ""
    driver.measure(robot.lengths)
    assert driver.loop.enable(driver.time)[0] and driver.loop.why_given_up == ""
    robot.tick(120)
    assert max(robot.moves) <= RATE * STEP + 1e-9


def test_a_model_with_non_finite_tensions_is_not_synchronised(drive, monkeypatch):
    robot = Robot(drive)
    robot.tick(30)
    driver = robot.driver
    simulation = driver.loop.simulation
    step, stay = simulation.step, simulation.stay

    def spoilt(command, budget=None):
        return replace(step(command, budget), efforts=np.full(4, np.nan))

    def spoilt_at_rest(command, measured=None):
        result = stay(command, measured)
        return result and replace(result, efforts=np.full(4, np.nan))

    robot.tick(70, present=False)
    monkeypatch.setattr(simulation, "step", spoilt)
    monkeypatch.setattr(simulation, "stay", spoilt_at_rest)
    robot.put(simulation.rest_setpoints - 0.02)
    before = len(driver.commands)
    robot.tick(60)
    assert driver.outcomes[-1].activity is Activity.RESYNCHRONISING
    assert len(driver.commands) == before
    monkeypatch.undo()
    robot.tick(60)
    assert len(driver.commands) > before
    assert all(np.isfinite(command).all() for command in driver.commands)


def failing_step(simulation):
    """A step that keeps the state and fails."""
    kept = simulation.step(Hold())

    def step(command, budget=None):
        return replace(kept, status=Status.DIVERGED)

    return step


def test_a_device_that_was_silent_while_moving_continues_to_its_target(drive):
    """Its messages stop for a while, and return half way to its commanded position."""
    robot = Robot(drive, device_timeout=0.1)
    robot.tick(5)
    behind = robot.lengths
    for _ in range(25):
        robot.driver.target(*TARGET)
        robot.driver.tick()
    assert robot.driver.outcomes[-1].cause == "device lost"
    ahead = robot.driver.commands[-1]
    assert np.abs(ahead - behind).max() > 4 * RATE * STEP
    robot.put(0.5 * (behind + ahead))
    assert robot.tick(target=None).activity is Activity.RESYNCHRONISING
    outcome = robot.tick(100, target=None)
    assert outcome.activity is Activity.FOLLOWING
    assert max(robot.moves) <= RATE * STEP + 1e-9


def test_a_device_that_reports_late_and_five_times_a_second_keeps_being_driven(drive):
    robot = Robot(drive, device_timeout=1.0, approach_speed=0.0)
    robot.tick(20)
    late = robot.lengths
    for number in range(30):
        side = 1.0 if number // 10 % 2 else -1.0
        sent = robot.driver.commands[-1]
        robot.driver.measure(late)
        for _ in range(20):
            robot.driver.target(0.02 * side, 0.02 * side, 0.13)
            robot.driver.tick()
            assert robot.driver.outcomes[-1].activity is Activity.FOLLOWING
        late = sent
