"""Contacts between the faces of two boxes."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.box_pairs import BoxPairDetector
from test.shapes import Box

EDGE, MARGIN = 0.04, 0.003
UPRIGHT = np.eye(3)


def cube(size=(EDGE,) * 3, rotation=UPRIGHT):
    return Box(np.zeros(3), np.array(size), rotation)


def on_top(offset, turn=0.0, gap=0.0, tilt=0.0, size=(EDGE,) * 3, world=None):
    """Contacts of a cube that stands on another one, with an offset, rotated and tilted."""
    world = world or Rotation.identity()
    at = np.array([*offset, 0.5 * (EDGE + size[2]) + gap])
    turned = world * Rotation.from_euler("zx", [turn, tilt])
    detector = BoxPairDetector(cube(size), cube())
    return detector.detect((world.apply(at), turned.as_matrix()), (np.zeros(3), world.as_matrix()), MARGIN)


@pytest.mark.parametrize("shift", [0.0, 1e-15, 1e-12, 1e-9, 1e-8, 1e-7, 1e-6])
@pytest.mark.parametrize("seed", range(4))
def test_flush_cubes_touch_at_four_corners_with_upright_normals(shift, seed):
    random = np.random.default_rng(seed)
    dx, dy, dz = shift * random.uniform(-1.0, 1.0, 3)
    found = on_top((dx, dy), turn=10.0 * shift * random.uniform(-1.0, 1.0), gap=dz)
    assert len(found.gaps) == 4
    np.testing.assert_allclose(found.normals, np.tile([0.0, 0.0, 1.0], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(found.gaps, dz, atol=1e-15)
    np.testing.assert_allclose(np.abs(found.first_positions[:, :2]), 0.5 * EDGE, atol=3e-6)
    np.testing.assert_allclose(
        np.sort(found.first_positions[:, 0]), [-0.5 * EDGE] * 2 + [0.5 * EDGE] * 2, atol=3e-6
    )


@pytest.mark.parametrize("shift", [1e-15, 1e-12, 1e-9, 1e-8, 1e-7])
def test_round_off_does_not_change_the_keys_of_flush_cubes(shift):
    expected = sorted(on_top((0.0, 0.0)).keys)
    for seed in range(20):
        random = np.random.default_rng(seed)
        dx, dy, dz, turn, tilt = shift * random.uniform(-1.0, 1.0, 5)
        assert sorted(on_top((dx, dy), turn, dz, tilt).keys) == expected


def in_both(points, offset, turn, size, spare=0.0):
    """Whether points of the plane between lie in both faces."""
    own = (points - offset) @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    mine = (np.abs(own) <= 0.5 * np.array(size[:2]) + spare).all(axis=1)
    return mine & (np.abs(points) <= 0.5 * EDGE + spare).all(axis=1)


@pytest.mark.parametrize("seed", range(30))
def test_contact_corners_span_the_common_area_of_two_faces(seed):
    random = np.random.default_rng(seed)
    offset, turn = random.uniform(-0.025, 0.025, 2), random.uniform(-np.pi, np.pi)
    size = random.uniform(0.02, 0.06, 3)
    gap, world = random.uniform(-1e-4, 1e-3), Rotation.random(random_state=seed)
    found = on_top(offset, turn, gap, size=size, world=world)
    corners = world.inv().apply(found.second_positions)[:, :2]
    assert in_both(corners, offset, turn, size, spare=1e-5).all(), f"seed {seed}"
    points = random.uniform(-0.5 * EDGE, 0.5 * EDGE, (400, 2))
    common = points[in_both(points, offset, turn, size, spare=-1e-9)]
    assert (Delaunay(corners).find_simplex(common, tol=1e-9) >= 0).all(), f"seed {seed}"
    assert len(ConvexHull(corners).vertices) <= 8
    assert len(set(found.keys)) == len(found.keys)
    np.testing.assert_allclose(found.gaps, gap, atol=1e-15)
    np.testing.assert_allclose(
        found.first_positions - found.second_positions, gap * found.normals, atol=1e-14
    )
    np.testing.assert_allclose(found.normals, np.tile(world.apply([0, 0, 1]), (len(corners), 1)), atol=1e-12)


@pytest.mark.parametrize("tilt", [1e-4, 1e-2, 0.3, 0.7])
def test_a_tilted_cube_stands_on_its_lowest_edge(tilt):
    lowest = 0.5 * EDGE * (np.cos(tilt) + np.sin(tilt))
    detector = BoxPairDetector(cube(), cube((0.2, 0.2, 0.02)))
    found = detector.detect(
        (np.array([0.0, 0.0, lowest + 0.01 + 1e-5]), Rotation.from_euler("x", tilt).as_matrix()),
        (np.zeros(3), UPRIGHT), MARGIN,
    )  # fmt: skip
    near = found.gaps < 1.1e-5
    assert near.sum() == 2
    np.testing.assert_allclose(found.gaps[near], 1e-5, atol=1e-9)
    np.testing.assert_allclose(np.sort(found.first_positions[near, 0]), [-0.5 * EDGE, 0.5 * EDGE])


def test_crossing_edges_have_no_face():
    turned = Rotation.from_euler("x", np.pi / 4) * Rotation.from_euler("z", 0.0)
    across = Rotation.from_euler("y", np.pi / 4)
    at = np.array([0.0, 0.0, np.sqrt(2.0) * EDGE - 1e-4])
    detector = BoxPairDetector(cube(), cube())
    poses = (at, turned.as_matrix()), (np.zeros(3), across.as_matrix())
    assert detector.detect(*poses, MARGIN) is None


@pytest.mark.parametrize("height", [-1e-7, -1e-9, 0.0, 1e-9, 1e-7])
def test_a_cube_that_slides_along_a_level_seam_is_not_caught_by_the_next_one(height):
    # Its leading edge is a millimetre before a cube of its support's height.
    found = on_top((EDGE + 1e-3, 0.0), gap=height)
    assert len(found.gaps) == 0


def test_a_ledge_of_a_tenth_of_a_millimetre_stops_a_sliding_cube():
    found = on_top((EDGE + 1e-3, 0.0), gap=-1e-4)
    np.testing.assert_allclose(found.normals, np.tile([1.0, 0.0, 0.0], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(found.gaps, 1e-3, atol=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 250.0])
def test_corners_scale_with_the_boxes(scale):
    small, large = Box(np.zeros(3), np.full(3, scale), UPRIGHT), np.array([0.1, -0.2, 1.0]) * scale
    detector = BoxPairDetector(small, small)
    found = detector.detect((large, UPRIGHT), (np.zeros(3), UPRIGHT), 0.01 * scale)
    corners = found.first_positions / scale
    np.testing.assert_allclose(np.sort(corners[:, 0]), [-0.4, -0.4, 0.5, 0.5], atol=1e-4)
    np.testing.assert_allclose(np.sort(corners[:, 1]), [-0.5, -0.5, 0.3, 0.3], atol=1e-4)
