
import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.regions import nodes_in_box

SIZES = (400, 1600, 4500, 15000)
FIXED_BOX = ((-15e-3, -15e-3, -40e-3), (15e-3, 15e-3, 10e-3))
ATTACH_POINTS = 1e-3 * np.array([(0, 97, 45), (-97, 0, 45), (0, -97, 45), (97, 0, 45)])


@pytest.fixture(scope="module", params=SIZES)
def mesh(request, kept_mesh):
    return kept_mesh(f"diamond_{request.param}")


def test_the_standard_refinement_has_about_5000_elements(kept_mesh):
    assert 4000 <= kept_mesh("diamond_1600").cell_count <= 5500


def test_all_refinements_fill_the_same_body(mesh):
    np.testing.assert_allclose(
        1e3 * mesh.bounding_box, [[-97, -97, -37], [97, 97, 126]], rtol=1e-12
    )
    assert 1e9 * mesh.volume == pytest.approx(391_802, abs=1)


def test_cables_are_attached_on_the_body_and_the_effector_lies_inside(mesh):
    points = np.vstack([ATTACH_POINTS, [0, 0, 125e-3]])
    np.testing.assert_allclose(locate_points(mesh, points).distances, 0.0, atol=1e-9)


def test_the_fixed_box_holds_the_base_and_nothing_else(mesh):
    fixed = np.zeros(mesh.node_count, dtype=bool)
    fixed[nodes_in_box(mesh.node_positions, *FIXED_BOX)] = True
    base = mesh.volumes[fixed[mesh.cells].all(axis=1)].sum()
    # 30 mm square, from the underside up to where the struts' upper sides meet it
    assert 1e9 * base == pytest.approx(24_797, abs=5)
    heights = mesh.node_positions[fixed, 2]
    assert heights.min() == pytest.approx(-37e-3)
    assert heights.max() < 0.0


def test_the_body_has_two_mirror_symmetries(mesh):
    nodes = {tuple(node) for node in np.round(1e7 * mesh.node_positions).astype(int)}
    assert nodes == {(y, x, z) for x, y, z in nodes} == {(-y, -x, z) for x, y, z in nodes}
    in_mirror = np.round(1e7 * mesh.node_positions[:, [1, 0, 2]]).astype(int)
    index = {
        tuple(node): number
        for number, node in enumerate(np.round(1e7 * mesh.node_positions).astype(int))
    }
    image = np.array([index[tuple(node)] for node in in_mirror])
    np.testing.assert_array_equal(
        np.unique(np.sort(image[mesh.cells], axis=1), axis=0),
        np.unique(np.sort(mesh.cells, axis=1), axis=0),
    )
