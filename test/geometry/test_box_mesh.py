"""Boxes that are meshed without a file."""

from __future__ import annotations

import numpy as np
import pytest

from softrobot_twin.geometry.box_mesh import cells_of_size, read_box
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.tet_mesh import TetMesh

pytestmark = pytest.mark.libraries

SIZE, CELLS = (0.1, 0.02, 0.03), (6, 2, 4)


@pytest.mark.parametrize("of_hexahedra", [False, True], ids=["tetrahedra", "hexahedra"])
def test_a_box_is_filled_from_the_origin_to_its_size(of_hexahedra):
    mesh = read_box(SIZE, CELLS, of_hexahedra).mesh
    assert isinstance(mesh, HexahedralMesh if of_hexahedra else TetMesh)
    assert mesh.cell_count == (1 if of_hexahedra else 6) * 6 * 2 * 4
    assert mesh.node_count == 7 * 3 * 5
    assert mesh.volumes.min() > 0.0
    assert mesh.volumes.sum() == pytest.approx(np.prod(SIZE), rel=1e-12)
    np.testing.assert_allclose(mesh.bounding_box, [np.zeros(3), SIZE], atol=1e-15)


@pytest.mark.parametrize("cells", [(1, 1, 1), (3, 2, 1), (2, 3, 3)])
def test_faces_of_neighbouring_cells_match(cells):
    """The surface of the tetrahedra is that of the box: two triangles on each square."""
    mesh = read_box(SIZE, cells).mesh
    nx, ny, nz = cells
    assert len(mesh.surface_triangles) == 4 * (nx * ny + ny * nz + nz * nx)
    assert radius_ratios(mesh).min() > 0.0


def test_the_mesh_of_even_counts_is_its_own_image_in_a_mirror():
    mesh = read_box(SIZE, CELLS).mesh
    numbers = {tuple(place): node for node, place in enumerate(np.round(mesh.node_positions, 9))}
    tets = {frozenset(tet) for tet in mesh.cells.tolist()}
    for axis in range(3):
        mirrored = mesh.node_positions.copy()
        mirrored[:, axis] = SIZE[axis] - mirrored[:, axis]
        image = np.array([numbers[tuple(place)] for place in np.round(mirrored, 9)])
        assert {frozenset(tet) for tet in image[mesh.cells].tolist()} == tets


def test_a_box_is_turned_and_then_moved():
    moved = read_box(SIZE, CELLS, rotation=(0.0, 0.0, np.pi / 2), translation=(1.0, 0.0, 0.0)).mesh
    np.testing.assert_allclose(
        moved.bounding_box, [[1.0 - SIZE[1], 0.0, 0.0], [1.0, SIZE[0], SIZE[2]]], atol=1e-12
    )


def test_cells_are_no_larger_than_asked_and_no_more_than_needed():
    assert cells_of_size((0.1, 0.02, 0.02), 0.005) == (20, 4, 4)
    assert cells_of_size((0.1, 0.02, 0.021), 0.005) == (20, 4, 5)
    assert cells_of_size((0.1, 0.02, 0.001), 0.05) == (2, 1, 1)
