"""The base of a robot on an arm follows a pose topic, or a frame of /tf."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Vector3,
)
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.transforms import BaseFollower
from test.scene_changes import yaml_file


@pytest.fixture
def carried(small_scene_file, tmp_path):
    path = yaml_file(tmp_path / "carried.yaml", {**yaml.safe_load(small_scene_file.read_text()), "moving_base": {}})
    return str(path)


def test_a_turned_base_turns_gravity(world, make_twin, carried):
    twin = make_twin(scene_file=carried)
    loads = world.hear(JointState, "/twin/base_loads/base", 10)
    poses = world.speaker(PoseStamped, "/twin/base_pose")
    world.until(lambda: loads)
    gravity = np.array(loads[-1].position)
    half = math.sqrt(0.5)
    poses.publish(PoseStamped(header=Header(stamp=world.stamp(), frame_id="floor"), pose=Pose(
        position=Point(x=1.0), orientation=Quaternion(x=half, w=half))))
    # About x by a right angle: what was along z is along y, seen from the base.
    expected = [gravity[0], gravity[2], -gravity[1]]
    world.until(lambda: np.allclose(loads[-1].position, expected, atol=1e-9))
    assert twin.loop.measured_base.refusals.by_word() == {}


def test_a_frame_needs_a_moving_base(make_twin):
    with pytest.raises(ParameterError, match="base_frame.*needs a scene with moving_base"):
        make_twin(base_frame="flange")


def test_transforms_of_other_frames_are_left_out():
    pytest.importorskip("tf2_msgs")
    kept, heard = [], []
    node = SimpleNamespace(create_subscription=lambda kind, topic, receive, depth: heard.append(topic))
    follower = BaseFollower(node, "flange", lambda *pose: kept.append(pose))
    follower.receive(SimpleNamespace(transforms=[transform("table", 1.0), transform("flange", 2.0)]))
    (place, turn, header), = kept
    assert place.tolist() == [2.0, 0.0, 0.0] and turn.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert header.frame_id == "floor" and heard == ["/tf"]


def transform(frame, x):
    return TransformStamped(header=Header(frame_id="floor"), child_frame_id=frame, transform=Transform(
        translation=Vector3(x=x), rotation=Quaternion(w=1.0)))
