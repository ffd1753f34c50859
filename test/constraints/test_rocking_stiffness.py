"""Facets on round shapes: their stiffness against rocking is the curvature of the true gap."""

import numpy as np
import pytest
from scipy.optimize import minimize

from softrobot_twin.constraints.rocking_stiffness import RoundPair, write_corner_stiffness

RADIUS = 0.015
AXIS = np.array([0.0, 1.0, 0.0])


class Standing:
    """A carrier that stands still."""

    def pose(self, positions):
        return np.zeros(3), np.eye(3)


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
    normal = np.array([[0.0, 0.0, 1.0]])
    pair = RoundPair(0, None, Standing(), RADIUS, axis, False)
    nodes = np.array([0, 1, -1 if edge else 2])
    found = np.zeros((3, 3))
    curvature = pair.curvatures(None, normal)[0]
    x = np.vstack([corners, np.zeros((3 - count, 3))])
    assert write_corner_stiffness(x, nodes, curvature, force, found) == count
    found = np.triu(found) + np.triu(found, 1).T
    np.testing.assert_allclose(found[:count, :count], expected, rtol=2e-2, atol=1e-2)


def test_a_facet_along_a_straight_side_is_not_infinitely_stiff():
    corners = np.array([[0.0, -0.004, RADIUS], [0.0, 0.004, RADIUS], [0.0, 0.0, 0.0]])
    curvature = RoundPair(0, None, Standing(), RADIUS, AXIS, False).curvatures(
        None, np.array([[0.0, 0.0, 1.0]])
    )[0]
    found = np.zeros((3, 3))
    assert write_corner_stiffness(corners, np.array([0, 1, -1]), curvature, 1.0, found) == 2
    assert 0.0 < found[0, 0] <= RADIUS / (0.1 * 0.008**2)


def test_stiffness_never_softens():
    rng = np.random.default_rng(0)
    for _ in range(50):
        corners = rng.normal(size=(3, 3))
        normal = rng.normal(size=(1, 3))
        normal /= np.linalg.norm(normal)
        curvature = RoundPair(0, None, Standing(), RADIUS, None, True).curvatures(None, normal)[0]
        found = np.zeros((3, 3))
        write_corner_stiffness(corners, np.arange(3), curvature, 1.0, found)
        full = np.triu(found) + np.triu(found, 1).T
        assert np.linalg.eigvalsh(full).min() > -1e-9 * np.abs(full).max()


def test_flat_ends_of_a_cylinder_have_no_curvature():
    pair = RoundPair(0, None, Standing(), RADIUS, AXIS, False)
    assert not pair.curvatures(None, AXIS[None]).any()
    round_ended = pair._replace(has_round_ends=True)
    assert np.trace(round_ended.curvatures(None, AXIS[None])[0]) == pytest.approx(2.0 / RADIUS)


def test_a_vertex_does_not_rock():
    found = np.zeros((3, 3))
    nodes = np.array([0, -1, -1])
    assert write_corner_stiffness(np.zeros((3, 3)), nodes, np.eye(3), 1.0, found) == 0
