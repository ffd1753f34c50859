"""The loop closed over measured markers, against a robot that is not its model."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import LoopSettings, WhenLost
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.control.target_correction import Law
from softrobot_twin.control.target_path import Circle
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.errors import ParameterError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import Simulation

from .conftest import ROOT, Driver

FLAWS = DeviceFlaws(delay=0.02, servo_rate=0.1, marker_noise=2e-4, seed=1)
TARGET = (0.006, -0.004, 0.136)


def track(driver, device, path, ticks, every=2, blind=(), measured=False):
    """Distances of the device's effector from the path, one for each reading [m].

    The loop gets its markers, and its lengths where `measured`.
    """
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
            if measured:
                driver.measure(reading.setpoints)
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


TICK = 0.025
ROUND = Circle((0.0, 0.0, 0.136), 0.015, 2.0 * np.pi / 1.26).position


@pytest.fixture(scope="module")
def other_meshes():
    """The Diamond and its device, on meshes of 200 and 600 nodes."""
    made = []
    for name, mesh in (("diamond", "diamond_200"), ("diamond_device", "diamond_600")):
        mapping = written_out(yaml.safe_load((ROOT / f"config/scenes/{name}.yaml").read_text()))
        mapping["body"]["mesh"]["file"] = str(ROOT / f"meshes/{mesh}.vtk")
        made.append(Simulation(scene_from_mapping(mapping)))
        made[-1].warm_up()
    return made


def late_run(
    twin, real, path, ticks, seed=0, delay=1, measured=True, closed=True, opened=0, noise=0.0,
    **settings,
):
    """Positions of a robot that acts some ticks late, and is seen a tick later [m]; and its driver.

    The loop is closed after `opened` ticks; the stream of targets has a noise [m].
    """
    source = np.random.default_rng(seed)
    twin.reset()
    real.reset()
    driver = Driver(twin, rate=1.0 / TICK, correction_gain=8.0, **settings)
    device = SimulatedDevice(real, DeviceFlaws(marker_noise=2e-4, seed=seed, servo_rate=1.0))
    sent, seen, places = [], None, []
    for tick in range(ticks):
        if closed and tick == opened:
            driver.loop.apply(replace(driver.loop.settings, closed_loop=True))
        if seen is not None:
            driver.see(seen.marker_positions, age=TICK)
            if measured:
                driver.measure(seen.setpoints, age=TICK)
        driver.target(*(path(driver.time) + source.normal(0.0, noise, 3)))
        sent.append(driver.tick().command.setpoints)
        if len(sent) > delay:
            device.apply(sent[-1 - delay], driver.time - TICK)
        seen = device.read(driver.time)
        places.append(seen.effector_positions[0])
    return np.array(places), driver


def rms_on_circle(places, delay=1):
    """RMS distance in the second half, by the delay that suits best [m]."""
    half = np.arange(len(places) // 2, len(places))
    return min(
        np.sqrt(((places[half] - [ROUND((tick - late) * TICK) for tick in half]) ** 2).sum(1).mean())
        for late in range(delay + 3))


@pytest.mark.exhaustive
def test_the_misfit_of_the_executed_command_keeps_a_wrong_model_on_its_circle(other_meshes, drawn_seed):
    """E is 15 % off, cables 1 mm, the mesh is another one; commands act 25 ms late, frames come 25 ms
    late with 0.2 mm of noise."""
    first = drawn_seed
    runs = [late_run(*other_meshes, ROUND, 200, first + seed) for seed in range(4)]
    misfit = np.array([rms_on_circle(places) for places, _ in runs])
    opened = rms_on_circle(late_run(*other_meshes, ROUND, 200, closed=False)[0])
    integrated, driver = late_run(*other_meshes, ROUND, 200, first, measured=False)
    integrated = rms_on_circle(integrated)
    print(f"RMS [mm]: open {1e3 * opened:.2f}, integrator {1e3 * integrated:.2f}, misfit "
          f"{1e3 * misfit.mean():.3f} (to {1e3 * misfit.max():.3f})")
    assert runs[0][1].loop.correction.law is Law.MISFIT
    assert driver.loop.correction.law is Law.INTEGRATOR
    assert misfit.max() < 0.25e-3
    assert misfit.max() < integrated < opened


@pytest.mark.sampled
@pytest.mark.parametrize("delay", [1, 5, 11])
def test_a_late_robot_does_not_overshoot_and_its_cables_rest(other_meshes, delay):
    """The loop is closed where the robot stands by the model alone; frames come a tick later."""
    target, opened = np.array([0.008, 0.0, 0.136]), 60
    places, driver = late_run(*other_meshes, lambda time: target, 200, delay=delay, opened=opened)
    off = places[opened - 1] - target
    along = (places[opened:] - target) @ off / (off @ off)
    assert np.linalg.norm(off) > 1e-3
    assert along.min() > -0.1
    settled = np.flatnonzero(np.linalg.norm(places[opened:] - target, axis=1) > 0.5e-3)[-1]
    assert settled <= delay + 8
    assert np.linalg.norm(places[-40:] - target, axis=1).mean() < 0.2e-3
    assert driver.commands[-40:].std(axis=0).max() < 0.02e-3


def rms_now(places, path, first=60):
    """RMS distance from where the target is at the same moment [m], from a tick on."""
    targets = np.array([path(tick * TICK) for tick in range(first, len(places))])
    return np.sqrt(((places[first:] - targets) ** 2).sum(axis=1).mean())


@pytest.mark.exhaustive
@pytest.mark.sampled
@pytest.mark.parametrize("delay", [1, 4])
def test_a_robot_that_acts_late_is_where_its_moving_target_is(other_meshes, delay):
    late, _ = late_run(*other_meshes, ROUND, 160, delay=delay, lead_limit=0.0)
    led, driver = late_run(*other_meshes, ROUND, 160, delay=delay)
    late, led = rms_now(late, ROUND), rms_now(led, ROUND)
    print(f"{delay} ticks late: RMS {1e3 * late:.2f} mm, led {1e3 * led:.2f} mm")
    assert driver.loop.lead.delay == pytest.approx(delay * TICK, abs=2e-3)
    # What is left is the error of the model, which the correction follows late.
    assert led < 0.35e-3
    assert led < 0.55 * late
    driver.loop.reset()
    driver.tick()
    assert not driver.loop.lead.ways.any()


@pytest.mark.exhaustive
@pytest.mark.parametrize("ramp", [0.0, 0.5])
def test_a_target_that_stops_is_overshot_by_its_way_of_the_delay_at_most(other_meshes, ramp):
    """At once: what was sent before is executed yet. Where it slows down, the robot does too."""
    speed, moves, delay = 0.01, 2.0, 4

    def path(time):
        slowing = np.clip(time - moves, 0.0, ramp)
        way = min(time, moves) + 0.5 * slowing * (2.0 - slowing / max(ramp, TICK))
        return np.array([speed * way - 0.012, 0.0, 0.136])

    late, _ = late_run(*other_meshes, path, 160, delay=delay, lead_limit=0.0)
    led, driver = late_run(*other_meshes, path, 160, delay=delay)
    past = led[80:, 0].max() - max(path(10.0)[0], late[80:, 0].max())
    rms = [rms_now(places, path, 40) for places in (late, led)]
    print(f"past the end by {1e3 * past:.2f} mm; RMS late {1e3 * rms[0]:.2f}, led {1e3 * rms[1]:.2f}")
    assert past < (speed * (delay + 1) * TICK if ramp == 0.0 else 0.2e-3)
    assert rms[1] < 0.8 * rms[0]
    assert not driver.loop.lead.ways.any()
    assert led[-20:].mean(axis=0) == pytest.approx(late[-20:].mean(axis=0), abs=0.05e-3)


def test_a_target_that_jumps_is_followed_as_without_a_lead(other_meshes):
    def path(time):
        return np.array([0.008 * (int(time / 0.5) % 2), 0.0, 0.136])

    without, _ = late_run(*other_meshes, path, 60, delay=4, lead_limit=0.0)
    led, driver = late_run(*other_meshes, path, 60, delay=4)
    assert np.array_equal(led, without)
    assert driver.loop.lead.delay == 0.0


@pytest.mark.exhaustive
def test_noise_of_a_standing_target_is_not_led(other_meshes, drawn_seed):
    arguments = (*other_meshes, standing, 120, drawn_seed)
    without, _ = late_run(*arguments, delay=4, noise=2e-4, lead_limit=0.0)
    led, _ = late_run(*arguments, delay=4, noise=2e-4)
    assert rms_now(led, standing) < 1.1 * rms_now(without, standing)


def test_a_delay_is_that_of_one_device(drive, simulation):
    """Who enables the twin anew may have changed the robot meanwhile."""
    driver = drive(use_device=True, closed_loop=True)
    driver.measure(simulation.rest_setpoints)
    driver.loop.enable(driver.time)
    driver.tick(2)
    driver.loop.lead.delay = 0.05
    driver.loop.disable()
    driver.tick()
    driver.measure(simulation.rest_setpoints)
    driver.loop.enable(driver.time)
    assert driver.tick(2).activity is Activity.HOLDING
    assert driver.loop.lead.delay == 0.0


@pytest.mark.parametrize("closed", [False, True])
def test_orientation_is_corrected_where_markers_tell_it(drive_posed, closed):
    """The robot is the model, but stands askew by 2 degrees: its tip points beside where it shall."""
    driver = drive_posed(closed_loop=closed)
    askew = Rotation.from_rotvec([0.025, -0.025, 0.0])
    upright = np.array([0.0, 0.0, 0.0, 1.0])
    for _ in range(60):
        driver.loop.targets.accept_pose(0, np.array([0.0, 0.0, 0.134]), upright, driver.arrival())
        outcome = driver.tick()
        driver.measure(outcome.command.setpoints)
        driver.see(askew.apply(outcome.predicted_markers))
    turn = askew * Rotation.from_quat(outcome.result.effector_orientations[0])
    off = np.arccos(turn.apply([0.0, 0.0, 1.0])[2])
    height = askew.apply(outcome.result.effector_positions[0])[2]
    if closed:
        assert off < 2e-3
        assert height == pytest.approx(0.134, abs=1e-5)
    else:
        assert off > 0.03
