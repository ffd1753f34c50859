"""Surfaces that touch to within round-off: every gap found is finite."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.surface_pairs import SurfacePairDetector

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip


@pytest.mark.parametrize("depth", [1e-18, 1e-15, 1e-12, 1e-10, 1e-9])
def test_a_corner_that_all_but_lies_on_a_diagonal_has_a_finite_gap(depth):
    """A small box lies on the diagonal between the two triangles of a great box's face."""
    detector = SurfacePairDetector(FACES, 8, FACES, 8)
    rng = np.random.default_rng(3)
    ground = 0.03 * CORNERS - [0.0, 0.0, 0.03]
    inside = 0
    for _ in range(200):
        box = 0.01 * CORNERS + [0.0, 0.0, 0.01] + rng.uniform(-depth, depth, 3)
        found = detector.detect(box, ground, 0.002)
        assert np.isfinite(found.gaps).all() and len(found.gaps) >= 4
        assert np.abs(found.gaps).max() < 1e-8
        inside += np.count_nonzero(found.gaps < 0.0)
    assert depth < 1e-16 or inside > 0


@pytest.mark.parametrize("depth", [1e-18, 1e-16, 1e-14, 1e-12])
def test_a_vertex_inside_by_round_off_comes_out_where_it_went_in(block, depth):
    """Two blocks, face on face: no vertex is sent out at a far side."""
    upper, lower = block((0.04, 0.04, 0.02), (6, 6, 3)), block((0.06, 0.06, 0.03), (3, 3, 2))
    detector = SurfacePairDetector(
        upper.surface_triangles, upper.node_count, lower.surface_triangles, lower.node_count
    )
    rng = np.random.default_rng(5)
    x = upper.node_positions - [0.02, 0.02, 0.0]
    y = lower.node_positions - [0.031, 0.032, 0.03]
    for turn in Rotation.random(50, random_state=1):
        moved = turn.apply(x + rng.uniform(-depth, depth, x.shape))
        found = detector.detect(moved, turn.apply(y), 0.001)
        assert np.abs(found.gaps).max() < 1e-9
        np.testing.assert_allclose(found.normals @ turn.as_matrix()[:, 2], 1.0, atol=1e-6)
