"""The loop on the inverse in contact: slides, single actuators commanded beside targets."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.control.target_path import read_waypoints
from softrobot_twin.simulation import Status
from test.builder import builder
from test.places import CONFIG

PLATFORM = "platform_z"
SLOWEST = 0.05
PERIOD = 0.02


def platform(outcome):
    """Where the platform is sent [m]."""
    return outcome.command.setpoints[-1]


@builder
def settled(drive_trunk, /, **settings):
    """Makes a driver whose tip hangs still at a target beside where it sags to."""
    driver = drive_trunk(**settings)
    driver.tick(5)
    tip = driver.loop.simulation.effector_positions()[0]
    driver.aim = tip + [0.004, 0.006, 0.0]
    assert driver.target(*driver.aim) is None
    driver.tick(40)
    assert driver.outcomes[-1].tracking_errors[0] < 1e-4
    return driver


def follow(driver, path, ticks, ramp=60):
    """Leads the tip onto a path and along it; gives its distances from it [m]."""
    start, errors = driver.loop.simulation.effector_positions()[0], []
    for tick in range(ramp + ticks):
        on_path = path.position(max(0, tick - ramp) * PERIOD)
        share = min(1.0, tick / ramp)
        driver.target(*(start + share * (on_path - start)))
        errors.append(driver.tick().tracking_errors[0])
    return np.array(errors[ramp:])


@pytest.mark.exhaustive
def test_the_tip_moves_between_the_cylinders_within_all_limits(drive_trunk):
    driver = drive_trunk()
    driver.tick(10)
    window = DiagnosticsWindow()
    path = read_waypoints(CONFIG / "targets/trunk_path.csv", "tip")
    errors = follow(driver, path, round(path.times[-1] / PERIOD))
    counts = [outcome.result.report.contact_count for outcome in driver.outcomes]
    for outcome in driver.outcomes:
        window.add(outcome)
    # A local minimum between two contacts may hold the tip until the target has gone on by 3 mm.
    assert np.median(errors) < 1e-5 and errors.mean() < 2e-4 and errors.max() < 4e-3
    assert window.blocked == 0 and not window.worst.is_failure
    assert window.overlap_max < 1e-6
    # Contact is made while approaching and lost while returning.
    assert counts[0] == 0 and max(counts) > 0 and counts[-1] == 0
    assert set(window.contact_forces) <= {("trunk", "cylinder_left"), ("trunk", "cylinder_right")}
    assert max(window.contact_forces.values()) > 0.01
    assert np.abs(np.diff(driver.commands, axis=0)).max() <= SLOWEST * PERIOD + 2e-6
    positions = driver.commands[:, -1]
    assert positions.min() >= -2e-6 and 0.04 < positions.max() <= 0.060 + 2e-6


def test_a_commanded_platform_moves_and_the_cables_compensate(settled):
    driver = settled()
    before = platform(driver.outcomes[-1])
    assert driver.choose([PLATFORM], [before + 0.004]) is None
    outcome = driver.tick(1)
    assert platform(outcome) == pytest.approx(before + SLOWEST * PERIOD, abs=2e-6)
    outcome = driver.tick(40)
    assert platform(outcome) == pytest.approx(before + 0.004, abs=1e-6)
    assert outcome.activity is Activity.FOLLOWING
    assert outcome.tracking_errors[0] < 1e-3


def test_commanded_tensions_move_the_cables_and_not_the_platform(drive_trunk):
    driver = drive_trunk(mode=Mode.DIRECT)
    rest, names = driver.loop.simulation.rest_setpoints, driver.loop.simulation.actuator_names
    driver.wind(names, [*rest[:-1], 0.01])
    driver.tick(20)
    assert driver.wind(names[:-1], tensions=[0.5] * 8) is None
    outcome = driver.tick(60)
    assert outcome.result.status is Status.OK
    assert outcome.command.efforts[:-1] == pytest.approx([0.5] * 8, abs=1e-3)
    assert platform(outcome) == pytest.approx(0.01, abs=1e-7)
    assert driver.wind(names, tensions=[0.5] * 9) is Refusal.WRONG_FIELDS


def wound_far(trunk, seed):
    """Lengths of some actuators as far as they may go [m]."""
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    limits, share = trunk.limits, np.zeros(len(trunk.rest_setpoints))
    picked = random.choice(len(share), 4, replace=False)
    share[picked] = random.uniform(0.6, 1.0, 4)
    share[picked[0]] = 1.0
    far = np.where(limits.displacement_max > 0.0, limits.displacement_max, limits.displacement_min)
    return trunk.rest_setpoints - share * far


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_reset_from_far_returns_to_rest_without_a_jump(drive_trunk, trunk, seed):
    """Elements may be inverted there; the actuators return all the same."""
    driver = drive_trunk(approach_speed=0.0)
    lengths = wound_far(trunk, seed)
    for _ in range(120):
        driver.choose(trunk.actuator_names, lengths)
        driver.target(0.0, 0.0, 0.2)
        driver.tick()
    wound = driver.commands[-1]
    assert np.abs(wound - trunk.rest_setpoints).max() > 0.02
    driver.outcomes.clear()
    driver.loop.reset()
    while driver.tick().activity is Activity.RETURNING:
        assert len(driver.outcomes) < 150
    steps = np.abs(np.diff(np.vstack([wound, driver.commands]), axis=0))
    assert steps.max() <= SLOWEST * PERIOD + 1e-9
    assert driver.commands[-1] == pytest.approx(trunk.rest_setpoints, abs=1e-9)
    assert trunk.state.step_count <= 1 and driver.loop.is_enabled


@pytest.mark.sampled
@pytest.mark.parametrize("seed", [0, 3, 5])
def test_a_device_far_from_rest_is_enabled_at_its_measured_lengths(drive_trunk, trunk, seed):
    driver = drive_trunk(use_device=True)
    measured = wound_far(trunk, seed)
    driver.measure(measured)
    assert driver.loop.enable(driver.time)[0]
    for _ in range(150):
        driver.measure(measured)
        driver.tick()
    assert driver.outcomes[-1].activity is Activity.HOLDING
    steps = np.abs(np.diff(np.vstack([measured, driver.commands]), axis=0))
    assert steps.max() <= SLOWEST * PERIOD + 1e-9
