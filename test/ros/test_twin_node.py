"""The twin as a node: real rclpy, the real simulation on the small mesh."""

import math
import time
from collections import Counter

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped, Twist, Vector3
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.loop_timing import TickClock
from softrobot_twin.ros import message_bytes, twin_node
from softrobot_twin.ros.audience import PERIOD
from softrobot_twin.ros.messages import markers_message

RATE = 50.0
CABLE_RATE = 0.05
INSIDE = (0.008, 0.004, 0.134)


def target_of(twin):
    """Effector position that the twin reaches [m], shape (3,)."""
    return twin.loop.targets.read(twin.monotonic(), 0.0, np.zeros((1, 3))).targets[0]


def nanoseconds(message):
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def lengths_of(messages):
    return np.array([list(message.position) for message in messages])


def test_a_target_moves_the_cables_and_the_effector(world, make_twin):
    twin = make_twin()
    cables = world.hear(JointState, "/twin/cables")
    effectors = world.hear(PointStamped, "/twin/effectors/tip")
    targets = world.speaker(PointStamped, "/twin/target/tip")
    world.until(lambda: cables and effectors)
    assert list(cables[-1].position) == pytest.approx(twin.loop.simulation.rest_setpoints.tolist(), abs=1e-6)
    targets.publish(world.target_message(INSIDE))

    def arrived():
        point = effectors[-1].point
        return math.dist((point.x, point.y, point.z), INSIDE) < 2e-4

    world.until(arrived)
    newest = cables[-1]
    assert newest.name == ["north", "west", "south", "east"]
    assert min(newest.effort) >= 0.0
    assert min(newest.position) < twin.loop.simulation.rest_setpoints.min() - 1e-3
    assert effectors[-1].header.frame_id == "base_link"


def test_messages_of_one_tick_carry_one_stamp(world, make_twin):
    twin = make_twin()
    heard = [world.hear(JointState, "/twin/cables", 100),
             world.hear(PointStamped, "/twin/effectors/tip", 100),
             world.hear(PointCloud2, "/twin/predicted_markers", 100)]
    world.until(lambda: all(len(messages) > 5 for messages in heard))
    twin.stop()

    def stamps():
        return [{nanoseconds(message) for message in messages} for messages in heard]

    world.until(lambda: max(set.union(*stamps())) in set.intersection(*stamps()))
    # The first message of a topic may be lost while another is being connected.
    assert len(set.intersection(*stamps())) >= 5


def test_a_target_100_mm_away_obeys_the_rate_limits_in_every_tick(world, make_twin):
    twin = make_twin(approach_speed=0.03)
    tick = world.ticks_of(twin)
    cables = world.hear(JointState, "/twin/cables", 100)
    targets = world.speaker(PointStamped, "/twin/target/tip")
    world.until(lambda: twin.count_subscribers("/twin/cables") > 0)
    targets.publish(world.target_message((0.06, 0.08, 0.134)))
    world.until(lambda: np.isfinite(target_of(twin)).all())
    for _ in range(40):
        tick()
    world.until(lambda: len(cables) == 40)
    steps = np.abs(np.diff(lengths_of(cables), axis=0))
    assert steps.max() <= CABLE_RATE / RATE + 1e-9
    assert steps.max() > 1e-4


@pytest.mark.parametrize(
    ("position", "header", "refusal"),
    [
        ((math.nan, 0.0, 0.13), {}, Refusal.NOT_FINITE),
        ((0.02, 0.0, 0.14), {"seconds_ago": 5.0}, Refusal.STALE),
        ((0.02, 0.0, 0.14), {"seconds_ago": -5.0}, Refusal.FROM_THE_FUTURE),
        ((0.02, 0.0, 0.14), {"frame_id": "map"}, Refusal.WRONG_FRAME),
    ],
)
def test_a_bad_target_is_refused_and_moves_nothing(world, make_twin, position, header, refusal):
    twin = make_twin()
    cables = world.hear(JointState, "/twin/cables")
    targets = world.speaker(PointStamped, "/twin/target/tip")
    targets.publish(world.target_message(position, **header))
    world.until(lambda: twin.loop.targets.refusals.of(refusal) == 1)
    world.until(lambda: len(cables) > 5)
    assert lengths_of(cables) == pytest.approx(
        np.tile(twin.loop.simulation.rest_setpoints, (len(cables), 1)), abs=1e-6
    )


def test_measured_markers_give_the_misfit_and_a_hidden_one_is_omitted(world, make_twin):
    twin = make_twin()
    markers = world.speaker(PointCloud2, "/twin/markers")
    places = twin.loop.simulation.marker_positions() + [0.0, 0.0, 0.003]
    places[2] = np.nan
    header = Header(stamp=world.stamp(), frame_id="base_link")
    markers.publish(markers_message(twin.loop.simulation.marker_ids, places, header))
    outcomes = []
    honest = twin.loop.tick
    twin.loop.tick = lambda *times: outcomes.append(honest(*times)) or outcomes[-1]
    world.until(lambda: outcomes and outcomes[-1].misfit.visible == 7)
    # The body sags a little from the shape it was measured against.
    assert outcomes[-1].misfit.rms == pytest.approx(0.003, abs=0.006)


def test_velocity_messages_move_the_effector_and_it_stops_without_them(world, make_twin):
    """teleop_twist_keyboard: an unstamped Twist, only while a key repeats, at 0.5 m/s."""
    twin = make_twin(speed_limit=0.02, velocity_timeout=0.3, workspace_max=[0.005, 1.0, 1.0],
                     workspace_min=[-1.0, -1.0, -1.0])
    twin.stop()
    # Its own time: on a busy machine keys and ticks would be late.
    times = [0.0]
    twin.tick_clock = TickClock(1.0 / RATE, lambda: times[-1])
    keys = world.speaker(Twist, "/twin/target_velocity")

    def press(seconds, **velocity):
        keys.publish(Twist(linear=Vector3(**velocity), angular=Vector3(z=1.0)))
        world.until(lambda: twin.loop.targets.age(twin.monotonic()) == 0.0)
        run(seconds)

    def run(seconds):
        for _ in range(round(seconds * RATE)):
            times.append(times[-1] + 1.0 / RATE)
            twin.tick()

    run(0.1)
    for _ in range(10):
        press(0.1, x=0.5)
    driven = target_of(twin)
    # One second at 0.02 m/s is 20 mm; the workspace ends at 5 mm.
    assert driven[0] == pytest.approx(0.005)
    press(0.6, y=0.5)
    here = target_of(twin)
    assert 0.0 < here[1] <= 0.02 * 0.4
    run(0.2)
    later = target_of(twin)
    assert np.array_equal(here, later)


@pytest.mark.parametrize("by_length", [True, False])
def test_in_direct_mode_cables_are_commanded_by_length_or_tension(world, make_twin, by_length):
    twin = make_twin(mode="direct")
    cables = world.hear(JointState, "/twin/cables")
    commands = world.speaker(JointState, "/twin/command/cables")
    names = ["east", "north", "west", "south"]
    rest = twin.loop.simulation.rest_setpoints
    lengths = (rest[[3, 0, 1, 2]] - 0.002).tolist()
    commands.publish(
        JointState(header=Header(stamp=world.stamp()), name=names, position=lengths)
        if by_length
        else JointState(header=Header(stamp=world.stamp()), name=names,
                        effort=[2.0, 2.5, 2.0, 2.5])
    )

    def met():
        if not cables:
            return False
        if by_length:
            return np.allclose(cables[-1].position, rest - 0.002, atol=1e-5)
        return np.allclose(cables[-1].effort, [2.5, 2.0, 2.5, 2.0], atol=1e-2)

    world.until(met)
    bad = JointState(header=Header(stamp=world.stamp()), name=["up", *names[1:]], position=lengths)
    commands.publish(bad)
    world.until(lambda: twin.loop.direct.refusals.of(Refusal.WRONG_NAMES) == 1)


def test_the_path_of_a_slack_cable_is_shorter_than_its_length_and_is_given_to_who_listens(world, make_twin):
    twin = make_twin(mode="direct", message_timeout=0.0)
    cables, paths = (world.hear(JointState, f"/twin/{topic}", 100) for topic in ("cables", "cable_paths"))
    names = twin.loop.simulation.actuator_names
    lengths = twin.loop.simulation.rest_setpoints - [0.012, 0.0, 0.012, 0.0]
    commands = world.speaker(JointState, "/twin/command/cables")
    commands.publish(JointState(header=Header(stamp=world.stamp()), name=list(names),
                                position=lengths.tolist()))  # fmt: skip
    world.until(lambda: cables and np.allclose(cables[-1].position, lengths, atol=1e-9))
    world.run(0.5)
    assert paths[-1].name == list(names)
    slack = lengths - paths[-1].position
    np.testing.assert_allclose(slack[[0, 2]], 0.0, atol=1e-6)
    assert slack[1] > 0.001 and slack[3] > 0.001
    told = next(one for one in cables if one.header.stamp == paths[-1].header.stamp)
    assert told.effort[1] == told.effort[3] == 0.0 < told.effort[0]


@pytest.mark.exhaustive
def test_a_tick_asks_once_a_second_who_listens_and_makes_no_message_anew(
    world, make_twin, posed_scene_file, monkeypatch
):
    def refuse(*_, **__):
        raise AssertionError("a message is made")

    twin = make_twin(scene_file=str(posed_scene_file), rate=100.0)
    heard = [world.hear(JointState, "/twin/cables", 100),
             world.hear(PointStamped, "/twin/effectors/tip", 100),
             world.hear(PoseStamped, "/twin/effector_poses/tip", 100)]
    world.until(lambda: all(heard))
    ask, asked = Publisher.get_subscription_count, Counter()
    monkeypatch.setattr(
        Publisher, "get_subscription_count", lambda one: (asked.update([one.topic_name]), ask(one))[1]
    )
    monkeypatch.setattr(twin_node, "Header", refuse)
    monkeypatch.setattr(message_bytes, "exact_bytes", refuse)
    before, begin = [len(messages) for messages in heard], time.monotonic()
    targets = world.speaker(PointStamped, "/twin/target/tip")
    asked.clear()
    for turn in range(100):
        height = 1e-3 * math.sin(0.1 * turn)
        targets.publish(world.target_message((INSIDE[0], INSIDE[1], INSIDE[2] + height)))
        world.run(0.02)
    seconds = time.monotonic() - begin
    assert twin.failed_ticks == 0
    assert all(len(messages) > count + 20 for messages, count in zip(heard, before, strict=True))
    assert {"/twin/effectors/tip", "/twin/effector_poses/tip", "/twin/predicted_markers"} <= asked.keys()
    assert "/twin/cables" not in asked, "commands leave in any case"
    del asked["/twin/visualization"]  # Asked when a message is due, after a tick.
    assert max(asked.values()) <= math.ceil(seconds / PERIOD) + 1, asked
