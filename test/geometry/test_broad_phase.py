"""Clusters of triangles, and the equality of results with and without them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.broad_phase import Clusters
from test.shapes import Box, Capsule, Cylinder, Plane, Sphere
from softrobot_twin.geometry.surface_shape import SurfaceShapeDetector
from test.near_pairs import near

MARGIN = 0.03
ENDS = [[0.0, 0.0, -0.2], [0.0, 0.0, 0.2]]
SHAPES = [
    Sphere([0.0] * 3, 0.1), Capsule(ENDS, 0.05), Cylinder(ENDS, 0.08),
    Box([0.0] * 3, [0.1, 0.2, 0.15]), Plane([0.0] * 3, [0.0, 0.0, 1.0]),
]  # fmt: skip


@pytest.fixture(scope="module")
def tube():
    """A bumpy tube of 1600 triangles along x: points and triangles."""
    rings, sides = 40, 20
    along, around = np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij")
    angle = 2.0 * np.pi * around / sides
    radius = 0.05 + 0.01 * np.sin(3.0 * angle + 0.7 * along)
    points = np.stack([0.02 * (along - 19.5), radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    a = sides * along[:-1] + around[:-1]
    b = sides * along[:-1] + (around[:-1] + 1) % sides
    triangles = np.concatenate([np.stack([a, b, a + sides], -1), np.stack([b, b + sides, a + sides], -1)])
    return points.reshape(-1, 3), triangles.reshape(-1, 3)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_excluding_clusters_changes_no_bit(tube, shape):
    points, triangles = tube
    rng = np.random.default_rng(1)
    culled = SurfaceShapeDetector(triangles, shape)
    whole = SurfaceShapeDetector(triangles, shape)
    everything = np.unique(triangles)
    whole.clusters = Clusters(everything, np.array([len(everything)]))
    found = 0
    for _ in range(60):
        bent = points + 0.003 * rng.normal(size=points.shape)
        origin = rng.uniform([-0.4, -0.2, -0.2], [0.4, 0.2, 0.2])
        rotation = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        a = near(culled, bent, origin, rotation, MARGIN)
        b = near(whole, bent, origin, rotation, MARGIN)
        found += len(a.gaps)
        for one, other in zip(a, b, strict=True):
            np.testing.assert_array_equal(one, other)
    assert found > 100
