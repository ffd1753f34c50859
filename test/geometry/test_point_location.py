import itertools

import numpy as np
import pytest

from softrobot_twin.geometry.point_location import closest_on_triangles, locate_points
from softrobot_twin.geometry.tet_mesh import TetMesh

pytestmark = pytest.mark.libraries


def held_points(mesh, location):
    return np.einsum("pn,pni->pi", location.barycentric_weights, mesh.node_positions[location.nodes])


def test_weights_of_inside_points_reproduce_the_points(block):
    mesh = block()
    points = np.random.default_rng(3).uniform(0, 1, (3000, 3)) * mesh.bounding_box[1]
    location = locate_points(mesh, points)
    np.testing.assert_allclose(held_points(mesh, location), points, atol=1e-14)
    np.testing.assert_allclose(location.barycentric_weights.sum(axis=1), 1.0, atol=1e-14)
    assert (location.barycentric_weights >= 0).all()
    assert (location.distances == 0).all()
    np.testing.assert_array_equal(location.nodes, mesh.cells[location.cells])
    assert location.cells.dtype == location.nodes.dtype == np.int64


def test_nodes_and_points_on_faces_are_inside(block):
    mesh = block()
    face_centres = mesh.node_positions[mesh.cells[:, :3]].mean(axis=1)
    points = np.concatenate([mesh.node_positions, face_centres])
    location = locate_points(mesh, points)
    assert (location.distances == 0).all()
    np.testing.assert_allclose(held_points(mesh, location), points, atol=1e-14)


def test_outside_points_are_located_at_the_nearest_point_of_the_surface(block):
    mesh = block(size=(0.2, 0.3, 0.4))
    points = np.random.default_rng(4).uniform(-0.3, 0.8, (2000, 3))
    nearest = np.clip(points, 0, [0.2, 0.3, 0.4])
    location = locate_points(mesh, points)
    np.testing.assert_allclose(held_points(mesh, location), nearest, atol=1e-13)
    np.testing.assert_allclose(location.distances, np.linalg.norm(points - nearest, axis=1), atol=1e-13)
    assert (location.barycentric_weights >= 0).all()
    np.testing.assert_allclose(location.barycentric_weights.sum(axis=1), 1.0, atol=1e-14)


def test_a_point_with_a_weight_of_minus_one_fifth_is_snapped_and_its_distance_is_given():
    mesh = TetMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2, 3]])
    location = locate_points(mesh, [0.4, 0.4, -0.2])
    np.testing.assert_allclose(location.barycentric_weights, [[0.2, 0.4, 0.4, 0.0]], atol=1e-15)
    assert location.distances == pytest.approx([0.2])


def test_far_points_are_located_too(block):
    location = locate_points(block(size=(0.2, 0.3, 0.4)), [[1e3, 0.15, 0.2], [0.1, 0.1, 0.1]])
    assert location.distances == pytest.approx([1e3 - 0.2, 0.0])


def test_points_are_located_in_a_small_body_far_from_the_origin(block):
    mesh = block()
    placed = TetMesh(mesh.node_positions * 1e-3 + 2.0, mesh.cells)
    points = np.random.default_rng(5).uniform(0, 1, (200, 3)) * 1e-3 * mesh.bounding_box[1] + 2.0
    location = locate_points(placed, points)
    np.testing.assert_allclose(held_points(placed, location), points, atol=1e-13)


def test_points_on_shared_faces_always_go_to_the_same_tetrahedron(block):
    mesh = block()
    alone = [int(locate_points(mesh, point).cells[0]) for point in mesh.node_positions]
    assert locate_points(mesh, mesh.node_positions).cells.tolist() == alone


def test_no_point_of_the_triangle_is_closer():
    random = np.random.default_rng(2)
    corners = random.normal(size=(200, 3, 3))
    points = 2 * random.normal(size=(200, 3))
    weights = closest_on_triangles(points, corners)
    found = np.linalg.norm(points - np.einsum("pc,pci->pi", weights, corners), axis=1)
    steps = itertools.product(range(21), repeat=2)
    samples = np.array([(i, j, 20 - i - j) for i, j in steps if i + j <= 20])
    sampled = np.einsum("sc,pci->psi", samples / 20, corners)
    smallest = np.linalg.norm(points[:, None] - sampled, axis=2).min(axis=1)
    assert (found <= smallest + 1e-12).all()
    assert (weights >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)


def test_each_region_of_the_plane_has_its_closest_point():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    cases = {
        (0.2, 0.2, 5): (0.6, 0.2, 0.2), (0.5, -3, 1): (0.5, 0.5, 0), (1, 1, 0): (0, 0.5, 0.5),
        (-1, 0.25, 0): (0.75, 0, 0.25), (-1, -1, 0): (1, 0, 0), (3, -1, 0): (0, 1, 0),
        (-1, 3, 0): (0, 0, 1),
    }  # fmt: skip
    weights = closest_on_triangles(np.array(list(cases), float), np.stack([corners] * len(cases)))
    np.testing.assert_allclose(weights, np.array(list(cases.values())), atol=1e-14)


def test_a_triangle_without_area_is_treated_as_its_edges():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1.0, 1, 1]] * 3])
    weights = closest_on_triangles(np.array([[1.5, 1, 0], [0.0, 0, 0]]), corners)
    closest = np.einsum("pc,pci->pi", weights, corners)
    np.testing.assert_allclose(closest, [[1.5, 0, 0], [1, 1, 1]], atol=1e-14)
