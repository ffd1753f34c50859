import numpy as np
import pytest

from softrobot_twin.geometry.self_proximity import FixedPairs, SelfDetector
from softrobot_twin.geometry.surface import boundary_triangles
from test.cad_parts import need_gmsh
from test.near_pairs import near
from test.thin_walled_meshes import bent, halved, random_thin_walls

MARGIN = 2e-3


@pytest.fixture
def strip(block):
    """A straight strip along x, 120 x 10 x 4 mm: points and surface."""
    mesh = block((0.12, 0.01, 0.004), (30, 3, 3), shake=0.0)
    return mesh.node_positions, boundary_triangles(mesh.cells)


@pytest.fixture
def notched(block):
    """A beam along x, 50 x 12 x 12 mm, with a notch 2 mm wide and 8 mm deep from above."""
    mesh = block((0.05, 0.012, 0.012), (25, 4, 6), shake=0.0)
    centres = mesh.node_positions[mesh.cells].mean(axis=1)
    notch = (np.abs(centres[:, 0] - 0.025) < 1e-3) & (centres[:, 2] > 0.004)
    return mesh.node_positions, boundary_triangles(mesh.cells[~notch])


def rolled_up(points, opening):
    """The strip bent to a ring around y whose ends are `opening` apart [m], a C."""
    length = points[:, 0].max()
    radius = (length + opening) / (2 * np.pi)
    angle = points[:, 0] / radius
    outer = radius - points[:, 2] + points[:, 2].mean()
    return np.column_stack([outer * np.sin(angle), points[:, 1], -outer * np.cos(angle)])


def with_notch(points, width):
    """The beam with all to the right of its notch moved so that the notch has another width."""
    moved = points.copy()
    upper = (points[:, 0] > 0.0255) & (points[:, 2] > 0.0041)
    moved[upper, 0] += width - 2e-3
    return moved


@pytest.mark.parametrize("size", [(0.06, 0.06, 0.001), (0.03, 0.03, 0.03), (0.1, 0.01, 0.002)])
def test_nothing_is_near_in_a_box_or_sheet_at_rest(block, size):
    mesh = block(size, (8, 8, 1), shake=0.0)
    detector = SelfDetector(boundary_triangles(mesh.cells), mesh.node_positions, 5e-3)
    for margin in (5e-4, 2e-3, 5e-3):
        assert len(near(detector, mesh.node_positions, margin).gaps) == 0


def test_a_squeezed_sheet_does_not_meet_itself_through_the_body(block):
    mesh = block((0.06, 0.06, 0.001), (8, 8, 1), shake=0.0)
    detector = SelfDetector(boundary_triangles(mesh.cells), mesh.node_positions, 3e-3)
    for thickness in (0.9, 0.5, 0.2):
        assert len(near(detector, mesh.node_positions * [1, 1, thickness], 2e-3).gaps) == 0


def test_a_bent_strip_has_no_contact_with_its_neighbours(strip):
    points, triangles = strip
    detector = SelfDetector(triangles, points, 5e-3)
    assert len(near(detector, rolled_up(points, 0.06), MARGIN).gaps) == 0


def test_the_ends_of_a_c_shape_meet_face_to_face(strip):
    points, triangles = strip
    detector = SelfDetector(triangles, points, 5e-3)
    ring = rolled_up(points, 1e-3)
    found = near(detector, ring, MARGIN)
    assert len(found.gaps) >= 8
    # The first point of each pair lies on one end, the second on the other.
    first, second = (np.abs(points[i, 0] - 0.06) for i in (found.first_points, found.second_points))
    assert (first > 0.059).all()
    assert (second > 0.059).all()
    sides = np.sign(found.first_positions[:, 0] - found.second_positions[:, 0])
    np.testing.assert_allclose(found.normals[:, 0] * sides, 1.0, atol=0.01)
    assert found.gaps.max() < 1.2e-3
    assert found.gaps.min() > 0.8e-3
    np.testing.assert_allclose(
        found.first_positions - found.second_positions,
        found.gaps[:, None] * found.normals, atol=1e-9,
    )  # fmt: skip
    assert len(np.unique(found.keys)) == len(found.keys)


def test_ends_that_have_passed_through_each_other_are_pushed_apart(strip):
    points, triangles = strip
    detector = SelfDetector(triangles, points, 5e-3)
    found = near(detector, rolled_up(points, -5e-4), MARGIN)
    deep = found.gaps < -1e-4
    assert deep.sum() >= 8
    # The end of small x lies at negative angles of the other's, and must go to positive ones.
    first_end = points[found.first_points[deep, 0], 0] < 0.06
    np.testing.assert_allclose(found.normals[deep, 0], np.where(first_end, 1.0, -1.0), atol=0.02)
    assert found.gaps.min() > -7e-4


def test_flanks_of_a_notch_face_each_other_and_nothing_else_does(notched):
    points, triangles = notched
    detector = SelfDetector(triangles, points, 5e-3)
    assert len(near(detector, points, 1.5e-3).gaps) == 0
    found = near(detector, points, 2.5e-3)
    assert len(found.gaps) > 0
    np.testing.assert_allclose(found.gaps, 2e-3)
    np.testing.assert_allclose(np.abs(found.normals[:, 0]), 1.0)


@pytest.mark.parametrize(("width", "count"), [(1e-3, 15), (1e-4, 15), (-1e-4, 6), (-4e-4, 6)])
def test_the_gap_of_a_closing_notch_is_its_width(notched, width, count):
    points, triangles = notched
    found = near(SelfDetector(triangles, points, 5e-3), with_notch(points, width), 1.5e-3)
    for flank, sign in ((0.024, -1.0), (0.026, 1.0)):
        vertices = set()
        for side, indices, weights in (
            (1.0, found.first_points, found.first_weights),
            (-1.0, found.second_points, found.second_weights),
        ):
            at = indices[np.arange(len(indices)), weights.argmax(axis=1)]
            # Vertices of this flank above the slanted part; at the rim there is no inside.
            here = np.isclose(points[at, 0], flank) & (points[at, 2] > 0.0065)
            here &= weights.max(axis=1) == 1.0
            np.testing.assert_allclose(found.gaps[here], width, atol=1e-9)
            np.testing.assert_allclose(side * found.normals[here, 0], sign, atol=1e-6)
            vertices |= set(at[here])
        assert len(vertices) == count


def test_normal_is_the_gradient_of_the_gap(notched):
    points, triangles = notched
    detector = SelfDetector(triangles, points, 5e-3)
    moved = with_notch(points, 5e-4) + 1e-5 * np.random.default_rng(0).normal(size=points.shape)
    found = near(detector, moved, 1e-3)
    assert len(found.gaps) >= 20
    for row in range(0, len(found.gaps), 5):
        for axis in range(3):
            gaps = []
            for step in (1e-8, -1e-8):
                shifted = moved.copy()
                for c in range(3):
                    # A weighted point moves by the step if each of its points does.
                    shifted[found.first_points[row, c], axis] = (
                        moved[found.first_points[row, c], axis] + step
                    )
                after = near(detector, shifted, 1e-3)
                place = np.flatnonzero(after.keys == found.keys[row])
                assert len(place) == 1
                gaps.append(after.gaps[place[0]])
            slope = (gaps[0] - gaps[1]) / 2e-8
            assert slope == pytest.approx(found.normals[row, axis], abs=1e-4)


# Two triangles facing up, and three points over, beside and under them.
POINTS = np.array(
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2], [3, 0, 2], [0, 3, 2.0],
     [0.25, 0.5, 0.1], [1, 1, 2.2], [0.3, 0.3, -0.4]]
)  # fmt: skip


def test_gap_and_weights_are_exact():
    found = near(FixedPairs([6, 7, 8], [[0, 1, 2], [3, 4, 5], [0, 1, 2]]), POINTS, 1.0)
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
    normal = near(pairs, points, 10.0).normals[0]
    for axis in range(3):
        gaps = []
        for step in (1e-6, -1e-6):
            moved = points.copy()
            moved[3, axis] += step
            gaps.append(near(pairs, moved, 10.0).gaps[0])
        assert (gaps[0] - gaps[1]) / 2e-6 == pytest.approx(normal[axis], abs=1e-8)


def test_pairs_beyond_the_margin_are_omitted_and_keys_stay():
    found = near(FixedPairs([6, 7, 8], [[0, 1, 2], [3, 4, 5], [0, 1, 2]]), POINTS, 0.15)
    np.testing.assert_array_equal(found.keys, [0, 2])
    np.testing.assert_allclose(found.gaps, [0.1, -0.4])


def test_a_point_beside_its_triangle_touches_the_rim():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, -0.5, 0.1]])
    found = near(FixedPairs([3], [[0, 1, 2]]), points, 1.0)
    np.testing.assert_allclose(found.gaps, [0.1])
    np.testing.assert_allclose(found.second_positions, [[0.5, 0, 0]])
    assert (found.second_weights >= 0).all()


@pytest.mark.parametrize("seed", range(60))
def test_a_thin_walled_body_that_crosses_nowhere_overlaps_nowhere(seed):
    need_gmsh()
    random = np.random.default_rng([61, seed])
    points, cells = random_thin_walls(random)
    triangles = boundary_triangles(cells)
    bodies = [(points, triangles)]
    if len(triangles) < 800:
        bodies.append(halved(points, triangles))
    for rest, faces in bodies:
        alarm = 10.0 ** random.uniform(-3.7, -2.3)
        detector = SelfDetector(faces, rest, alarm)
        for strain in (0.0, 0.1, 0.3):
            found = near(detector, bent(rest, random, strain), alarm)
            assert found.gaps.min(initial=0.0) > -1e-12, f"seed {seed}, strain {strain}"
