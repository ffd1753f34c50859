"""Targets: points, velocities, and what becomes of neither."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import TargetInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS

STEP = 0.05
REST = np.array([[0.0, 0.0, 0.125], [0.1, 0.0, 0.0]])
SETTINGS = LoopSettings(
    speed_limit=0.02, velocity_timeout=0.2, target_timeout=1.0,
    workspace_min=(-0.01, -0.01, 0.12), workspace_max=(0.01, 0.01, 0.13),
)


@pytest.fixture
def targets():
    return TargetInput(2, 0, "base_link", SETTINGS)


def at(time, stamp=None):
    ros_time = round((1000.0 + time) * NANOSECONDS)
    return Arrival("base_link", ros_time if stamp is None else stamp, ros_time, time)


def drive(targets, start, duration):
    """Reads every tick; the time after the last one."""
    time = start
    for _ in range(round(duration / STEP)):
        targets.read(time, STEP, REST)
        time += STEP
    return time


def test_a_point_is_the_target_of_its_effector_alone(targets):
    assert targets.accept_point(1, (0.01, 0.002, 0.13), at(0.0)) is None
    reading = targets.read(0.1, STEP, REST)
    assert np.isnan(reading.targets[0]).all()
    assert reading.targets[1].tolist() == [0.01, 0.002, 0.13]
    assert reading.source == "point" and reading.age == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("position", "refusal"),
    [
        ((math.nan, 0.0, 0.1), Refusal.NOT_FINITE),
        ((0.0, math.inf, 0.1), Refusal.NOT_FINITE),
        ((0.0, 0.1), Refusal.WRONG_SIZE),
    ],
)
def test_an_invalid_point_changes_nothing_and_is_counted(targets, position, refusal):
    targets.accept_point(0, (0.0, 0.0, 0.13), at(0.0))
    assert targets.accept_point(0, position, at(0.1)) is refusal
    assert targets.refusals.by_word() == {refusal.value: 1}
    assert targets.read(0.2, STEP, REST).targets[0].tolist() == [0.0, 0.0, 0.13]


def test_each_effector_has_its_own_message_order(targets):
    targets.accept_point(0, (0.0, 0.0, 0.13), at(0.2))
    assert targets.accept_point(1, (0.0, 0.0, 0.13), at(0.1)) is None
    assert targets.accept_point(0, (0.0, 0.0, 0.13), at(0.1)) is Refusal.OUT_OF_ORDER


def test_targets_time_out_and_are_accepted_again(targets):
    targets.accept_point(0, (0.0, 0.0, 0.13), at(0.0))
    assert not targets.read(1.0, STEP, REST).timed_out
    assert targets.read(1.01, STEP, REST).timed_out
    targets.accept_point(0, (0.0, 0.0, 0.13), at(1.1))
    assert not targets.read(1.2, STEP, REST).timed_out


def test_a_velocity_moves_the_target_from_the_effector_s_position(targets):
    targets.accept_velocity((0.01, 0.0, 0.0), 0.0)
    reading = targets.read(0.0, STEP, REST)
    assert reading.targets[0] == pytest.approx([0.01 * STEP, 0.0, 0.125])
    assert reading.source == "velocity"


def test_a_velocity_is_limited_and_keeps_its_direction(targets):
    targets.accept_velocity((0.3, 0.4, 0.0), 0.0)
    moved = targets.read(0.0, STEP, REST).targets[0] - REST[0]
    assert moved == pytest.approx(np.array([0.6, 0.8, 0.0]) * 0.02 * STEP)


def test_a_velocity_stops_after_its_timeout(targets):
    targets.accept_velocity((0.01, 0.0, 0.0), 0.0)
    end = drive(targets, 0.0, 0.6)
    reading = targets.read(end, STEP, REST)
    # It counts at 0, 0.05, 0.1, 0.15 and 0.2 s.
    assert reading.targets[0, 0] == pytest.approx(0.01 * STEP * 5)


def test_a_velocity_does_not_move_the_target_out_of_the_workspace(targets):
    for second in range(10):
        targets.accept_velocity((0.02, -0.02, 0.02), 0.2 * second)
        drive(targets, 0.2 * second, 0.2)
    target = targets.read(2.0, STEP, REST).targets[0]
    assert target == pytest.approx([0.01, -0.01, 0.13])


def test_a_target_outside_a_reduced_workspace_moves_only_inwards_and_without_a_jump(targets):
    settings = targets.settings
    targets.apply(replace(settings, workspace_max=(0.1, 0.1, 0.2)))
    targets.accept_point(0, (0.05, 0.0, 0.125), at(0.0))
    targets.apply(settings)
    targets.accept_velocity((0.02, 0.0, 0.0), 0.1)
    assert targets.read(0.1, STEP, REST).targets[0, 0] == 0.05
    targets.accept_velocity((-0.02, 0.0, 0.0), 0.15)
    assert targets.read(0.15, STEP, REST).targets[0, 0] == pytest.approx(0.05 - 0.02 * STEP)


def test_a_point_outside_the_workspace_is_limited_to_it_and_counted(targets):
    assert targets.accept_point(0, (1e6, -0.005, 0.125), at(0.0)) is None
    assert targets.read(0.0, STEP, REST).targets[0].tolist() == [0.01, -0.005, 0.125]
    assert targets.clamped == 1 and targets.refusals.total == 0
    targets.accept_point(0, (0.0, 0.0, 0.125), at(0.1))
    assert targets.clamped == 1


def test_a_velocity_that_is_stopped_at_the_workspace_is_counted(targets):
    targets.accept_point(0, (0.01, 0.0, 0.125), at(0.0))
    targets.accept_velocity((0.02, 0.0, 0.0), 0.1)
    targets.read(0.1, STEP, REST)
    assert targets.clamped == 1


@pytest.mark.parametrize(("speed", "count"), [(0.02, 0), (0.021, 1), (1e200, 1)])
def test_a_velocity_above_the_speed_limit_is_counted(targets, speed, count):
    assert targets.settings.speed_limit == 0.02
    targets.accept_velocity((0.0, -speed, 0.0), 0.1)
    for _ in range(3):
        targets.read(0.1, STEP, REST)
    assert targets.slowed == count and targets.refusals.total == 0


def test_a_point_stops_a_velocity(targets):
    targets.accept_velocity((0.02, 0.0, 0.0), 0.0)
    targets.accept_point(0, (0.0, 0.0, 0.125), at(0.05))
    assert targets.read(0.05, STEP, REST).targets[0].tolist() == [0.0, 0.0, 0.125]


@pytest.mark.parametrize("velocity", [(math.nan, 0.0, 0.0), (0.0, -math.inf, 0.0)])
def test_a_velocity_that_is_not_finite_is_refused_and_counted(targets, velocity):
    assert targets.accept_velocity(velocity, 0.0) is Refusal.NOT_FINITE
    assert targets.refusals.total == 1
    assert np.isnan(targets.read(0.0, STEP, REST).targets).all()


def test_reset_clears_targets_velocities_and_order_but_keeps_counts(targets):
    targets.accept_point(0, (0.0, 0.0, 0.13), at(0.5))
    targets.accept_point(0, (math.nan, 0.0, 0.13), at(0.5))
    targets.accept_velocity((0.02, 0.0, 0.0), 0.5)
    targets.reset()
    assert np.isnan(targets.read(0.5, STEP, REST).targets).all()
    assert targets.accept_point(0, (0.0, 0.0, 0.13), at(0.4)) is None
    assert targets.refusals.total == 1


HALF = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))


@pytest.fixture
def posed():
    return TargetInput(2, 0, "base_link", SETTINGS, (True, False))


def test_a_pose_is_position_and_orientation_of_its_effector_alone(posed):
    assert posed.accept_pose(0, (0.0, 0.0, 0.13), HALF, at(0.0)) is None
    reading = posed.read(0.1, STEP, REST)
    assert reading.targets[0].tolist() == [0.0, 0.0, 0.13]
    assert reading.orientations[0] == pytest.approx(HALF)
    assert np.isnan(reading.orientations[1]).all()
    assert reading.source == "pose"


def test_a_point_or_a_velocity_keeps_the_wanted_orientation(posed):
    posed.accept_pose(0, (0.0, 0.0, 0.13), HALF, at(0.0))
    posed.accept_point(0, (0.001, 0.0, 0.13), at(0.1))
    posed.accept_velocity((0.01, 0.0, 0.0), 0.15)
    reading = posed.read(0.2, STEP, REST)
    assert reading.targets[0, 0] > 0.001
    assert reading.orientations[0] == pytest.approx(HALF)


def test_a_twist_turns_the_wanted_orientation_as_fast_as_the_speed_limit_allows():
    length = 0.05
    posed = TargetInput(2, 0, "base_link", SETTINGS, (length, 0.0))
    turns = np.array([[0.0, 0.0, 0.0, 1.0], [np.nan] * 4])
    posed.accept_velocity((0.0, 0.0, 0.0, 0.0, 0.0, 0.1), 0.0)
    reading = posed.read(0.0, STEP, REST, turns)
    assert np.isnan(reading.targets).all()
    assert reading.orientations[0] == pytest.approx([0.0, 0.0, np.sin(0.05 * STEP), np.cos(0.05 * STEP)])
    # Twists are in the world, and are limited: what is far from the axis keeps to the speed limit.
    posed.accept_pose(0, (0.0, 0.0, 0.13), HALF, at(0.1))
    posed.accept_velocity((0.0, 0.0, 0.0, 0.0, 0.0, 1e300), 0.1)
    turned = Rotation.from_quat(posed.read(0.1, STEP, REST, turns).orientations[0])
    way = (turned * Rotation.from_quat(HALF).inv()).as_rotvec()
    assert way == pytest.approx([0.0, 0.0, SETTINGS.speed_limit / length * STEP])
    assert posed.accept_velocity((0.0, 0.0, 0.0, math.nan, 0.0, 0.0), 0.2) is Refusal.NOT_FINITE


def test_a_twist_of_an_effector_without_orientation_moves_its_position_alone(targets):
    targets.accept_velocity((0.01, 0.0, 0.0, 1.0, 2.0, 3.0), 0.0)
    reading = targets.read(0.0, STEP, REST)
    assert reading.targets[0] == pytest.approx([0.01 * STEP, 0.0, 0.125])
    assert reading.orientations is None


@pytest.mark.parametrize(
    ("effector", "position", "quaternion", "refusal"),
    [
        (0, (math.nan, 0.0, 0.1), HALF, Refusal.NOT_FINITE),
        (0, (0.0, 0.0, 0.13), (0.0, math.nan, 0.0, 1.0), Refusal.NOT_FINITE),
        (0, (0.0, 0.0, 0.13), (0.0, math.inf, 0.0, 1.0), Refusal.NOT_FINITE),
        (0, (0.0, 0.0, 0.13), (0.0, 0.0, 0.0, 0.0), Refusal.NO_ROTATION),
        (0, (0.0, 0.0, 0.13), (0.0, 0.0, 0.0, 2.0), Refusal.NO_ROTATION),
        (0, (0.0, 0.0, 0.13), (1e308, 1e308, 0.0, 1.0), Refusal.NO_ROTATION),
        (0, (0.0, 0.0, 0.13), (0.0, 0.0, 1.0), Refusal.WRONG_SIZE),
        (0, (0.0, 0.13), HALF, Refusal.WRONG_SIZE),
        (1, (0.0, 0.0, 0.13), HALF, Refusal.WRONG_NAMES),
    ],
)
def test_an_invalid_pose_changes_nothing_and_is_counted(posed, effector, position, quaternion, refusal):
    posed.accept_pose(0, (0.0, 0.0, 0.125), (0.0, 0.0, 0.0, 1.0), at(0.0))
    assert posed.accept_pose(effector, position, quaternion, at(0.1)) is refusal
    assert posed.refusals.by_word() == {refusal.value: 1}
    reading = posed.read(0.2, STEP, REST)
    assert reading.targets[0].tolist() == [0.0, 0.0, 0.125]
    assert reading.orientations[0].tolist() == [0.0, 0.0, 0.0, 1.0]


def test_a_pose_that_was_overtaken_by_a_point_is_refused(posed):
    posed.accept_point(0, (0.0, 0.0, 0.13), at(0.2))
    refusal = posed.accept_pose(0, (0.0, 0.0, 0.125), HALF, at(0.1))
    assert refusal is Refusal.OUT_OF_ORDER


def test_a_pose_outside_the_workspace_is_limited_to_it(posed):
    posed.accept_pose(0, (5.0, 0.0, 0.125), HALF, at(0.0))
    assert posed.read(0.0, STEP, REST).targets[0, 0] == 0.01
    assert posed.clamped == 1


def test_a_path_is_followed_by_its_own_times_and_ends_at_its_end(targets):
    times, places = [0.1, 0.2, 0.4], [[0, 0, 0.12], [0.004, 0, 0.12], [0.004, 0.002, 0.12]]
    assert targets.accept_path(0, times, places, at(1.0, stamp=at(0.95).stamp)) is None
    for now, place in ((1.0, (0, 0)), (1.1, (0.002, 0)), (1.25, (0.004, 0.001)), (5.0, (0.004, 0.002))):
        assert targets.is_moving(now) == (now <= 1.35)
        reading = targets.read(now, STEP, REST)
        assert reading.targets[0] == pytest.approx([*place, 0.12], abs=1e-9)
        assert reading.source == "path"
    # It counts as sent as long as it lasts.
    assert reading.age == pytest.approx(5.0 - 1.35) and reading.timed_out
    assert targets.read(1.3, STEP, REST).age <= 1.3 - 1.0
    ahead = targets.ahead(1.1, np.array([0.0, 0.1, 9.0]))
    assert ahead[:, 0] == pytest.approx(
        np.array([[0.002, 0, 0.12], [0.004, 0.0005, 0.12], [0.004, 0.002, 0.12]]), abs=1e-9)
    assert np.isnan(ahead[:, 1]).all()
    targets.accept_point(0, (0.0, 0.0, 0.13), at(1.2))
    assert targets.read(1.2, STEP, REST).targets[0].tolist() == [0.0, 0.0, 0.13]


@pytest.mark.parametrize(("times", "places", "refusal"), [
    ([0.0, 0.1], [[0, 0, 0.12]], Refusal.WRONG_SIZE),
    ([], np.empty((0, 3)), Refusal.WRONG_SIZE),
    ([0.0, 0.0], [[0, 0, 0.12]] * 2, Refusal.OUT_OF_ORDER),
    ([0.0, math.nan], [[0, 0, 0.12]] * 2, Refusal.NOT_FINITE),
    ([0.0, 0.1], [[0, 0, 0.12], [0, math.inf, 0.12]], Refusal.NOT_FINITE),
])  # fmt: skip
def test_an_invalid_path_changes_nothing_and_is_counted(targets, times, places, refusal):
    targets.accept_point(0, (0.0, 0.0, 0.13), at(0.0))
    assert targets.accept_path(0, times, places, at(0.1)) is refusal
    assert targets.refusals.by_word() == {refusal.value: 1}
    assert targets.read(0.2, STEP, REST).targets[0].tolist() == [0.0, 0.0, 0.13]


def test_a_path_outside_the_workspace_is_limited_to_it(targets):
    targets.accept_path(0, [0.0, 0.1], [[0, 0, 0.5], [0, 0, 0.12]], at(0.0))
    assert targets.clamped == 1
    assert targets.read(0.0, STEP, REST).targets[0].tolist() == [0.0, 0.0, 0.13]


def test_the_course_of_a_stream_is_followed_ahead_as_far_as_leads_are_limited(targets):
    targets.apply(replace(SETTINGS, lead_limit=0.1))
    for tick in range(20):
        time = 0.02 * tick
        targets.accept_point(0, (0.01 * time, 0.0, 0.12), at(time))
    now = 0.02 * 19
    ahead = targets.ahead(now, np.array([0.0, 0.05, 0.1, 0.3]))[:, 0, 0]
    assert ahead == pytest.approx(0.01 * (now + np.array([0.0, 0.05, 0.1, 0.1])), rel=1e-3)
