import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points

SIZES = (700, 1600, 4000)


@pytest.fixture(scope="module", params=SIZES)
def mesh(request, kept_mesh):
    return kept_mesh(f"trunk_{request.param}")


@pytest.fixture(scope="module")
def script(mesh_script):
    return mesh_script("make_trunk")


@pytest.fixture(scope="module")
def cables(script):
    return {name: 1e-3 * path for name, path in script.cables()}


def test_all_refinements_have_the_published_volume_and_length(mesh):
    assert 1e9 * mesh.volume == pytest.approx(38_829, rel=1e-4)
    assert 1e9 * mesh.volume == pytest.approx(38_900, rel=0.005)
    lowest, highest = 1e3 * mesh.bounding_box
    assert (lowest[2], highest[2]) == pytest.approx((0.0, 195.0))
    np.testing.assert_allclose(highest[:2], 12.44, rtol=0.025)  # the first disk, at z 20
    np.testing.assert_allclose(lowest[:2], -highest[:2], rtol=1e-9)


def test_every_section_is_balanced_about_the_axis(mesh):
    x, y, z = np.round(1e6 * mesh.node_positions).T
    for height in np.unique(z):
        own = z == height
        np.testing.assert_allclose([x[own].mean(), y[own].mean()], 0.0, atol=1.0)


def test_every_point_of_the_cables_lies_inside(mesh, cables):
    points = np.vstack([path[1:] for path in cables.values()])
    np.testing.assert_allclose(locate_points(mesh, points).distances, 0.0, atol=1e-9)


def test_the_cables_cross_the_first_gaps_outside_the_body(mesh, cables):
    path = cables["L0"]
    between = 0.5 * (path[2:8:2] + path[3:9:2])
    assert locate_points(mesh, between).distances.min() > 0.5e-3


def test_cables_follow_the_published_rule(cables):
    assert list(cables) == ["L0", "L1", "L2", "L3", "S0", "S1", "S2", "S3"]
    along = np.array([0.0, -8.0, 195.0]) / np.hypot(8.0, 195.0)
    for j in range(10):
        for k, z in enumerate((0.021, 0.027)):
            expected = [0.0, 0.010 + 0.0175 * j * along[1], z + 0.0175 * j * along[2]]
            np.testing.assert_allclose(cables["L0"][1 + 2 * j + k], expected, atol=1e-12)
    bases = [cables[f"L{i}"][0] for i in range(4)]
    expected = [[0, 0.01, 0], [-0.01, 0, 0], [0, -0.01, 0], [0.01, 0, 0]]
    np.testing.assert_allclose(bases, expected, atol=1e-12)
    for i in range(4):
        np.testing.assert_array_equal(cables[f"S{i}"], cables[f"L{i}"][:11])


def test_the_fixed_base_ends_on_a_layer_of_nodes(mesh):
    assert np.abs(mesh.node_positions[:, 2] - 0.020).min() < 1e-9
