"""A cable that holds on a patch."""

import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_changes import with_mesh_file
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.simulation.building.deformable_body import spread_mapping
from softrobot_twin.simulation.building.scene_layout import lay_out
from softrobot_twin.study.accuracy_study import with_hold_radius
from test.places import ROOT

SCENE = ROOT / "config" / "scenes" / "diamond.yaml"


def diamond(size, radius):
    scene = with_mesh_file(load_scene(SCENE), ROOT / "meshes" / f"diamond_{size}.vtk")
    return Simulation(with_hold_radius(scene, radius))


def hold(simulation):
    """The first cable's hold at rest [m]."""
    return simulation.model.actuators.terms[0].paths[0].points.positions(simulation.state.positions)[0]


def test_without_a_radius_a_cable_is_attached_at_its_point():
    np.testing.assert_allclose(hold(diamond(400, 0.0)), [0.0, 0.097, 0.045], atol=1e-12)


def test_a_patch_is_the_same_on_every_mesh():
    places = [hold(diamond(size, 0.004)) for size in (150, 400, 1600)]
    np.testing.assert_allclose(places[1:], [places[0]] * 2, atol=1e-9)
    # On a face only half of the ball lies in the body: the mean lies within, by 3/8 of the radius
    # but for the coarseness of the sampling.
    assert places[0][1] == pytest.approx(0.097 - 0.375 * 0.004, abs=0.4e-3)


def test_the_work_of_a_patch_is_that_of_its_cable():
    simulation = diamond(400, 0.004)
    cables, positions = simulation.model.actuators.terms[0], simulation.state.positions
    blocks, values = cables.rows_at(positions)
    free = simulation.model.nodes.free_nodes
    move = np.random.default_rng(3).normal(size=positions.shape) * 1e-7
    moved = positions.copy()
    moved[free] += move[free]
    expected = np.bincount(cables.entry_rows, minlength=4, weights=np.einsum(
        "ei,ei->e", blocks, move[free][cables.entry_nodes]))
    found = cables.lengths(positions) - cables.lengths(moved)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-12)


def test_prescribed_lengths_are_met_with_a_patch():
    simulation = diamond(400, 0.004)
    for _ in range(20):
        result = simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.004, 0.1))
    np.testing.assert_allclose(result.displacements, 0.004, atol=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize("leaving", [0.0, 1.0], ids=["along the surface", "out of the body"])
def test_the_weights_of_a_patch_have_continuous_derivatives_by_radius_and_place(drawn_rng, leaving):
    """Second differences fall by the square of the step: a kink would let them fall by the step."""
    scene = with_mesh_file(load_scene(SCENE), ROOT / "meshes" / "diamond_150.vtk")
    body = lay_out(scene, []).bodies[0]
    mesh, start = body.mesh, np.array([0.0, 0.097 - leaving * 0.0015, 0.045])
    way = 1e-3 * drawn_rng.normal(size=3) * [1.0, 0.0, 1.0] + [0.0, leaving * 0.003, 0.0]

    def weights(share):
        place = (start + share * way)[None]
        found = locate_points(mesh.corner_mesh, place)
        patch = spread_mapping(body, place, found, 0.0036 * (1.0 + 0.3 * share))
        whole = np.zeros(mesh.node_count)
        np.add.at(whole, patch.nodes[0], patch.barycentric_weights[0])
        return whole

    bends = []
    for count in (25, 50, 100):
        at = np.array([weights(share) for share in np.linspace(0.0, 1.0, count + 1)])
        np.testing.assert_allclose(at.sum(axis=1), 1.0, rtol=0, atol=1e-12)
        assert at.min() >= 0.0
        bends.append(np.abs(np.diff(at, 2, axis=0)).max())
    print(bends)
    assert bends[2] < 0.1 * bends[0]
