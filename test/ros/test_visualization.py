"""Markers for RViz and Foxglove: only for who listens, where the twin is, as rerun shows it."""

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from softrobot_twin.ros.topics import NEWEST
from softrobot_twin.ros.twin_node import TwinNode
from softrobot_twin.ros.visualization import RobotMarkers
from softrobot_twin.view.drawn_parts import obstacle_skins

TOPIC = "/twin/visualization"


@pytest.fixture
def made(monkeypatch):
    """A list to which each message of markers is appended, and their maker as None."""
    calls = []
    make, message = RobotMarkers.__init__, RobotMarkers.message

    def counting_make(self, *given):
        calls.append(None)
        make(self, *given)

    def counting_message(self, *given):
        calls.append(message(self, *given))
        return calls[-1]

    monkeypatch.setattr(RobotMarkers, "__init__", counting_make)
    monkeypatch.setattr(RobotMarkers, "message", counting_message)
    return calls


def points_of(marker):
    return np.array([[point.x, point.y, point.z] for point in marker.points])


def by_kind(message):
    return {(marker.ns, marker.id): marker for marker in message.markers}


def test_nothing_is_made_until_somebody_listens_and_after(world, make_twin, made):
    twin = make_twin(visualization_rate=100.0)
    cables = world.hear(JointState, "/twin/cables", 100)
    world.until(lambda: len(cables) > 10)
    assert not made
    heard = []
    subscription = world.probe.create_subscription(MarkerArray, TOPIC, heard.append, NEWEST)
    world.until(lambda: len(heard) > 3)
    assert made.count(None) == 1
    world.probe.destroy_subscription(subscription)
    world.until(lambda: not twin.count_subscribers(TOPIC))
    world.run(0.1)
    before, ticks = len(made), len(cables)
    world.until(lambda: len(cables) > ticks + 10)
    assert len(made) == before


def test_markers_are_the_state_of_the_twin_with_its_stamp_and_frame(world, make_twin):
    twin = make_twin(mode="direct", frame_id="left/base_link")
    cables = world.hear(JointState, "/twin/cables", 1000)
    heard = world.hear(MarkerArray, TOPIC, NEWEST)
    speaker = world.speaker(JointState, "/twin/command/cables")
    simulation = twin.loop.simulation
    names = ["north", "west", "south", "east"]
    lengths = simulation.rest_setpoints - [0.008, 0.004, 0.0, 0.004]
    message = JointState(header=Header(stamp=world.stamp(), frame_id="left/base_link"),
                         name=names, position=lengths.tolist())  # fmt: skip
    speaker.publish(message)
    world.until(lambda: cables and np.allclose(cables[-1].position, lengths, atol=1e-12))
    world.until(lambda: simulation.state.efforts.max() > 1.0)
    twin.stop()
    for _ in range(25):
        twin.tick()
    before = len(heard)
    world.until(lambda: not twin.tick() and len(heard) > before + 1)
    found = by_kind(heard[-1])
    assert list(found) == [("surfaces", 0), ("cables", 0), ("effectors", 0)]
    stamp = heard[-1].markers[0].header.stamp
    world.until(lambda: any(message.header.stamp == stamp for message in cables))
    for marker in found.values():
        assert marker.header.frame_id == "left/base_link" and marker.header.stamp == stamp
        assert marker.action == Marker.ADD and marker.pose.orientation.w == 1.0
        assert 1.0 < marker.lifetime.sec + 1e-9 * marker.lifetime.nanosec < 10.0
    surface, lines = found["surfaces", 0], found["cables", 0]
    assert surface.type == Marker.TRIANGLE_LIST and lines.type == Marker.LINE_LIST
    skin = simulation.skins[0]
    wanted = simulation.skin_positions()[0][skin.triangles.ravel()]
    np.testing.assert_allclose(points_of(surface), wanted, atol=1e-4)
    north = simulation.actuator_paths()["north"]
    np.testing.assert_allclose(points_of(lines)[:2], north[:2], atol=1e-4)
    assert len(lines.colors) == len(lines.points)
    np.testing.assert_allclose(points_of(found["effectors", 0]), simulation.effector_positions(), atol=1e-4)


def test_markers_come_at_the_rate_of_the_parameter(world, make_twin, made):
    twin = make_twin(visualization_rate=10.0)
    twin.stop()
    heard = world.hear(MarkerArray, TOPIC, 1000)
    world.until(lambda: twin.count_subscribers(TOPIC))
    world.until(lambda: not twin.tick() and heard)
    outcome, before = twin.window.newest, len(made)
    # Times since the machine was started, which round differently; with a little jitter.
    for start in (twin.monotonic() + 1.0, 2.0**20 / 3.0, 2.0**24 / 7.0):
        for tick in range(50):
            twin.visualization.offer(outcome, tick, start + 0.02 * tick - 1e-4 * (tick % 3))
        assert len(made) - before == 10
        before = len(made)
    # With simulated time the clock may be set back.
    twin.visualization.offer(outcome, 0, start - 100.0)
    twin.visualization.offer(outcome, 0, start - 99.99)
    assert len(made) - before == 1


def test_obstacles_rigid_bodies_and_targets_are_shown(world):
    twin = world.add(TwinNode, scene_file="scenes/trunk_cylinders.yaml", rate=5.0)
    twin.stop()
    heard = world.hear(MarkerArray, TOPIC, 100)
    world.until(lambda: twin.count_subscribers(TOPIC))
    world.until(lambda: not twin.tick() and heard)
    simulation = twin.loop.simulation
    found = by_kind(heard[0])
    obstacles = obstacle_skins(simulation.model)
    for number, skin in enumerate(obstacles):
        marker = found["obstacles", number]
        np.testing.assert_array_equal(points_of(marker), skin.points[skin.triangles.ravel()])
    assert len(obstacles) == sum(kind == "obstacles" for kind, _ in found) > 0
    for number, position in enumerate(simulation.rigid_poses()[0]):
        place = found["rigid_bodies", number].pose.position
        np.testing.assert_allclose([place.x, place.y, place.z], position, atol=1e-3)
    assert ("targets", 0) not in found
    tip = simulation.effector_positions()[0]
    arrival = twin.arrival(Header(frame_id="base_link", stamp=world.stamp()))
    assert twin.loop.targets.accept_point(0, tip, arrival) is None
    world.run(0.15)
    world.until(lambda: not twin.tick() and ("targets", 0) in by_kind(heard[-1]))
    np.testing.assert_allclose(points_of(by_kind(heard[-1])["targets", 0]), [tip], atol=1e-9)
