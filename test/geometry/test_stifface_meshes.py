"""Meshes of the Stifface."""


import numpy as np
import pytest

from meshes.make_stifface import HALF_SIDE, HEIGHT, REFINEMENTS, THICKNESS, make_stifface
from meshes.mesh_making import mirror, turn_about_z
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh


@pytest.mark.parametrize("size", REFINEMENTS)
def test_a_mesh_has_its_size_and_the_dimensions_of_the_pad(size):
    mesh = make_stifface(REFINEMENTS[size])
    assert isinstance(mesh, HexahedralMesh) and mesh.node_count == size
    x, y, z = mesh.node_positions.T
    plate = z >= HEIGHT - 1e-9
    assert np.abs(x[plate]).max() == pytest.approx(HALF_SIDE)
    assert z.max() == pytest.approx(HEIGHT + THICKNESS) and z.min() == 0.0


@pytest.mark.parametrize("size", REFINEMENTS)
def test_a_mesh_is_the_same_after_a_quarter_of_a_turn_and_in_mirrors(size):
    places = make_stifface(REFINEMENTS[size]).node_positions
    known = {tuple(place) for place in np.round(places, 9) + 0.0}
    for matrix in (turn_about_z(4), mirror(0), mirror(1)):
        assert {tuple(place) for place in np.round(places @ matrix.T, 9) + 0.0} == known


def test_all_refinements_have_the_same_volume():
    volumes = [make_stifface(refinement).volume for refinement in REFINEMENTS.values()]
    assert volumes == pytest.approx([volumes[0]] * len(volumes), rel=1e-9)
