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
from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.inputs import BaseInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.ros.messages import stamp_of
from softrobot_twin.ros.topics import LATCHED
from softrobot_twin.ros.transforms import MOST_FRAMES, BaseFollower
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
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


def test_a_base_follows_a_flange_at_the_end_of_a_chain(world, make_twin, carried):
    tf2 = pytest.importorskip("tf2_msgs.msg")
    fixed = world.probe.create_publisher(tf2.TFMessage, "/tf_static", LATCHED)
    half = math.sqrt(0.5)
    fixed.publish(tf2.TFMessage(transforms=[transform("flange", 0.1, "arm", w=half, z=half)]))
    make_twin(scene_file=carried, base_frame="flange")
    moving = world.speaker(tf2.TFMessage, "/tf")
    loads = world.hear(JointState, "/twin/base_loads/base", 10)
    world.until(lambda: loads)
    gravity = np.array(loads[-1].position)
    tilted = transform("arm", 1.0)
    tilted.transform.rotation = Quaternion(x=half, w=half)

    def is_tilted():
        tilted.header.stamp = world.stamp()
        moving.publish(tf2.TFMessage(transforms=[tilted]))
        # About x, then about the new z: what was along z is along x.
        return np.allclose(loads[-1].position, [gravity[2], *gravity[:2]], atol=1e-9)

    world.until(is_tilted)


@pytest.fixture
def follower():
    pytest.importorskip("tf2_msgs")
    heard = []
    node = SimpleNamespace(create_subscription=lambda kind, topic, receive, depth: heard.append(topic))
    made = BaseFollower(node, "flange", lambda *pose: made.kept.append(pose))
    made.kept, made.heard = [], heard
    return made


def said(*transforms):
    return SimpleNamespace(transforms=transforms)


def transform(frame, x, parent="floor", seconds=0.0, w=1.0, z=0.0):
    return TransformStamped(
        header=Header(frame_id=parent, stamp=stamp_of(round(1e9 * seconds))), child_frame_id=frame,
        transform=Transform(translation=Vector3(x=x), rotation=Quaternion(w=w, z=z)))


def test_transforms_of_other_frames_are_left_out(follower):
    follower.receive(said(transform("table", 1.0), transform("flange", 2.0)))
    (place, turn, header), = follower.kept
    assert place.tolist() == [2.0, 0.0, 0.0] and turn.tolist() == [0.0, 0.0, 0.0, 1.0]
    assert header.frame_id == "floor" and follower.heard == ["/tf", "/tf_static"]


def test_a_chain_of_transforms_is_put_together_at_its_last_common_time(follower):
    half = math.sqrt(0.5)
    follower.receive(said(transform("flange", 0.1, "wrist")), is_fixed=True)
    for second in (1.0, 2.0, 3.0):
        follower.receive(said(transform("arm", second, seconds=second)))
    follower.receive(said(transform("wrist", 0.5, "arm", 2.5, half, half)))
    place, turn, header = follower.kept[-1]
    # A quarter turn about z: what is along x of the wrist is along y of the floor.
    assert place == pytest.approx([2.5 + 0.5, 0.1, 0.0]) and turn == pytest.approx([0.0, 0.0, half, half])
    assert header.frame_id == "floor" and (header.stamp.sec, header.stamp.nanosec) == (2, 500_000_000)
    told = len(follower.kept)
    follower.receive(said(transform("arm", 4.0, seconds=4.0)))
    assert len(follower.kept) == told  # The wrist is not known later.


def test_circles_floods_and_rotations_that_are_none_move_no_base(follower):
    follower.receive(said(transform("flange", 1.0, "wrist"), transform("wrist", 1.0, "flange")))
    assert not follower.kept
    follower.receive(said(*(transform(f"frame_{k}", 1.0) for k in range(3 * MOST_FRAMES))))
    assert len(follower.links) <= MOST_FRAMES
    follower.receive(said(transform("flange", 2.0, seconds=1.0)))
    assert follower.kept[-1][0].tolist() == [2.0, 0.0, 0.0]
    loop_input = BaseInput(LoopSettings())
    for count, odd in enumerate((transform("flange", 2.0, seconds=2.0, w=0.0),
                                 transform("flange", math.nan, seconds=3.0)), 1):
        follower.receive(said(odd))
        place, turn, header = follower.kept[-1]
        loop_input.accept(place, turn, Arrival("floor", 0, 1, 1.0))
        assert loop_input.refusals.total == count


def test_a_base_in_another_frame_begins_anew(small_scene_file):
    content = {**yaml.safe_load(small_scene_file.read_text()), "moving_base": {}}
    twin = Simulation(scene_from_mapping(content, small_scene_file))
    loop, standing = TwinLoop(twin, LoopSettings(rate=20.0)), None
    for tick, (frame, x) in enumerate([("wrist", 0.0)] * 3 + [("floor", 5.0)] * 3):
        time = 0.05 * tick
        loop.measured_base.accept([x, 0, 0], [0, 0, 0, 1], Arrival(frame, 0, 1 + tick, time))
        load = loop.tick(time, 1 + tick).result.state.memory["base.load"]
        standing = load if standing is None else standing
        np.testing.assert_allclose(load, standing)
