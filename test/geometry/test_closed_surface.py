"""Flat regions of rigid surfaces, and contacts with their triangulations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.closed_surface import (
    FLAT_SHARE,
    closed_surface,
    flat_regions,
    flatten_regions,
)
from test.shapes import Box, Capsule, Cylinder, Sphere
from softrobot_twin.geometry.shapes.distance_kernels import CYLINDER
from softrobot_twin.geometry.solid_shape import SolidShapeDetector
from softrobot_twin.geometry.surface_pairs import SurfacePairDetector
from softrobot_twin.geometry.surface_shape import is_past_shape
from test.near_pairs import near

SCALES = [1e-3, 1.0, 10.0]
FLOOR = Box([0.0, 0.0, -0.5], [4.0, 4.0, 1.0])
UPRIGHT = np.eye(3)
# How far a region is from its plane, at most, for a floor of size 1.
PLANE = FLAT_SHARE * 6.0


def regions_of(points, triangles):
    return flat_regions(closed_surface(triangles, len(points)), points)


def single(points, seed):
    """Points in a random orientation, rounded to single precision."""
    turned = Rotation.random(random_state=seed).apply(points)
    return turned.astype(np.float32).astype(float)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("seed", range(3))
def test_a_box_has_six_flat_regions_twelve_ridges_and_eight_crests(scale, seed):
    points, triangles = Box([0, 0, 0], [0.04, 0.03, 0.02]).surface(0.004)
    regions = regions_of(single(scale * points, seed), triangles)
    assert len(np.unique(regions.leaders)) == 6
    ends = points[regions.crests]
    on_edge = (np.abs(np.abs(ends) - [0.02, 0.015, 0.01]) < 1e-9).sum(axis=1)
    assert (on_edge >= 2).all()
    assert len(ends) == 4 * (9 + 7 + 4) + 8


@pytest.mark.sampled
@pytest.mark.parametrize("scale", SCALES)
def test_a_finely_cut_round_surface_is_not_flat(scale):
    """Points of a region are in its plane up to round-off, for any angle between triangles."""
    points, triangles = Sphere([0, 0, 0], scale).surface(0.02 * scale)
    regions = regions_of(points, triangles)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    leading = normals[regions.leaders]
    off = np.abs(np.einsum("tci,ti->tc", corners - corners[regions.leaders, :1], leading))
    assert off.max() < 1e-5 * scale
    assert len(regions.crests) > 0.9 * len(points)


def test_a_bend_of_any_angle_above_round_off_is_a_ridge_only_where_it_is_convex():
    for angle in (1e-3, 0.01, 0.1):
        for way in (1.0, -1.0):
            points, triangles = Box([0, 0, 0], [2.0, 1.0, 0.2]).surface(1.0)
            top = (points[:, 2] > 0) & (np.abs(points[:, 0]) < 1e-9)
            points[top, 2] += way * angle
            surface = closed_surface(triangles, len(points))
            regions = flat_regions(surface, points)
            ridge = regions.ridges[top[surface.edges[:, :2]].all(axis=1)]
            assert ridge.all() == (way > 0) and ridge.any() == (way > 0)


def test_a_face_whose_points_are_off_by_round_off_is_one_region():
    """Points off the face by round-off tilt its triangles; they still are one region."""
    points, triangles = Box([0, 0, 0], [1.0, 1.0, 1.0]).surface(0.25)
    inner = np.flatnonzero((points[:, 2] > 0.49) & (np.abs(points[:, :2]) < 0.4).all(axis=1))
    points[inner, 2] += np.random.default_rng(0).uniform(-2e-7, 2e-7, len(inner))
    assert len(np.unique(regions_of(points, triangles).leaders)) == 6


def floor(cells, scale, seed):
    """Surface of a floor whose inner points are moved at random within its top."""
    points, triangles = FLOOR.surface(4.0 / cells)
    inner = (np.abs(points[:, :2]) < 1.99).all(axis=1) & (points[:, 2] > -1e-9)
    random = np.random.default_rng(seed)
    points[inner, :2] += random.uniform(-0.3, 0.3, (inner.sum(), 2)) * 4.0 / cells
    points[:, 2] += random.uniform(-1e-7, 1e-7, len(points))
    return flatten_regions(scale * points, triangles), triangles


@pytest.mark.sampled
@pytest.mark.parametrize("cells, scale, seed", [
    (2, 1e-3, 0), (2, 1.0, 1), (2, 10.0, 2), (8, 1e-3, 1), (8, 1.0, 2), (8, 10.0, 3),
    (30, 1e-3, 2), (30, 1.0, 3), (30, 10.0, 0),
])  # fmt: skip
def test_all_contact_normals_on_a_flat_floor_equal_its_normal(cells, scale, seed):
    """A cube, a sphere, a capsule and a cylinder, above the surface and slightly inside."""
    points, triangles = floor(cells, scale, seed)
    random = np.random.default_rng(seed)
    cube, faces = Box([0, 0, 0], [0.3 * scale] * 3).surface(np.inf)
    pair = SurfacePairDetector(triangles, len(points), faces, len(cube), rigid_points=(points, cube))
    radius = 0.15 * scale
    ends = radius * np.array([[0, 0, -1.0], [0, 0, 1.0]])
    round_shapes = [Sphere([0, 0, 0], radius), Capsule(ends, radius), Cylinder(ends, radius)]
    detectors = [SolidShapeDetector(triangles, points, shape) for shape in round_shapes]
    for _ in range(25):
        height = random.choice([1e-9, -1e-9, 1e-6, -1e-6, -1e-4, 1e-3]) * scale
        x, y = scale * random.uniform(-1.5, 1.5, 2)
        yaw = Rotation.from_euler("z", random.uniform(0, 6))
        lying = yaw * Rotation.from_euler("y", np.pi / 2)
        low = [x, y, height + radius]
        found = near(pair, points, yaw.apply(cube) + low, 0.01 * scale)
        assert np.abs(found.normals - [0, 0, -1]).max() < 1e-5
        assert (np.abs(found.gaps - height) < PLANE * scale).sum() >= 4
        for detector, pose in zip(detectors, (yaw, lying, lying), strict=True):
            found = near(detector, points, np.array(low), pose.as_matrix(), 0.01 * scale)
            assert len(found.gaps) >= (1 if detector is detectors[0] else 2)
            assert np.abs(found.normals - [0, 0, -1]).max() < 1e-5
            np.testing.assert_allclose(found.gaps, height, rtol=0, atol=PLANE * scale)


def test_a_ball_touches_a_table_by_its_face_edge_and_corner_alone():
    points, triangles = Box([0, 0, 0], [1.0, 1.0, 1.0]).surface(0.1)
    detector = SolidShapeDetector(triangles, points, Sphere([0, 0, 0], 0.2))
    for centre, normal in (
        ([0.33, 0.11, 0.7], [0, 0, 1]), ([0.6, 0.13, 0.6], [1, 0, 1]), ([0.6] * 3, [1, 1, 1]),
        ([0.3, 0.2, 0.7], [0, 0, 1]), ([0.7, 0.5 - 1e-9, 0.2], [1, 0, 0]),
    ):  # fmt: skip
        found = near(detector, points, np.array(centre), UPRIGHT, 0.05)
        away = np.array(normal) / np.linalg.norm(normal)
        np.testing.assert_allclose(found.normals, np.tile(-away, (len(found.gaps), 1)), atol=1e-6)
        nearest = np.clip(centre, -0.5, 0.5)
        np.testing.assert_allclose(found.gaps, np.linalg.norm(centre - nearest) - 0.2, atol=1e-9)
        assert len(found.gaps) >= 1


def test_a_ball_whose_centre_is_behind_a_face_is_pushed_out_through_it():
    points, triangles = Box([0, 0, 0], [1.0, 1.0, 1.0]).surface(0.25)
    detector = SolidShapeDetector(triangles, points, Sphere([0, 0, 0], 0.1))
    found = near(detector, points, np.array([0.13, 0.21, 0.47]), UPRIGHT, 0.01)
    np.testing.assert_allclose(found.normals, np.tile([0, 0, -1.0], (len(found.gaps), 1)))
    np.testing.assert_allclose(found.gaps, -0.13, atol=1e-12)


def test_a_ball_in_a_groove_touches_both_flanks_and_not_its_bottom():
    points, triangles = Box([0, 0, 0], [2.0, 2.0, 1.0]).surface(0.5)
    groove = (points[:, 2] > 0.49) & (np.abs(points[:, 0]) < 1e-9)
    points[groove, 2] -= 0.5
    detector = SolidShapeDetector(triangles, points, Sphere([0, 0, 0], 0.1))
    # Flanks fall by 45 degrees from x = -0.5 and 0.5 to the foot at z = 0.
    found = near(detector, points, np.array([0.0, 0.13, 0.1 * 2**0.5]), UPRIGHT, 0.01)
    np.testing.assert_allclose(np.abs(found.normals[:, 0]), 0.5**0.5, atol=1e-9)
    assert set(np.sign(found.normals[:, 0])) == {-1.0, 1.0}
    np.testing.assert_allclose(found.gaps, 0.0, atol=1e-9)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("seed", range(3))
def test_flattening_moves_points_by_round_off_into_the_planes_of_their_regions(scale, seed):
    points, triangles = Box([0, 0, 0], [0.04, 0.03, 0.02]).surface(0.004)
    rough = single(scale * points, seed)
    flat = flatten_regions(rough, triangles)
    assert np.abs(flat - rough).max() < 1e-6 * 0.05 * scale
    leaders = regions_of(flat, triangles).leaders
    corners = flat[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    off = np.einsum("tci,ti->tc", corners - corners[leaders, :1], normals[leaders])
    assert np.abs(off).max() < 1e-14 * scale


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("depth", [1e-22, 1e-19, 1e-16, 1e-13, 1e-3])
def test_a_rim_exactly_on_a_floor_is_not_treated_as_beyond_it(scale, depth):
    """Round-off of a rim point's own distance must not end the contact there for a step."""
    radius, half = 0.02 * scale, 0.03 * scale
    extents = np.array([radius, half, 0.0])
    random = np.random.default_rng(5)
    for angle, end in zip(random.uniform(0.0, 7.0, 1000), random.choice([-1.0, 1.0], 1000),
                          strict=True):
        x, y = np.cos(angle), np.sin(angle)
        # The floor's plane is square to the radius, the rim point is below it.
        foot = ((radius - depth * scale) * x, (radius - depth * scale) * y, end * half)
        assert not is_past_shape((CYLINDER, extents), foot, -depth * scale)
        beyond = (-2.0 * radius * x, -2.0 * radius * y, end * half)
        assert is_past_shape((CYLINDER, extents), beyond, -3.0 * radius)
