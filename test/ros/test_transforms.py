"""Transforms for /tf. tf2_msgs is not among the wheels, and the set-up builds it only where there is
a compiler: in most tests a class stands where its message is.
"""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from softrobot_twin.ros.audience import Audience
from softrobot_twin.ros.transforms import TransformOutput, make_transforms

pytestmark = pytest.mark.libraries

POSE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
HEADER = Header(stamp=Time(sec=7, nanosec=8), frame_id="base_link")


class TFMessage:
    """The message of tf2_msgs: a list of `geometry_msgs/TransformStamped`."""

    def __init__(self, transforms=()):
        self.transforms = list(transforms)


class Publisher:
    def __init__(self):
        self.messages, self.listeners = [], 0

    def get_subscription_count(self):
        return self.listeners

    def publish(self, message):
        self.messages.append(message)


class Node:
    """What the output asks of a node."""

    def __init__(self):
        self.opened, self.warnings = [], []

    def create_publisher(self, *given):
        self.opened.append(given)
        return Publisher()

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append)


class Simulation:
    """A palm and a tip; counts how often its poses are read."""

    rigid_names, effector_names = ("palm",), ("tip",)
    reads = 0

    def rigid_poses(self):
        self.reads += 1
        return np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 0.0, 0.6, 0.8]])


def outcome_of(positions, turns=None):
    result = SimpleNamespace(effector_positions=np.array(positions), effector_orientations=turns)
    return SimpleNamespace(result=result)


@pytest.fixture
def with_tf2(monkeypatch):
    package, messages = ModuleType("tf2_msgs"), ModuleType("tf2_msgs.msg")
    messages.TFMessage = TFMessage
    monkeypatch.setitem(sys.modules, "tf2_msgs", package)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", messages)


@pytest.fixture
def without_tf2(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_msgs", None)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", None)


def test_a_transform_has_the_pose_the_frames_and_the_stamp():
    turn = np.array([0.0, 0.6, 0.0, 0.8])
    found = make_transforms(HEADER, ["left/tip"], np.array([[1.0, 2.0, 3.0]]), turn[None])
    assert len(found) == 1 and found[0].header == HEADER and found[0].child_frame_id == "left/tip"
    moved, turned = found[0].transform.translation, found[0].transform.rotation
    assert (moved.x, moved.y, moved.z) == (1.0, 2.0, 3.0)
    assert (turned.x, turned.y, turned.z, turned.w) == tuple(turn)


def test_without_an_orientation_it_is_not_turned_and_without_a_place_it_is_left_out():
    positions = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0]])
    found = make_transforms(HEADER, ["tip", "lost"], positions, np.full((2, 4), np.nan))
    assert [one.child_frame_id for one in found] == ["tip"]
    assert found[0].transform.rotation.w == 1.0


def output_of(node, audience=None, simulation=None, **given):
    """An output of a node, with some parameters."""
    values = {"frame_id": "base_link", "tf": "auto", "tf_prefix": "", "tf_base_frame": "",
              "tf_base_pose": POSE}  # fmt: skip
    return TransformOutput(node, simulation or Simulation(), values | given, audience or Audience())


def test_the_base_is_in_the_frame_that_is_given(with_tf2):
    pose = (1.0, 0.0, 0.5, 0.0, 0.0, 1.0, 0.0)
    output = output_of(Node(), tf="on", tf_prefix="left/", tf_base_frame="world", tf_base_pose=pose)
    output.publisher.listeners = 1
    output.publish(outcome_of([[0.0, 0.0, 0.2]]), lambda: HEADER)
    last = output.publisher.messages[0].transforms[-1]
    assert (last.header.frame_id, last.child_frame_id) == ("world", "base_link")
    assert last.header.stamp == HEADER.stamp
    assert last.transform.translation.x == 1.0 and last.transform.rotation.z == 1.0


@pytest.mark.parametrize(("wanted", "warnings"), [("auto", 0), ("on", 1), ("off", 0)])
def test_without_tf2_msgs_there_is_nothing_and_only_who_asks_is_told(without_tf2, wanted, warnings):
    node = Node()
    output = output_of(node, tf=wanted)
    assert not output.is_heard
    assert not node.opened and len(node.warnings) == warnings
    assert all("tf2_msgs is not installed" in sentence for sentence in node.warnings)


def test_a_twin_that_is_asked_for_tf_tells_once_that_it_cannot(world, make_twin, without_tf2, capfd):
    make_twin(tf="on")
    world.run(0.5)
    assert capfd.readouterr().err.count("tf2_msgs is not installed") == 1


def test_a_twin_publishes_its_effectors_on_tf_also_where_yaml_reads_on_as_a_truth_value(world, make_twin):
    messages = pytest.importorskip("tf2_msgs.msg")
    received = []
    world.probe.create_subscription(messages.TFMessage, "/tf", received.append, 10)
    make_twin(tf=True)
    world.until(lambda: received, 20.0)
    (tip,) = received[0].transforms
    assert (tip.header.frame_id, tip.child_frame_id) == ("base_link", "tip")
    assert tip.transform.translation.z > 0.05
