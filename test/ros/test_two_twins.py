"""Of two twins on the same topics one commands; the ghost of a crashed one blocks nothing."""

import itertools
import time
from functools import partial

import pytest
from geometry_msgs.msg import PointStamped, Twist
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool

from softrobot_twin.ros import twin_node
from softrobot_twin.ros.claim import LIFE_TIME, Rival, TopicClaim
from softrobot_twin.ros.messages import cables_message
from softrobot_twin.ros.twin_node import TwinNode


def hear_each_other(world, twins):
    """Until each twin has heard the others."""
    world.until(lambda: all(len(twin.claim.rivals) == len(twins) - 1 for twin in twins))


def test_the_later_twin_stays_silent_and_says_whose_topics_these_are(world, make_twin):
    first = make_twin()
    world.run(0.3)
    second = make_twin()
    assert first.loop.is_enabled and not second.loop.is_enabled
    assert "/twin/cables is commanded by /twin (process" in second.loop.why_given_up
    hear_each_other(world, (first, second))
    world.run(0.6)
    assert first.loop.is_enabled and not second.loop.is_enabled


def test_a_twin_with_device_is_not_enabled_beside_one_that_commands(world, make_twin):
    first = make_twin()
    world.run(0.3)
    second = make_twin(use_device=True)
    hear_each_other(world, (first, second))
    request, response = SetBool.Request(data=True), SetBool.Response()
    assert not second.enable(request, response).success
    assert "is commanded by /twin (process" in response.message
    assert first.loop.is_enabled


def test_a_twin_starts_beside_the_ghost_of_one_that_crashed(world, make_twin):
    make_twin().claim.close()
    world.run(LIFE_TIME + 0.2)
    assert make_twin().loop.is_enabled


def test_the_ghost_of_a_twin_of_another_name_blocks_no_enabling(world, make_twin, small_scene_file):
    arguments = ["--ros-args", "-r", "__node:=other"]
    for topic in ("cables", "measured_cables", "target/tip"):
        arguments += ["-r", f"~/{topic}:=/twin/{topic}"]
    other = world.add(partial(TwinNode, cli_args=arguments), scene_file=str(small_scene_file))
    world.run(0.3)
    twin = make_twin()
    hear_each_other(world, (other, twin))
    request = SetBool.Request(data=True)
    refused = twin.enable(request, SetBool.Response())
    assert not refused.success and "commanded by /other" in refused.message
    other.stop()
    other.claim.close()  # As a crash does: its publishers stay in the graph.
    time.sleep(LIFE_TIME + 0.2)
    assert twin.enable(request, SetBool.Response()).success
    # A publisher that is no twin still does.
    twin.loop.disable()
    world.probe.create_publisher(JointState, "/twin/cables", 1)
    world.until(lambda: twin.count_publishers("/twin/cables") == 3)
    refused = twin.enable(request, SetBool.Response())
    assert not refused.success and "/probe" in refused.message


@pytest.mark.parametrize("enabled", [*itertools.product((False, True), repeat=2)])
def test_of_two_twins_one_has_precedence_as_both_find(enabled):
    for ages in ((0.0, 0.0), (0.3, 0.0), (5.0, 0.0), (0.0, 5.0)):
        one, other = (Rival(0.0, -age, "/twin", name, on)
                      for age, name, on in zip(ages, "ab", enabled))
        has = TopicClaim.has_precedence
        assert has(one, other) is not has(other, one)
        if enabled[0] is not enabled[1]:
            assert has(one, other) is enabled[0]


def test_what_is_no_claim_is_ignored(world, make_twin):
    twin = make_twin()
    speaker = world.speaker(String, "/twin/cables/claim", 10)
    for text in ("", "{}", "[1, 2]", '["a", "b", "old", true]', "[[], [], 1, 1]", "\0" * 1000):
        speaker.publish(String(data=text))
    world.run(0.5)
    assert twin.claim.is_alone and twin.loop.is_enabled


def test_two_publishers_of_targets_are_named_and_not_followed(world, make_twin):
    twin = make_twin(rate=50.0)
    speakers = [world.speaker(PointStamped, "/twin/target/tip") for _ in range(2)]

    def until(is_ended, *voices):
        """Speakers publish their targets by turns until the cause of the newest tick is as asked."""
        turns = itertools.cycle(voices)

        def speak():
            speaker, x = next(turns)
            speaker.publish(world.target_message((x, 0.0, 0.134)))
            world.run(0.02)
            return is_ended(twin.window.newest.cause)

        world.until(speak)

    both = (speakers[0], 0.01), (speakers[1], -0.01)
    until(
        lambda cause: cause.startswith("two publishers on /twin/target/tip (/probe, /probe)"),
        *both,
    )
    until(lambda cause: cause == "", both[0])


def test_two_nodes_that_give_a_point_and_a_velocity_by_turns_are_named(
    world, make_twin, diagnostics, monkeypatch
):
    monkeypatch.setattr(twin_node, "DIAGNOSTICS_PERIOD", 1.0)
    make_twin(rate=50.0)
    points = world.speaker(PointStamped, "/twin/target/tip")
    velocities = world.speaker(Twist, "/twin/target_velocity")

    def speak_by_turns():
        points.publish(world.target_message((0.0, 0.0, 0.134)))
        world.run(0.05)
        velocities.publish(Twist())
        world.run(0.05)
        return [status for message in diagnostics.messages for status in message.status
                if "by turns" in status.message]  # fmt: skip

    world.until(speak_by_turns)
    found = speak_by_turns()[0]
    assert found.level == b"\x01"
    assert found.message == (
        "targets by turns as point and velocity, the newest counts: "
        "/twin/target/tip (/probe), /twin/target_velocity (/probe)"
    )


def test_two_devices_disable_a_running_twin_and_are_named(world, make_twin):
    twin = make_twin(use_device=True, device_timeout=20.0)
    names, rest = twin.loop.simulation.actuator_names, twin.loop.simulation.rest_setpoints

    def measure(speaker, lengths):
        header = Header(stamp=world.stamp())
        speaker.publish(cables_message(names, lengths, [0.0] * len(names), header))
        world.run(0.02)

    first = world.speaker(JointState, "/twin/measured_cables")
    for _ in range(5):
        measure(first, rest)
    assert world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success
    second = world.speaker(JointState, "/twin/measured_cables")
    # They agree, and yet nobody knows which of them is right.
    for _ in range(5):
        measure(first, rest)
        measure(second, rest)
    assert not twin.loop.is_enabled
    assert twin.loop.why_given_up.startswith("two publishers on /twin/measured_cables (/probe, ")
