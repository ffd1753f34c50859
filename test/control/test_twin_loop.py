"""The loop on the small Diamond: targets and direct commands in, cable lengths out."""

import subprocess
import sys

import numpy as np
import pytest

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.simulation import Status
from test.places import ROOT

RATE = 0.05
STEP = 0.05
INSIDE = (0.008, 0.004, 0.134)
ROUNDING = 1.0e-9


def test_without_a_target_the_cables_stay_at_rest(drive):
    driver = drive()
    outcome = driver.tick(5)
    assert outcome.activity is Activity.HOLDING and outcome.cause == "no target yet"
    assert driver.commands == pytest.approx(
        np.tile(driver.loop.simulation.rest_setpoints, (5, 1)), abs=1e-9
    )


def test_commands_are_followed_before_a_target_comes_and_what_they_do_not_name_stays(drive):
    driver = drive()
    simulation = driver.loop.simulation
    rest = simulation.rest_setpoints
    wound = np.append(rest[0] - 0.004, rest[1:])
    assert driver.choose(simulation.actuator_names[:1], wound[:1]) is None
    outcome = driver.tick(10)
    assert outcome.activity is Activity.COMMANDED and outcome.cause == ""
    assert outcome.command.setpoints == pytest.approx(wound, abs=1e-9)
    driver.target(*INSIDE)
    assert driver.tick().activity is Activity.FOLLOWING
    assert driver.choose([]) is None
    assert driver.tick(30).tracking_errors[0] < 2e-5


def test_a_target_inside_the_workspace_is_reached(drive):
    driver = drive()
    driver.target(*INSIDE)
    outcome = driver.tick(30)
    assert outcome.activity is Activity.FOLLOWING
    assert outcome.result.status is Status.OK
    assert outcome.result.effector_positions[0] == pytest.approx(INSIDE, abs=2e-5)
    assert outcome.tracking_errors[0] < 2e-5


@pytest.mark.parametrize("approach_speed", [0.0, 0.03])
def test_a_target_100_mm_away_obeys_all_limits(drive, approach_speed):
    driver = drive(approach_speed=approach_speed)
    driver.target(0.06, 0.08, 0.134)
    outcome = driver.tick(80)
    limits = driver.loop.simulation.limits
    rest = driver.loop.simulation.rest_setpoints
    assert all(outcome.violated == () for outcome in driver.outcomes)
    assert driver.largest_step <= RATE * STEP + ROUNDING
    assert (driver.commands >= rest - limits.displacement_max - ROUNDING).all()
    assert (driver.commands <= rest + ROUNDING).all()
    assert outcome.result.status is Status.SATURATED
    assert outcome.result.report.active_limits
    # Where it ends is as near as it can: holding it longer brings it no nearer.
    ended = outcome.tracking_errors[0]
    assert driver.tick(20).tracking_errors[0] == pytest.approx(ended, abs=1e-5)


@pytest.mark.parametrize("azimuth", [0.0, 0.3, 0.93, 2.5])
def test_a_target_100_mm_away_is_approached_on_a_straight_line(drive, azimuth):
    driver = drive(approach_speed=0.03)
    driver.target(0.0, 0.0, 0.136)
    start = driver.tick(40).result.effector_positions[0]
    direction = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    driver.target(*(start + 0.1 * direction))
    first = len(driver.outcomes)
    while driver.tick().result.status.is_success:
        moved = driver.outcomes[-1].result.effector_positions[0] - start
        assert np.linalg.norm(moved - (moved @ direction) * direction) < 1e-4
    assert moved @ direction > 0.01
    assert len(driver.outcomes) > first + 7
    assert driver.largest_step <= RATE * STEP + ROUNDING


def test_nothing_accumulates_while_a_target_is_unreachable(drive):
    driver = drive(approach_speed=0.03)
    driver.target(0.1, 0.0, 0.136)
    far = driver.tick(80).result.effector_positions[0]
    driver.target(*(far - [0.005, 0.0, 0.0]))
    outcome = driver.tick(8)
    assert outcome.tracking_errors[0] < 1e-3


@pytest.mark.parametrize("position, header, refusal", [
    ((np.nan, 0.0, 0.13), {}, Refusal.NOT_FINITE),
    ((0.0, -np.inf, 0.13), {}, Refusal.NOT_FINITE),
    ((0.0, 0.13), {}, Refusal.WRONG_SIZE),
    ((0.02, 0.0, 0.14), {"age": 1.0}, Refusal.STALE),
    ((0.02, 0.0, 0.14), {"age": -1.0}, Refusal.FROM_THE_FUTURE),
    ((0.02, 0.0, 0.14), {"age": 0.2}, Refusal.OUT_OF_ORDER),
    ((0.02, 0.0, 0.14), {"frame_id": "map"}, Refusal.WRONG_FRAME),
])  # fmt: skip
def test_a_bad_target_is_refused_and_the_commands_are_as_without_it(drive, position, header, refusal):
    def run(bad):
        driver = drive()
        driver.loop.simulation.reset()
        driver.target(*INSIDE)
        driver.tick(3)
        if bad:
            assert driver.target(*position, **header) is refusal
        driver.tick(5)
        return driver.commands

    assert np.array_equal(run(bad=True), run(bad=False))


def test_without_a_target_for_the_timeout_the_loop_holds_and_a_new_one_continues(drive):
    driver = drive(target_timeout=0.3)
    driver.target(*INSIDE)
    driver.tick(7)
    held = driver.tick(3)
    assert held.activity is Activity.HOLDING and held.cause == "no target for target_timeout"
    assert np.array_equal(driver.commands[-1], driver.commands[-2])
    driver.target(*INSIDE)
    assert driver.tick().activity is Activity.FOLLOWING


@pytest.mark.parametrize("lengths", [True, False])
def test_direct_mode_takes_lengths_or_tensions(drive, lengths):
    driver = drive(mode=Mode.DIRECT)
    names = driver.loop.simulation.actuator_names
    rest = driver.loop.simulation.rest_setpoints
    assert driver.tick().cause == "no command yet"
    wanted = rest - [0.004, 0.001, 0.002, 0.003] if lengths else np.array([3.0, 2.0, 2.5, 2.2])
    values = (wanted, []) if lengths else ([], wanted)
    assert driver.loop.direct.accept(names, *values, driver.arrival()) is None
    outcome = driver.tick(40)
    assert outcome.activity is Activity.COMMANDED
    reached = outcome.command.setpoints if lengths else outcome.command.efforts
    assert reached == pytest.approx(wanted, abs=1e-5 if lengths else 1e-2)
    assert driver.largest_step <= RATE * STEP + ROUNDING


def test_a_direct_command_outside_the_limits_is_met_up_to_the_limits(drive):
    driver = drive(mode=Mode.DIRECT)
    names = driver.loop.simulation.actuator_names
    rest = driver.loop.simulation.rest_setpoints
    driver.loop.direct.accept(names, rest + 0.5, [], driver.arrival())
    outcome = driver.tick(5)
    assert outcome.violated == ()
    assert outcome.result.status is Status.SATURATED
    assert outcome.command.setpoints == pytest.approx(rest, abs=1e-6)


def tilted(degrees):
    half = 0.5 * np.radians(degrees)
    return np.sin(half), 0.0, 0.0, np.cos(half)


def test_a_pose_is_reached_by_position_and_orientation(drive_posed):
    driver = drive_posed()
    driver.loop.targets.accept_pose(0, (0.0, 0.0, 0.134), tilted(6.0), driver.arrival())
    outcome = driver.tick(40)
    assert outcome.activity is Activity.FOLLOWING
    assert outcome.result.status is Status.OK
    assert np.degrees(outcome.orientation_errors[0]) < 0.1
    assert outcome.result.effector_positions[0, 2] == pytest.approx(0.134, abs=1e-4)
    assert driver.largest_step <= RATE * STEP + ROUNDING


def test_a_far_orientation_is_approached_at_the_speed_of_positions(drive_posed):
    driver = drive_posed(approach_speed=0.02)
    driver.loop.targets.accept_pose(0, (0.0, 0.0, 0.13), tilted(15.0), driver.arrival())
    length = driver.loop.simulation.lengths_per_radian[0]
    turns = [driver.tick().result.effector_orientations[0] for _ in range(10)]
    assert driver.outcomes[2].is_approaching
    steps = 2.0 * np.arccos(np.abs(np.sum(np.array(turns)[1:] * turns[:-1], axis=1)).clip(max=1))
    assert 0.2 * 0.02 * STEP < length * steps.max() < 1.5 * 0.02 * STEP


@pytest.mark.exhaustive
@pytest.mark.parametrize("scene, changes", [
    ("diamond", {"observer": {}}), ("fast_pneunet", {}), ("fast_trunk_device", {}), ("finray", {}),
])  # fmt: skip
def test_the_first_targets_and_measurements_compile_nothing(scene, changes):
    run = subprocess.run([sys.executable, ROOT / "test/first_ticks.py", scene, str(changes)], cwd=ROOT,
                         capture_output=True, text=True)  # fmt: skip
    assert run.stdout.strip() == "[]", run.stderr
