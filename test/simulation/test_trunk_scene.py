"""The Trunk: how it hangs, where it reaches, and how it goes between the cylinders."""

import copy

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from test.builder import builder
from test.places import CONFIG
from test.scene_changes import LEFT_OUT, change_scene, changed, repeat_step, solved

TIME_STEP = 0.02
MAPPINGS = {
    name: written_out(read_yaml((CONFIG / "scenes" / f"{name}.yaml").read_text()))
    for name in ("trunk", "trunk_cylinders", "trunk_device")
}


@builder
def trunk(name="trunk", change=None, newton_iterations=1) -> Simulation:
    """Makes a simulation of one of the Trunk's scenes, of linear elements on its coarsest mesh."""
    mapping = copy.deepcopy(MAPPINGS[name])
    mapping["body"]["mesh"]["file"] = "../../meshes/trunk_700.vtk"
    mapping["body"]["element"] = "linear"
    mapping["solver"] = {"newton_iterations": newton_iterations}
    change_scene(mapping, change)
    return Simulation(scene_from_mapping(mapping, CONFIG / "scenes" / f"{name}.yaml"))


@pytest.fixture(scope="module")
def path():
    """Targets between the cylinders and beyond, at the loop's rate [m], shape (count, 1, 3)."""
    table = np.loadtxt(CONFIG / "targets" / "trunk_path.csv", delimiter=",", skiprows=1)
    times = np.arange(0.0, table[-1, 0] + 1e-9, TIME_STEP)
    points = [np.interp(times, table[:, 0], table[:, axis]) for axis in (1, 2, 3)]
    return np.stack(points, axis=1)[:, None, :]


def sag(simulation):
    """How far the tip hangs down at rest lengths [m]."""
    result = solved(simulation, Hold(TIME_STEP), 20)
    assert result.report.residual < 1e-6
    return -result.effector_positions[0, 1]


def depth(simulation):
    """How deep nodes of the body are in either cylinder of the scene [m], shape (2,)."""
    body = simulation.state.positions[: simulation.model.bodies[0].mesh.node_count]
    depths = []
    for entry in MAPPINGS["trunk_cylinders"]["obstacles"]:
        x, _, z = entry["cylinder"]["ends"][0]
        away = np.hypot(body[:, 0] - x, body[:, 2] - z)
        depths.append(entry["cylinder"]["radius"] - away.min())
    return np.array(depths)


def follow(simulation, path):
    """Goes along a path; errors and greatest depths [m], and how the steps ended."""
    repeat_step(simulation, FollowTargets(path[0], TIME_STEP), 60)
    errors, depths, statuses = [], [], []
    for target in path:
        result = simulation.step(FollowTargets(target, TIME_STEP))
        errors.append(result.effector_errors[0])
        depths.append(depth(simulation))
        statuses.append(result.status)
    return np.array(errors), np.max(depths, axis=0), statuses


def test_the_upper_cables_hold_the_trunk_that_would_hang_down(trunk):
    simulation = trunk()
    assert 0.010 < sag(simulation) < 0.030
    upper = [simulation.actuator_names.index(name) for name in ("L0", "S0")]
    tensions = simulation.state.efforts[:8]
    assert tensions[upper].min() > 0.1
    np.testing.assert_allclose(np.delete(tensions, upper), 0.0, atol=1e-9)


def test_tubes_in_the_disks_stiffen_and_whole_tubes_would_hold_the_trunk_straight(trunk):
    none = changed({"tubes": LEFT_OUT})
    def whole(mapping):
        mapping["tubes"] = [
            {"name": cable["name"] + "_tube", "points": cable["points"], "axial_stiffness": 250.0}
            for cable in mapping["cables"]
        ]

    lined = sag(trunk())
    assert 0.6 * sag(trunk(change=none)) < lined < sag(trunk(change=none))
    assert sag(trunk(change=whole)) < 0.2 * lined


@pytest.mark.sampled
@pytest.mark.parametrize("target", [
    (40, 0, 180), (-40, 20, 175), (0, 80, 150), (40, 80, 140), (40, -20, 170), (-40, 60, 160),
], ids=str)  # fmt: skip
def test_the_tip_reaches_the_published_workspace(trunk, target):
    simulation = trunk()
    result = repeat_step(simulation, FollowTargets(1e-3 * np.array([target]), TIME_STEP), 100)
    assert result.effector_errors[0] < 1e-5
    assert result.efforts[:8].min() >= -1e-12


def test_the_platform_moves_the_trunk_without_deformation(trunk):
    simulation = trunk(newton_iterations=3)
    sag(simulation)
    before = simulation.state.positions.copy()
    lengths = simulation.state.setpoints.copy()
    platform = simulation.actuator_names.index("platform_z")
    for _ in range(20):
        lengths[platform] += 0.001
        result = solved(simulation, CommandSetpoints(lengths, TIME_STEP))
    moved = result.state.positions - before
    np.testing.assert_allclose(moved, np.array([[0, 0, 0.020]]) * np.ones((len(moved), 1)),
                               atol=1e-7)


@pytest.mark.exhaustive
def test_without_contact_the_body_crosses_both_cylinders(trunk, path):
    errors, depths, _ = follow(trunk(), path)
    assert errors.max() < 1e-4
    assert depths.min() > 2e-3


@pytest.mark.exhaustive
def test_with_contact_the_tip_moves_between_the_cylinders_and_beyond(trunk, path):
    errors, depths, statuses = follow(trunk("trunk_cylinders"), path)
    assert depths.max() < 5e-5
    assert errors.mean() < 2e-4
    assert Status.DIVERGED not in statuses
    assert Status.INVERTED not in statuses


@pytest.mark.exhaustive
def test_a_trunk_pulled_against_a_cylinder_presses_on_it(trunk):
    simulation = trunk("trunk_cylinders", newton_iterations=3)
    names = simulation.actuator_names
    forward = np.array([8.0, 6.0, 7.2, 9.2, 3.2, 2.8, 4.0, 4.4, 0.0])
    forward[names.index("platform_z")] = -52.0
    aside = np.array([0.0, 6.0, 0.0, -6.0, 0.0, 3.0, 0.0, -3.0, 0.0])
    rest = simulation.rest_setpoints
    for part in np.linspace(0.0, 1.0, 54):
        simulation.step(CommandSetpoints(rest - 1e-3 * part * forward, TIME_STEP))
    for part in np.append(np.linspace(0.0, 1.0, 40), np.ones(30)):
        result = simulation.step(CommandSetpoints(rest - 1e-3 * (forward + part * aside), TIME_STEP))
    forces = result.contacts.forces.sum(axis=0)
    assert forces[0] > 0.1  # the left cylinder pushes it to the right
    assert result.contacts.gaps.min() > -1e-6
    assert depth(simulation).max() < 1e-6
