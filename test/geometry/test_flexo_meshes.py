import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points

SIZES = (48, 216)


@pytest.fixture(scope="module", params=SIZES)
def mesh(request, kept_mesh):
    return kept_mesh(f"flexo_hand_{request.param}")


@pytest.fixture(scope="module")
def script(mesh_script):
    return mesh_script("make_flexo")


def test_all_refinements_fill_the_same_three_fingers(mesh):
    assert 1e9 * mesh.volume == pytest.approx(3 * 12.0 * 7.5 * 70.0, rel=1e-9)
    low, high = 1e3 * mesh.bounding_box
    assert low[2] == pytest.approx(0.0, abs=1e-9) and high[2] == pytest.approx(70.0)
    assert high[0] == pytest.approx(24.0)


def test_the_fingers_are_copies_at_120_degrees(mesh, script):
    count = mesh.node_count // 3
    turn = script.turn_about_z(3)
    for finger in range(2):
        own, following = (mesh.node_positions[k * count : (k + 1) * count]
                          for k in (finger, finger + 1))  # fmt: skip
        np.testing.assert_allclose(own @ turn.T, following, atol=1e-9)


def test_the_cable_runs_through_nodes_of_the_coarse_quadratic_mesh(kept_mesh, script):
    mesh = kept_mesh("flexo_hand_48")
    ends = mesh.node_positions
    edges = np.unique(np.sort(np.concatenate([
        mesh.cells[:, [a, b]] for a in range(4) for b in range(a)]), axis=1), axis=0)  # fmt: skip
    nodes = np.vstack([ends, ends[edges].mean(axis=1)])
    for point in script.FingerShape().cable():
        assert np.linalg.norm(nodes - point, axis=1).min() < 1e-9


def test_the_cable_lies_on_every_refinement(mesh, script):
    points = script.FingerShape().cable()
    np.testing.assert_allclose(locate_points(mesh, points).distances, 0.0, atol=1e-9)
