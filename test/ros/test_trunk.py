"""The Trunk's twin as a node: along the demo's path between the cylinders, leaning on them."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.target_path import read_waypoints
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.ros.topics import STREAM
from softrobot_twin.ros.twin_node import TwinNode
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import Status
from test.builder import builder

ROOT = Path(__file__).resolve().parents[2]
GIVEN = yaml.safe_load((ROOT / "config/trunk.yaml").read_text())["/**"]["ros__parameters"]
PATH = ROOT / "config" / GIVEN["target_path"]
PLATFORM = "platform_z"


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
    file = tmp_path / "trunk.yaml"
    file.write_text(yaml.safe_dump(scene))
    given = {"scene_file": str(file), "use_device": False, "message_timeout": 20.0}
    return world.add(TwinNode, **{**GIVEN, **given, **changes})


def lead(world, twin, tick, targets, position):
    """Publishes a target of the tip, lets the twin receive it and run a tick."""
    targets.publish(world.target_message(position))
    world.until(lambda: np.allclose(
        twin.loop.targets.read(twin.monotonic(), 0.0, np.zeros((1, 3))).targets[0], position))
    tick()


@pytest.mark.exhaustive
def test_the_tip_follows_the_demo_s_path_between_the_cylinders(world, make_trunk, diagnostics):
    # Without a deadline a step depends on no clock, and the path is always the same.
    twin = make_trunk(deadline=0.0)
    tick = world.ticks_of(twin)
    cables = world.hear(JointState, "/twin/cables", 100)
    contacts = world.hear(PointCloud2, "/twin/contacts", STREAM)
    targets = world.speaker(PointStamped, "/twin/target/tip")
    for _ in range(5):
        tick()
    path = read_waypoints(PATH, "tip")
    start = twin.loop.simulation.effector_positions()[0]
    errors, gaps, statuses, counts = [], [], set(), []
    period, ramp = 1.0 / GIVEN["rate"], 60
    for number in range(ramp + round(path.times[-1] / period)):
        on_path = path.position(max(0, number - ramp) * period)
        lead(world, twin, tick, targets, start + min(1.0, number / ramp) * (on_path - start))
        result = twin.window.newest.result
        errors.append(twin.window.newest.tracking_errors[0])
        gaps.append(result.contacts.gaps.min(initial=0.0))
        counts.append(len(result.contacts.gaps))
        statuses.add(result.status)
    errors = np.array(errors[ramp:])
    assert np.median(errors) < 1e-6 and errors.max() < 1e-5
    assert min(gaps) >= -1e-8
    assert not any(status.is_failure for status in statuses) and Status.INVERTED not in statuses
    assert counts[0] == 0 and max(counts) >= 1 and counts[-1] == 0
    world.until(lambda: contacts and cables)
    assert cables[-1].name[-1] == PLATFORM and len(cables[-1].effort) == 9
    assert max(message.position[-1] for message in cables) > 0.04
    told = [status for message in diagnostics.messages for status in message.status
            if status.name == "twin: contact"]
    assert any(pair.key.startswith("one_contact_max_n: on trunk by cylinder") for status in told for pair in status.values)
    residuals = [float(pair.value) for status in told for pair in status.values
                 if pair.key == "residual_mm"]
    assert residuals and max(residuals) < 1e-6
    assert {"programs_max"} <= {pair.key for status in told for pair in status.values}


def test_a_platform_commanded_beside_targets_stays_at_its_command(world, make_trunk, diagnostics):
    twin = make_trunk()
    cables = world.hear(JointState, "/twin/cables")
    targets = world.speaker(PointStamped, "/twin/target/tip")
    commands = world.speaker(JointState, "/twin/command/cables")
    world.until(lambda: len(cables) > 3)
    tip = twin.loop.simulation.effector_positions()[0]
    targets.publish(world.target_message(tip + [0.004, 0.006, -0.002]))
    header = Header(stamp=world.stamp())
    commands.publish(JointState(header=header, name=[PLATFORM], position=[0.003]))
    world.until(lambda: abs(cables[-1].position[-1] - 0.003) < 1e-6)
    account = diagnostics("target", lambda account: "commanded" in account.values)
    assert account.values["commanded"] == PLATFORM
    assert float(account.values["commanded_age_s"]) >= 0.0
    refused = JointState(header=Header(stamp=world.stamp()), name=[PLATFORM], effort=[1.0])
    commands.publish(refused)
    world.until(lambda: twin.loop.selected.refusals.of(Refusal.WRONG_FIELDS) == 1)
    commands.publish(JointState(header=Header(stamp=world.stamp())))
    world.until(lambda: twin.loop.selected.setpoints is None)
    diagnostics("target", lambda account: "commanded" not in account.values)


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


def test_the_target_file_is_found_beside_the_scenes(world):
    target = world.add(TargetNode, target_path=GIVEN["target_path"], target_ramp_time=0.0)
    assert target.path.points.shape[1] == 3
    with pytest.raises(ParameterError, match="no_such_path"):
        world.add(TargetNode, target_path="targets/no_such_path.csv")
