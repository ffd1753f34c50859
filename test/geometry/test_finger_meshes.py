"""Meshes of the finger that README and examples begin with."""

from pathlib import Path

import numpy as np
import pytest

from meshes.make_finger import REFINEMENTS
from meshes.mesh_making import maps_onto_itself, mirror
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.scene import load_scene

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module", params=REFINEMENTS)
def mesh(request):
    return read_solid_mesh(ROOT / "meshes" / f"finger_{request.param}.msh").mesh


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
