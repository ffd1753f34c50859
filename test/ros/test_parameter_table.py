"""Parameters, as files and command lines give them."""

from pathlib import Path

import pytest
import rclpy
import yaml

from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.parameters import ALL_TABLES, RUNTIME, TWIN, Entry, declare, loop_settings

pytestmark = pytest.mark.libraries

CONFIG = Path(__file__).resolve().parents[2] / "config" / "diamond.yaml"
DRIVEN_DIRECTLY = {"fast_pneunet", "finray", "grasper", "octoleg", "pneunet"}
KNOWN = {entry.name: entry for table in ALL_TABLES for entry in table}


def test_a_parameter_name_has_the_same_meaning_in_every_node():
    for table in ALL_TABLES:
        for entry in table:
            assert KNOWN[entry.name] == entry


def test_the_settings_of_the_loop_can_change_and_the_structure_cannot():
    assert not any(entry.read_only for entry in RUNTIME)
    structure = {"scene_file", "mode", "use_device", "frame_id", "view"}
    assert all(entry.read_only for entry in TWIN if entry.name in structure)


def test_the_parameter_file_of_the_diamond_has_every_parameter():
    assert yaml.safe_load(CONFIG.read_text())["/**"]["ros__parameters"].keys() == KNOWN.keys()


@pytest.mark.parametrize("robot", sorted(file.stem for file in CONFIG.parent.glob("*.yaml")))
def test_the_parameter_file_of_a_robot_has_known_parameters_with_their_types(robot):
    sections = yaml.safe_load(CONFIG.with_name(f"{robot}.yaml").read_text()).values()
    given = {name: value for one in sections for name, value in one["ros__parameters"].items()}
    for name, value in given.items():
        assert type(value) is type(KNOWN[name].default), name
    values = {name: entry.default for name, entry in KNOWN.items()} | given
    loop_settings(values)
    for name in ("scene_file", "device_scene_file"):
        assert (CONFIG.parent / values[name]).is_file()
    assert values["device_angle_rate"] > 0.0
    assert (values["mode"] == "direct") == (robot in DRIVEN_DIRECTLY)


TABLE = (
    Entry("gain", 1.0, "Gain.", "1/s", 0.0, 10.0),
    Entry("count", 3, "Count.", "", 1, 5),
    Entry("word", "a", "Word.", choices=("a", "b")),
    Entry("switch", "auto", "Switch.", choices=("auto", "on", "off"), read_only=True),
)


@pytest.mark.parametrize(
    ("given", "word"), [(True, "on"), (False, "off"), ("on", "on"), ("off", "off"), ("auto", "auto")]
)
def test_a_switch_takes_the_truth_values_that_yaml_makes_of_on_and_off(world, given, word):
    node = world.add(rclpy.create_node, "some", switch=given)
    assert declare(node, TABLE)["switch"] == word


@pytest.mark.parametrize("name, value, reason", [
    ("gain", 3, "must be of the type of 1.0"),
    ("gain", 11.0, "range"),
    ("gain", "fast", "must be of the type"),
    ("count", 6, "range"),
    ("word", "c", "must be one of"),
    ("switch", "no", "must be one of"),
    ("switch", 1, "must be one of"),
])  # fmt: skip
def test_an_invalid_value_is_refused_by_name_and_value(world, name, value, reason):
    node = world.add(rclpy.create_node, "some", **{name: value})
    with pytest.raises(ParameterError, match=reason) as raised:
        declare(node, TABLE)
    assert (raised.value.name, raised.value.value) == (name, value)
