import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.regions import nodes_in_box

SIZES = (158, 400, 1200)
FIXED_BOX = ((-15e-3, 0.0, 0.0), (5e-3, 10e-3, 15e-3))
WIDTH = 15e-3


@pytest.fixture(scope="module", params=SIZES)
def mesh(request, kept_mesh):
    return kept_mesh(f"grasper_finger_{request.param}")


@pytest.fixture(scope="module")
def script(mesh_script):
    return mesh_script("make_grasper")


def test_all_refinements_fill_the_same_finger(mesh):
    np.testing.assert_allclose(
        1e3 * mesh.bounding_box, [[-103.4, 0, 0], [0, 15, 15]], rtol=1e-12, atol=1e-9
    )
    assert 1e9 * mesh.volume == pytest.approx(18_521.25, abs=0.1)


def test_every_point_of_the_cable_lies_inside(mesh, script):
    points = 1e-3 * script.CABLE_POINTS
    np.testing.assert_allclose(locate_points(mesh, points).distances, 0.0, atol=1e-9)


def test_the_cable_crosses_four_notches_outside_the_body_and_a_hinge_stays_below(mesh):
    for centre in (25e-3, 40e-3, 55e-3, 70e-3):
        points = [(-centre, 12.5e-3, 2.5e-3), (-centre, 4e-3, 2.5e-3)]
        across, below = locate_points(mesh, points).distances
        assert across == pytest.approx(3.25e-3)  # half a notch from the flanks
        assert below == 0.0


def test_the_fixed_box_holds_the_root_on_both_sides(mesh):
    fixed = mesh.node_positions[nodes_in_box(mesh.node_positions, *FIXED_BOX)]
    assert len(fixed) >= 18
    np.testing.assert_allclose(fixed.min(axis=0), [-15e-3, 0.0, 0.0], atol=1e-9)
    assert fixed[:, 0].max() == 0.0
    assert fixed[:, 2].max() == pytest.approx(15e-3)


def test_a_finger_is_its_own_mirror_image(mesh):
    def numbered(positions):
        return {tuple(node): k for k, node in enumerate(np.round(1e7 * positions).astype(int))}

    index = numbered(mesh.node_positions)
    mirrored = mesh.node_positions * [1, 1, -1] + [0, 0, WIDTH]
    image = np.array([index[node] for node in numbered(mirrored)])
    np.testing.assert_array_equal(
        np.unique(np.sort(image[mesh.cells], axis=1), axis=0),
        np.unique(np.sort(mesh.cells, axis=1), axis=0),
    )
