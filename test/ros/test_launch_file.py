"""The launch file starts what exists; ``launch`` is not among the wheels, so small classes that
record what they are given stand where its own are.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml

from softrobot_twin.command_line.commands import NODES
from softrobot_twin.ros.parameters import ALL_TABLES
from test.places import ROOT

FILE = ROOT / "launch" / "robot.launch.py"
ROBOTS = sorted(path.stem for path in (ROOT / "config").glob("*.yaml"))


class LaunchConfiguration:
    def __init__(self, name):
        self._name = name

    def perform(self, context):
        return context.launch_configurations[self._name]


def recorded(*positional, **keywords):
    return SimpleNamespace(positional=positional, **keywords)


@pytest.fixture
def launch(monkeypatch):
    """What the file starts for some arguments: a function that returns the nodes."""
    contents = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": recorded, "OpaqueFunction": recorded,
                           "Shutdown": recorded},
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch_ros": {},
        "launch_ros.actions": {"Node": recorded},
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda _: str(ROOT)},
    }
    for name, members in contents.items():
        module = ModuleType(name)
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location("robot_launch", FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def run(**given):
        *arguments, opaque = module.generate_launch_description()
        values = {argument.positional[0]: argument.default_value for argument in arguments}
        assert given.keys() <= values.keys()
        assert all(isinstance(value, str) for value in values.values())
        return opaque.function(SimpleNamespace(launch_configurations=values | given))

    return run


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_nodes_and_the_parameter_file_of_a_robot_exist(launch, robot):
    nodes = launch(robot=robot)
    assert [node.executable for node in nodes] == list(NODES)
    for node in nodes:
        assert node.package == "softrobot_twin" and node.name == node.executable
        assert Path(node.parameters[0]).is_file() and node.namespace is None


def test_every_parameter_is_known_and_has_its_type(launch):
    known = {entry.name: entry for table in ALL_TABLES for entry in table}
    nodes = launch(frame_id="left/base_link", tf_prefix="left/", view="true", view_port="9880",
                   record="run.mcap")  # fmt: skip
    for node in nodes:
        for name, value in node.parameters[1].items():
            assert type(value) is type(known[name].default), name
    twin = nodes[0].parameters[1]
    assert twin == {"frame_id": "left/base_link", "tf_prefix": "left/", "view": True,
                    "view_port": 9880, "record": "run.mcap"}  # fmt: skip
    assert nodes[1].parameters[1] == {"frame_id": "left/base_link"}


def test_device_target_and_rviz_are_started_as_asked(launch):
    nodes = launch(device="false", target="False", rviz="true", namespace="/lab/left")
    assert [node.package for node in nodes] == ["softrobot_twin", "rviz2"]
    assert all(node.namespace == "/lab/left" for node in nodes)
    assert ("/twin/visualization", "twin/visualization") in nodes[1].remappings
    assert Path(nodes[1].arguments[1]).is_file() and nodes[1].arguments[2:] == ["-f", "base_link"]


def test_an_own_parameter_file_is_used_in_place_of_the_robots(launch, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.touch()
    assert all(node.parameters[0] == str(mine) for node in launch(parameters=str(mine)))


@pytest.mark.parametrize("given, words", [
    ({"robot": "fingr"}, "robot:=fingr: must be one of diamond, .*finger"),
    ({"parameters": "none.yaml"}, "parameters:=none.yaml: there is no such file"),
    ({"rviz": "ture"}, "rviz:=ture: must be true or false"),
    ({"view_port": "-1"}, "view_port:=-1: must be a whole number"),
])  # fmt: skip
def test_a_mistyped_argument_is_refused_before_any_node_starts(launch, given, words):
    with pytest.raises(RuntimeError, match=words):
        launch(**given)


def test_simulated_time_is_that_of_all_nodes(launch):
    for node in launch(use_sim_time="true", rviz="true"):
        assert node.parameters[-1]["use_sim_time"] is True


def test_all_ends_with_the_twin_and_not_with_the_others(launch):
    twin, *others = launch()
    assert twin.on_exit.reason == "the twin ended"
    assert all(node.on_exit is None for node in others)
