"""Facets on round shapes: their stiffness against rocking is the curvature of the true gap."""

import numpy as np
import pytest
from scipy.optimize import minimize

from softrobot_twin.constraints.contact_curvature import (
    LEAST_CURVATURE,
    write_corner_stiffness,
    write_curvature,
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


def gap(corners, axis):
    """Least distance of a facet from a cylinder or a sphere about the origin [m]."""

    def distance(t):
        p = corners[0] + sum(s * (corner - corners[0]) for s, corner in zip(t, corners[1:]))
        if axis is not None:
            p = p - (p @ axis) * axis
        return np.linalg.norm(p) - RADIUS

    start = np.full(len(corners) - 1, 1.0 / len(corners))
    return minimize(distance, start, method="BFGS", options={"gtol": 1e-13}).fun


def facet(edge: bool) -> np.ndarray:
    """Corners of a facet that touches the shape from above with its inside."""
    corners = np.array([[-0.004, -0.003, RADIUS], [0.005, 0.002, RADIUS], [-0.001, 0.006, RADIUS]])
    return corners[:2] if edge else corners - [0.0, 0.0012, 0.0]


@pytest.mark.parametrize("edge, axis", [(True, AXIS), (True, None), (False, None)])
def test_rocking_stiffness_is_minus_force_times_the_gaps_curvature(edge, axis):
    corners = facet(edge)
    count, force, h = len(corners), 0.7, 2e-4
    # Only moves along the normal count: what is left out has no part in them.
    expected = np.empty((count, count))
    for i in range(count):
        for j in range(count):
            values = []
            for a, b in ((h, h), (h, -h), (-h, h), (-h, -h)):
                moved = corners.copy()
                moved[i, 2] += a
                moved[j, 2] += b
                values.append(gap(moved, axis))
            expected[i, j] = -force * (values[0] - values[1] - values[2] + values[3]) / (4 * h * h)
    nodes = np.array([0, 1, -1 if edge else 2])
    found = np.zeros((3, 3))
    curvature = curvature_of(np.array([0.0, 0.0, 1.0]), axis)
    x = np.vstack([corners, np.zeros((3 - count, 3))])
    assert write_corner_stiffness(x, nodes, curvature, force, found) == count
    found = np.triu(found) + np.triu(found, 1).T
    np.testing.assert_allclose(found[:count, :count], expected, rtol=2e-2, atol=1e-2)


def test_a_facet_along_a_straight_side_is_not_infinitely_stiff():
    corners = np.array([[0.0, -0.004, RADIUS], [0.0, 0.004, RADIUS], [0.0, 0.0, 0.0]])
    curvature = curvature_of(np.array([0.0, 0.0, 1.0]), AXIS)
    found = np.zeros((3, 3))
    assert write_corner_stiffness(corners, np.array([0, 1, -1]), curvature, 1.0, found) == 2
    assert 0.0 < found[0, 0] <= 1.001 * RADIUS / (LEAST_CURVATURE * 0.008**2)


def test_contact_curvature_never_reduces_the_stiffness():
    rng = np.random.default_rng(0)
    for _ in range(50):
        corners = rng.normal(size=(3, 3))
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        curvature = curvature_of(normal, None)
        found = np.zeros((3, 3))
        write_corner_stiffness(corners, np.arange(3), curvature, 1.0, found)
        full = np.triu(found) + np.triu(found, 1).T
        assert np.linalg.eigvalsh(full).min() > -1e-9 * np.abs(full).max()


def test_flat_ends_of_a_cylinder_have_no_curvature():
    assert not curvature_of(AXIS, AXIS).any()
    assert np.trace(curvature_of(AXIS, AXIS, has_round_ends=True)) == pytest.approx(2.0 / RADIUS)


def test_a_vertex_has_no_rocking_stiffness():
    found = np.zeros((3, 3))
    nodes = np.array([0, -1, -1])
    assert write_corner_stiffness(np.zeros((3, 3)), nodes, np.eye(3), 1.0, found) == 0
