"""The simulated device as a node."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.device import DeviceReading
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.messages import cables_message, read_markers
from softrobot_twin.ros.twin_node import TwinNode
from test.builder import builder


@builder
def make_device(world, small_scene_file, /, **parameters):
    defaults = {"device_scene_file": str(small_scene_file), "device_rate": 50.0, "device_marker_noise": 0.0}
    return world.add(DeviceNode, **{**defaults, **parameters})


def command(world, device, lengths):
    names = device.device.actuator_names
    return cables_message(names, lengths, [0.0] * 4, Header(stamp=world.stamp()))


def rest_of(device):
    return np.array(device.device.read(device.monotonic()).setpoints)


def test_it_measures_lengths_markers_and_effectors_with_one_stamp(world, make_device):
    make_device()
    cables = world.hear(JointState, "/twin/measured_cables", 100)
    markers = world.hear(PointCloud2, "/twin/markers", 100)
    effectors = world.hear(PointStamped, "/device/effectors/tip", 100)
    world.until(lambda: min(map(len, (cables, markers, effectors))) > 4)
    ids, places = read_markers(markers[-1])
    assert ids.tolist() == list(range(8)) and np.isfinite(places).all()
    assert cables[-1].name == ["north", "west", "south", "east"]
    assert markers[-1].header.frame_id == effectors[-1].header.frame_id == "base_link"
    stamps = [{(m.header.stamp.sec, m.header.stamp.nanosec) for m in heard}
              for heard in (cables, markers, effectors)]
    assert len(set.intersection(*stamps)) >= 3


def test_its_scene_has_other_values_where_the_parameter_gives_them(make_device):
    device = make_device(device_scene_changes=["cables.north.tension=[0, 7]"])
    assert device.device.simulation.limits.effort_max[:2].tolist() == [7.0, 20.0]


def test_the_device_moves_to_a_command_at_the_rate_of_its_servos(world, make_device):
    device = make_device(device_servo_rate=0.01)
    rest = rest_of(device)
    measured = world.hear(JointState, "/twin/measured_cables", 100)
    cables = world.speaker(JointState, "/twin/cables")
    tick = world.ticks_of(device)
    cables.publish(command(world, device, rest - 0.002))
    world.until(lambda: tick() or (measured and np.allclose(measured[-1].position, rest - 0.002, atol=1e-6)))
    lengths = np.array([list(message.position) for message in measured])
    assert (lengths <= rest + 1e-9).all() and (lengths >= rest - 0.002 - 1e-6).all()
    on_the_way = ((lengths < rest - 1e-5) & (lengths > rest - 0.002 + 1e-5)).all(axis=1)
    assert 0.1 < np.count_nonzero(on_the_way) * device.tick_clock.period < 0.3


def test_a_device_that_follows_efforts_takes_tensions_and_refuses_lengths_alone(world, make_device):
    device = make_device(device_follows="efforts")
    rest, tensions = rest_of(device), [2.0, 1.8, 2.2, 1.8]
    measured = world.hear(JointState, "/twin/measured_cables", 100)
    cables = world.speaker(JointState, "/twin/cables")
    names, header = device.device.actuator_names, Header(stamp=world.stamp())
    cables.publish(JointState(header=header, name=names, position=rest.tolist()))
    world.until(lambda: device.refusals.of(Refusal.WRONG_SIZE) == 1)
    cables.publish(cables_message(names, rest, tensions, Header(stamp=world.stamp())))
    world.until(lambda: measured and np.allclose(measured[-1].effort, tensions, rtol=1e-6))


def test_the_topics_follow_the_name_of_the_twin(world, make_device):
    make_device(twin="/left/")
    cables = world.hear(JointState, "/left/measured_cables")
    world.until(lambda: cables)


def test_an_impossible_flaw_is_refused_at_start_up(make_device):
    with pytest.raises(ParameterError, match="device_delay"):
        make_device(device_delay=-1.0)


class Bench:
    """A user's own driver: two cables that follow immediately, and one marker."""

    actuator_names = ("left", "right")
    effector_names = ()

    def __init__(self):
        self.setpoints = np.array([0.1, 0.1])

    def apply(self, setpoints, now):
        self.setpoints = setpoints

    def read(self, now):
        return DeviceReading(
            self.setpoints, np.zeros(2), np.array([3], dtype=np.uint32), np.ones((1, 3)),
            np.empty((0, 3)),
        )


class BenchNode(DeviceNode):
    def make_device(self, values):
        return Bench()


def test_a_user_driver_needs_two_methods(world):
    node = world.add(BenchNode)
    measured = world.hear(JointState, "/twin/measured_cables")
    cables = world.speaker(JointState, "/twin/cables")
    cables.publish(
        JointState(header=Header(stamp=world.stamp()), name=["right", "left"],
                   position=[0.07, 0.09])
    )
    world.until(lambda: measured and list(measured[-1].position) == [0.09, 0.07])
    assert node.device.setpoints.tolist() == [0.09, 0.07]


def test_a_device_follows_its_twin(world, make_device, small_scene_file):
    """The twin receives lengths and markers, is enabled, and the device moves to the target."""
    # On a busy machine messages come late.
    device = make_device(message_timeout=20.0)
    twin = world.add(TwinNode, scene_file=str(small_scene_file), rate=50.0, use_device=True,
                     message_timeout=20.0, device_timeout=20.0)
    world.until(lambda: twin.loop.device.setpoints is not None)
    world.until(lambda: np.isfinite(twin.loop.markers.positions).all())
    assert twin.loop.enable(twin.monotonic())[0]
    position = (0.006, 0.0, 0.133)
    arrival = Arrival("base_link", 0, 0, twin.monotonic())
    assert twin.loop.targets.accept_point(0, position, arrival) is None
    effectors = world.hear(PointStamped, "/device/effectors/tip")

    def arrived():
        where = effectors[-1].point if effectors else Point()
        return math.dist((where.x, where.y, where.z), position) < 5e-4

    world.until(arrived)
    assert device.device.refused == 0 and device.refusals.total == 0
