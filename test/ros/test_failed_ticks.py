"""An exception in a tick ends no node: it is told, and the last safe command is repeated."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.ros.topics import LATCHED
from softrobot_twin.ros.twin_node import TwinNode

BEYOND_2038 = 2**31 * 10**9


@pytest.fixture
def twin(world, small_scene_file, monkeypatch):
    """A twin without a device whose ticks are done by hand, after its first one.

    Each tick asks who listens, so that one without a publisher fails.
    """
    monkeypatch.setattr("softrobot_twin.ros.audience.PERIOD", 0.0)
    twin = world.add(TwinNode, scene_file=str(small_scene_file), rate=50.0)
    twin.stop()
    twin.tick()
    return twin


def break_effectors(twin, monkeypatch):
    """Destroys the publisher of the effector."""
    effectors = next(one for one in twin.publishers if "/effectors/" in one.topic_name)
    twin.destroy_publisher(effectors)


def break_step(twin, monkeypatch):
    """Lets each step raise an exception."""
    monkeypatch.setattr(twin.loop.simulation, "step", lambda *_: 1 / 0)


def break_diagnostics(twin, monkeypatch):
    """Lets the diagnostics raise an exception in each tick."""
    monkeypatch.setattr("softrobot_twin.ros.twin_node.DIAGNOSTICS_PERIOD", -math.inf)
    twin.request_diagnostics()
    monkeypatch.setattr(twin.diagnostics, "statuses", lambda now: {}["of the diagnostics"])


@pytest.mark.parametrize("spoil", (break_effectors, break_step, break_diagnostics))
def test_three_failed_ticks_disable_with_the_reason(world, twin, monkeypatch, spoil):
    cables = world.hear(JointState, "/twin/cables")
    states = world.hear(DiagnosticStatus, "/twin/status", LATCHED)
    world.until(lambda: states and twin.count_subscribers("/twin/cables"))
    before = twin.loop.last_command.setpoints.copy()
    with monkeypatch.context() as patch:
        spoil(twin, patch)
        for count in (1, 2):
            twin.tick()
            assert (twin.failures_in_a_row, twin.loop.is_enabled) == (count, True)
        world.until(lambda: cables and states[-1].level == DiagnosticStatus.ERROR)
        assert np.array(cables[-1].position) == pytest.approx(before)
        assert "a tick failed" in states[-1].message
        twin.tick()
        assert not twin.loop.is_enabled
        assert twin.loop.why_given_up == f"3 ticks in a row failed: {twin.failure}"
        world.until(lambda: "3 ticks in a row failed" in states[-1].message)
        twin.tick()
    if spoil is not break_effectors:
        twin.tick()
        assert twin.failures_in_a_row == 0
        assert world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success
        cables.clear()
        twin.tick()
        world.until(lambda: cables)
        assert np.array(cables[-1].position) == pytest.approx(before)


def test_a_single_failed_tick_changes_no_command(world, twin, monkeypatch):
    with monkeypatch.context() as patch:
        break_step(twin, patch)
        twin.tick()
    twin.tick()
    assert twin.failures_in_a_row == 0 and twin.failed_ticks == 1 and twin.loop.is_enabled


def far_future(node, monkeypatch):
    """Lets the node's clock tell a time that no message can hold."""
    monkeypatch.setattr(node, "ros_time", lambda: BEYOND_2038)


def test_a_stamp_beyond_2038_ends_no_node(world, twin, small_scene_file, monkeypatch):
    device = world.add(DeviceNode, device_scene_file=str(small_scene_file))
    target = world.add(TargetNode, scene_file=str(small_scene_file), target_center=[0.0, 0.0, 0.134])
    world.hear(PointStamped, "/twin/effectors/tip")  # A message with a stamp, also while disabled.
    while target.began == math.inf:
        twin.tick()
        world.run(0.05)
    for node in (twin, device, target):
        node.stop()
        with monkeypatch.context() as patch:
            far_future(node, patch)
            for _ in range(4):
                node.tick()
        assert node.failed_ticks >= 4, node.get_name()
        node.tick()
        assert node.failures_in_a_row == 0
    assert "3 ticks in a row failed" in twin.loop.why_given_up
