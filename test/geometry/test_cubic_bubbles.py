"""Facts of the cubic bubbles on quadratic tetrahedra."""

import numpy as np
import pytest

from softrobot_twin.geometry.cubic_bubbles import (
    FACE_LOAD_SHARE,
    FACES,
    FIRST_EDGE,
    FIRST_FACE,
    add_bubbles,
    cubic_slopes,
    cubic_values,
)
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import EDGES


def test_bubbles_vanish_at_the_nodes_of_quadratic_elements():
    nodes = np.vstack([np.eye(4), np.eye(4)[EDGES].mean(axis=1)])
    np.testing.assert_allclose(cubic_values(nodes)[:, FIRST_EDGE:], 0.0, atol=1e-16)


def test_slopes_are_the_derivatives_of_the_functions():
    points, step = np.random.default_rng(2).dirichlet(np.ones(4), 15), 1e-6
    slopes = cubic_slopes(points)
    for direction in range(4):
        way = step * np.eye(4)[direction]
        differences = (cubic_values(points + way) - cubic_values(points - way)) / (2.0 * step)
        np.testing.assert_allclose(slopes[:, :, direction], differences, atol=1e-9)


def test_nodes_and_bubbles_together_carry_a_cubic_field(block):
    """Coefficients are found in some points; others then follow, in every tetrahedron."""
    mesh = add_bubbles(add_mid_edge_nodes(block(cells=(1, 2, 2))))
    rng = np.random.default_rng(5)
    count = mesh.node_count + len(mesh.bubble_corners)

    def carried_by(points):
        found = locate_points(mesh.corner_mesh, points)
        functions, values = mesh.carriers(found.cells, found.barycentric_weights)
        weights = np.zeros((len(points), count))
        np.add.at(weights, (np.arange(len(points))[:, None], functions), values)
        return weights

    def field(x):
        return 1.0 + x[:, 0] ** 3 - 2.0 * x[:, 0] * x[:, 1] * x[:, 2] + x[:, 2] ** 2 * x[:, 1]

    low, high = mesh.bounding_box
    known, others = (rng.uniform(low, high, (n, 3)) for n in (6 * count, 200))
    coefficients = np.linalg.lstsq(carried_by(known), field(known), rcond=None)[0]
    np.testing.assert_allclose(carried_by(others) @ coefficients, field(others), atol=1e-9)


def test_bubbles_are_those_of_all_edges_and_all_faces(block):
    linear = block()
    quadratic = add_mid_edge_nodes(linear)
    mesh = add_bubbles(quadratic)
    faces = np.unique(np.sort(linear.cells[:, FACES], axis=2).reshape(-1, 3), axis=0)
    edges = quadratic.node_count - linear.node_count
    assert len(mesh.bubble_corners) == edges + len(faces)
    assert mesh.functions.max() == quadratic.node_count + len(mesh.bubble_corners) - 1


def test_a_face_bears_its_share_of_a_uniform_load():
    anywhere = np.random.default_rng(0).dirichlet(np.ones(4), 400_000)  # even in a tetrahedron
    means = cubic_values(anywhere).mean(axis=0)
    assert means[FIRST_FACE:] == pytest.approx(FACE_LOAD_SHARE, rel=0.02)
    assert means[FIRST_EDGE:FIRST_FACE] == pytest.approx(0.0, abs=1e-3)
