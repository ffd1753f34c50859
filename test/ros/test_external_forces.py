"""Forces that an observer found, as messages and in the diagnostics."""

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header

from softrobot_twin.errors import SceneError
from softrobot_twin.ros.messages import markers_message
from softrobot_twin.ros.twin_node import TwinNode
from test.scene_changes import yaml_file

TIP = [0.0, 0.0, 0.125]


@pytest.fixture
def twin(world, small_scene_file, diagnostics):
    scene = yaml.safe_load(small_scene_file.read_text())
    scene["observer"] = {"forces": [{"name": "push", "points": [TIP]}], "marker_noise": 2e-5}
    file = yaml_file(small_scene_file.with_name("observed_diamond.yaml"), scene)
    return world.add(TwinNode, scene_file=str(file), rate=50.0, priority="normal")


def test_a_displacement_of_the_markers_is_told_as_a_force(world, diagnostics, twin):
    forces = world.hear(WrenchStamped, "/twin/external_forces/push")
    spreads = world.hear(JointState, "/twin/force_deviations/push")
    contacts = world.hear(JointState, "/twin/external_contacts")
    markers = world.speaker(PointCloud2, "/twin/markers")
    simulation = twin.loop.simulation
    still = simulation.marker_positions()

    def see(moved):
        header = Header(stamp=world.stamp(), frame_id="base_link")
        markers.publish(markers_message(simulation.marker_ids, still + moved, header))

    # Those around the tip go aside: this is a push along x.
    pushed = np.zeros((len(still), 3))
    pushed[4:, 0] = 0.002
    for _ in range(60):
        see(pushed)
        count = len(forces)
        world.until(lambda count=count: len(forces) > count)
    assert forces[-1].wrench.force.x > 0.02
    assert forces[-1].wrench.torque.x == 0.0
    assert list(spreads[-1].name) == ["x", "y", "z"]
    assert np.linalg.norm(np.array(spreads[-1].position) - TIP) < 0.01
    assert 0.0 < spreads[-1].effort[0] < forces[-1].wrench.force.x
    assert list(contacts[-1].name) == ["push"] and contacts[-1].position[0] == 1.0
    see(pushed)
    told = diagnostics("observer", lambda one: one.message == "found: push")
    assert float(told.values["push_force_n"].split()[0]) > 0.02


def test_with_the_parameter_a_scene_without_observer_has_one(world, small_scene_file):
    twin = world.add(TwinNode, scene_file=str(small_scene_file), observer=True, priority="normal")
    assert twin.loop.observer.names == ("tip",)  # Its effector.
    published = [name for name, _ in twin.get_topic_names_and_types()]
    assert "/twin/external_forces/tip" in published


def test_the_parameter_is_refused_where_nothing_can_be_observed(world, small_scene_file):
    scene = yaml.safe_load(small_scene_file.read_text())
    scene["markers"], scene["effectors"][0]["measured_by"] = scene["markers"][:2], []
    file = yaml_file(small_scene_file.with_name("two_markers.yaml"), scene)
    with pytest.raises(SceneError, match="an observer needs three markers or more"):
        world.add(TwinNode, scene_file=str(file), observer=True, priority="normal")
