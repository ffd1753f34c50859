"""The Grasper's twin and device as nodes: motor, poses, contacts."""


import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.twin_node import TwinNode
from test.builder import builder
from test.places import CONFIG

GIVEN = yaml.safe_load((CONFIG / "grasper.yaml").read_text())["/**"]["ros__parameters"]
@builder
def make_grasper(world, /, **changes):
    """Makes the Grasper's twin from its parameter file, some of them replaced."""
    return world.add(TwinNode, **{**GIVEN, **changes})


def pose_message(world, position, quaternion=(0.0, 0.0, 0.0, 1.0), **header):
    x, y, z = position
    qx, qy, qz, qw = quaternion
    stated = Header(**{"stamp": world.stamp(), "frame_id": "base_link", **header})
    pose = Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
    return PoseStamped(header=stated, pose=pose)


def grip_message(world, **values):
    return JointState(header=Header(stamp=world.stamp()), name=["grip"], **values)


def height(messages):
    return messages[-1].pose.position.z


@pytest.mark.exhaustive
def test_a_device_in_contact_follows_the_twin_s_cables_and_poses(world, make_grasper):
    # Both share one thread with the test: on a busy machine messages come late.
    patient = {"message_timeout": 20.0, "device_timeout": 20.0}
    twin = make_grasper(rate=50.0, use_device=True, **patient)
    device = world.add(DeviceNode, **{**GIVEN, "device_rate": 50.0, **patient})
    measured = world.hear(JointState, "/twin/measured_cables")
    palm = world.hear(PoseStamped, "/device/bodies/palm")
    cube = world.hear(PoseStamped, "/device/bodies/cube")
    commands = world.speaker(JointState, "/twin/command/cables")
    poses = world.speaker(PoseStamped, "/twin/command/pose/palm")
    world.until(lambda: len(measured) > 3)
    rest = twin.loop.simulation.rest_setpoints
    # Nothing of a disabled twin reaches the device.
    poses.publish(pose_message(world, (0.0, 0.0, 0.02)))
    world.until(lambda: twin.loop.poses.newest)
    world.run(0.3)
    assert height(palm) == 0.0
    assert world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success
    world.until(lambda: twin.loop.is_enabled)
    commands.publish(grip_message(world, position=[float(rest[0] - 0.004)]))
    poses.publish(pose_message(world, (0.0, 0.0, 0.02)))
    world.until(lambda: measured and np.allclose(measured[-1].position, rest - 0.004, atol=1e-4), 20.0)
    world.until(lambda: abs(height(palm) - 0.02) < 1e-4, 20.0)
    assert height(cube) == pytest.approx(-0.104, abs=1e-4)
    assert device.poses.refusals.total == 0
