import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.reading import read_tet_mesh
from softrobot_twin.geometry.regions import nodes_in_box
from softrobot_twin.geometry.surface import boundary_triangles

MESHES = Path(__file__).resolve().parents[2] / "meshes"
NODE_COUNTS = {158: (150, 170), 400: (350, 450), 1200: (1100, 1300)}
FIXED_BOX = ((-15e-3, 0.0, 0.0), (5e-3, 10e-3, 15e-3))
WIDTH = 15e-3


@pytest.fixture(scope="module", params=NODE_COUNTS)
def size(request):
    return request.param


@pytest.fixture(scope="module")
def mesh(size):
    reading = read_tet_mesh(MESHES / f"grasper_finger_{size}.vtk")
    assert reading.notes == ()
    return reading.mesh


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("make_grasper", MESHES / "make_grasper.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_each_refinement_has_its_size(mesh, size):
    lowest, highest = NODE_COUNTS[size]
    assert lowest <= mesh.node_count <= highest


def test_no_element_is_badly_shaped(mesh):
    assert radius_ratios(mesh).min() >= 0.35


def test_all_refinements_fill_the_same_finger(mesh):
    np.testing.assert_allclose(
        1e3 * mesh.bounding_box, [[-103.4, 0, 0], [0, 15, 15]], rtol=1e-12, atol=1e-9
    )
    assert 1e9 * mesh.volume == pytest.approx(18_521.25, abs=0.1)


def test_the_surface_is_closed(mesh):
    corners = mesh.node_positions[boundary_triangles(mesh.tets)]
    flux = np.einsum("ti,ti->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6
    assert flux == pytest.approx(mesh.volume, rel=1e-12)


def test_every_point_of_the_cable_lies_inside(mesh, script):
    points = 1e-3 * script.CABLE_POINTS
    np.testing.assert_allclose(locate_points(mesh, points).distances, 0.0, atol=1e-9)


def test_the_cable_crosses_four_notches_in_the_open_and_a_hinge_stays_below(mesh):
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
        np.unique(np.sort(image[mesh.tets], axis=1), axis=0),
        np.unique(np.sort(mesh.tets, axis=1), axis=0),
    )


def test_the_script_makes_the_meshes_that_are_kept(script, mesh, size, tmp_path, capsys):
    assert script.main(["--size", str(size), "--output", str(tmp_path)]) == 0
    made = read_tet_mesh(tmp_path / f"grasper_finger_{size}.vtk").mesh
    np.testing.assert_array_equal(made.tets, mesh.tets)
    np.testing.assert_allclose(made.node_positions, mesh.node_positions, rtol=0, atol=1e-12)
    assert f"{mesh.node_count} nodes" in capsys.readouterr().out


def test_the_script_does_not_write_a_mesh_that_cannot_be_used(
    script, tmp_path, capsys, monkeypatch
):
    flat = script.Refinement(50e-3, 1, 1, 1, 6)
    monkeypatch.setitem(script.REFINEMENTS, 158, flat)
    assert script.main(["--size", "158", "--output", str(tmp_path)]) == 1
    assert "radius ratio is 0." in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
