"""Two nodes or publishers of one name are reported within a second, and enabling is refused."""

import pytest
from geometry_msgs.msg import PointStamped, Twist
from sensor_msgs.msg import JointState, PointCloud2

from softrobot_twin.ros.device_node import DeviceNode

OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"


def test_a_twin_alone_on_its_topics_reports_it(world, make_twin, diagnostics):
    make_twin()
    graph = diagnostics("graph")
    assert graph.level == OK and graph.message == "no other publisher on its topics"


@pytest.mark.parametrize("kind, topic, level", [
    (JointState, "/twin/measured_cables", ERROR),
    (PointCloud2, "/twin/markers", ERROR),
    (PointStamped, "/twin/target/tip", WARN),
    (Twist, "/twin/target_velocity", WARN),
    (JointState, "/twin/command/cables", WARN),
])  # fmt: skip
def test_a_second_publisher_is_reported_and_keeps_the_twin_disabled(
    world, make_twin, diagnostics, kind, topic, level
):
    twin = make_twin()
    assert world.enable(False).success
    first = world.speaker(kind, topic)
    assert world.enable().success
    assert world.enable(False).success
    second = world.speaker(kind, topic)
    graph = diagnostics("graph", lambda status: status.level != OK)
    assert graph.level == level
    assert f"2 publishers on {topic} (/probe, /probe)" in graph.message
    answer = world.enable()
    assert not answer.success and topic in answer.message and "end all but one" in answer.message
    assert not twin.loop.is_enabled
    world.probe.destroy_publisher(second)
    diagnostics("graph", lambda status: status.level == OK)
    assert world.enable().success
    world.probe.destroy_publisher(first)


def test_two_twins_of_one_name_are_reported_by_both(world, make_twin, diagnostics):
    twins = [make_twin(), make_twin()]
    graph = diagnostics("graph", lambda status: "2 nodes are called /twin" in status.message)
    assert graph.level == ERROR and "publishers on /twin/cables" in graph.message
    world.until(lambda: all(twin.clashes for twin in twins))
    assert world.enable(False).success
    world.until(lambda: not all(twin.loop.is_enabled for twin in twins))
    # Only one of them received the request; twins without a device are always enabled.
    world.until(lambda: "2 nodes are called /twin" in world.enable().message)


def test_two_devices_on_one_topic_are_reported_by_both(world, make_twin, small_scene_file):
    twin = make_twin(use_device=True)
    devices = [world.add(DeviceNode, device_scene_file=str(small_scene_file)) for _ in range(2)]
    world.until(lambda: all("name" in {clash.key for clash in device.clashes}
                            and "/twin/measured_cables" in {clash.key for clash in device.clashes}
                            for device in devices))
    world.until(lambda: twin.loop.device.setpoints is not None)
    answer = world.enable()
    assert not answer.success and "2 publishers on /twin/measured_cables" in answer.message
