"""Touches as messages: a force or a place in, both out."""

import math

import pytest
import yaml
from geometry_msgs.msg import Point, PointStamped, Vector3, Wrench, WrenchStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.ros.twin_node import TwinNode
from test.scene_changes import yaml_file


@pytest.fixture(scope="module")
def touched_scene_file(column):
    scene = yaml.safe_load(column.read_text())
    scene["effectors"][0]["directions"] = ["x", "y"]
    scene["touches"] = [{"name": "finger", "points": [[0.01, 0.01, 0.10]], "force_limit": 1.0}]
    return yaml_file(column.with_name("touched_column.yaml"), scene)


@pytest.fixture
def twin(world, touched_scene_file):
    return world.add(
        TwinNode, scene_file=str(touched_scene_file), rate=50.0, priority="normal",
        touch_timeout=30.0, message_timeout=30.0,
    )  # fmt: skip


def force_message(world, y):
    header = Header(stamp=world.stamp(), frame_id="base_link")
    return WrenchStamped(header=header, wrench=Wrench(force=Vector3(x=0.0, y=y, z=0.0)))


def place_message(world, place):
    x, y, z = map(float, place)
    header = Header(stamp=world.stamp(), frame_id="base_link")
    return PointStamped(header=header, point=Point(x=x, y=y, z=z))


def wait_for(world, answers, count):
    """Runs until so many more answers came, one for each tick."""
    before = len(answers)
    world.until(lambda: len(answers) >= before + count)


def test_a_force_is_answered_with_a_displacement_and_its_place_with_the_force(world, twin):
    answers = world.hear(JointState, "/twin/touch/finger")
    forces = world.speaker(WrenchStamped, "/twin/touch_force/finger")
    places = world.speaker(PointStamped, "/twin/touch_position/finger")
    world.until(lambda: answers)
    assert list(answers[-1].name) == ["x", "y", "z"]
    assert not any(answers[-1].position) and not any(answers[-1].effort)
    forces.publish(force_message(world, 0.02))
    world.until(lambda: answers[-1].effort[1] == 0.02)
    wait_for(world, answers, 15)
    moved = answers[-1].position[1]
    assert moved > 1e-4
    touches = twin.loop.simulation.touches
    place, begin = touches.points[0].copy(), touches.origins[0].copy()
    places.publish(place_message(world, 0.5 * (place + begin)))
    world.until(lambda: answers[-1].effort[1] < 0.015)
    places.publish(place_message(world, place))
    world.until(lambda: answers[-1].effort[1] > 0.015)
    wait_for(world, answers, 15)
    assert answers[-1].effort[1] == pytest.approx(0.02, rel=1e-3)
    assert answers[-1].position[1] == pytest.approx(moved, rel=1e-3)
    places.publish(place_message(world, (math.nan,) * 3))
    world.until(lambda: not any(answers[-1].effort))
    assert not any(answers[-1].position)
