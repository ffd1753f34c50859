"""The latched status: who comes late receives it, and it is sent only when it changes."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from softrobot_twin.ros.status import LEAST_PERIOD
from softrobot_twin.ros.topics import LATCHED

TOPIC = "/twin/status"


def values_of(message):
    return {pair.key: pair.value for pair in message.values}


def test_who_comes_late_receives_the_last_status(world, make_twin):
    make_twin(rate=20.0)
    cables = world.hear(JointState, "/twin/cables", 100)
    world.until(lambda: len(cables) > 5)
    heard = world.hear(DiagnosticStatus, TOPIC, LATCHED)
    world.until(lambda: heard)
    assert heard[0].name == "twin: status" and heard[0].level == DiagnosticStatus.OK
    assert heard[0].message.startswith("holding: ok")
    values = values_of(heard[0])
    assert values["activity"] == "holding" and values["status"] == "ok"
    assert values["active_limits"] == "" and values["mode"] == "inverse"
    assert values["uses_device"] == "false"


def test_a_target_beyond_reach_is_told_with_the_active_limits(world, make_twin):
    make_twin()
    heard = world.hear(DiagnosticStatus, TOPIC, LATCHED)
    world.until(lambda: heard)
    speaker = world.speaker(PointStamped, "/twin/target/tip")

    def is_saturated():
        speaker.publish(world.target_message([0.0, 0.0, 0.02]))
        world.run(0.02)
        return values_of(heard[-1])["status"] == "saturated"

    world.until(is_saturated, 20.0)
    values = values_of(heard[-1])
    assert heard[-1].level == DiagnosticStatus.WARN and values["activity"] == "following"
    assert values["active_limits"]
    seen = [values_of(message)["activity"] for message in heard]
    assert seen[0] == "holding" and "following" in seen


def test_a_twin_of_a_device_begins_disabled_and_tells_why(world, make_twin):
    make_twin(use_device=True)
    heard = world.hear(DiagnosticStatus, TOPIC, LATCHED)
    world.until(lambda: heard)
    assert values_of(heard[0])["activity"] == "disabled"
    assert "not enabled" in heard[0].message
    answer = world.ask(SetBool, "/twin/enable", SetBool.Request(data=True))
    assert not answer.success


@pytest.fixture
def twin(make_twin):
    """A twin that has ticked and is stopped; what its status publishes is recorded."""
    twin = make_twin()
    twin.stop()
    twin.tick()
    messages = []
    twin.status.publisher = SimpleNamespace(messages=messages, publish=messages.append)
    return twin


def test_an_unchanged_status_is_not_sent_and_a_restless_one_not_at_every_tick(twin):
    status, outcome, recorded = twin.status, twin.window.newest, twin.status.publisher
    start = twin.monotonic() + 1.0
    for tick in range(100):
        status.offer(outcome, start + 0.01 * tick)
    assert not recorded.messages
    for tick in range(100):
        changed = outcome._replace(cause=f"cause {tick % 2}")
        status.offer(changed, start + 2.0 + 0.01 * tick)
    assert 10 <= len(recorded.messages) <= 1.0 / LEAST_PERIOD + 1
    # The last one is sent, though late.
    status.offer(outcome._replace(cause="the last"), start + 3.0)
    status.offer(outcome._replace(cause="the last"), start + 3.0 + 2.0 * LEAST_PERIOD)
    assert values_of(recorded.messages[-1])["cause"] == "the last"


def test_a_command_that_is_kept_back_is_an_error(twin):
    outcome = twin.window.newest._replace(violated=("north.tension_max",))
    twin.status.offer(outcome, twin.monotonic() + 1.0)
    (message,) = twin.status.publisher.messages
    assert message.level == DiagnosticStatus.ERROR
    assert values_of(message)["kept_back"] == "north.tension_max"


def test_a_twin_looks_for_nearer_poses_after_its_work_and_says_so(twin, monkeypatch):
    looks = []
    monkeypatch.setattr(twin.loop.simulation, "plan", lambda: looks.append(twin.has_worked))
    twin.tick()
    assert looks == [True]
    outcome = twin.window.newest
    report = replace(outcome.result.report, is_exploring=True)
    outcome = outcome._replace(cause="", result=replace(outcome.result, report=report))
    twin.status.offer(outcome, twin.monotonic() + 1.0)
    (message,) = twin.status.publisher.messages
    assert values_of(message)["exploring"] == "true"
    assert "looks for a nearer pose" in message.message
