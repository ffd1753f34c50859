import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.point_location import closest_on_triangles
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.surface_pairs import SurfacePairDetector
from test.builder import builder
from test.near_pairs import near

MARGIN = 3e-3


@builder
def box(block, /, size=(0.02, 0.02, 0.02), cells=(1, 1, 1)):
    """A box about its own centre: its points and the triangles of its surface."""
    mesh = block(size, cells, shake=0.0)
    return mesh.node_positions - np.array(size) / 2, boundary_triangles(mesh.cells)


def detector_of(first, second, depth=None):
    return SurfacePairDetector(first[1], len(first[0]), second[1], len(second[0]), depth)


def distance_by_sampling(first, second):
    """Least distance of points strewn densely over one surface from all triangles of the other."""
    points, triangles = first
    n = 60
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
    i, j = i[i + j <= n] / n, j[i + j <= n] / n
    weights = np.stack([1 - i - j, i, j], axis=1)
    strewn = np.einsum("wc,tci->twi", weights, points[triangles]).reshape(-1, 3)
    corners = second[0][second[1]]
    least = np.inf
    for corner in corners:
        repeated = np.broadcast_to(corner, (len(strewn), 3, 3))
        closest = closest_on_triangles(strewn, repeated) @ corner
        least = min(least, np.linalg.norm(strewn - closest, axis=1).min())
    return least


def gathered(points, indices, weights):
    return np.einsum("pc,pci->pi", weights, points[indices])


def assert_consistent(found, first_points, second_points):
    """Checks that weights yield the positions, and that normal and gap connect them."""
    np.testing.assert_allclose(
        gathered(first_points, found.first_points, found.first_weights),
        found.first_positions, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(
        gathered(second_points, found.second_points, found.second_weights),
        found.second_positions, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(
        found.first_positions - found.second_positions,
        found.gaps[:, None] * found.normals, atol=1e-9,
    )  # fmt: skip
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0)
    assert len(np.unique(found.keys)) == len(found.keys)


def test_face_over_face_gives_the_corners_with_the_face_normal(box):
    upper, lower = box(), box((0.04, 0.04, 0.04))
    points = upper[0] + [0.002, 0.001, 0.031]
    found = near(detector_of(upper, lower), points, lower[0], MARGIN)
    assert_consistent(found, points, lower[0])
    np.testing.assert_allclose(found.gaps, 1e-3)
    np.testing.assert_allclose(found.normals, np.tile([0, 0, 1], (4, 1)), atol=1e-12)
    assert set(found.first_points[:, 0]) == set(np.flatnonzero(upper[0][:, 2] < 0))


@pytest.mark.parametrize("gap", [1e-3, -2e-3])
def test_crossed_bars_touch_at_four_crossings_and_are_pushed_apart_not_aside(box, gap):
    upper, lower = box((0.1, 0.02, 0.02)), box((0.02, 0.1, 0.02))
    points = upper[0] + [0, 0, 0.02 + gap]
    found = near(detector_of(upper, lower), points, lower[0], MARGIN)
    np.testing.assert_allclose(found.gaps, np.full(4, gap))
    np.testing.assert_allclose(found.normals, np.tile([0, 0, 1], (4, 1)), atol=1e-12)
    if gap > 0.0:
        assert_consistent(found, points, lower[0])
        crossings = {(round(x, 6), round(y, 6)) for x, y, _ in found.first_positions}
        assert crossings == {(x, y) for x in (-0.01, 0.01) for y in (-0.01, 0.01)}


def test_corner_over_face_is_one_pair(box):
    upper, lower = box(), box((0.06, 0.06, 0.02))
    onto_corner = Rotation.align_vectors([[0, 0, -1]], [[1, 1, 1]])[0]
    points = onto_corner.apply(upper[0]) + [0.003, 0.004, 0.01 + 0.01 * 3**0.5 + 5e-4]
    found = near(detector_of(upper, lower), points, lower[0], MARGIN)
    assert_consistent(found, points, lower[0])
    np.testing.assert_allclose(found.gaps, [5e-4])
    np.testing.assert_allclose(found.normals, [[0, 0, 1]], atol=1e-12)


def test_parallel_edges_give_continuous_normals(box):
    upper, lower = box(), box()
    on_edge = Rotation.from_euler("x", 45, degrees=True)
    for skew in (0.0, 1e-9, 1e-4):
        turned = Rotation.from_euler("z", skew) * on_edge
        points = turned.apply(upper[0]) + [0.003, 0.0, 0.01 * 2**0.5 + 0.0105]
        found = near(detector_of(upper, lower), points, lower[0], MARGIN)
        assert len(found.gaps) >= 2
        assert (found.normals[:, 2] > 0.99).all()
        np.testing.assert_allclose(found.gaps, 5e-4, atol=1e-6)


@pytest.mark.parametrize("seed", range(12))
def test_least_gap_is_the_distance_of_the_surfaces(box, seed):
    random = np.random.default_rng(seed)
    first, second = box((0.02, 0.03, 0.025), (1, 2, 1)), box((0.03, 0.02, 0.02), (2, 1, 1))
    points = Rotation.random(random_state=seed).apply(first[0])
    direction = random.normal(size=3)
    points += 0.045 * direction / np.linalg.norm(direction)
    expected = distance_by_sampling((points, first[1]), second)
    found = near(detector_of(first, second), points, second[0], 0.05)
    assert_consistent(found, points, second[0])
    # Samples lie up to a sixtieth of an edge from the closest points.
    assert found.gaps.min() == pytest.approx(expected, abs=5e-5)
    assert found.gaps.min() <= expected + 1e-9


@pytest.mark.parametrize("turn, height", [
    ((30, 20, 10), 0.0), ((0, 45, 25), 0.0), ((20, 0, 0), 0.0), ((30, 20, 10), -1e-3),
])  # fmt: skip
def test_normal_is_the_gradient_of_the_gap(box, turn, height):
    first, second = box((0.02, 0.03, 0.025), (2, 3, 2)), box((0.04, 0.04, 0.02), (3, 3, 2))
    points = Rotation.from_euler("xyz", turn, degrees=True).apply(first[0])
    points[:, 2] += 0.0105 - points[:, 2].min() + height
    detector = detector_of(first, second)
    found = near(detector, points, second[0], MARGIN)
    assert_consistent(found, points, second[0])
    assert len(found.gaps) >= 1
    assert (found.gaps.min() < 0) == (height < 0)
    step = 1e-7
    for axis in range(3):
        gaps = []
        for sign in (1, -1):
            moved = points.copy()
            moved[:, axis] += sign * step
            after = near(detector, moved, second[0], MARGIN)
            gaps.append(dict(zip(after.keys, after.gaps, strict=True)))
        common = [k for k in found.keys if k in gaps[0] and k in gaps[1]]
        assert len(common) >= 1
        for key in common:
            slope = (gaps[0][key] - gaps[1][key]) / (2 * step)
            normal = found.normals[list(found.keys).index(key)]
            assert slope == pytest.approx(normal[axis], abs=1e-5)


def test_keys_stay_while_features_do(box):
    upper, lower = box((0.02, 0.02, 0.02), (2, 2, 2)), box((0.05, 0.05, 0.02))
    detector = detector_of(upper, lower)
    keys = []
    for shift in np.linspace(0, 1e-3, 5):
        points = upper[0] + [0.001 + shift, 0.003, 0.0205 - shift]
        found = near(detector, points, lower[0], MARGIN)
        keys.append(set(found.keys))
    assert len(keys[0]) == 9
    assert all(others == keys[0] for others in keys)


@pytest.mark.parametrize("height", [0.0005, -0.0015, -0.004])
def test_swapping_the_surfaces_mirrors_every_pair(box, height):
    first, second = box((0.02, 0.03, 0.025), (2, 3, 2)), box((0.04, 0.04, 0.02), (3, 3, 2))
    points = Rotation.from_euler("xyz", (8, 5, 30), degrees=True).apply(first[0])
    points += [0.004, 0.007, 0.01 - points[:, 2].min() + height]
    there = near(detector_of(first, second), points, second[0], MARGIN)
    back = near(detector_of(second, first), second[0], points, MARGIN)
    assert len(there.gaps) == len(back.gaps) >= 1

    def rows(first_positions, second_positions, normals, gaps):
        table = np.column_stack([first_positions, second_positions, normals, gaps]).round(9) + 0.0
        return table[np.lexsort(table.T)]

    np.testing.assert_allclose(
        rows(there.first_positions, there.second_positions, there.normals, there.gaps),
        rows(back.second_positions, back.first_positions, -back.normals, back.gaps), atol=2e-9,
    )  # fmt: skip


@pytest.mark.parametrize("cells", [(1, 1, 1), (3, 3, 3)])
def test_a_deep_overlap_is_resolved_on_the_side_of_entry(box, cells):
    body, obstacle = box((0.1, 0.03, 0.02), (14, 4, 3)), box((0.03, 0.05, 0.02), cells)
    points = body[0] + [0.0, 0.0, 0.015]
    detector = detector_of(body, obstacle)
    for _ in range(60):
        found = near(detector, points, obstacle[0], 1e-4)
        if not len(found.gaps) or found.gaps.min() > -1e-6:
            break
        assert (found.normals[:, 2] > 0.99).all()
        points = points + found.normals.mean(axis=0) * 2e-4
    assert points[:, 2].min() == pytest.approx(0.01, abs=4e-4)


def test_a_shallow_overlap_at_a_rim_is_resolved_along_the_shortest_distance(box):
    upper, lower = box((0.03, 0.03, 0.03), (3, 3, 3)), box((0.04, 0.04, 0.04), (4, 4, 4))
    # 3 mm beyond the rim sideways, 1 mm deep.
    points = upper[0] + [0.032, 0.001, 0.034]
    found = near(detector_of(upper, lower), points, lower[0], 1e-5)
    assert len(found.gaps) >= 4
    assert (found.normals[:, 2] > 0.99).all()
    np.testing.assert_allclose(found.gaps, -1e-3, atol=1e-9)


def test_a_point_beyond_a_thin_body_is_not_inside_it(box):
    plate, lower = box((0.06, 0.06, 0.001), (6, 6, 1)), box((0.03, 0.03, 0.001), (3, 3, 1))
    # The whole plate lies below: behind the upper face of the other, and yet outside.
    points = plate[0] - [0.0, 0.0, 0.002]
    found = near(detector_of(plate, lower, depth=0.01), points, lower[0], MARGIN)
    assert len(found.gaps) > 0
    np.testing.assert_allclose(found.gaps, 1e-3)
    assert (found.normals[:, 2] < -0.99).all()


def test_nothing_is_found_beyond_the_margin(box):
    first, second = box((0.02, 0.02, 0.02), (3, 3, 3)), box((0.02, 0.02, 0.02), (3, 3, 3))
    detector = detector_of(first, second)
    assert len(near(detector, first[0] + [0, 0, 0.0231], second[0], MARGIN).gaps) == 0
    assert len(near(detector, first[0] + [0, 0, 0.0229], second[0], MARGIN).gaps) > 0
    assert len(near(detector, first[0] + [1, 1, 1], second[0], MARGIN).gaps) == 0


def test_open_surfaces_are_refused(box):
    points, triangles = box()
    with pytest.raises(MeshError, match="closed"):
        SurfacePairDetector(triangles[1:], len(points), triangles, len(points))
    flipped = triangles.copy()
    flipped[0] = flipped[0, ::-1]
    with pytest.raises(MeshError, match="opposite"):
        SurfacePairDetector(triangles, len(points), flipped, len(points))


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip


@pytest.mark.parametrize("depth", [1e-18, 1e-15, 1e-12, 1e-10, 1e-9])
def test_a_corner_almost_on_a_diagonal_has_a_finite_gap(depth):
    """A small box lies on the diagonal between the two triangles of a great box's face."""
    detector = SurfacePairDetector(FACES, 8, FACES, 8)
    rng = np.random.default_rng(3)
    ground = 0.03 * CORNERS - [0.0, 0.0, 0.03]
    inside = 0
    for _ in range(200):
        box = 0.01 * CORNERS + [0.0, 0.0, 0.01] + rng.uniform(-depth, depth, 3)
        found = near(detector, box, ground, 0.002)
        assert np.isfinite(found.gaps).all() and len(found.gaps) >= 4
        assert np.abs(found.gaps).max() < 1e-8
        inside += np.count_nonzero(found.gaps < 0.0)
    assert depth < 1e-16 or inside > 0


@pytest.mark.parametrize("depth", [1e-18, 1e-16, 1e-14, 1e-12])
def test_a_vertex_inside_by_round_off_is_pushed_out_on_its_side(block, depth):
    """Two blocks, face on face: no vertex is pushed out through the opposite side."""
    upper, lower = block((0.04, 0.04, 0.02), (6, 6, 3)), block((0.06, 0.06, 0.03), (3, 3, 2))
    detector = SurfacePairDetector(
        upper.surface_triangles, upper.node_count, lower.surface_triangles, lower.node_count
    )
    rng = np.random.default_rng(5)
    x = upper.node_positions - [0.02, 0.02, 0.0]
    y = lower.node_positions - [0.031, 0.032, 0.03]
    for turn in Rotation.random(50, random_state=1):
        moved = turn.apply(x + rng.uniform(-depth, depth, x.shape))
        found = near(detector, moved, turn.apply(y), 0.001)
        assert np.abs(found.gaps).max() < 1e-9
        np.testing.assert_allclose(found.normals @ turn.as_matrix()[:, 2], 1.0, atol=1e-6)
        # And none of them is missed.
        assert np.isin(np.flatnonzero(x[:, 2] == 0.0), found.first_points).all()
