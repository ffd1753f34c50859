import itertools

import numpy as np

from softrobot_twin.geometry.closest_point import closest_on_triangles


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
        (0.2, 0.2, 5): (0.6, 0.2, 0.2),
        (0.5, -3, 1): (0.5, 0.5, 0),
        (1, 1, 0): (0, 0.5, 0.5),
        (-1, 0.25, 0): (0.75, 0, 0.25),
        (-1, -1, 0): (1, 0, 0),
        (3, -1, 0): (0, 1, 0),
        (-1, 3, 0): (0, 0, 1),
    }
    weights = closest_on_triangles(np.array(list(cases), float), np.stack([corners] * len(cases)))
    np.testing.assert_allclose(weights, np.array(list(cases.values())), atol=1e-14)


def test_a_triangle_without_area_is_taken_as_its_edges():
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [2, 0, 0]], [[1.0, 1, 1]] * 3])
    weights = closest_on_triangles(np.array([[1.5, 1, 0], [0.0, 0, 0]]), corners)
    closest = np.einsum("pc,pci->pi", weights, corners)
    np.testing.assert_allclose(closest, [[1.5, 0, 0], [1, 1, 1]], atol=1e-14)
