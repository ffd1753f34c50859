import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.fixed_pairs import FixedPairs

# Two triangles facing up, and three points over, beside and under them.
POINTS = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2], [3, 0, 2], [0, 3, 2.0],
     [0.25, 0.5, 0.1], [1, 1, 2.2], [0.3, 0.3, -0.4]]
)  # fmt: skip


def test_gap_and_weights_are_exact():
    found = FixedPairs([6, 7, 8], [[0, 1, 2], [3, 4, 5], [0, 1, 2]]).detect(POINTS, 1.0)
    np.testing.assert_allclose(found.gaps, [0.1, 0.2, -0.4])
    np.testing.assert_allclose(found.normals, np.tile([0, 0, 1.0], (3, 1)))
    np.testing.assert_allclose(
        found.second_weights, [[0.25, 0.25, 0.5], [1 / 3, 1 / 3, 1 / 3], [0.4, 0.3, 0.3]]
    )
    np.testing.assert_allclose(found.first_positions, POINTS[[6, 7, 8]])
    np.testing.assert_allclose(
        np.einsum("pc,pci->pi", found.second_weights, POINTS[found.second_points]),
        found.second_positions,
    )
    np.testing.assert_array_equal(found.first_points, [[6] * 3, [7] * 3, [8] * 3])
    np.testing.assert_array_equal(found.keys, [0, 1, 2])


def test_normal_is_the_gradient_of_the_gap_on_a_tilted_triangle():
    points = np.random.default_rng(3).normal(size=(4, 3))
    points[3] = points[:3].mean(axis=0) + [0.1, -0.2, 0.3]
    pairs = FixedPairs([3], [[0, 1, 2]])
    normal = pairs.detect(points, 10.0).normals[0]
    for axis in range(3):
        gaps = []
        for step in (1e-6, -1e-6):
            moved = points.copy()
            moved[3, axis] += step
            gaps.append(pairs.detect(moved, 10.0).gaps[0])
        assert (gaps[0] - gaps[1]) / 2e-6 == pytest.approx(normal[axis], abs=1e-8)


def test_pairs_beyond_the_margin_are_left_out_and_keys_stay():
    found = FixedPairs([6, 7, 8], [[0, 1, 2], [3, 4, 5], [0, 1, 2]]).detect(POINTS, 0.15)
    np.testing.assert_array_equal(found.keys, [0, 2])
    np.testing.assert_allclose(found.gaps, [0.1, -0.4])


def test_a_point_beside_its_triangle_bears_on_the_rim():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, -0.5, 0.1]])
    found = FixedPairs([3], [[0, 1, 2]]).detect(points, 1.0)
    np.testing.assert_allclose(found.gaps, [0.1])
    np.testing.assert_allclose(found.second_positions, [[0.5, 0, 0]])
    assert (found.second_weights >= 0).all()


def test_no_pairs_give_nothing():
    found = FixedPairs(np.empty(0, int), np.empty((0, 3), int)).detect(POINTS, 1.0)
    assert found.gaps.shape == (0,)
    assert found.normals.shape == (0, 3)


def test_pairs_that_make_no_sense_are_refused():
    with pytest.raises(MeshError, match="paired"):
        FixedPairs([6, 7], [[0, 1, 2]])
    with pytest.raises(MeshError, match="twice"):
        FixedPairs([0], [[0, 1, 2]])
    with pytest.raises(MeshError, match="-1"):
        FixedPairs([-1], [[0, 1, 2]])
