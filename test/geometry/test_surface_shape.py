from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from test.shapes import Box, Capsule, Cylinder, Plane, Sphere
from softrobot_twin.geometry.surface_shape import SurfaceShapeDetector, edges_and_sides
from test.near_pairs import near

HERE, UPRIGHT = np.zeros(3), np.eye(3)
MARGIN = 2e-3
SHAPES = {
    "plane": Plane([0, 0, 0], [0.3, 0.2, 1.0]),
    "sphere": Sphere([0.001, 0, 0], 0.008),
    "capsule": Capsule([[-0.01, 0, 0], [0.02, 0.005, 0]], 0.004),
    "cylinder": Cylinder([[-0.01, 0, 0], [0.02, 0.005, 0]], 0.005),
    "box": Box([0, 0.001, 0], [0.03, 0.02, 0.01], Rotation.from_rotvec([0.5, 0, 1]).as_matrix()),
}
# One triangle that looks down on what lies below it.
COVER = np.array([[-0.05, -0.05, 0.0], [0.0, 0.07, 0.0], [0.05, -0.05, 0.0]])


@pytest.fixture(params=SHAPES)
def shape(request):
    return SHAPES[request.param]


def least(convex, places):
    """Least values on [0, 1] of convex functions, of an array of places (*places, 9) each."""
    low, high = np.zeros(places), np.ones(places)
    for _ in range(13):
        t = low[..., None] + (high - low)[..., None] * np.linspace(0.0, 1.0, 9)
        values = convex(t)
        best = values.argmin(axis=-1)[..., None]
        # The least value lies between the neighbours of the best place.
        low = np.take_along_axis(t, np.maximum(best - 1, 0), -1)[..., 0]
        high = np.take_along_axis(t, np.minimum(best + 1, 8), -1)[..., 0]
    return values.min(axis=-1)


def least_distances(shape, corners):
    """Least signed distance of each triangle [m] within a hundred-millionth of its size.

    The distance of a convex shape is convex, and so is its least value on the lines of a triangle.
    """

    def across(t):
        ends = [corners[:, :1] + t[..., None] * (corners[:, k] - corners[:, 0])[:, None]
                for k in (1, 2)]  # fmt: skip

        def along(s):
            x = ends[0][..., None, :] + s[..., None] * (ends[1] - ends[0])[..., None, :]
            return shape.signed_distances(x.reshape(-1, 3))[0].reshape(s.shape)

        return least(along, t.shape)

    return least(across, len(corners))


def surely_apart(shape, corners):
    """Lower bound of the distances of triangles [m], which are convex: a tangent in the middle."""
    middles = corners.mean(axis=1)
    distances, slopes = shape.signed_distances(middles)
    rises = np.einsum("tci,ti->tc", corners - middles[:, None], slopes)
    return distances + rises.min(axis=1) - 1e-12


def approach(shape, points, triangles, turn, direction, gap):
    """Origin at which the shape, coming in along a direction, has this smallest distance."""
    way, last = 0.2, None
    for _ in range(400):
        corners = (points[triangles] - way * direction) @ turn
        apart = surely_apart(shape, corners)
        if apart.min() > MARGIN:
            way -= apart.min() - gap
            continue
        most = shape.signed_distances(corners.reshape(-1, 3))[0].min()
        if last is not None:
            most = min(most, last[1] + abs(way - last[0]))
        nearest = least_distances(shape, corners[apart <= most]).min()
        if abs(nearest - gap) <= 1e-9:
            return way * direction
        slope = 1.0 if last is None else (nearest - last[1]) / (way - last[0])
        last = way, nearest
        # Distances fall by at most the way; a secant that says else, or hardly falls, is not used.
        way -= (nearest - gap) / (slope if 0.05 < slope < 1.0 else 1.0)
    raise RuntimeError("never came near")


@cache
def touching(shape, seed, gap):
    """A body with coarse triangles beside a shape, and what the detector finds."""
    generator = np.random.default_rng(seed)
    turns = Rotation.random(2, random_state=seed).as_matrix()
    body = Box([0, 0, 0], [0.03, 0.05, 0.04], turns[0]) if seed % 2 else Sphere([0, 0, 0], 0.02)
    points, triangles = body.surface([np.inf, 0.02, 0.01][seed % 3])
    points = points + generator.uniform(-4e-4, 4e-4, points.shape)
    direction = generator.normal(size=3)
    direction /= np.linalg.norm(direction)
    if shape.is_half_space:
        direction = -turns[1] @ shape.unit_normal
    origin = approach(shape, points, triangles, turns[1], direction, gap)
    found = near(SurfaceShapeDetector(triangles, shape), points, origin, turns[1], MARGIN)
    return points, triangles, origin, turns[1], found


def lowest_on_triangles(shape, points, triangles, origin, turn):
    """Least signed distance of each triangle, or a lower bound beyond the margin."""
    corners = (points[triangles] - origin) @ turn
    lowest = surely_apart(shape, corners)
    within = lowest < MARGIN
    lowest[within] = least_distances(shape, corners[within])
    return lowest


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(12))
def test_no_point_of_a_triangle_is_nearer_than_its_contact_point(shape, seed):
    points, triangles, origin, turn, found = touching(shape, seed, 5e-4)
    lowest = lowest_on_triangles(shape, points, triangles, origin, turn)
    assert lowest.min() == pytest.approx(5e-4, abs=2e-9)
    for triangle, least in zip(triangles, lowest, strict=True):
        on_it = np.isin(found.first_points, triangle).all(axis=1)
        if least < MARGIN - 1e-9:
            assert found.gaps[on_it].min() <= least + 1e-9


# In the last two, a corner of the box is behind two triangles of an edge and faces the farther one.
@pytest.mark.sampled
@pytest.mark.parametrize("seed", [*range(6), 1015, 1075])
def test_in_overlap_a_contact_point_is_at_least_as_deep_as_any_point(shape, seed):
    points, triangles, origin, turn, found = touching(shape, seed, -2e-4)
    lowest = lowest_on_triangles(shape, points, triangles, origin, turn)
    assert lowest.min() == pytest.approx(-2e-4, abs=2e-9)
    assert found.gaps.min() <= lowest.min() + 1e-9
    # Features need at most √3 times the depth of a point to come apart.
    assert found.gaps.min() >= np.sqrt(3.0) * lowest.min() - 1e-9


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(6))
def test_contacts_are_consistent_and_never_nearer_than_the_distance(shape, seed):
    points, triangles, origin, turn, found = touching(shape, seed, 5e-4)
    assert {tuple(sorted(set(row))) for row in found.first_points} <= {
        tuple(sorted(set(part)))
        for t in triangles
        for part in (t, *t[:, None], t[:2], t[1:], t[[0, 2]])
    }
    np.testing.assert_allclose(found.first_weights.sum(axis=1), 1.0)
    assert (found.first_weights >= 0.0).all()
    on_surface = np.einsum("kc,kci->ki", found.first_weights, points[found.first_points])
    np.testing.assert_allclose(found.first_positions, on_surface, atol=1e-15)
    np.testing.assert_allclose(
        found.first_positions - found.second_positions, found.gaps[:, None] * found.normals,
        atol=1e-15,
    )  # fmt: skip
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0)
    distances, _ = shape.signed_distances((found.first_positions - origin) @ turn)
    corners = np.array([len(set(row)) for row in found.first_points])
    # Inside a triangle, gaps are those of corners and rims of the shape along the normal.
    assert (found.gaps >= distances - 1e-12).all()
    np.testing.assert_allclose(found.gaps[corners < 3], distances[corners < 3], atol=1e-9)
    assert (found.gaps < MARGIN).all()
    assert (found.second_points == -1).all() and not found.second_weights.any()
    beyond, _ = shape.signed_distances((found.second_positions - origin) @ turn)
    # Both ends of a parallel edge are given along one normal, that of a place between them.
    for k in np.flatnonzero(np.abs(beyond) > 1e-9):
        assert corners[k] == 2
        ends = (points[np.unique(found.first_points[k])] - origin) @ turn
        places = np.linspace(ends[0], ends[1], 401)
        between, normals = shape.signed_distances(places)
        # Outside of a convex shape, a gradient turns by at most the way over the distance.
        turned = np.linalg.norm(ends[1] - ends[0]) / 800.0 / between.min()
        assert np.linalg.norm(normals @ turn.T - found.normals[k], axis=1).min() <= turned


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(6))
def test_every_pair_is_given_once_and_at_a_distinct_place(shape, seed):
    found = touching(shape, seed, 5e-4)[-1]
    assert len(np.unique(found.keys)) == len(found.keys)
    apart = np.linalg.norm(found.first_positions[:, None] - found.first_positions, axis=2)
    assert (apart + np.eye(len(apart))).min() > 1e-8


@pytest.mark.sampled
def test_all_vertices_within_the_margin_are_given_first(shape):
    points, triangles, origin, turn, _ = touching(shape, 2, 1e-4)
    distances, normals = shape.signed_distances((points - origin) @ turn)
    margin = np.median(distances)
    found = near(SurfaceShapeDetector(triangles, shape), points, origin, turn, margin)
    within = np.flatnonzero(distances < margin)
    np.testing.assert_array_equal(found.first_points[: len(within)], np.tile(within, (3, 1)).T)
    np.testing.assert_allclose(found.gaps[: len(within)], distances[within], atol=1e-15)
    np.testing.assert_allclose(found.normals[: len(within)], normals[within] @ turn.T, atol=1e-12)


@pytest.mark.sampled
def test_contacts_move_with_the_placement_of_the_whole(shape):
    points, triangles, origin, turn, found = touching(shape, 4, -1e-4)
    move, shift = Rotation.from_rotvec([1.0, -2.0, 0.5]).as_matrix(), np.array([0.3, -0.1, 0.2])
    moved = near(
        SurfaceShapeDetector(triangles, shape), points @ move.T + shift,
        move @ origin + shift, move @ turn, MARGIN,
    )
    np.testing.assert_array_equal(moved.keys, found.keys)
    np.testing.assert_allclose(moved.gaps, found.gaps, atol=1e-12)
    np.testing.assert_allclose(moved.normals, found.normals @ move.T, atol=1e-6)
    np.testing.assert_allclose(moved.first_positions, found.first_positions @ move.T + shift, atol=1e-8)


@pytest.mark.sampled
def test_the_normal_is_the_direction_of_fastest_growth_of_the_gap(shape):
    points, triangles, origin, turn, found = touching(shape, 4, 3e-4)
    detector = SurfaceShapeDetector(triangles, shape)
    step, slopes = 1e-7, []
    for shift in np.eye(3):
        gaps = []
        for way in (step, -step):
            moved = near(detector, points + way * shift, origin, turn, MARGIN)
            gaps.append(dict(zip(moved.keys.tolist(), moved.gaps, strict=True)))
        slopes.append([(gaps[0].get(k, np.nan) - gaps[1].get(k, np.nan)) / (2 * step)
                       for k in found.keys.tolist()])  # fmt: skip
    slopes = np.array(slopes).T
    known = np.isfinite(slopes).all(axis=1)
    assert known.mean() > 0.9
    np.testing.assert_allclose(slopes[known], found.normals[known], atol=2e-3)


@pytest.mark.sampled
def test_keys_stay_under_small_motion(shape):
    points, triangles, origin, turn, found = touching(shape, 5, 2e-4)
    shaken = points + np.random.default_rng(1).uniform(-1e-8, 1e-8, points.shape)
    again = near(SurfaceShapeDetector(triangles, shape), shaken, origin, turn, MARGIN)
    off_border = np.abs(found.gaps - MARGIN) > 1e-6
    assert set(found.keys[off_border].tolist()) <= set(again.keys.tolist())
    np.testing.assert_allclose(
        again.gaps[np.isin(again.keys, found.keys)],
        found.gaps[np.isin(found.keys, again.keys)], atol=1e-7,
    )  # fmt: skip


def test_far_away_nothing_is_found(shape):
    origin = -10.0 * shape.unit_normal if shape.is_half_space else np.array([0.0, 0.0, 10.0])
    detector = SurfaceShapeDetector(np.array([[0, 1, 2]]), shape)
    found = near(detector, COVER, origin, UPRIGHT, MARGIN)
    assert [len(array) for array in found] == [0] * 9


def test_all_pairs_are_given_when_there_are_many():
    points, triangles = Sphere([0, 0, 0], 0.02).surface(0.005)
    detector = SurfaceShapeDetector(triangles, Sphere([0, 0, 0], 0.01))
    found = near(detector, points, HERE, UPRIGHT, 0.02)
    edges, _ = edges_and_sides(triangles)
    # About the common centre every edge is nearest in its middle.
    assert len(found.gaps) >= len(points) + len(edges)
    assert len(np.unique(found.keys)) == len(found.keys)


DEEP = 5e-3
# Turns the diagonal of a cube upright.
TILT = np.arccos(1 / np.sqrt(3)) * np.array([1, -1, 0]) / np.sqrt(2)
TIP = Rotation.from_rotvec(TILT).as_matrix()


def detect(points, triangles, shape, margin=MARGIN):
    points = np.array(points, float)
    detector = SurfaceShapeDetector(np.array(triangles), shape)
    return near(detector, points, HERE, UPRIGHT, margin)


def under_cover(shape):
    return detect(COVER, [[0, 1, 2]], shape)


def carries_moment(positions):
    """Whether points span an area."""
    return np.linalg.matrix_rank(positions - positions.mean(axis=0), tol=1e-4) == 2


@pytest.mark.parametrize("gap", [1e-3, 1e-9, -1e-4])
@pytest.mark.parametrize("make", [
    lambda z: Sphere([0.001, 0.002, z - 0.01], 0.01),
    lambda z: Capsule([[0.001, 0, z - 0.03], [0.003, 0, z - 0.01]], 0.01),
    lambda z: Cylinder([[0, 0, z - 0.02], [1e-9, 0, z]], 0.01),
])  # fmt: skip
def test_a_coarse_triangle_touches_with_its_interior(make, gap):
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
def test_an_edge_along_a_cylinder_touches_at_both_ends_of_the_cylinder(round_ends, gap):
    kind = Capsule if round_ends else Cylinder
    points = [[-0.05, 0, 0], [0.04, 0, 0], [0, 0.01, 0.05], [0, -0.01, 0.05]]
    shape = kind([[-0.01, 0, -gap - 0.003], [0.012, 0, -gap - 0.003]], 0.003)
    found = detect(points, [[1, 0, 2], [0, 1, 3]], shape)
    assert len(found.gaps) == 2
    np.testing.assert_allclose(found.gaps, gap, atol=1e-5)
    np.testing.assert_allclose(sorted(found.first_positions[:, 0]), [-0.01, 0.012], atol=3e-4)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]] * 2, atol=1e-9)


@pytest.mark.parametrize("slope", [0.049, 0.02, 4e-3, 1e-3, 1e-4])
def test_an_edge_nearly_along_a_cylinder_touches_at_its_lowest_point_too(slope):
    length, radius, low = 0.02, 0.005, 0.35
    # Across the edge the cylinder lies so oblique that the slope at the far end is as given.
    oblique = np.sqrt(slope * radius / ((1.0 - low) * length))
    along = np.array([np.cos(oblique), np.sin(oblique), 0.0])
    side, deep = np.array([0.0, 0.0, radius]), [0.0, 0.0, -1e-5]
    ends = [side - low * length * along + deep, side + (1.0 - low) * length * along + deep]
    shape = Cylinder([[-0.1, 0, 0], [0.1, 0, 0]], radius)
    found = detect([*ends, [0, 0.03, 0.05], [0, -0.03, 0.05]], [[0, 1, 2], [1, 0, 3]], shape)
    lowest = found.gaps.argmin()
    assert found.gaps[lowest] == pytest.approx(-1e-5, abs=1e-12)
    place = along @ (found.first_positions[lowest] - ends[0]) / length
    assert place == pytest.approx(low, abs=1e-2)


def test_an_edge_across_a_thin_cylinder_touches_at_one_point():
    points = [[0, -0.05, 0], [0, 0.04, 0], [0.01, 0, 0.05], [-0.01, 0, 0.05]]
    shape = Cylinder([[-0.1, 0, -0.004], [0.1, 0, -0.004]], 0.003)
    found = detect(points, [[0, 1, 2], [1, 0, 3]], shape)
    np.testing.assert_allclose(found.gaps, [1e-3], atol=1e-12)
    np.testing.assert_allclose(found.first_positions, [[0, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("gap", [1e-3, 0.0, -1e-3])
def test_a_facet_on_a_box_touches_at_the_corners_of_the_overlap(gap):
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
def test_a_facet_on_a_cap_touches_all_round_the_rim(gap):
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


def test_a_corner_outside_a_thin_body_is_not_treated_as_inside():
    points, triangles = Box([0, 0, 0], [0.1, 0.1, 0.004]).surface(np.inf)
    found = detect(points, triangles, Box([0.01, 0, -0.003 - np.sqrt(3) * 0.02], [0.04] * 3, TIP))
    np.testing.assert_allclose(found.gaps, [1e-3], atol=1e-12)
    np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-9)


@pytest.mark.parametrize("shape", [
    Plane([0, 0, 0], [0, 0, 1]),
    Sphere([0, 0, -0.03], 0.03),
    Capsule([[-0.1, 0, -0.03], [0.1, 0, -0.03]], 0.03),
    Cylinder([[-0.1, 0, -0.03], [0.1, 0, -0.03]], 0.03),
    Cylinder([[0, 0, -0.06], [0, 0, 0]], 0.03),
    Box([0, 0, -0.03], [0.06] * 3),
])  # fmt: skip
def test_the_normal_of_a_tip_five_millimetres_deep_points_to_the_nearest_surface_point(shape):
    points = np.array([[0, 0, 0], [0.03, 0, 0.1], [0, 0.03, 0.1], [-0.03, -0.03, 0.1]])
    triangles = [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]
    found = detect(points - [0, 0, DEEP], triangles, shape)
    assert found.first_points[0].tolist() == [0, 0, 0]
    assert found.gaps[0] == pytest.approx(-DEEP)
    np.testing.assert_allclose(found.normals[0], [0, 0, 1], atol=1e-12)
    assert found.gaps.min() >= -np.sqrt(2) * DEEP


@pytest.mark.parametrize("shape", [
    Sphere([0, 0, 0], 0.01),
    Capsule([[-0.1, 0, 0], [0.1, 0, 0]], 0.01),
    Cylinder([[-0.1, 0, 0], [0.1, 0, 0]], 0.01),
    Cylinder([[0, 0, -0.1], [0, 0, 0.1]], 0.01),
    Capsule([[0, 0, -0.1], [0, 0, 0.1]], 0.01),
    Box([0, 0, 0], [0.02] * 3),
])  # fmt: skip
@pytest.mark.parametrize("part", ["vertex", "edge", "inside"])
def test_a_feature_through_the_centre_has_a_unit_normal(shape, part):
    weights = {"vertex": [1, 0, 0], "edge": [0.3, 0.7, 0], "inside": [0.2, 0.3, 0.5]}[part]
    found = under_cover(shape)
    at_centre = detect(COVER - np.array(weights) @ COVER, [[0, 1, 2]], shape)
    assert len(found.gaps) > 0 and len(at_centre.gaps) > 0
    for result in (found, at_centre):
        assert all(np.isfinite(array).all() for array in result)
        np.testing.assert_allclose(np.linalg.norm(result.normals, axis=1), 1.0)
    if not shape.has_edges or part != "inside":
        assert at_centre.gaps.min() <= -0.01 + 1e-9


def test_flat_and_folded_triangles_give_finite_contacts():
    points = [[0, 0, 0], [0.01, 0, 0], [0.02, 0, 0], [0, 0, 0]]
    for shape in (Sphere([0.01, 0, -0.006], 0.005), Box([0.01, 0, -0.006], [0.01] * 3)):
        found = detect(points, [[0, 1, 2], [0, 3, 1], [0, 2, 1]], shape)
        assert len(found.gaps) > 0
        assert all(np.isfinite(array).all() for array in found)
