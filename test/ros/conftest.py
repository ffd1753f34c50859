"""Real rclpy without launch: nodes, publishers and clients in one context and one executor."""

import time
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def small_scene_file(tmp_path_factory):
    """The Diamond on its coarsest mesh."""
    scene = yaml.safe_load((ROOT / "config/scenes/diamond.yaml").read_text())
    scene["body"]["mesh"]["file"] = str(ROOT / "meshes/diamond_400.vtk")
    file = tmp_path_factory.mktemp("scenes") / "small_diamond.yaml"
    file.write_text(yaml.safe_dump(scene))
    return file


class World:
    """A ROS of its own, with what a test needs of it."""

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
        """Makes a node with these parameters; it runs whenever the world does."""
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        keywords = {"parameter_overrides": overrides} if overrides else {}
        node = node_class(*arguments, context=self.context, **keywords)
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def until(self, condition, timeout=10.0):
        """Runs until something is so; fails when it does not become so."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, "it did not happen"
            self.executor.spin_once(0.02)

    def run(self, seconds):
        """Runs for a while."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(0.02)

    def hear(self, kind, topic, quality=10):
        """A list that grows with every message."""
        heard = []
        self.probe.create_subscription(kind, topic, heard.append, quality)
        return heard

    def speaker(self, kind, topic, quality=1):
        """A publisher that somebody listens to."""
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

    def stamp(self, seconds_ago=0.0):
        """This moment, or one before it, as a message has it."""
        from rclpy.duration import Duration

        return (self.probe.get_clock().now() - Duration(seconds=seconds_ago)).to_msg()

    def close(self):
        self.executor.shutdown()
        for node in self.nodes:
            node.destroy_node()
        rclpy.try_shutdown(context=self.context)


@pytest.fixture
def world(ros_domain_id):
    world = World(ros_domain_id)
    yield world
    world.close()
