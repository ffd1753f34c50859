"""The thickness of bodies and the number of elements across it."""

import numpy as np
import pytest

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.wall_thickness import thinnest_part

SIZE = (0.06, 0.04, 0.005)


@pytest.mark.parametrize("of_hexahedra", [True, False])
@pytest.mark.parametrize("layers", [1, 3])
def test_layers_of_a_plate_are_counted_whatever_their_length(of_hexahedra, layers):
    mesh = read_box(SIZE, (6, 4, layers), of_hexahedra, rotation=(0.3, -0.2, 0.7)).mesh
    part = thinnest_part(mesh)
    assert part.thickness == pytest.approx(0.005, rel=1e-6)
    assert part.elements == pytest.approx(layers, rel=1e-6)


def test_the_thinnest_part_lies_in_the_middle_of_the_wall():
    mesh = read_box(SIZE, (6, 4, 2)).mesh
    assert thinnest_part(mesh).place[2] == pytest.approx(0.0025)
    low, high = np.zeros(3), np.array(SIZE)
    assert ((low < thinnest_part(mesh).place) & (thinnest_part(mesh).place < high)).all()
