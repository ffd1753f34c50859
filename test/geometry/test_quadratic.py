"""Facts of quadratic meshes."""

import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import EDGES, quadratic_values
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.tet_mesh import TetMesh


def test_every_edge_gets_one_node_in_its_middle(block):
    linear = block(cells=(2, 2, 3))
    mesh = add_mid_edge_nodes(linear)
    x = mesh.node_positions
    np.testing.assert_array_equal(x[: linear.node_count], linear.node_positions)
    ends = x[mesh.cells[:, EDGES]]
    np.testing.assert_allclose(x[mesh.cells[:, 4:]], ends.mean(axis=2), atol=1e-15)
    # V - E + F - T = 1 for a body without holes.
    faces = np.sort(linear.cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]], axis=2)
    face_count = len(np.unique(faces.reshape(-1, 3), axis=0))
    edge_count = mesh.node_count - linear.node_count
    assert linear.node_count - edge_count + face_count - linear.cell_count == 1
    assert len(np.unique(x.round(12), axis=0)) == mesh.node_count


def test_shape_functions_are_one_at_their_node_and_sum_to_one():
    corners = np.eye(4)
    nodes = np.vstack([corners, corners[EDGES].mean(axis=1)])
    np.testing.assert_allclose(quadratic_values(nodes), np.eye(10), atol=1e-15)
    anywhere = np.random.default_rng(0).dirichlet(np.ones(4), 20)
    assert quadratic_values(anywhere).sum(axis=1) == pytest.approx(1.0)


def test_interpolated_points_follow_a_quadratic_field_exactly(block):
    mesh = add_mid_edge_nodes(block())
    points = np.random.default_rng(3).uniform(0.02, 0.18, (40, 3))
    found = locate_points(mesh.corner_mesh, points)
    nodes, weights = mesh.carriers(found.cells, found.barycentric_weights)
    form = np.random.default_rng(4).standard_normal((3, 3, 3))

    def field(x):
        return x + np.einsum("ijk,nj,nk->ni", form, x, x)

    carried = np.einsum("pa,pai->pi", weights, field(mesh.node_positions)[nodes])
    np.testing.assert_allclose(carried, field(points), atol=1e-14)


def test_surface_covers_the_body_with_four_outward_triangles_a_face(block):
    linear = block()
    mesh = add_mid_edge_nodes(linear)
    triangles = mesh.surface_triangles
    assert len(triangles) == 4 * len(boundary_triangles(linear.cells))
    a, b, c = mesh.node_positions[triangles].transpose(1, 0, 2)
    # Gauss: closed and facing outwards, or the volume would not come out.
    assert np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0 == pytest.approx(linear.volume)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0.0
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}


def test_shares_of_a_uniform_load_are_the_integrals_of_the_shape_functions():
    rng = np.random.default_rng(0)
    samples = quadratic_values(rng.dirichlet(np.ones(4), 400_000)).mean(axis=0)
    one = add_mid_edge_nodes(TetMesh(np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 1, 2, 3]])))
    np.testing.assert_allclose(one.load_shares, samples, atol=2e-3)
    assert one.load_shares.sum() == pytest.approx(1.0)
