import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.mass_properties import surface_mass_properties
from test.shapes import Box, Capsule, Cylinder, Plane, Sphere

TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
SOLIDS = {
    "sphere": Sphere([0.1, -0.2, 0.3], 0.25),
    "capsule": Capsule([[0.1, 0.0, -0.2], [0.3, 0.3, 0.2]], 0.15),
    "cylinder": Cylinder([[0.1, 0.0, -0.2], [0.3, 0.3, 0.2]], 0.2),
    "box": Box([0.1, 0.2, -0.1], [0.3, 0.5, 0.4], TURN),
}
SHAPES = SOLIDS | {"plane": Plane([0.1, 0.2, 0.3], [1.0, -2.0, 0.5])}


@pytest.fixture(params=SHAPES)
def shape(request):
    return SHAPES[request.param]


@pytest.fixture(params=SOLIDS)
def solid(request):
    return SOLIDS[request.param]


@pytest.fixture
def points():
    return np.random.default_rng(3).uniform(-0.7, 0.9, (400, 3))


def test_distance_is_that_to_the_nearest_of_many_points_of_the_surface(solid, points):
    surface, _ = solid.surface(0.005)
    nearest, _ = cKDTree(surface).query(points)
    distances, _ = solid.signed_distances(points)
    assert (nearest >= np.abs(distances) - 1e-12).all()
    # A grid of 5 mm leaves out what lies half a diagonal aside.
    assert (nearest**2 <= distances**2 + 2 * 0.005**2 + 0.01 * np.abs(distances)).all()


def test_distance_is_negative_inside_and_only_there(solid):
    surface, _ = solid.surface(0.02)
    _, normals = solid.signed_distances(surface)
    centre = solid.mass_properties().centroid
    assert (solid.signed_distances(surface + 0.01 * (surface - centre))[0] > 0.0).all()
    assert (solid.signed_distances(surface - 0.01 * (surface - centre))[0] < 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_normal_is_the_gradient_of_the_distance(shape, points):
    distances, normals = shape.signed_distances(points)
    step = 1e-6
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        ahead, behind = (shape.signed_distances(points + s * shift)[0] for s in (1, -1))
        smooth = np.abs(ahead + behind - 2 * distances) < 1e-10
        assert smooth.mean() > 0.98
        np.testing.assert_allclose((ahead - behind)[smooth] / (2 * step), normals[smooth, axis], atol=1e-4)


def test_inside_the_solid_the_normal_points_to_the_nearest_surface_point(solid, points):
    points = 0.4 * points + solid.mass_properties().centroid
    distances, normals = solid.signed_distances(points)
    inside = distances < 0.0
    assert inside.sum() > 50
    out = points[inside] - distances[inside, None] * normals[inside]
    np.testing.assert_allclose(solid.signed_distances(out)[0], 0.0, atol=1e-14)


def test_the_axes_of_its_frame_are_right_handed_unit_vectors(shape):
    _, axes = shape.frame()
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_a_point_on_the_axis_has_one_unit_normal(solid):
    centre = solid.frame()[0]
    distances, normals = solid.signed_distances(centre[None])
    assert np.linalg.norm(normals[0]) == pytest.approx(1.0)
    out = centre - distances[0] * normals[0]
    assert solid.signed_distances(out[None])[0][0] == pytest.approx(0.0, abs=1e-14)
    assert distances[0] == pytest.approx(-np.min(solid.extents()[solid.extents() > 0.0]))


@pytest.mark.parametrize("resolution", [0.02, 0.1, np.inf])
def test_surface_lies_on_the_solid_and_is_closed_outwards(solid, resolution):
    points, triangles = solid.surface(resolution)
    np.testing.assert_allclose(solid.signed_distances(points)[0], 0.0, atol=1e-14)
    assert triangles.dtype == np.int64
    assert 0.5 * solid.volume < surface_mass_properties(points, triangles).volume
    assert surface_mass_properties(points, triangles).volume < solid.volume * (1 + 1e-12)


def test_surface_of_a_plane_is_a_square_about_its_point_facing_its_normal():
    plane = SHAPES["plane"]
    points, triangles = plane.square(np.array(plane.point), 0.5)
    np.testing.assert_allclose(plane.signed_distances(points)[0], 0.0, atol=1e-15)
    np.testing.assert_allclose(points.mean(axis=0), plane.point, atol=1e-15)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    np.testing.assert_allclose(normals.sum(axis=0), plane.unit_normal)


@pytest.mark.exhaustive
def test_mass_properties_are_the_limit_of_those_of_its_surface(solid):
    exact = solid.mass_properties()
    errors = []
    for resolution in (0.02, 0.01):
        found = surface_mass_properties(*solid.surface(resolution))
        np.testing.assert_allclose(found.centroid, exact.centroid, atol=1e-12)
        errors.append([found.volume / exact.volume - 1.0,
                       *((found.inertia - exact.inertia).ravel() / np.trace(exact.inertia))])
    coarse, fine = np.abs(errors)
    assert fine.max() < 2e-3
    assert fine.max() < 0.3 * coarse.max() + 1e-12
