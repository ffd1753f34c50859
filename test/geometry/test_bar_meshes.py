"""The slim bar's meshes: the script makes the committed files, of both kinds the same body."""

import numpy as np
import pytest

from softrobot_twin.geometry.hexahedral_mesh import scaled_jacobians
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from test.places import MESHES

KEPT = sorted(path.name for path in MESHES.glob("bar_*.msh"))


@pytest.mark.parametrize("name", KEPT)
def test_every_mesh_of_the_bar_has_its_volume_and_names_its_body(name):
    reading = read_solid_mesh(MESHES / name)
    mesh = reading.mesh
    assert reading.notes == ()
    assert mesh.volume == pytest.approx(4e-5)
    assert mesh.node_count == int(name.removesuffix(".msh").rpartition("_")[2])
    assert len(reading.parts.region("body")) == mesh.cell_count
    if "hexa" in name:
        np.testing.assert_allclose(scaled_jacobians(mesh.node_positions[mesh.hexahedra]), 1.0)
