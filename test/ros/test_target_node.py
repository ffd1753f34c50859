"""The target as a node."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.target_node import TargetNode

CENTRE = [0.0, 0.0, 0.13]


@pytest.fixture
def make_target(world):
    def make(**parameters):
        defaults = {"target_center": CENTRE, "target_radius": 0.02, "target_period": 2.0,
                    "target_ramp_time": 0.5, "target_rate": 100.0}
        return world.add(TargetNode, **{**defaults, **parameters})

    return make


def heard_from(world, position):
    """The messages of the target after it received the effector's position."""
    targets = world.hear(PointStamped, "/twin/target/tip", 100)
    effectors = world.speaker(PointStamped, "/twin/effectors/tip")
    world.run(0.2)
    assert not targets, "it must wait for the effector"
    x, y, z = position
    effectors.publish(
        PointStamped(header=Header(stamp=world.stamp(), frame_id="base_link"),
                     point=Point(x=x, y=y, z=z))
    )
    return targets


def places(targets):
    return np.array([[m.point.x, m.point.y, m.point.z] for m in targets])


def test_the_target_starts_at_the_effector_and_reaches_its_path(world, make_target):
    make_target()
    start = (0.001, 0.002, 0.125)
    targets = heard_from(world, start)
    world.until(lambda: len(targets) > 100)
    path = places(targets)
    assert math.dist(path[0], start) < 1e-3
    assert np.linalg.norm(path[-1] - CENTRE) == pytest.approx(0.02)
    assert targets[-1].header.frame_id == "base_link"
    times = np.array([m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in targets])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert (steps < 0.15 * np.diff(times) + 1e-3).all()


def test_paths_alternate(make_target):
    """Calls the ticks at given times, because on a busy machine some would be skipped."""
    target = make_target(target_sequence=["circle", "lemniscate"], target_sequence_time=0.6,
                         target_period=0.5, target_ramp_time=0.1)
    target.stop()
    sent = []
    target._targets.publish = sent.append
    target._take_start(PointStamped(point=Point(x=0.0, y=0.0, z=0.125)))
    for tick in range(110):
        target.work(target._began + 0.01 * tick)
    radii = np.linalg.norm(places(sent)[:, :2], axis=1)
    assert radii[20:50] == pytest.approx(0.02, abs=1e-6)
    assert radii[70:].min() < 0.01


def test_a_file_of_targets_is_played(world, make_target, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("t,tip.x,tip.y,tip.z\n0,0,0,0.13\n0.2,0.01,0,0.13\n")
    make_target(target_path=str(file), target_ramp_time=0.0)
    targets = heard_from(world, (0.0, 0.0, 0.125))
    world.until(lambda: len(targets) > 40)
    assert places(targets)[-1] == pytest.approx([0.01, 0.0, 0.13])


@pytest.mark.parametrize(
    ("parameters", "name"),
    [
        ({"target_path": "spiral"}, "target_path"),
        ({"target_path": "/nowhere.csv"}, "target_path"),
        ({"target_center": [0.0, 0.0]}, "target_center"),
        ({"target_radius": -0.1}, "target_radius"),
        ({"target_plane": "zz"}, "target_plane"),
        ({"target_sequence": ["circle", "x"]}, "target_path"),
    ],
)
def test_an_invalid_path_is_refused_at_start_up(make_target, parameters, name):
    with pytest.raises(ParameterError) as raised:
        make_target(**parameters)
    assert raised.value.name == name


def test_an_actuator_is_commanded_to_and_fro_beside_the_targets(world, make_target):
    make_target(target_actuator="grip", target_setpoints=[0.9, 0.8], target_setpoint_period=0.5)
    commands = world.hear(JointState, "/twin/command/cables", 100)
    targets = heard_from(world, (0.001, 0.002, 0.125))
    world.until(lambda: len(commands) > 60)
    assert targets and {tuple(message.name) for message in commands} == {("grip",)}
    values = np.array([message.position[0] for message in commands])
    assert values.min() >= 0.8 and values.max() <= 0.9 and np.ptp(values) > 0.05
    assert all(not message.effort for message in commands)


def test_without_an_actuator_nothing_is_commanded(world, make_target):
    make_target()
    commands = world.hear(JointState, "/twin/command/cables", 100)
    targets = heard_from(world, (0.001, 0.002, 0.125))
    world.until(lambda: len(targets) > 20)
    assert not commands
