"""Paths ahead as messages, to a twin whose scene has control: real rclpy, a finger that vibrates."""

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PointStamped
from nav_msgs.msg import Path
from std_msgs.msg import Header

from softrobot_twin.ros.messages import path_message, read_path
from softrobot_twin.ros.target_node import TargetNode
from test.places import SCENES
from test.scene_changes import yaml_file


@pytest.fixture
def finger_file(tmp_path):
    """A finger of few elements in motion, led by tensions."""
    scene = yaml.safe_load((SCENES / "finger.yaml").read_text())
    scene["body"] |= {
        "mesh": {"box": {"size": [0.1, 0.018, 0.018], "cells": [4, 1, 1]},
                 "translation": [0, -0.009, -0.009]},
        "element": "quadratic", "damping": {"stiffness": 5e-3},
        "fixed": [{"box": {"minimum": [-1e-3, -1, -1], "maximum": [1e-3, 1, 1]}}],
    }  # fmt: skip
    for cable in scene["cables"]:
        cable.pop("rate")
    scene |= {"integration": "dynamic", "time_scheme": "generalized_alpha", "control": {"inputs": "efforts"}}
    return yaml_file(tmp_path / "finger.yaml", scene)


def header(world, seconds_ago=0.0):
    return Header(stamp=world.stamp(seconds_ago), frame_id="base_link")


def test_a_message_has_the_times_and_places_of_its_poses(world):
    times, places = np.array([0.0, 0.1, 0.25]), np.arange(9.0).reshape(3, 3)
    found = read_path(path_message(times, places, header(world)))
    assert found[0] == pytest.approx(times) and np.array(found[1]) == pytest.approx(places)


def test_a_twin_with_control_follows_a_path_and_tells_how(world, make_twin, finger_file, diagnostics):
    twin = make_twin(scene_file=str(finger_file), rate=50.0, velocity_effector="tip")
    paths = world.speaker(Path, "/twin/target_path/tip")
    tip = world.hear(PointStamped, "/twin/effectors/tip")
    world.until(lambda: tip)
    low = np.array([0.097, 0.0, -0.013])
    times = np.linspace(0.0, 0.5, 26)
    paths.publish(path_message(times, np.tile(low, (26, 1)), header(world)))
    world.until(lambda: tip[-1].point.z < low[2] + 3e-3)
    reading = twin.loop.targets.read(twin.monotonic(), 0.0, np.zeros((1, 3)))
    assert reading.source == "path" and reading.targets[0] == pytest.approx(low)
    account = diagnostics("control", lambda account: "margin" in account.values)
    assert "times the stiffness of the model" in account.values["margin"]
    assert account.values["fallbacks"] == "0" and account.message == "by prediction"


def test_the_target_node_tells_its_path_ahead(world):
    world.add(TargetNode, target_center=[0.09, 0.0, -0.01], target_radius=0.004, target_period=2.0,
              target_plane="xz", target_rate=50.0, target_ramp_time=0.5, target_ahead=0.4)  # fmt: skip
    paths = world.hear(Path, "/twin/target_path/tip", 100)
    start = world.speaker(PointStamped, "/twin/effectors/tip")
    world.run(0.2)
    start.publish(world.target_message((0.1, 0.0, 0.0)))
    world.until(lambda: len(paths) > 40)
    times, places = read_path(paths[-1])
    assert times == pytest.approx(np.arange(21) / 50.0) and len(places) == 21
    apart = np.linalg.norm(np.array(places) - [0.09, 0.0, -0.01], axis=1)
    assert apart == pytest.approx(np.full(21, 0.004), abs=1e-6)
