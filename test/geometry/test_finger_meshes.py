"""Meshes of the finger that README and examples begin with."""

from pathlib import Path

import numpy as np
import pytest

from meshes.make_finger import REFINEMENTS, FingerShape, Refinement, main, make_finger
from meshes.mesh_making import maps_onto_itself, mirror
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.scene import load_scene

pytestmark = pytest.mark.libraries

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module", params=REFINEMENTS)
def mesh(request):
    return read_solid_mesh(ROOT / "meshes" / f"finger_{request.param}.msh").mesh


def test_the_script_makes_the_files_that_are_kept(tmp_path):
    assert main(["--output", str(tmp_path)]) == 0
    for size in REFINEMENTS:
        kept = read_solid_mesh(ROOT / "meshes" / f"finger_{size}.msh").mesh
        made = read_solid_mesh(tmp_path / f"finger_{size}.msh").mesh
        assert made.node_count == size
        np.testing.assert_array_equal(made.cells, kept.cells)
        np.testing.assert_allclose(made.node_positions, kept.node_positions, rtol=0, atol=1e-12)


def test_a_finger_has_its_dimensions_and_no_flat_element(mesh):
    box = [[0.0, -8.0, -10.0], [100.0, 8.0, 10.0]]
    np.testing.assert_allclose(1e3 * mesh.bounding_box, box, atol=1e-9)
    assert radius_ratios(mesh).min() > 0.4


def test_a_finger_is_its_own_image_in_both_mirrors(mesh):
    assert maps_onto_itself(mesh, mirror(1)) and maps_onto_itself(mesh, mirror(2))


@pytest.mark.parametrize("scene", ["finger", "finger_device"])
def test_cables_and_markers_of_the_scene_lie_in_the_body(scene):
    scene = load_scene(ROOT / "config" / "scenes" / f"{scene}.yaml")
    mesh = read_solid_mesh(scene.file_path(scene.deformables[0].mesh.file)).mesh
    points = [point for cable in scene.cables for point in (cable.pull_point, *cable.points)]
    points += [marker.point for marker in scene.markers]
    assert locate_points(mesh, np.array(points)).distances.max() < 1e-9


def test_cables_outside_the_finger_are_named():
    from meshes.make_finger import finger_faults
    made = make_finger(Refinement(8, 2, 1, 1), FingerShape(root=(4.0, 4.0), end=(3.0, 3.0)))
    assert any("a point of a cable lies 3" in fault for fault in finger_faults(made))
