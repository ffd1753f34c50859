"""Facets on round shapes: their stiffness against rocking is the curvature of the true gap."""

import numpy as np
import pytest
from scipy.optimize import minimize

from softrobot_twin.constraints.contact_curvature import (
    LEAST_CURVATURE,
    write_curvature,
    write_facet_stiffness,
)

RADIUS = 0.015
AXIS = np.array([0.0, 1.0, 0.0])


def curvature_of(normal, axis, has_round_ends=False):
    """Curvature of a sphere's distance, or of a cylinder's or capsule's about an axis."""
    found = np.full((3, 3), np.nan)
    straight = np.zeros(3) if axis is None else axis
    is_round = write_curvature(normal, RADIUS, straight, axis is not None, has_round_ends, found)
    assert is_round == found.any()
    return found


def nearest(corners, axis):
    """The nearest point of a facet to a cylinder or a sphere about the origin."""

    def distance(t):
        p = corners[0] + sum(s * (corner - corners[0]) for s, corner in zip(t, corners[1:]))
        if axis is not None:
            p = p - (p @ axis) * axis
        return np.linalg.norm(p) - RADIUS

    start = np.full(len(corners) - 1, 1.0 / len(corners))
    return minimize(distance, start, method="BFGS", options={"gtol": 1e-13})


def gap(corners, axis):
    """Least distance [m]."""
    return nearest(corners, axis).fun


def touching(corners, axis):
    """Parameters t of the nearest point, shape (count - 1,)."""
    return nearest(corners, axis).x


def facet(edge: bool) -> np.ndarray:
    """Corners of a facet that touches the shape from above with its inside."""
    corners = np.array([[-0.004, -0.003, RADIUS], [0.005, 0.002, RADIUS], [-0.001, 0.006, RADIUS]])
    return corners[:2] if edge else corners - [0.0, 0.0012, 0.0]


def gaps_curvature(corners, axis, h=1e-4):
    """∂²gap/∂x² by differences [1/m], shape (3 count, 3 count)."""
    flat, count = corners.ravel(), corners.size

    def at(*moves):
        moved = flat.copy()
        for place, move in moves:
            moved[place] += move
        return gap(moved.reshape(-1, 3), axis)

    found = np.empty((count, count))
    for i, j in np.ndindex(count, count):
        values = [at((i, a), (j, b)) for a, b in ((h, h), (h, -h), (-h, h), (-h, -h))]
        found[i, j] = (values[0] - values[1] - values[2] + values[3]) / (4 * h * h)
    return found


@pytest.mark.parametrize("edge, axis", [(True, AXIS), (True, None), (False, None)])
def test_stiffness_is_minus_force_times_the_gaps_curvature_or_its_definite_part(edge, axis):
    corners, force = facet(edge) + [0.0, 0.0003, -0.0005], 0.7
    count = len(corners)
    weights = np.zeros(3)
    weights[0] = 1.0
    weights[1:count] = touching(corners, axis)
    weights[0] -= weights[1:].sum()
    outward = weights[:count] @ corners
    if axis is not None:
        outward = outward - (outward @ axis) * axis
    distance = np.linalg.norm(outward)
    normal = outward / distance
    curvature = curvature_of(normal, axis) * RADIUS / distance
    x = np.vstack([corners, np.zeros((3 - count, 3))])
    nodes, size, c = np.array([0, 1, -1 if edge else 2]), 3 * count, weights[:count]
    whole = -force * gaps_curvature(corners, axis)
    for is_whole in (True, False):
        found = np.zeros((9, 9))
        assert count == write_facet_stiffness(
            x, nodes, weights, curvature, normal, force, True, is_whole, found
        )
        left_out = 0.0 if is_whole else force * np.kron(np.outer(c, c), curvature)
        np.testing.assert_allclose(found[:size, :size], whole + left_out, atol=2e-3 * np.abs(whole).max())
        assert not found[size:].any() and not found[:, size:].any()


def test_what_moves_across_a_moving_shape_does_not_roll():
    corners = facet(True)
    found = np.zeros((9, 9))
    normal = np.array([0.0, 0.0, 1.0])
    arguments = np.array([0, 1, -1]), np.array([0.6, 0.4, 0.0]), curvature_of(normal, AXIS), normal
    write_facet_stiffness(corners, *arguments, 1.0, False, False, found)
    across = np.array([0, 1, 3, 4])
    assert found.any() and not found[across].any() and not found[:, across].any()


def test_a_facet_along_a_straight_side_is_not_infinitely_stiff():
    corners = np.array([[0.0, -0.004, RADIUS], [0.0, 0.004, RADIUS], [0.0, 0.0, 0.0]])
    normal, found = np.array([0.0, 0.0, 1.0]), np.zeros((9, 9))
    curvature, weights = curvature_of(normal, AXIS), np.array([0.5, 0.5, 0.0])
    nodes = np.array([0, 1, -1])
    assert 2 == write_facet_stiffness(corners, nodes, weights, curvature, normal, 1.0, True, False, found)
    assert 0.0 < found[2, 2] <= 1.001 * RADIUS / (LEAST_CURVATURE * 0.008**2)


def test_contact_curvature_never_reduces_the_stiffness():
    rng = np.random.default_rng(0)
    for _ in range(50):
        corners = rng.normal(size=(3, 3))
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        found, weights = np.zeros((9, 9)), rng.dirichlet(np.ones(3))
        write_facet_stiffness(
            corners, np.arange(3), weights, curvature_of(normal, None), normal, 1.0, True, False,
            found,
        )
        np.testing.assert_allclose(found, found.T, atol=1e-12 * np.abs(found).max())
        assert np.linalg.eigvalsh(found).min() > -1e-9 * np.abs(found).max()


def test_flat_ends_of_a_cylinder_have_no_curvature():
    assert not curvature_of(AXIS, AXIS).any()
    assert np.trace(curvature_of(AXIS, AXIS, has_round_ends=True)) == pytest.approx(2.0 / RADIUS)


def test_a_vertex_does_not_roll():
    found, normal = np.zeros((9, 9)), np.array([0.0, 0.0, 1.0])
    nodes, weights = np.array([0, -1, -1]), np.array([1.0, 0.0, 0.0])
    assert not write_facet_stiffness(
        np.zeros((3, 3)), nodes, weights, np.eye(3), normal, 1.0, True, False, found
    )
    assert not found.any()


def test_a_vertex_that_slides_over_a_shape_is_softened_by_its_curvature():
    found, normal = np.zeros((9, 9)), np.array([0.0, 0.0, 1.0])
    nodes, weights = np.array([0, -1, -1]), np.array([1.0, 0.0, 0.0])
    curvature = curvature_of(normal, AXIS)
    assert 1 == write_facet_stiffness(
        np.zeros((3, 3)), nodes, weights, curvature, normal, 2.0, True, True, found
    )
    np.testing.assert_allclose(found[:3, :3], -2.0 * curvature)
