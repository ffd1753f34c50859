"""Targets with orientation as messages: real rclpy, the small Diamond whose tip points."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped

from softrobot_twin.ros.messages import read_pose
from softrobot_twin.ros.target_node import TargetNode

HEIGHT, TILT = 0.134, math.radians(6.0)
TURN = (math.sin(0.5 * TILT), 0.0, 0.0, math.cos(0.5 * TILT))
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def twin(make_twin, posed_scene_file):
    return make_twin(scene_file=str(posed_scene_file))


def direction(message):
    """Where the tip points, by a pose message, shape (3,)."""
    x, y, z, w = read_pose(message)[1]
    return np.array([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])


def angle(message):
    """Angle between where the tip points and where it is to [rad]."""
    wanted = np.array([0.0, -math.sin(TILT), math.cos(TILT)])
    return math.atan2(np.linalg.norm(np.cross(direction(message), wanted)), direction(message) @ wanted)


def test_a_target_pose_moves_and_turns_the_effector(world, twin):
    poses = world.hear(PoseStamped, "/twin/effector_poses/tip")
    places = world.hear(PointStamped, "/twin/effectors/tip")
    targets = world.speaker(PoseStamped, "/twin/target_pose/tip")
    world.until(lambda: poses and places)
    assert read_pose(poses[-1])[1] == pytest.approx(UPRIGHT, abs=1e-3)
    targets.publish(world.pose_target((0.0, 0.0, HEIGHT), TURN))
    world.until(lambda: angle(poses[-1]) < math.radians(0.1)
                and abs(poses[-1].pose.position.z - HEIGHT) < 2e-4)
    assert poses[-1].header.frame_id == "base_link"
    assert np.linalg.norm(read_pose(poses[-1])[1]) == pytest.approx(1.0)


def test_diagnostics_tell_the_error_of_the_orientation(world, twin, diagnostics):
    targets = world.speaker(PoseStamped, "/twin/target_pose/tip")
    targets.publish(world.pose_target((0.0, 0.0, HEIGHT), TURN))
    world.until(lambda: twin.loop.targets.age(twin.monotonic()) < 10.0)
    account = diagnostics("target", lambda account: float(account.values["orientation_error_deg"]) < 0.1)
    assert account.values["source"] == "pose"


def test_the_target_node_publishes_poses_along_a_path_with_quaternions(world, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("time_s,tip_x_m,tip_y_m,tip_z_m,tip_qx,tip_qy,tip_qz,tip_qw\n"
                    f"0,0,0,0.13,0,0,0,1\n0.5,0,0,{HEIGHT},{TURN[0]},0,0,{TURN[3]}\n")
    world.add(TargetNode, target_path=str(file), target_ramp_time=1.0, target_rate=50.0)
    targets = world.hear(PoseStamped, "/twin/target_pose/tip", 100)
    start = world.speaker(PoseStamped, "/twin/effector_poses/tip")
    world.run(0.2)
    assert not targets
    start.publish(world.pose_target((0.0, 0.0, 0.125), UPRIGHT))
    # The ramp has ended when two targets are the same.
    world.until(lambda: targets and targets[-1].pose.position.z > HEIGHT - 1e-6
                and targets[-1].pose == targets[-2].pose)
    assert read_pose(targets[0])[0] == pytest.approx((0.0, 0.0, 0.125), abs=2e-3)
    assert read_pose(targets[-1])[1] == pytest.approx(TURN, abs=1e-9)
    turned = [2.0 * math.asin(read_pose(target)[1][0]) for target in targets]
    assert turned == sorted(turned)
