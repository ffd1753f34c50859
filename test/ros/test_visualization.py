"""Markers for RViz and Foxglove: only for who listens, where the twin is, as rerun shows it."""

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from softrobot_twin.ros.message_bytes import Content, MarkerBytes
from softrobot_twin.ros.topics import NEWEST
from softrobot_twin.ros.twin_node import TwinNode
from softrobot_twin.ros.visualization import OBSTACLES_EVERY, RobotMarkers
from softrobot_twin.simulation.colours import tension_colours
from softrobot_twin.view import Entity

pytestmark = pytest.mark.libraries

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


def colours_of(marker):
    return np.array([[colour.r, colour.g, colour.b, colour.a] for colour in marker.colors])


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


def test_markers_are_the_state_of_the_twin_with_its_stamp_frame_and_colours(world, make_twin):
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
    colours = tension_colours(simulation.state.efforts, (0.0, simulation.limits.effort_max.max()))
    ends = 2 * np.array([len(path) - 1 for path in simulation.actuator_paths().values()])
    np.testing.assert_allclose(
        colours_of(lines), np.repeat(colours, ends, axis=0) / 255.0, atol=0.02
    )
    np.testing.assert_allclose(
        points_of(found["effectors", 0]), simulation.effector_positions(), atol=1e-4
    )


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


def test_a_rate_of_zero_publishes_none(world, make_twin, made):
    make_twin(visualization_rate=0.0)
    cables = world.hear(JointState, "/twin/cables", 100)
    world.hear(MarkerArray, TOPIC, NEWEST)
    world.until(lambda: len(cables) > 10)
    assert not made


def test_obstacles_rigid_bodies_and_targets_are_shown(world):
    twin = world.add(TwinNode, scene_file="scenes/trunk_cylinders.yaml", rate=5.0)
    twin.stop()
    heard = world.hear(MarkerArray, TOPIC, 100)
    world.until(lambda: twin.count_subscribers(TOPIC))
    world.until(lambda: not twin.tick() and heard)
    simulation = twin.loop.simulation
    found = by_kind(heard[0])
    obstacles = simulation.obstacle_skins()
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
    # They do not move, and are sent again only now and then.
    assert OBSTACLES_EVERY >= 0.5
    some = by_kind(heard[-1]).keys() | by_kind(heard[-2]).keys()
    assert ("surfaces", 0) in some


def random_markers(random):
    """Prototypes of markers and what changes of them, and the messages that they should become."""
    prototypes, contents, whole = [], [], []
    stamp = Time(sec=int(random.integers(2**31)), nanosec=int(random.integers(10**9)))
    for number in range(int(random.integers(1, 6))):
        count = int(random.integers(1, 9))
        name = "".join(random.choice(list("abcé"), int(random.integers(0, 9))))
        points, pose = random.normal(size=(count, 3)), random.normal(size=7)
        colour = random.random(4)
        colours = random.random((count, 4)) if random.random() < 0.5 else None
        kind = int(random.integers(1, 9))
        both = [Marker(ns=name, id=number, type=kind, text=name[1:]) for _ in range(2)]
        for marker in both:
            marker.header.frame_id = f"{name}/frame"
            marker.scale.y, marker.lifetime.sec = 7.0, 7
            marker.texture.data = [1, 2, 3]
            marker.mesh_file.filename = "none"
        prototypes.append(both[0])
        contents.append(Content(points, colours, colour, pose[:3], pose[3:]))
        full = both[1]
        full.header.stamp = stamp
        place, turn = full.pose.position, full.pose.orientation
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = map(float, pose)
        full.color.r, full.color.g, full.color.b, full.color.a = map(float, colour)
        for x, y, z in points.tolist():
            point = type(place)(x=x, y=y, z=z)
            full.points.append(point)
        for r, g, b, a in () if colours is None else colours.tolist():
            full.colors.append(ColorRGBA(r=r, g=g, b=b, a=a))
        whole.append(full)
    return prototypes, contents, whole, stamp


def test_the_bytes_are_those_of_the_message():
    seed = int(np.random.default_rng().integers(2**32))
    print(f"seed {seed}")
    random = np.random.default_rng(seed)
    for _ in range(30):
        prototypes, contents, whole, stamp = random_markers(random)
        maker = MarkerBytes(prototypes, [one.colours is not None for one in contents])
        found = maker.message((stamp.sec, stamp.nanosec), contents)
        # Colours are rounded to 32 bits on the way; padding may be any bytes.
        wanted = deserialize_message(serialize_message(MarkerArray(markers=whole)), MarkerArray)
        assert deserialize_message(found, MarkerArray) == wanted
        # A message after it, with other numbers of points.
        fewer = [one._replace(points=one.points[:1],
                              colours=None if one.colours is None else one.colours[:1])
                 for one in contents]  # fmt: skip
        again = deserialize_message(maker.message((1, 2), fewer), MarkerArray)
        assert [len(marker.points) for marker in again.markers] == [1] * len(fewer)
        assert again.markers[-1].text == whole[-1].text


def test_a_marker_without_points_or_with_too_few_colours_is_refused():
    prototype = Marker(type=Marker.LINE_LIST)
    plain, coloured = MarkerBytes([prototype], [False]), MarkerBytes([prototype], [True])
    points = np.zeros((2, 3))
    with pytest.raises(ValueError, match="needs points"):
        plain.message((0, 0), [Content(np.empty((0, 3)))])
    with pytest.raises(ValueError, match="colours as it was announced"):
        plain.message((0, 0), [Content(points, np.zeros((2, 4)))])
    with pytest.raises(ValueError, match="one colour for each point"):
        coloured.message((0, 0), [Content(points, np.zeros((1, 4)))])


def test_a_body_with_nothing_to_show_is_left_out(make_twin):
    twin = make_twin()
    twin.stop()
    twin.tick()
    markers = RobotMarkers(twin.loop.simulation, "base_link", 3.0)
    triangles, points = np.array([[0, 1, 2]]), np.ones((3, 3))
    markers.entities = [Entity(f"/obstacles/{many}", "solid", triangles=triangles[:many], points=points,
                               kind="obstacle") for many in (0, 1)]
    found = deserialize_message(
        markers.message(twin.window.newest, (1, 2), True), MarkerArray
    ).markers
    assert [(marker.ns, marker.id) for marker in found if marker.ns == "obstacles"] == [
        ("obstacles", 1)
    ]
