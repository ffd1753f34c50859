"""Sensors over ROS: what they show is published, what is measured is taken, targets are followed."""

import numpy as np
import pytest
import yaml
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool
from test.scene_changes import yaml_file


@pytest.fixture
def with_sensors(small_scene_file, tmp_path):
    content = yaml.safe_load(small_scene_file.read_text())
    content["sensors"] = [
        {"name": "rope", "cable": "north", "weight": 1.0}, {"name": "other", "cable": "south"}]
    content["reactions"] = [{"name": "base", "of": content["body"].get("name", "body")}]
    return yaml_file(tmp_path / "sensing.yaml", content)


def test_what_sensors_show_is_published_and_their_targets_are_followed(world, make_twin, with_sensors, diagnostics):
    twin = make_twin(scene_file=str(with_sensors))
    shown = world.hear(JointState, "/twin/sensor_lengths/rope", 10)
    reaction = world.hear(JointState, "/twin/reaction_forces/base", 10)
    targets = world.speaker(JointState, "/twin/target_sensors")
    measured = world.speaker(JointState, "/twin/measured_sensor_lengths/other")
    world.until(lambda: shown and reaction)
    length = shown[-1].position[0]
    assert list(shown[-1].name) == ["length"] and list(reaction[-1].name) == ["x", "y", "z"]

    def say(speaker, name, value):
        speaker.publish(JointState(header=Header(stamp=world.stamp(), frame_id="base_link"),
                                   name=[name], position=[value]))  # fmt: skip

    say(targets, "rope", length - 0.002)
    world.until(lambda: abs(shown[-1].position[0] - length + 0.002) < 2e-5)
    say(measured, "length", 0.123)
    world.until(lambda: twin.window.newest.measured["sensor_lengths"][1, 0] == 0.123)
    diagnostics("markers", lambda one: "other_length_m_misfit" in one.values and "rope_length_m_misfit" not in one.values)
    say(targets, "other", 0.1)
    world.until(lambda: twin.loop.sensors.refusals.by_word() == {"wrong_names": 1})
    assert np.isfinite(reaction[-1].position).all()


def test_a_service_tells_a_grip_to_hold(world, make_twin, with_sensors, tmp_path):
    content = yaml.safe_load(with_sensors.read_text())
    content["grips"] = [{"name": "hook", "points": [[0.0, 0.0, 0.125]], "holds": "world"}]
    path = yaml_file(tmp_path / "gripping.yaml", content)
    twin = make_twin(scene_file=str(path))
    held = world.hear(JointState, "/twin/grip_holds/hook", 10)
    client = world.probe.create_client(SetBool, "/twin/grip/hook")
    world.until(client.service_is_ready)
    for holds in (True, False):
        answer = client.call_async(SetBool.Request(data=holds))
        world.until(answer.done)
        assert answer.result().success and "hook" in answer.result().message
        world.until(lambda: held and held[-1].position[0] == float(holds))
    assert not twin.loop.grip("nobody", True)[0]
