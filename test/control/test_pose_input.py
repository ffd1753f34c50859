"""Poses of guided bodies."""

import math

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import PoseInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
HERE = (0.1, 0.2, 0.3)


def at(time, age=0.0, frame_id="base_link"):
    now = round((1000.0 + time) * NANOSECONDS)
    return Arrival(frame_id, now - round(age * NANOSECONDS), now, time)


@pytest.fixture
def poses():
    return PoseInput(("palm", "base"), "base_link", LoopSettings())


def test_the_newest_pose_of_each_body_wins(poses):
    assert poses.accept("palm", HERE, UPRIGHT, at(0.0)) is None
    assert poses.accept("base", (0.0, 0.0, 0.0), UPRIGHT, at(0.1)) is None
    assert poses.accept("palm", (0.4, 0.5, 0.6), (0.0, 0.0, 1.0, 0.0), at(0.2)) is None
    assert poses.newest["palm"].position.tolist() == [0.4, 0.5, 0.6]
    assert poses.newest["palm"].quaternion.tolist() == [0.0, 0.0, 1.0, 0.0]
    assert poses.newest["base"].position.tolist() == [0.0, 0.0, 0.0]
    assert poses.age(0.5) == pytest.approx(0.3)


@pytest.mark.parametrize("name, position, quaternion, header, refusal", [
    ("palm", (math.nan, 0.0, 0.0), UPRIGHT, {}, Refusal.NOT_FINITE),
    ("palm", HERE, (0.0, 0.0, math.inf, 1.0), {}, Refusal.NOT_FINITE),
    ("palm", HERE, (0.0, 0.0, 0.0, 0.0), {}, Refusal.NO_ROTATION),
    ("palm", HERE, UPRIGHT, {"frame_id": "map"}, Refusal.WRONG_FRAME),
    ("palm", HERE, UPRIGHT, {"frame_id": ""}, Refusal.WRONG_FRAME),
    ("palm", HERE, UPRIGHT, {"age": 2.0}, Refusal.STALE),
    ("palm", HERE, UPRIGHT, {"age": -2.0}, Refusal.FROM_THE_FUTURE),
    ("cube", HERE, UPRIGHT, {}, Refusal.WRONG_NAMES),
])  # fmt: skip
def test_an_invalid_pose_is_refused_and_counted(poses, name, position, quaternion, header, refusal):
    assert poses.accept(name, position, quaternion, at(0.0, **header)) is refusal
    assert poses.refusals.of(refusal) == 1
    assert poses.newest == {} and np.isinf(poses.age(0.0))


def test_an_outdated_pose_is_refused_for_its_body_only(poses):
    poses.accept("palm", HERE, UPRIGHT, at(0.2))
    assert poses.accept("palm", HERE, UPRIGHT, at(0.3, age=0.2)) is Refusal.OUT_OF_ORDER
    assert poses.accept("base", HERE, UPRIGHT, at(0.3, age=0.2)) is None


def test_a_pose_outside_the_workspace_is_limited_to_it_and_counted():
    poses = PoseInput(("palm",), "base_link", LoopSettings(workspace_max=(0.2, 0.2, 0.2)))
    assert poses.accept("palm", (0.1, 1e9, -3.0), UPRIGHT, at(0.0)) is None
    assert poses.newest["palm"].position.tolist() == [0.1, 0.2, -1.0]
    assert poses.clamped == 1 and poses.refusals.total == 0
