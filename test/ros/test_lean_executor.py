"""The executor of the nodes calls what rclpy's calls."""

import time

import pytest
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from softrobot_twin.ros.lean_executor import LeanExecutor


@pytest.fixture
def node(world):
    """A node in an executor of this kind."""
    made = rclpy.create_node("lean", context=world.context)
    executor = LeanExecutor(context=world.context)
    executor.add_node(made)
    yield made
    executor.shutdown()
    made.destroy_node()


def until(world, node, condition, timeout=20.0):
    """Runs both executors until a condition holds."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        node.executor.spin_once(0.01)
        world.executor.spin_once(0.0)


def test_messages_requests_and_timers_are_served_and_destroyed_ones_are_not(world, node):
    heard, ticks = [], []
    subscription = node.create_subscription(Float64MultiArray, "/numbers", heard.append, 1)
    node.create_subscription(Float64MultiArray, "/numbers", lambda message, info: heard.append(info), 1)
    timer = node.create_timer(0.01, lambda: ticks.append(time.monotonic()))
    node.create_service(Trigger, "/ask", lambda request, response: Trigger.Response(success=True))
    publisher = world.probe.create_publisher(Float64MultiArray, "/numbers", 1)
    until(world, node, lambda: publisher.get_subscription_count() == 2)
    publisher.publish(Float64MultiArray(data=[1.0]))
    until(world, node, lambda: len(heard) == 2)
    assert Float64MultiArray(data=[1.0]) in heard
    assert any(isinstance(one, dict) and "source_timestamp" in one for one in heard)
    client = world.probe.create_client(Trigger, "/ask")
    until(world, node, client.service_is_ready)
    future = client.call_async(Trigger.Request())
    until(world, node, future.done)
    assert future.result().success
    until(world, node, lambda: len(ticks) > 2)
    timer.cancel()
    count = len(ticks)
    node.destroy_subscription(subscription)
    publisher.publish(Float64MultiArray())
    until(world, node, lambda: len(heard) == 3)
    assert len(ticks) == count


def test_events_of_publishers_are_still_told(world, node, monkeypatch):
    told = []
    publisher = node.create_publisher(
        Float64MultiArray, "/numbers", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    for event in publisher.event_handlers:
        monkeypatch.setattr(event, "callback", told.append)
    world.hear(Float64MultiArray, "/numbers")  # It asks for reliable messages.
    until(world, node, lambda: told)


def test_an_error_in_a_callback_is_raised_and_a_node_with_a_client_is_served_by_rclpy(world, node):
    def fail():
        raise ArithmeticError("in a callback")

    node.create_timer(0.01, fail)
    with pytest.raises(ArithmeticError):
        until(world, node, lambda: False)
    node.create_client(Trigger, "/nobody")
    with pytest.raises(ArithmeticError):
        until(world, node, lambda: False)


def test_a_context_that_was_shut_down_ends_the_spinning(world, node):
    node.executor.spin_once(0.0)
    rclpy.shutdown(context=world.context)
    with pytest.raises((ExternalShutdownException, RuntimeError)):
        node.executor.spin_once(0.1)


def test_a_callback_that_always_fails_keeps_no_other_from_its_turn(world, node):
    ticks, heard = [], []

    def fail(message):
        heard.append(message)
        raise OverflowError("a defect")

    def refuse(request, response):
        raise TypeError("a \x1b[31mdefect")

    for topic in ("/first", "/second"):
        node.create_subscription(Float64MultiArray, topic, fail, 10)
    node.create_timer(0.01, lambda: ticks.append(len(heard)))
    node.create_service(Trigger, "/ask", refuse)
    publishers = [world.probe.create_publisher(Float64MultiArray, topic, 10)
                  for topic in ("/first", "/second")]
    client = world.probe.create_client(Trigger, "/ask")
    until(world, node, lambda: all(one.get_subscription_count() for one in publishers)
          and client.service_is_ready())
    failures = []

    def spin(condition):
        end = time.monotonic() + 20.0
        while not condition():
            assert time.monotonic() < end, "it did not happen"
            for publisher in publishers:
                publisher.publish(Float64MultiArray())
            world.executor.spin_once(0.0)
            try:
                node.executor.spin_once(0.05)
            except Exception as found:  # noqa: BLE001 - of one callback, or a group
                failures.extend(getattr(found, "exceptions", (found,)))

    # There is always a message before the timer, whose turn comes all the same.
    spin(lambda: len(heard) > 20 and len(set(ticks)) > 5)
    assert all(isinstance(one, OverflowError) for one in failures)
    future = client.call_async(Trigger.Request())
    spin(future.done)
    assert (future.result().success, future.result().message) == (
        False, "failed: TypeError: a \\x1b[31mdefect")
