"""The Grasper's twin and device as nodes: motor, poses, contacts."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import SetBool

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.messages import contacts_message
from softrobot_twin.ros.topics import STREAM
from softrobot_twin.ros.twin_node import TwinNode
from softrobot_twin.view.recording import CAN_SERVE
from test.builder import builder

CONFIG = Path(__file__).resolve().parents[2] / "config"
GIVEN = yaml.safe_load((CONFIG / "grasper.yaml").read_text())["/**"]["ros__parameters"]
GRIP = 0.015


@builder
def make_grasper(world, /, **changes):
    """Makes the Grasper's twin from its parameter file, some of them replaced."""
    twin = world.add(TwinNode, **{**GIVEN, **changes})
    return twin


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


def run_ticks(world, tick, count):
    """Runs ticks without waiting, and receives messages between them."""
    for number in range(count):
        tick()
        if number % 10 == 0:
            world.executor.spin_once(0.0)


@pytest.mark.exhaustive
def test_a_motor_closes_the_fingers_and_a_pose_lifts_palm_and_cube(world, make_grasper):
    twin = make_grasper(rate=100.0)
    tick = world.ticks_of(twin)
    cube = world.hear(PoseStamped, "/twin/bodies/cube")
    palm = world.hear(PoseStamped, "/twin/poses/palm")
    cables = world.hear(JointState, "/twin/cables")
    contacts = world.hear(PointCloud2, "/twin/contacts", STREAM)
    commands = world.speaker(JointState, "/twin/command/cables")
    poses = world.speaker(PoseStamped, "/twin/command/pose/palm")
    rest = twin.loop.simulation.rest_setpoints
    commands.publish(grip_message(world, position=[float(rest[0] - GRIP)]))
    world.until(lambda: np.isfinite(twin.loop.direct.age(twin.monotonic())))
    run_ticks(world, tick, 150)
    world.until(lambda: cables and np.allclose(cables[-1].position, rest - GRIP, atol=1e-6))
    closed = height(cube)
    poses.publish(pose_message(world, (0.0, 0.0, 0.05)))
    world.until(lambda: twin.loop.poses.newest)
    run_ticks(world, tick, 130)
    world.until(lambda: abs(height(palm) - 0.05) < 1e-6)
    world.until(lambda: abs(height(cube) - closed - 0.05) < 2e-3)
    orientation = cube[-1].pose.orientation
    turned = 2.0 * math.atan2(orientation.z, orientation.w)
    assert turned == pytest.approx(math.pi / 4, abs=0.2)
    assert cube[-1].header.frame_id == "base_link"
    fields = [field.name for field in contacts[-1].fields]
    assert fields == ["x", "y", "z", "fx", "fy", "fz"]

    def forces():
        return np.frombuffer(contacts[-1].data, np.float32).reshape(-1, 6)[:, 3:]

    # Only the fingers carry the cube of 30 g now, by friction; the message of the last tick may
    # still be on its way.
    world.until(lambda: forces()[:, 2].sum() == pytest.approx(-0.2943, abs=0.02))
    assert len(forces()) >= 3


def test_a_motor_s_effort_is_the_tension_of_each_of_its_cables(world, make_grasper):
    twin = make_grasper(rate=100.0)
    tick = world.ticks_of(twin)
    cables = world.hear(JointState, "/twin/cables")
    commands = world.speaker(JointState, "/twin/command/cables")
    commands.publish(grip_message(world, effort=[0.4]))
    world.until(lambda: twin.loop.direct.efforts is not None)
    run_ticks(world, tick, 100)
    world.until(lambda: cables and np.allclose(cables[-1].effort, 0.4, atol=1e-3))
    assert cables[-1].name == ["cable_0", "cable_1", "cable_2"]


def test_invalid_poses_and_lengths_are_refused_counted_and_move_nothing(
    world, make_grasper, diagnostics
):
    twin = make_grasper(rate=50.0)
    commands = world.speaker(JointState, "/twin/command/cables")
    poses = world.speaker(PoseStamped, "/twin/command/pose/palm")
    bad = {
        Refusal.NOT_FINITE: pose_message(world, (math.nan, 0.0, 0.05)),
        Refusal.NO_ROTATION: pose_message(world, (0.0, 0.0, 0.05), (0.0, 0.0, 0.0, 0.0)),
        Refusal.WRONG_FRAME: pose_message(world, (0.0, 0.0, 0.05), frame_id="map"),
    }
    for refusal, message in bad.items():
        poses.publish(message)
        world.until(lambda refusal=refusal: twin.loop.poses.refusals.of(refusal) == 1)
    for refusal, message in {
        Refusal.NOT_FINITE: grip_message(world, position=[math.inf]),
        Refusal.WRONG_NAMES: JointState(name=["grip", "cable_0"], position=[0.1, 0.1]),
        Refusal.WRONG_SIZE: grip_message(world, position=[0.1, 0.1]),
    }.items():
        commands.publish(message)
        world.until(lambda refusal=refusal: twin.loop.direct.refusals.of(refusal) == 1)
    account = diagnostics("target", lambda account: account.values.get("refused") == "6")
    assert account.values["refused_not_finite"] == "2"
    (palm, _), _ = twin.loop.simulation.rigid_poses()
    assert palm.tolist() == [0.0, 0.0, 0.0]
    simulation = twin.loop.simulation
    assert simulation.state.setpoints == pytest.approx(simulation.rest_setpoints)


def test_diagnostics_report_contacts_and_their_accuracy(world, make_grasper, diagnostics):
    make_grasper(rate=50.0)
    account = diagnostics("contact", lambda account: account.values.get("count", "0") != "0")
    assert int(account.values["count"]) >= 3
    assert float(account.values["residual_mm"]) <= 1e-5
    assert {"sweeps_max", "force_residual_n", "overlap_max_mm", "count_max"} <= set(account.values)
    assert account.message.startswith("contacts: ")


@pytest.mark.skipif(not CAN_SERVE, reason="this rerun cannot read its files")
def test_a_recording_shows_fingers_rigid_bodies_floor_and_contacts(world, make_grasper, tmp_path):
    file = tmp_path / "run.rrd"
    twin = make_grasper(rate=100.0, record_file=str(file), record_every=1, view_every=1)
    twin.stop()
    for _ in range(5):
        twin.tick()
        world.until(lambda: twin.feed.mirror.frames_logged == twin.tick_clock.ticks)
    position = twin.loop.simulation.rigid_poses()[0][1]
    twin.destroy_node()
    from rerun.chunk import RrdReader

    chunks = RrdReader(file).stream().to_chunks()
    entities = {chunk.entity_path for chunk in chunks}
    assert {"/robot/surface/finger_0", "/robot/surface/finger_2", "/rigid_bodies/palm",
            "/rigid_bodies/cube", "/obstacles/floor", "/contacts/forces",
            "/contacts/points"} <= entities
    placed = [chunk.to_record_batch() for chunk in chunks
              if chunk.entity_path == "/rigid_bodies/cube" and not chunk.is_static]
    rows = {step: cell for batch in placed for step, cell in zip(
        batch.column("step").to_pylist(),
        batch.column("Transform3D:translation").to_pylist())}
    assert rows[max(rows)][0] == pytest.approx(position, abs=1e-7)


def test_a_scene_without_rigid_bodies_has_no_topics_for_them(world, make_twin):
    twin = make_twin(mode="direct")
    names = [name for name, _ in twin.get_publisher_names_and_types_by_node("twin", "/")]
    assert "/twin/cables" in names
    assert not [name for name in names if "bodies" in name or "poses" in name or "contact" in name]


def test_without_contacts_the_message_has_no_points():
    message = contacts_message(np.empty((0, 3)), np.empty((0, 3)), Header())
    assert message.width == 0 and len(message.data) == 0 and message.point_step == 24


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
    world.until(lambda: measured and np.allclose(measured[-1].position, rest - 0.004, atol=1e-4),
                20.0)
    world.until(lambda: abs(height(palm) - 0.02) < 1e-4, 20.0)
    assert height(cube) == pytest.approx(-0.104, abs=1e-4)
    assert device.poses.refusals.total == 0
