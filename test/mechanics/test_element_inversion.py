"""A quadratic element counts as folded wherever in it det F is not positive."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import integration_points
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.element_inversion import is_folded, least_coefficient

# Barycentric coordinates of points all over a tetrahedron, its corners among them.
FINE = np.array([p for p in itertools.product(range(13), repeat=4) if sum(p) == 12]) / 12.0


def least_determinant(corners):
    """The least det F at many points between corners, and the scale of it."""
    values = np.linalg.det(np.einsum("pc,cij->pij", FINE, corners))
    return values.min(), np.abs(values).max()


def corners_of(rng, unevenness):
    """Deformation gradients at four corners: one that is upright, varied."""
    mean = Rotation.random(random_state=rng).as_matrix() * rng.uniform(0.5, 1.5, 3)
    return mean + unevenness * rng.standard_normal((4, 3, 3))


@pytest.mark.parametrize("seed", range(4))
def test_inversion_is_found_exactly_where_the_determinant_is_not_positive(seed):
    rng = np.random.default_rng(seed)
    counts = {True: 0, False: 0}
    for _ in range(300):
        corners = corners_of(rng, rng.uniform(0.2, 0.7))
        least, scale = least_determinant(corners)
        if abs(least) < 0.02 * scale:
            continue  # too near for the sampling to judge
        assert is_folded(corners) == (least < 0.0)
        counts[least < 0.0] += 1
    assert min(counts.values()) > 30


@pytest.mark.parametrize("seed", range(4))
def test_the_least_bernstein_coefficient_is_a_lower_bound_of_the_determinant(seed):
    rng = np.random.default_rng(seed)
    for _ in range(50):
        corners = corners_of(rng, 0.4)
        least, scale = least_determinant(corners)
        assert least_coefficient(corners) <= 6.0 * least + 1e-12 * scale
    even = np.repeat(corners[:1], 4, axis=0)
    assert least_coefficient(even) == pytest.approx(6.0 * np.linalg.det(even[0]))


@pytest.mark.parametrize("where", ["corners and points", "edges too"])
def test_an_element_with_positive_determinant_at_sampled_points_may_be_inverted(bind, where):
    """An element that must not have the status `ok`: found in bodies that had collapsed to a line.
    """
    tet = np.vstack([np.zeros(3), np.eye(3)])
    mesh = add_mid_edge_nodes(TetMesh(tet, np.array([[0, 1, 2, 3]])))
    bound = bind(("corotational", mesh, 1.0, 0.3))
    gradients = integration_points(mesh.node_positions, mesh.cells, mesh.shape_functions).gradients
    places = np.vstack([np.eye(4), 0.138 + 0.447 * np.eye(4)])
    if where == "edges too":
        pairs = itertools.combinations(np.eye(4), 2)
        middles = [(first + second) / 2 for first, second in pairs]
        places = np.vstack([places, middles])
    found = 0
    for seed in range(4000):
        x = mesh.node_positions + 0.25 * np.random.default_rng(seed).standard_normal((10, 3))
        F = np.einsum("kai,kqaj->kqij", x[mesh.cells], gradients)[0]
        far = (5.0 - np.sqrt(5.0)) / 20.0
        corners = (F - far * F.sum(axis=0)) / (1.0 - 4.0 * far)
        seen = np.linalg.det(np.einsum("pc,cij->pij", places, corners)).min()
        least, scale = least_determinant(corners)
        if seen > 0.01 * scale and least < -0.01 * scale:
            assert bound.forces(x)[1] == 1
            found += 1
            if found == 3:
                return
    raise AssertionError("no such element among those tried")


@pytest.mark.parametrize("seed", range(3))
def test_elements_of_a_bent_and_rotated_body_are_not_inverted(bind, block, seed):
    """Nor are those whose rotation varies: a roll of almost a full turn."""
    mesh = add_mid_edge_nodes(block(size=(0.01, 0.02, 0.3), cells=(1, 2, 12), shake=0.0))
    bound = bind(("corotational", mesh, 1.0, 0.3))
    x, y, z = mesh.node_positions.T
    radius = 0.3 / np.radians(330.0)
    angle = z / radius
    rolled = np.column_stack([(radius + x) * np.cos(angle), y, (radius + x) * np.sin(angle)])
    turned = Rotation.random(random_state=seed).apply(rolled)
    # In this order its elements are upright; mirrored, all of them are inside out.
    counts = {bound.forces(turned)[1], bound.forces(turned * [-1.0, 1.0, 1.0])[1]}
    assert counts == {0, len(mesh.cells)}
