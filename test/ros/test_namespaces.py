"""Two robots at once in one domain: every name of a node is below its namespace."""

from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_srvs.srv import SetBool

from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.ros.topics import LATCHED, NEWEST
from softrobot_twin.ros.twin_node import TwinNode

SIDES = ("left", "right")
SHARED = ("/rosout", "/parameter_events", "/clock", "/diagnostics", "/tf")


@pytest.fixture
def two_robots(world, small_scene_file):
    """A twin, a device and a target on each side, by side and name."""
    file, found = str(small_scene_file), {}
    for side in SIDES:
        # As on a command line: -r __ns:=/lab/left.
        space = {"cli_args": ["--ros-args", "-r", f"__ns:=/lab/{side}"]}
        frame = f"{side}/base_link"
        found[side, "twin"] = world.add(
            partial(TwinNode, **space), scene_file=file, rate=20.0, use_device=True,
            mesh_error=False, frame_id=frame, tf_prefix=f"{side}/",
        )  # fmt: skip
        found[side, "device"] = world.add(
            partial(DeviceNode, **space), device_scene_file=file, frame_id=frame,
            device_rate=20.0, device_delay=0.0, device_marker_noise=0.0,
        )  # fmt: skip
    return found


def test_every_topic_and_service_of_a_robot_is_below_its_namespace(world, two_robots):
    world.add(partial(TargetNode, cli_args=["--ros-args", "-r", "__ns:=/lab/left"]),
              frame_id="left/base_link", target_center=[0.0, 0.0, 0.13])  # fmt: skip
    node = two_robots["left", "twin"]

    def counts(side):
        """Ends of its topics that the node has discovered."""
        cables, others = f"/lab/{side}/twin/cables", ("markers", "target/tip")
        return [node.count_publishers(cables), node.count_subscribers(cables),
                *(node.count_publishers(f"/lab/{side}/twin/{name}") for name in others)]

    # The parameter `twin` is relative, and finds the twin beside its node.
    world.until(lambda: counts("left") == [1, 1, 1, 1] and counts("right") == [1, 1, 1, 0])
    for name, _ in node.get_topic_names_and_types():
        assert name in SHARED or name.startswith(("/lab/left/", "/lab/right/")), name
    for name, _ in node.get_service_names_and_types():
        assert name.startswith(("/lab/", "/probe/")), name


def test_two_robots_follow_their_own_targets(world, two_robots):
    tips = {side: world.hear(PointStamped, f"/lab/{side}/twin/effectors/tip", 10) for side in SIDES}
    statuses = {side: world.hear(DiagnosticStatus, f"/lab/{side}/twin/status", LATCHED)
                for side in SIDES}  # fmt: skip
    diagnostics = world.hear(DiagnosticArray, "/diagnostics", 10)
    speakers = {side: world.speaker(PointStamped, f"/lab/{side}/twin/target/tip", NEWEST)
                for side in SIDES}  # fmt: skip
    for side in SIDES:
        service = f"/lab/{side}/twin/enable"
        world.until(lambda service=service: world.ask(SetBool, service, SetBool.Request(data=True)).success)
    rest = {side: two_robots[side, "twin"].loop.simulation.effector_positions()[0]
            for side in SIDES}  # fmt: skip
    wanted = {"left": rest["left"] + [0.004, 0.0, 0.002], "right": rest["right"] + [-0.004, 0.0, 0.002]}

    def have_moved():
        for side in SIDES:
            message = world.target_message(wanted[side], frame_id=f"{side}/base_link")
            speakers[side].publish(message)
        world.run(0.05)
        moves = [tips[side][-1].point.x - rest[side][0] if tips[side] else 0.0 for side in SIDES]
        return moves[0] > 3e-3 and moves[1] < -3e-3

    world.until(have_moved, 30.0)
    for side in SIDES:
        assert tips[side][-1].header.frame_id == f"{side}/base_link"
        assert statuses[side][-1].name == f"lab/{side}/twin: status"
        # The device moved to where its own twin sent it.
        device = two_robots[side, "device"]
        world.until(lambda device=device: np.ptp(device.device.read(device.monotonic()).setpoints) > 1e-3)
    assert not two_robots["left", "twin"].clashes
    world.until(lambda: {"lab/left/twin: solver", "lab/right/twin: solver"} <= {
        status.name for message in diagnostics for status in message.status})  # fmt: skip


def test_the_twin_of_a_full_name_is_found_from_every_namespace(world):
    node = world.add(
        partial(TargetNode, cli_args=["--ros-args", "-r", "__ns:=/elsewhere"]),
        twin="/lab/left/twin", target_center=[0.0, 0.0, 0.13],
    )  # fmt: skip
    world.until(lambda: node.count_publishers("/lab/left/twin/target/tip") == 1)
