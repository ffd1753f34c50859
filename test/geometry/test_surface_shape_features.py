import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.shapes import Box, Capsule, Cylinder, Plane, Sphere
from softrobot_twin.geometry.surface_shape import SurfaceShapeDetector

HERE, UPRIGHT = np.zeros(3), np.eye(3)
MARGIN = 2e-3
# One large triangle that looks down on what lies below it.
COVER = np.array([[-0.05, -0.05, 0.0], [0.0, 0.07, 0.0], [0.05, -0.05, 0.0]])
DEEP = 5e-3
# Turns the diagonal of a cube upright.
TILT = np.arccos(1 / np.sqrt(3)) * np.array([1, -1, 0]) / np.sqrt(2)
TIP = Rotation.from_rotvec(TILT).as_matrix()


def detect(points, triangles, shape, margin=MARGIN):
    points = np.array(points, float)
    detector = SurfaceShapeDetector(np.array(triangles), len(points), shape)
    return detector.detect(points, HERE, UPRIGHT, margin)


def under_cover(shape):
    return detect(COVER, [[0, 1, 2]], shape)


def carries_moment(positions):
    """Whether points span an area."""
    return np.linalg.matrix_rank(positions - positions.mean(axis=0), tol=1e-4) == 2


@pytest.mark.parametrize("gap", [1e-3, 1e-9, -1e-4])
@pytest.mark.parametrize(
    "make",
    [
        lambda z: Sphere([0.001, 0.002, z - 0.01], 0.01),
        lambda z: Capsule([[0.001, 0, z - 0.03], [0.003, 0, z - 0.01]], 0.01),
        lambda z: Cylinder([[0, 0, z - 0.02], [1e-9, 0, z]], 0.01),
    ],
)
def test_a_coarse_triangle_touches_with_its_inside(make, gap):
    found = under_cover(make(-gap))
    assert len(found.gaps) >= 1
    np.testing.assert_allclose(found.gaps, gap, atol=1e-9)
    np.testing.assert_allclose(found.normals, np.tile([0, 0, 1.0], (len(found.gaps), 1)), atol=1e-6)
    assert (np.sort(found.first_points, axis=1) == [0, 1, 2]).all()


@pytest.mark.parametrize("gap", [1e-3, -1e-4])
@pytest.mark.parametrize("round_ends", [True, False])
def test_a_coarse_triangle_over_a_lying_cylinder_touches_along_a_line(round_ends, gap):
    kind = Capsule if round_ends else Cylinder
    found = under_cover(kind([[-0.01, 0, -gap - 0.003], [0.012, 0, -gap - 0.003]], 0.003))
    np.testing.assert_allclose(found.gaps, gap, atol=1e-12)
    np.testing.assert_allclose(sorted(found.first_positions[:, 0]), [-0.01, 0.012], atol=1e-12)


@pytest.mark.parametrize("gap", [1e-3, -1e-4])
@pytest.mark.parametrize("round_ends", [True, False])
def test_an_edge_along_a_cylinder_is_held_at_both_ends_of_the_cylinder(round_ends, gap):
    kind = Capsule if round_ends else Cylinder
    points = [[-0.05, 0, 0], [0.04, 0, 0], [0, 0.01, 0.05], [0, -0.01, 0.05]]
    shape = kind([[-0.01, 0, -gap - 0.003], [0.012, 0, -gap - 0.003]], 0.003)
    found = detect(points, [[1, 0, 2], [0, 1, 3]], shape)
    assert len(found.gaps) == 2
    np.testing.assert_allclose(found.gaps, gap, atol=1e-5)
    np.testing.assert_allclose(sorted(found.first_positions[:, 0]), [-0.01, 0.012], atol=3e-4)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]] * 2, atol=1e-9)


def test_an_edge_across_a_thin_cylinder_touches_at_one_point():
    points = [[0, -0.05, 0], [0, 0.04, 0], [0.01, 0, 0.05], [-0.01, 0, 0.05]]
    shape = Cylinder([[-0.1, 0, -0.004], [0.1, 0, -0.004]], 0.003)
    found = detect(points, [[0, 1, 2], [1, 0, 3]], shape)
    np.testing.assert_allclose(found.gaps, [1e-3], atol=1e-12)
    np.testing.assert_allclose(found.first_positions, [[0, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("gap", [1e-3, 0.0, -1e-3])
def test_a_facet_on_a_box_is_held_at_the_corners_of_the_overlap(gap):
    tiny = Rotation.from_rotvec([1e-4, -2e-4, 0.3]).as_matrix()
    found = under_cover(Box([0, 0, -gap - 0.01], [0.03, 0.02, 0.02], tiny))
    assert len(found.gaps) == 4
    np.testing.assert_allclose(found.gaps, gap, atol=1e-5)
    assert carries_moment(found.first_positions)
    partly = under_cover(Box([0.03, -0.05, -gap - 0.01], [0.03, 0.02, 0.02]))
    assert carries_moment(partly.first_positions)
    # A vertex, a corner of the box, and where the borders of both cross.
    assert len(partly.gaps) >= 3


@pytest.mark.parametrize("gap", [1e-3, 0.0, -1e-3])
def test_a_facet_on_a_cap_is_held_all_round_the_rim(gap):
    found = under_cover(Cylinder([[0, 0, -gap - 0.02], [0, 0, -gap]], 0.01))
    assert len(found.gaps) == 8
    np.testing.assert_allclose(found.gaps, gap, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(found.first_positions[:, :2], axis=1), 0.01)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, -1e-6, -1e-3, -DEEP])
def test_a_boxs_corner_under_a_coarse_triangle_is_found_before_and_after_contact(gap):
    half = 0.02
    found = under_cover(Box([0.001, 0.002, -np.sqrt(3) * half - gap], [2 * half] * 3, TIP))
    assert found.gaps.min() == pytest.approx(gap, abs=1e-12)
    corner = found.gaps.argmin()
    np.testing.assert_allclose(found.normals[corner], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(found.second_positions[corner], [0.001, 0.002, -gap], atol=1e-9)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, -1e-6, -1e-3])
def test_an_edge_against_a_boxs_edge_keeps_its_normal_through_contact(gap):
    points = [[-0.05, 0, 0], [0.05, 0, 0], [0, 0.03, 0.05], [0, -0.03, 0.05]]
    roof = Rotation.from_rotvec([0, np.pi / 4, 0]).as_matrix()
    shape = Box([0.001, 0, -np.sqrt(2) * 0.02 - gap], [0.04, 0.1, 0.04], roof)
    found = detect(points, [[1, 0, 2], [0, 1, 3]], shape)
    edge = found.gaps.argmin()
    assert found.gaps[edge] == pytest.approx(gap, abs=1e-9)
    np.testing.assert_allclose(found.normals[edge], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(found.first_positions[edge], [0.001, 0, 0], atol=1e-6)


def test_a_corner_outside_a_thin_body_is_not_taken_for_one_inside():
    points, triangles = Box([0, 0, 0], [0.1, 0.1, 0.004]).surface(np.inf)
    found = detect(points, triangles, Box([0.01, 0, -0.003 - np.sqrt(3) * 0.02], [0.04] * 3, TIP))
    np.testing.assert_allclose(found.gaps, [1e-3], atol=1e-12)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-9)


@pytest.mark.parametrize(
    "shape",
    [
        Plane([0, 0, 0], [0, 0, 1]),
        Sphere([0, 0, -0.03], 0.03),
        Capsule([[-0.1, 0, -0.03], [0.1, 0, -0.03]], 0.03),
        Cylinder([[-0.1, 0, -0.03], [0.1, 0, -0.03]], 0.03),
        Cylinder([[0, 0, -0.06], [0, 0, 0]], 0.03),
        Box([0, 0, -0.03], [0.06] * 3),
    ],
)
def test_a_tip_five_millimetres_deep_is_shown_the_shortest_way_out(shape):
    points = np.array([[0, 0, 0], [0.03, 0, 0.1], [0, 0.03, 0.1], [-0.03, -0.03, 0.1]])
    triangles = [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]
    found = detect(points - [0, 0, DEEP], triangles, shape)
    assert found.first_points[0].tolist() == [0, 0, 0]
    assert found.gaps[0] == pytest.approx(-DEEP)
    np.testing.assert_allclose(found.normals[0], [0, 0, 1], atol=1e-12)
    assert found.gaps.min() >= -np.sqrt(2) * DEEP


@pytest.mark.parametrize(
    "shape",
    [
        Sphere([0, 0, 0], 0.01),
        Capsule([[-0.1, 0, 0], [0.1, 0, 0]], 0.01),
        Cylinder([[-0.1, 0, 0], [0.1, 0, 0]], 0.01),
        Cylinder([[0, 0, -0.1], [0, 0, 0.1]], 0.01),
        Capsule([[0, 0, -0.1], [0, 0, 0.1]], 0.01),
        Box([0, 0, 0], [0.02] * 3),
    ],
)
@pytest.mark.parametrize("part", ["vertex", "edge", "inside"])
def test_a_feature_through_the_centre_still_gets_a_unit_normal(shape, part):
    weights = {"vertex": [1, 0, 0], "edge": [0.3, 0.7, 0], "inside": [0.2, 0.3, 0.5]}[part]
    found = under_cover(shape)
    at_centre = detect(COVER - np.array(weights) @ COVER, [[0, 1, 2]], shape)
    assert len(found.gaps) > 0 and len(at_centre.gaps) > 0
    for result in (found, at_centre):
        assert all(np.isfinite(array).all() for array in result)
        np.testing.assert_allclose(np.linalg.norm(result.normals, axis=1), 1.0)
    if not isinstance(shape, Box) or part != "inside":
        assert at_centre.gaps.min() <= -0.01 + 1e-9


def test_flat_and_folded_triangles_do_no_harm():
    points = [[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0], [0, 0, 0]]
    for shape in (Sphere([0.01, 0, -0.006], 0.005), Box([0.01, 0, -0.006], [0.01] * 3)):
        found = detect(points, [[0, 1, 2], [0, 3, 1], [0, 2, 1]], shape)
        assert len(found.gaps) > 0
        assert all(np.isfinite(array).all() for array in found)
