"""The target as a node."""

import math

import numpy as np
import pytest
from geometry_msgs.msg import Point, PointStamped, PoseStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.simulation import Simulation
from softrobot_twin.tables.input_tables import TableFileError
from test.builder import builder
from test.places import CONFIG

CENTRE = [0.0, 0.0, 0.13]


@builder
def make_target(world, /, **parameters):
    defaults = {"target_center": CENTRE, "target_radius": 0.02, "target_period": 2.0,
                "target_ramp_time": 0.5, "target_rate": 100.0}
    return world.add(TargetNode, **{**defaults, **parameters})


def heard_from(world, position):
    """The messages of the target after it received the effector's position."""
    targets = world.hear(PointStamped, "/twin/target/tip", 100)
    effectors = world.speaker(PointStamped, "/twin/effectors/tip")
    world.run(0.2)
    assert not targets, "it must wait for the effector"
    x, y, z = position
    effectors.publish(
        PointStamped(header=Header(stamp=world.stamp(), frame_id="base_link"),
                     point=Point(x=x, y=y, z=z))
    )
    return targets


def seconds_of(stamp):
    return stamp.sec + 1e-9 * stamp.nanosec


def places(targets):
    return np.array([[m.point.x, m.point.y, m.point.z] for m in targets])


def test_the_target_starts_at_the_effector_and_reaches_its_path(world, make_target):
    make_target()
    start = (0.001, 0.002, 0.125)
    targets = heard_from(world, start)
    began = seconds_of(world.stamp())
    world.until(lambda: len(targets) > 100)
    path = places(targets)
    # On a busy machine the first one comes late.
    late = max(0.0, seconds_of(targets[0].header.stamp) - began)
    assert math.dist(path[0], start) < 1e-3 + 0.15 * late
    assert np.linalg.norm(path[-1] - CENTRE) == pytest.approx(0.02)
    assert targets[-1].header.frame_id == "base_link"
    times = np.array([seconds_of(message.header.stamp) for message in targets])
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert (steps < 0.15 * np.diff(times) + 1e-3).all()


def test_a_file_of_targets_is_played(world, make_target, tmp_path):
    file = tmp_path / "path.csv"
    file.write_text("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0.13\n0.2,0.01,0,0.13\n")
    make_target(target_path=str(file), target_ramp_time=0.0)
    targets = heard_from(world, (0.0, 0.0, 0.125))
    world.until(lambda: len(targets) > 40)
    assert places(targets)[-1] == pytest.approx([0.01, 0.0, 0.13])


def test_an_actuator_is_commanded_to_and_fro_beside_the_targets(world, make_target):
    make_target(target_actuator="grip", target_setpoints=[0.9, 0.8], target_setpoint_period=0.5)
    commands = world.hear(JointState, "/twin/command/cables", 100)
    targets = heard_from(world, (0.001, 0.002, 0.125))
    world.until(lambda: len(commands) > 60)
    assert targets and {tuple(message.name) for message in commands} == {("grip",)}
    values = np.array([message.position[0] for message in commands])
    assert values.min() >= 0.8 and values.max() <= 0.9 and np.ptp(values) > 0.05
    assert all(not message.effort for message in commands)


# --- commands that are played ----------------------------------------------------------------

GRASPER = CONFIG / "scenes" / "grasper.yaml"


def table_of(folder, *rows):
    file = folder / "commands.csv"
    header = "time_s,grip_shortening_m,palm_x_m,palm_y_m,palm_z_m"
    file.write_text("\n".join([header, *rows]) + "\n")
    return {"scene_file": str(GRASPER), "target_commands": str(file), "target_effector": "cube"}


def test_a_table_of_commands_is_played_over_and_over_and_no_targets(world, make_target, tmp_path):
    given = table_of(tmp_path, "0.0,0.0,0,0,0", "0.5,0.01,0,0,0.02", "1.0,0.0,0,0,0")
    target = make_target(**given)
    commands = world.hear(JointState, "/twin/command/cables", 1000)
    poses = world.hear(PoseStamped, "/twin/command/pose/palm", 1000)
    effectors = world.speaker(PointStamped, "/twin/effectors/cube")
    world.run(0.3)
    assert not commands and not poses, "it must wait for the twin"
    effectors.publish(PointStamped(header=Header(stamp=world.stamp(), frame_id="base_link")))
    rest = Simulation.from_scene_file(GRASPER).rest_setpoints

    def windings():
        return rest - np.array([message.position for message in commands]).reshape(-1, len(rest))

    def pairs():
        """Length wound and height of the palm of each command that has both."""
        heights = {stamp_of(message): message.pose.position.z for message in poses}
        return np.array([
            (winding, heights[stamp_of(message)])
            for winding, message in zip(windings()[:, 0], commands, strict=True)
            if stamp_of(message) in heights
        ])

    # No times: on a busy machine ticks are late.
    world.until(lambda: peaks(windings()[:, 0], 0.002, 0.008) >= 2 and len(pairs()) > 20, 30.0)
    assert not [name for name, _ in target.get_publisher_names_and_types_by_node("target", "/")
                if "/target/" in name]
    wound = windings()
    assert set(map(tuple, (message.name for message in commands))) == {
        ("cable_0", "cable_1", "cable_2")}
    assert np.ptp(wound, axis=1).max() < 1e-12, "one motor winds all three"
    assert np.abs(pairs() @ [2.0, -1.0]).max() < 1e-9, "both follow the same row"
    assert all(message.pose.orientation.w == 1.0 for message in poses)


def stamp_of(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def peaks(values, low, high):
    """How often values rise from below the low level to above the high one."""
    count, is_low = 0, True
    for value in values:
        if is_low and value > high:
            count, is_low = count + 1, False
        elif value < low:
            is_low = True
    return count


def test_a_table_that_the_scene_does_not_know_is_refused_at_start_up(make_target, tmp_path):
    given = table_of(tmp_path, "0.0,0.0,0,0,0", "0.5,0.01,0,0,0.02")
    file = tmp_path / "commands.csv"
    file.write_text(file.read_text().replace("grip", "grab"))
    with pytest.raises(TableFileError, match="grab_.*is not a valid column.*motors: grip"):
        make_target(**given)
    with pytest.raises(ParameterError, match="target_commands.*no such file"):
        make_target(**{**given, "target_commands": "nowhere.csv"})


def test_a_table_that_is_played_before_the_path_ends_in_targets_from_where_the_effector_is_then(
    world, make_target, tmp_path
):
    given = table_of(tmp_path, "0.0,0.0,0,0,0", "0.5,0.01,0,0,0.02")
    make_target(target_beginning=given.pop("target_commands"), target_ramp_time=60.0, **given)
    commands = world.hear(JointState, "/twin/command/cables", 1000)
    poses = world.hear(PoseStamped, "/twin/command/pose/palm", 1000)
    targets = world.hear(PointStamped, "/twin/target/cube", 1000)
    effectors = world.speaker(PointStamped, "/twin/effectors/cube")
    world.run(0.3)
    assert not commands and not poses, "it must wait for the twin"

    def lifted():
        """The effector follows the palm, as the twin tells."""
        height = poses[-1].pose.position.z if poses else 0.0
        header = Header(stamp=world.stamp(), frame_id="base_link")
        effectors.publish(PointStamped(header=header, point=Point(x=0.0, y=0.0, z=height - 0.1)))
        return len(targets) > 20

    world.until(lifted)
    named = [len(message.name) for message in commands]
    assert named == [3] * named.count(3) + [0] * named.count(0) and named.count(3) and named[-1] == 0
    assert 0.01 < max(message.pose.position.z for message in poses) <= 0.02
    # A tick or two behind the palm.
    assert places(targets)[0] == pytest.approx([0.0, 0.0, poses[-1].pose.position.z - 0.1], abs=4e-3)
