"""Wanted stiffnesses as messages: real rclpy, the small Diamond whose tip is asked for one."""

import math

import pytest
from geometry_msgs.msg import PointStamped, Vector3Stamped
from std_msgs.msg import Header

from softrobot_twin.ros.messages import vector_message
from test.scene_changes import entries_of, yaml_file

FREE = math.nan


@pytest.fixture
def twin(make_twin, small_scene_file):
    scene = entries_of(small_scene_file, {"effectors.0.stiffness": {"weight": 1.0}})
    file = yaml_file(small_scene_file.with_name("stiff_diamond.yaml"), scene)
    return make_twin(scene_file=str(file))


def wanted(world, stiffness, seconds_ago=0.0, frame_id="base_link"):
    return vector_message(stiffness, Header(stamp=world.stamp(seconds_ago), frame_id=frame_id))


def test_a_target_stiffness_is_followed_and_told(world, twin):
    told = world.hear(Vector3Stamped, "/twin/stiffness/tip")
    places = world.hear(PointStamped, "/twin/effectors/tip")
    targets = world.speaker(Vector3Stamped, "/twin/target_stiffness/tip")
    world.until(lambda: places)
    assert not told
    targets.publish(wanted(world, (FREE, FREE, 540.0)))
    world.until(lambda: told and abs(told[-1].vector.z - 540.0) < 5.4)
    assert math.isnan(told[-1].vector.x) and told[-1].header.frame_id == "base_link"
