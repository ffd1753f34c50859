"""The loop closed over measured markers, against a robot that is not its model."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import LoopSettings, WhenLost
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.control.target_path import Circle
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.errors import ParameterError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation

from .conftest import ROOT, Driver

FLAWS = DeviceFlaws(delay=0.02, servo_rate=0.1, marker_noise=2e-4, seed=1)
TARGET = (0.006, -0.004, 0.136)


def track(driver, device, path, ticks, every=2, blind=()):
    """Distances of the device's effector from the path, one for each reading [m]."""
    errors = []
    period = driver.loop.settings.period
    driver.see(device.read(driver.time).marker_positions)
    for tick in range(ticks):
        driver.target(*path(driver.time))
        outcome = driver.tick()
        device.apply(outcome.command.setpoints, driver.time - period)
        if tick % every == 0:
            reading = device.read(driver.time)
            errors.append(np.linalg.norm(reading.effector_positions[0] - path(driver.time)))
            if tick not in blind:
                driver.see(reading.marker_positions)
    return np.array(errors)


@pytest.fixture
def robot(device_simulation):
    return SimulatedDevice(device_simulation, FLAWS)


def standing(time):
    return np.array(TARGET)


def test_a_constant_model_error_is_removed(drive, robot):
    driver = drive(closed_loop=True, correction_gain=4.0, correction_limit=0.01)
    errors = track(driver, robot, standing, 60)
    assert errors[-5:].mean() < 0.2e-3
    assert driver.outcomes[-1].misfit.visible == 8
    assert driver.outcomes[-1].tracking_errors[0] < 0.5e-3


@pytest.mark.slow
def test_the_closed_loop_cuts_the_mean_error_to_a_fifth(drive, robot):
    path = Circle((0.0, 0.0, 0.136), 0.02, 7.5).position

    def mean_error(closed):
        robot.simulation.reset()
        device = SimulatedDevice(robot.simulation, FLAWS)
        driver = drive(closed_loop=closed, correction_gain=5.0, correction_limit=0.01)
        driver.loop.simulation.reset()
        return track(driver, device, path, 200)[20:].mean()

    assert mean_error(closed=True) < 0.2 * mean_error(closed=False)


def test_the_misfit_compares_the_same_moment(drive):
    """A perfect robot whose markers come late has no misfit, however fast it moves."""
    driver = drive()
    path = Circle((0.0, 0.0, 0.136), 0.01, 2.0).position
    late = []
    for _ in range(20):
        driver.target(*path(driver.time))
        if len(late) > 3:
            driver.see(late[-4], age=4 * driver.loop.settings.period)
        late.append(driver.tick().predicted_markers)
    now = driver.outcomes[-1]
    assert np.linalg.norm(now.measured_markers - now.predicted_markers, axis=1).max() > 2e-3
    assert now.misfit.rms < 1e-6


@pytest.mark.parametrize("policy, activity", [
    (WhenLost.OPEN_LOOP, Activity.FOLLOWING), (WhenLost.HOLD, Activity.HOLDING),
])  # fmt: skip
def test_lost_markers_freeze_the_correction_and_hold_if_asked_to(drive, robot, policy, activity):
    driver = drive(closed_loop=True, on_lost_markers=policy, marker_timeout=0.2)
    track(driver, robot, standing, 20)
    correction = driver.loop.correction.offsets.copy()
    assert np.linalg.norm(correction) > 1e-4
    track(driver, robot, standing, 20, blind=range(20))
    frozen = driver.loop.correction.offsets.copy()
    outcome = driver.tick()
    assert driver.loop.markers_are_lost(outcome.measured_markers)
    assert outcome.activity is activity
    assert np.array_equal(driver.loop.correction.offsets, frozen)
    # They come back: it goes on.
    track(driver, robot, standing, 10)
    assert driver.outcomes[-1].activity is Activity.FOLLOWING
    assert not np.array_equal(driver.loop.correction.offsets, frozen)


def test_markers_that_are_all_hidden_are_lost(drive, robot):
    driver = drive(closed_loop=True)
    hidden = np.full((8, 3), np.nan)
    hidden[:4] = robot.read(0.0).marker_positions[:4]
    driver.see(hidden)
    outcome = driver.tick()
    assert outcome.misfit.visible == 4
    # Those that are seen do not move with the effector.
    assert driver.loop.markers_are_lost(outcome.measured_markers)


def test_lost_markers_do_not_matter_in_open_loop(drive):
    driver = drive(closed_loop=False, on_lost_markers=WhenLost.HOLD)
    driver.target(*TARGET)
    outcome = driver.tick()
    assert outcome.activity is Activity.FOLLOWING
    assert not driver.loop.markers_are_lost(outcome.measured_markers)


def test_the_correction_fades_when_the_loop_is_opened(drive, robot):
    driver = drive(closed_loop=True)
    track(driver, robot, standing, 30)
    before = np.linalg.norm(driver.loop.correction.offsets)
    driver.loop.apply(replace(driver.loop.settings, closed_loop=False))
    track(driver, robot, standing, 2)
    assert 0.0 < np.linalg.norm(driver.loop.correction.offsets) < before
    track(driver, robot, standing, 200)
    assert np.linalg.norm(driver.loop.correction.offsets) < 1e-3 * before


def test_the_distance_to_a_far_target_is_not_treated_as_a_model_error(drive, robot):
    driver = drive(closed_loop=True, approach_speed=0.02)
    track(driver, robot, standing, 40)
    settled = driver.loop.correction.offsets.copy()
    track(driver, robot, lambda time: np.array(TARGET) + [0.012, 0.0, 0.004], 8)
    assert driver.outcomes[-1].tracking_errors[0] > 2e-3
    assert np.array_equal(driver.loop.correction.offsets, settled)


def test_the_correction_is_constant_while_the_loop_holds(drive, robot):
    driver = drive(closed_loop=True, target_timeout=0.2)
    track(driver, robot, standing, 10)
    driver.tick(6)
    held = driver.loop.correction.offsets.copy()
    for _ in range(4):
        driver.see(robot.read(driver.time).marker_positions)
        assert driver.tick().activity is Activity.HOLDING
    assert np.array_equal(driver.loop.correction.offsets, held)


def test_an_unreachable_target_does_not_increase_the_correction(drive, robot):
    driver = drive(closed_loop=True, correction_gain=4.0, correction_limit=0.01)
    track(driver, robot, lambda time: np.array([0.1, 0.0, 0.13]), 60)
    assert np.linalg.norm(driver.loop.correction.offsets) < 1e-3


def test_a_scene_that_measures_no_effector_cannot_close_the_loop(drive, small_scene_mapping):
    mapping = {**small_scene_mapping}
    mapping["effectors"] = [{**small_scene_mapping["effectors"][0], "measured_by": []}]
    simulation = Simulation(scene_from_mapping(mapping))
    with pytest.raises(ParameterError, match="closed_loop"):
        TwinLoop(simulation, LoopSettings(closed_loop=True))


def test_a_reduced_twin_closes_the_loop_over_a_full_and_different_device(device_simulation):
    """Both errors, of the reduction and of the wrong model, are removed by the markers."""
    twin = Simulation.from_scene_file(ROOT / "config" / "scenes" / "diamond_reduced.yaml")
    twin.warm_up()
    path = Circle((0.0, 0.0, 0.136), 0.015, 7.5).position
    driver = Driver(twin, closed_loop=True, correction_gain=5.0, correction_limit=0.01)
    errors = track(driver, SimulatedDevice(device_simulation, FLAWS), path, 160)
    device_simulation.reset()
    twin.reset()
    opened = Driver(twin, closed_loop=False)
    without = track(opened, SimulatedDevice(device_simulation, FLAWS), path, 160)
    assert errors[40:].mean() < 0.25 * without[40:].mean()
    assert not any(outcome.result.status.is_failure for outcome in driver.outcomes)
