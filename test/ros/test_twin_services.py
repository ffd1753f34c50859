"""The twin as a node: its services, its view, and inputs with which it does not start."""

import pytest
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from softrobot_twin.control.engagement import Activity
from softrobot_twin.errors import ParameterError, SceneError
from softrobot_twin.ros.messages import cables_message

INSIDE = (0.008, 0.004, 0.134)


def run_ticks(world, effectors, count):
    """Runs until so many more positions of the effector came, one for each tick."""
    before = len(effectors)
    world.until(lambda: len(effectors) >= before + count)


def measured(world, twin, lengths):
    names = twin.loop.simulation.actuator_names
    return cables_message(names, lengths, [0.0] * len(names), Header(stamp=world.stamp()))


def test_with_a_device_nothing_is_commanded_before_it_is_enabled(world, make_twin):
    twin = make_twin(use_device=True, device_timeout=5.0)
    cables = world.hear(JointState, "/twin/cables", 100)
    effectors = world.hear(PointStamped, "/twin/effectors/tip")
    world.until(lambda: len(effectors) > 3)
    assert not cables
    refused = world.enable()
    assert not refused.success and "measured setpoints" in refused.message
    wound = twin.loop.simulation.rest_setpoints - [0.006, 0.002, 0.0, 0.004]
    device = world.speaker(JointState, "/twin/measured_cables")
    device.publish(measured(world, twin, wound))
    world.until(lambda: twin.loop.device.setpoints is not None)
    assert world.enable().success
    world.until(lambda: cables)
    assert list(cables[0].position) == pytest.approx(wound.tolist(), abs=1e-5)
    assert world.enable(False).success
    run_ticks(world, effectors, 5)
    before = len(cables)
    run_ticks(world, effectors, 15)
    assert len(cables) == before


def test_a_lost_device_makes_the_twin_hold_and_is_reported(world, make_twin, diagnostics):
    twin = make_twin(use_device=True, device_timeout=0.5, on_lost_device="hold")
    device = world.speaker(JointState, "/twin/measured_cables")

    def is_enabled():
        device.publish(measured(world, twin, twin.loop.simulation.rest_setpoints))
        return world.enable().success

    # On a busy machine the answer may come after the timeout.
    world.until(is_enabled)
    targets = world.speaker(PointStamped, "/twin/target/tip")
    targets.publish(world.target_message(INSIDE))
    status = diagnostics("device", lambda status: "lost" in status.message)
    assert status.level == b"\x02" and status.message == "device lost: holding"
    assert diagnostics("solver").values["activity"] == Activity.HOLDING.value


def test_lost_markers_are_reported_and_the_loop_continues_open(world, make_twin, diagnostics):
    make_twin(closed_loop=True, on_lost_markers="open_loop", marker_timeout=0.2)
    status = diagnostics("markers", lambda status: "lost" in status.message)
    assert status.level == b"\x01" and status.message == "markers lost: open loop"


def test_a_view_can_be_recorded(world, make_twin, diagnostics, tmp_path):
    file = tmp_path / "run.rrd"
    twin = make_twin(record_file=str(file), record_every=1)
    status = diagnostics("view", lambda status: int(status.values["frames_logged"]) > 5)
    assert status.level == b"\x00" and status.values["failure"] == ""
    twin.destroy_node()
    assert file.stat().st_size > 10_000


@pytest.mark.parametrize("parameters, error, reason", [
    ({"scene_file": "/nowhere.yaml"}, ParameterError, "no such file"),
    ({"mode": "sideways"}, ParameterError, "must be one of"),
    ({"velocity_effector": "elbow"}, ParameterError, "elbow"),
    ({"workspace_min": [1.0, 2.0]}, ParameterError, "three finite numbers"),
    ({"rate": 30}, ParameterError, "type"),
])  # fmt: skip
def test_impossible_parameters_are_refused_at_start_up(world, make_twin, parameters, error, reason):
    with pytest.raises(error, match=reason):
        make_twin(**parameters)
    # No part of it stays in the graph.
    world.until(lambda: ("twin", "/") not in world.probe.get_node_names_and_namespaces())


def test_an_impossible_scene_is_refused_at_start_up(make_twin, tmp_path):
    file = tmp_path / "scene.yaml"
    file.write_text("name: diamond\nbody: 3\n")
    with pytest.raises(SceneError, match="body"):
        make_twin(scene_file=str(file))
