import numpy as np
import pytest

from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.surface_splitting import split_triangles

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.2, 0.3, 1.5]])
PYRAMID = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def areas(points, triangles):
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def volume(points, triangles):
    return np.linalg.det(points[triangles]).sum() / 6.0


def test_each_triangle_is_cut_in_four_where_all_edges_are():
    points, triangles = split_triangles(CORNERS, PYRAMID, lambda ends: np.full(len(ends), True), 1)
    assert len(triangles) == 4 * len(PYRAMID)
    np.testing.assert_array_equal(points[: len(CORNERS)], CORNERS)
    sizes = np.linalg.norm(areas(points, triangles), axis=1)
    whole = np.linalg.norm(areas(CORNERS, PYRAMID), axis=1)
    assert np.sort(sizes) == pytest.approx(np.sort(np.repeat(whole / 4.0, 4)))


def test_nothing_is_cut_where_no_edge_is_chosen():
    points, triangles = split_triangles(CORNERS, PYRAMID, lambda ends: np.full(len(ends), False))
    assert points is CORNERS
    np.testing.assert_array_equal(triangles, PYRAMID)


def test_a_surface_cut_anywhere_stays_the_same_closed_surface(drawn_rng):
    """Whichever edges are cut: their number and places are drawn."""
    for _ in range(20):
        share = drawn_rng.random()
        points, triangles = split_triangles(
            CORNERS, PYRAMID, lambda ends, share=share: drawn_rng.random(len(ends)) < share, 3)  # fmt: skip
        assert (half_edges(triangles).counts == 2).all()
        assert volume(points, triangles) == pytest.approx(volume(CORNERS, PYRAMID), rel=1e-12)
        own = areas(points, triangles)
        assert np.linalg.norm(own, axis=1).sum() == pytest.approx(
            np.linalg.norm(areas(CORNERS, PYRAMID), axis=1).sum(), rel=1e-12)
        assert (np.linalg.norm(own, axis=1) > 0.0).all()


def test_no_edge_is_longer_than_wanted_at_its_place():
    """The wanted length grows with the height; each edge is asked for once."""
    asked = []

    def is_long(ends):
        asked.extend(map(bytes, ends))
        return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 0.05 + 0.1 * ends[:, :, 2].min(axis=1)

    points, triangles = split_triangles(CORNERS, PYRAMID, is_long)
    assert not is_long(points[half_edges(triangles).edges]).any()
    before = asked[: -len(half_edges(triangles).edges)]
    assert len(set(before)) == len(before)
