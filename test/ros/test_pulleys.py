"""Pulleys over ROS: angles on topics of their own."""

import numpy as np
import pytest
import yaml
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.twin_node import TwinNode
from test.scene_changes import yaml_file

RADIUS = 0.01


@pytest.fixture(scope="module")
def wound_file(small_scene_file):
    scene = yaml.safe_load(small_scene_file.read_text())
    for cable, winds in zip(scene["cables"], ("positive", "negative")):
        cable["pulley"] = {"radius": RADIUS, "winds": winds, "angle": [-1.5, 1.5]}
    return yaml_file(small_scene_file.with_name("wound.yaml"), scene)


def angles_of(world, names, angles, torques=()):
    return JointState(header=Header(stamp=world.stamp()), name=list(names),
                      position=list(map(float, angles)), effort=list(map(float, torques)))


def test_a_commanded_angle_is_published_beside_the_length(world, wound_file):
    twin = world.add(TwinNode, scene_file=str(wound_file), rate=50.0, mode="direct")
    names = twin.loop.simulation.actuator_names
    rest = twin.loop.simulation.rest_setpoints
    cables = world.hear(JointState, "/twin/cables", 100)
    angles = world.hear(JointState, "/twin/angles", 100)
    command = world.speaker(JointState, "/twin/command/angles")
    command.publish(angles_of(world, names[:2], [0.4, -0.3]))
    world.until(lambda: angles and np.allclose(angles[-1].position, [0.4, -0.3], atol=1e-9))
    heard = angles[-1]
    assert list(heard.name) == list(names[:2])
    (both,) = [m for m in cables if m.header.stamp == heard.header.stamp]
    np.testing.assert_allclose(both.position[:2], rest[:2] - [RADIUS * 0.4, RADIUS * 0.3])
    np.testing.assert_allclose(heard.effort, [RADIUS * both.effort[0], -RADIUS * both.effort[1]])


def test_a_device_measures_angles_and_the_twin_starts_from_them(world, wound_file):
    device = world.add(DeviceNode, device_scene_file=str(wound_file), device_rate=50.0)
    measured = world.hear(JointState, "/twin/measured_angles", 100)
    twin = world.add(TwinNode, scene_file=str(wound_file), rate=50.0, mode="direct", use_device=True)
    world.until(lambda: measured and twin.loop.device.setpoints is not None)
    names = twin.loop.simulation.actuator_names
    assert list(measured[-1].name) == list(names[:2])
    assert world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success
    command = world.speaker(JointState, "/twin/command/angles")
    world.until(lambda: twin.loop.is_enabled and twin.loop.activity.value == "holding")
    command.publish(angles_of(world, names[:2], [0.3, 0.0]))
    world.until(lambda: abs(measured[-1].position[0] - 0.3) < 1e-3)
    rest = twin.loop.simulation.rest_setpoints[0]
    assert device.device.result.setpoints[0] == pytest.approx(rest - 0.3 * RADIUS, abs=1e-5)
