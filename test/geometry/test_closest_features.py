import numpy as np
import pytest

from softrobot_twin.geometry.closest_features import (
    plane_weights,
    squared_distance,
    triangle_normal,
)
from softrobot_twin.geometry.point_location import closest_on_triangles


@pytest.fixture
def pairs():
    generator = np.random.default_rng(5)
    return generator.normal(size=(300, 3)), generator.normal(size=(300, 3, 3))


def test_distance_to_a_triangle_is_that_to_its_closest_point(pairs):
    points, corners = pairs
    weights = closest_on_triangles(points, corners)
    closest = np.einsum("pc,pci->pi", weights, corners)
    expected = ((points - closest) ** 2).sum(axis=1)
    found = [squared_distance(tuple(p), *map(tuple, x)) for p, x in zip(*pairs, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_distance_to_a_flat_triangle_is_that_to_its_edges():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    assert triangle_normal(x, 0, 1, 2) == (0.0, 0.0, 0.0)
    a, b, c = map(tuple, x)
    assert squared_distance((2.0, 1.0, 0.0), a, b, c) == pytest.approx(1.0)
    assert squared_distance((3.0, 4.0, 0.0), a, a, a) == pytest.approx(25.0)


def test_plane_weights_give_the_foot_of_the_perpendicular(pairs):
    for point, x in zip(*pairs, strict=True):
        weights = plane_weights(x, 0, 1, 2, tuple(point))
        away = point - np.array(weights) @ x
        assert sum(weights) == pytest.approx(1.0)
        np.testing.assert_allclose((x - x[0]) @ away, 0.0, atol=1e-10)
