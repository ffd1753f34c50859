"""Facts of scenes with quadratic elements or the linear law."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets
from test.scene_changes import changed, repeat_step

quadratic = changed({"body.element": "quadratic"})


linear_law = changed({"body.material.law": "linear"})


small = changed(quadratic, {"body.mesh.file": "../../meshes/diamond_150.vtk"})


both = changed(quadratic, linear_law)


def test_mid_edge_nodes_are_added_and_counted(diamond):
    coarse, fine = diamond(), diamond(quadratic)
    mesh = fine.model.bodies[0].mesh
    edge_count = len(mesh.mid_edge_ends)
    assert fine.node_count == coarse.node_count + edge_count == len(fine.state.positions)
    assert fine.tet_count == coarse.tet_count
    assert fine.dof_count == 3 * len(fine.model.nodes.free_nodes) > 4 * coarse.dof_count
    assert all("it buckles" in note for note in fine.notes)


def test_a_mid_edge_node_between_fixed_nodes_is_fixed(diamond):
    body = diamond(quadratic).model.bodies[0]
    fixed = body.fixed
    corner_count = body.mesh.corner_mesh.node_count
    held = fixed[body.mesh.mid_edge_ends].all(axis=1)
    assert held.any() and np.all(fixed[corner_count:][held])

    def by_number(mapping):
        quadratic(mapping)
        mapping["body"]["fixed"] = [{"nodes": np.flatnonzero(fixed[:corner_count]).tolist()}]

    np.testing.assert_array_equal(diamond(by_number).model.nodes.free_index < 0, fixed)


def test_points_are_placed_where_the_scene_has_them(diamond):
    simulation = diamond(quadratic)
    scene = simulation.scene
    np.testing.assert_allclose(
        simulation.marker_positions(), [marker.point for marker in scene.markers], atol=1e-12
    )
    for path, cable in zip(simulation.actuator_paths().values(), scene.cables, strict=True):
        np.testing.assert_allclose(path, [cable.pull_point, *cable.points], atol=1e-12)
    np.testing.assert_allclose(
        simulation.effector_positions(), [e.points[0] for e in scene.effectors], atol=1e-12
    )


@pytest.mark.parametrize("change", [quadratic, both])
def test_newton_converges_faster_than_linearly(diamond, change):
    simulation = diamond(change)
    results = [simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.005, 10.0))
               for _ in range(6)]
    residuals = np.array([result.report.residual for result in results])
    assert not any(result.report.projected_tangent for result in results)
    ratios = residuals[1:] / residuals[:-1]
    quickest = np.argmin(ratios)
    assert residuals[-1] < 1e-11
    assert ratios[quickest] < 1e-3 and np.all(np.diff(ratios[: quickest + 1]) < 0.0)


@pytest.mark.sampled
@pytest.mark.parametrize("change", [quadratic, linear_law, both])
def test_targets_in_the_workspace_are_met(diamond, circle, change):
    simulation = diamond(change)
    for targets in circle(4):
        result = repeat_step(simulation, FollowTargets(targets, 10.0), 6)
        assert result.status.is_success
        assert result.effector_errors[0] < 1e-5


def test_quadratic_elements_are_softer_and_both_laws_agree_for_small_displacements(diamond, settle):
    def light(change):
        return changed(change, {"gravity": [0.0, 0.0, -0.01]})

    def sag(change):
        simulation = diamond(light(change))
        before = simulation.effector_positions()[0, 2]
        settle(simulation)
        return before - simulation.effector_positions()[0, 2]

    linear = sag(lambda mapping: None)
    assert sag(quadratic) > 1.3 * linear > 0.0
    assert sag(linear_law) == pytest.approx(linear, rel=1e-2)
    assert sag(both) == pytest.approx(sag(quadratic), rel=1e-2)


@pytest.mark.sampled
@pytest.mark.parametrize("change, steps", [(None, 400), (small, 150)], ids=["linear", "quadratic"])
@pytest.mark.parametrize("collapse", ["plane", "point", "random", "mirrored"])
def test_a_collapsed_body_recovers_its_shape_or_is_reported_as_inverted(
    diamond, collapse, recovers, change, steps
):
    recovers(diamond(change), collapse, steps)


def test_the_surface_follows_the_bent_edges(diamond):
    simulation = diamond(quadratic)
    triangles, points = simulation.surface_triangles, simulation.surface_positions()
    assert triangles.max() == len(points) - 1
    assert len(triangles) == 4 * len(diamond().surface_triangles)
    a, b, c = points[triangles].transpose(1, 0, 2)
    volume = np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0
    assert volume == pytest.approx(simulation.model.bodies[0].mesh.volume)
