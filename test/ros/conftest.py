"""Real rclpy without launch: nodes, publishers and clients in one context and one executor."""

import time
from typing import NamedTuple

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PointStamped
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from softrobot_twin.control.loop_timing import TickClock
from softrobot_twin.ros import twin_node
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.messages import pose_message
from softrobot_twin.ros.twin_node import TwinNode
from test.builder import builder
from test.places import ROOT
from test.scene_changes import entries_of, yaml_file


@pytest.fixture(scope="session")
def small_scene_file(tmp_path_factory):
    """The Diamond on its coarsest mesh."""
    scene = entries_of(ROOT / "config/scenes/diamond.yaml",
                       {"body.mesh.file": str(ROOT / "meshes/diamond_400.vtk"), "body.element": "linear"})
    return yaml_file(tmp_path_factory.mktemp("scenes") / "small_diamond.yaml", scene)


@pytest.fixture(scope="session")
def posed_scene_file(small_scene_file):
    """The same, whose tip has a height and an axis that points."""
    scene = yaml.safe_load(small_scene_file.read_text())
    markers = {marker["id"]: marker["point"] for marker in scene["markers"]}
    patch = [markers[marker] for marker in (4, 5, 6, 7)]
    scene["effectors"][0] |= {
        "orientation": {"pointing": [0.0, 0.0, 1.0], "points": patch}, "directions": ["z"],
    }  # fmt: skip
    return yaml_file(small_scene_file.with_name("posed_diamond.yaml"), scene)


class World:
    """A separate ROS context with an executor, and functions for tests."""

    def __init__(self, domain_id):
        self.context = Context()
        rclpy.init(
            context=self.context, domain_id=domain_id,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.executor = SingleThreadedExecutor(context=self.context)
        self.nodes = []
        self.probe = self.add(rclpy.create_node, "probe")

    def add(self, node_class, *arguments, **parameters):
        """Makes a node with these parameters in the executor of this world."""
        made = getattr(node_class, "func", node_class)
        if made is TwinNode:  # a second process for each twin would slow down all tests
            parameters.setdefault("mesh_error", False)
        if made in (TwinNode, DeviceNode):  # on a busy machine messages come late
            parameters.setdefault("message_timeout", 3.0)
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        keywords = {"parameter_overrides": overrides} if overrides else {}
        node = node_class(*arguments, context=self.context, **keywords)
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def until(self, condition, timeout=30.0):
        """Runs until a condition holds; fails after a timeout."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, "it did not happen"
            self.executor.spin_once(0.02)

    def run(self, seconds):
        """Runs for a while."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(0.02)

    def ticks_of(self, node):
        """Stops a node's timer; returns a function that runs a tick one period after the last one.

        Rates hold for the time on the clock: ticks in a row on the machine's clock would move an
        actuator by the time that a tick takes, and no test could tell how far.
        """
        node.stop()
        period = node.tick_clock.period
        times = [node.monotonic()]
        node.tick_clock = TickClock(period, lambda: times[-1])

        def tick():
            times.append(times[-1] + period)
            node.tick()

        return tick

    def hear(self, kind, topic, quality=10):
        """A list to which every received message is appended."""
        heard = []
        self.probe.create_subscription(kind, topic, heard.append, quality)
        return heard

    def speaker(self, kind, topic, quality=1):
        """A publisher that has a subscriber."""
        publisher = self.probe.create_publisher(kind, topic, quality)
        self.until(lambda: publisher.get_subscription_count() > 0)
        return publisher

    def ask(self, kind, name, request):
        """Answer of a service."""
        client = self.probe.create_client(kind, name)
        self.until(client.service_is_ready)
        future = client.call_async(request)
        self.until(future.done)
        return future.result()

    def enable(self, data=True):
        """Answer of the twin to its enabling, or disabling."""
        return self.ask(SetBool, "/twin/enable", SetBool.Request(data=data))

    def target_message(self, position, seconds_ago=0.0, frame_id="base_link"):
        """A target at a position [m], shape (3,)."""
        x, y, z = position
        header = Header(stamp=self.stamp(seconds_ago), frame_id=frame_id)
        return PointStamped(header=header, point=Point(x=x, y=y, z=z))

    def pose_target(self, position, quaternion, seconds_ago=0.0, frame_id="base_link"):
        """A target at a position [m], shape (3,), with an orientation (x, y, z, w)."""
        header = Header(stamp=self.stamp(seconds_ago), frame_id=frame_id)
        return pose_message(position, quaternion, header)

    def stamp(self, seconds_ago=0.0):
        """The present time, or an earlier one, as a message stamp."""
        return (self.probe.get_clock().now() - Duration(seconds=seconds_ago)).to_msg()

    def close(self):
        self.executor.shutdown()
        for node in self.nodes:
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@builder
def make_twin(world, small_scene_file, /, **parameters):
    """Makes a twin of the small Diamond in the world."""
    defaults = {"scene_file": str(small_scene_file), "rate": 50.0}
    return world.add(TwinNode, **{**defaults, **parameters})


@pytest.fixture
def world(ros_domain_id):
    world = World(ros_domain_id)
    yield world
    world.close()


class Account(NamedTuple):
    """One diagnostics status of the twin."""

    level: bytes
    message: str
    values: dict[str, str]


class Diagnostics:
    """Receives the twin's diagnostics.

    Attributes:
        messages: All that came.
    """

    def __init__(self, world):
        self._world = world
        self.messages = world.hear(DiagnosticArray, "/diagnostics")

    def __call__(self, part, condition=lambda account: True, timeout=30.0):
        """The next status of a part that satisfies a condition."""
        first, found = len(self.messages), []

        def is_found():
            for message in self.messages[first:]:
                found.extend(status for status in statuses(message, part) if condition(status))
            return found

        self._world.until(is_found, timeout)
        return found[0]


def statuses(message, part):
    """Statuses of a part in a message."""
    for status in message.status:
        if status.name == f"twin: {part}":
            values = {pair.key: pair.value for pair in status.values}
            yield Account(status.level, status.message, values)


@pytest.fixture
def diagnostics(world, monkeypatch):
    """The twin's diagnostics, five times a second: nobody waits a second for each."""
    monkeypatch.setattr(twin_node, "DIAGNOSTICS_PERIOD", 0.2)
    return Diagnostics(world)
