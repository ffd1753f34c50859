import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.regions import nodes_in_box
from softrobot_twin.geometry.surface import boundary_triangles

SIZES = (120, 400, 1000)
FIXED_BOX = ((50e-3, -20e-3, 30e-3), (75e-3, 20e-3, 50e-3))
# Published places of the seven self-contacts, (x, z).
NOTCHES = 1e-3 * np.array(
    [(64, 11), (78, 3), (93, -7.5), (107, -23), (118, -38), (129.5, -55.5), (138, -73)]
)


@pytest.fixture(scope="module", params=SIZES)
def mesh(request, kept_mesh):
    return kept_mesh(f"octoleg_{request.param}")


@pytest.fixture(scope="module")
def script(mesh_script):
    return mesh_script("make_octoleg")


@pytest.fixture(scope="module")
def cable(script):
    return 1e-3 * np.insert(script.CABLE_POINTS, 1, 0.0, axis=1)


def test_all_refinements_fill_nearly_the_same_body(mesh):
    np.testing.assert_allclose(
        1e3 * mesh.bounding_box, [[41.8, -9.2, -102], [165, 9.2, 37]], rtol=1e-9
    )
    # 0.024 kg of silicone of 1070 kg/m³
    assert 1e9 * mesh.volume == pytest.approx(22_430, rel=0.01)


def test_every_point_of_the_cable_lies_inside(mesh, cable):
    np.testing.assert_allclose(locate_points(mesh, cable).distances, 0.0, atol=1e-9)


def test_the_cable_crosses_seven_notches_outside_the_body(mesh, cable):
    across = 0.5 * (cable[1::2] + cable[2::2])
    between = 0.5 * (cable[2:-1:2] + cable[3::2])
    assert locate_points(mesh, across).distances.min() > 1e-3
    assert locate_points(mesh, between).distances.max() < 1e-9


def test_the_fixed_box_holds_the_back_of_the_root(mesh):
    fixed = mesh.node_positions[nodes_in_box(mesh.node_positions, *FIXED_BOX)]
    assert len(fixed) >= 8
    assert fixed[:, 1].max() - fixed[:, 1].min() > 15e-3
    assert np.linalg.matrix_rank(fixed - fixed.mean(axis=0), tol=1e-3) == 3


def test_the_nodes_are_their_own_mirror_image(mesh):
    nodes = {tuple(node) for node in np.round(1e7 * mesh.node_positions).astype(int)}
    assert nodes == {(x, -y, z) for x, y, z in nodes}


def test_every_self_contact_is_a_surface_vertex_that_faces_another_flank(mesh, script):
    pairs = script.contact_pairs()
    assert len(pairs) == 7
    surface = np.unique(boundary_triangles(mesh.cells))
    distances = np.linalg.norm(mesh.node_positions[surface] - pairs[:, :, None], axis=-1)
    assert distances.min(axis=-1).max() < 1e-9
    points, keels, left, right = pairs.transpose(1, 0, 2)
    assert np.linalg.norm(points[:, [0, 2]] - NOTCHES, axis=1).max() < 1.5e-3
    normals = np.cross(left - keels, right - keels)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    # Out of the other flank: towards the root, where the cable comes from.
    assert (normals[:, 0] < 0.0).all()
    gaps = np.sum((points - keels) * normals, axis=1)
    assert gaps.min() > 2e-3
    assert gaps.max() < 6e-3


def test_the_coarsest_mesh_has_one_triangle_on_every_flank(script, kept_mesh):
    mesh = kept_mesh("octoleg_120")
    triangles = {frozenset(triangle) for triangle in boundary_triangles(mesh.cells).tolist()}
    for corners in script.contact_pairs()[:, 1:]:
        offsets = mesh.node_positions - corners[:, None]
        nearest = np.linalg.norm(offsets, axis=-1).argmin(axis=1)
        assert frozenset(nearest.tolist()) in triangles
