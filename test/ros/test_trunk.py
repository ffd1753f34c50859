"""The Trunk's twin as a node: along the demo's path between the cylinders, leaning on them."""

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.ros.twin_node import TwinNode
from softrobot_twin.scene.loading import written_out
from test.builder import builder
from test.places import ROOT
from test.scene_changes import yaml_file

GIVEN = yaml.safe_load((ROOT / "config/trunk.yaml").read_text())["/**"]["ros__parameters"]


@pytest.fixture(scope="module")
def mapping():
    """The Trunk's scene on its coarse mesh."""
    scene = written_out(yaml.safe_load((ROOT / "config" / GIVEN["scene_file"]).read_text()))
    scene["body"]["mesh"]["file"] = str(ROOT / "meshes/trunk_700.vtk")
    return scene


@builder
def make_trunk(world, mapping, tmp_path, /, contact=None, **changes):
    """Makes the Trunk's twin from its parameter file, some of them and of the scene replaced."""
    scene = {**mapping, "contact": {**mapping["contact"], **(contact or {})}}
    file = yaml_file(tmp_path / "trunk.yaml", scene)
    given = {"scene_file": str(file), "use_device": False, "message_timeout": 20.0}
    return world.add(TwinNode, **{**GIVEN, **given, **changes})


def test_an_infeasible_force_limit_is_relaxed_and_named(world, make_trunk, diagnostics):
    # With the largest contact force at zero, the commanded platform pushes the body into a
    # cylinder.
    twin = make_trunk(contact={"force_limit": 1e-4})
    targets = world.speaker(PointStamped, "/twin/target/tip")
    commands = world.speaker(JointState, "/twin/command/cables")
    lengths = twin.loop.simulation.rest_setpoints.copy()
    lengths[-1] = 0.02
    commands.publish(JointState(
        header=Header(stamp=world.stamp()), name=list(twin.loop.simulation.actuator_names),
        position=lengths.tolist()))
    targets.publish(world.target_message(twin.loop.simulation.effector_positions()[0]))
    account = diagnostics("contact", lambda account: account.values.get("given_up"))
    assert account.level == DiagnosticStatus.WARN
    assert account.values["given_up"] == "trunk.cylinder_left.force_limit_exceeded"
    assert float(account.values["force_limit_n"]) == 1e-4
    assert float(account.values["one_contact_max_n: on trunk by cylinder_left"]) > 1e-4
    limits = diagnostics("limits")
    assert "trunk.cylinder_left.force_limit_exceeded" in limits.values["active"]
