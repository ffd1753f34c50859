import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.tet_mesh import TetMesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)


def test_volumes_of_a_box_sum_to_its_volume(block):
    mesh = block(size=(0.2, 0.3, 0.4))
    assert mesh.volumes.shape == (mesh.cell_count,)
    assert mesh.volume == pytest.approx(0.2 * 0.3 * 0.4, rel=1e-14)


def test_a_corner_tetrahedron_has_a_sixth_of_the_cube():
    mesh = TetMesh(CORNERS, [[0, 1, 2, 3]])
    assert (mesh.node_count, mesh.cell_count) == (4, 1)
    assert mesh.volumes == pytest.approx([1 / 6])


def test_bounding_box_holds_the_extreme_coordinates(block):
    box = block(size=(0.2, 0.3, 0.4)).bounding_box
    np.testing.assert_allclose(box, [[0, 0, 0], [0.2, 0.3, 0.4]])


def test_arrays_are_copies_that_cannot_be_written():
    positions = CORNERS.copy()
    mesh = TetMesh(positions, [[0, 1, 2, 3]])
    positions[0] = 9.0
    assert mesh.node_positions[0].tolist() == [0, 0, 0]
    for array in (mesh.node_positions, mesh.cells, mesh.volumes):
        with pytest.raises(ValueError):
            array[0] = 0
    assert mesh.node_positions.dtype == np.float64
    assert mesh.cells.dtype == np.int64


@pytest.mark.parametrize("corners", [[0, 2, 1, 3], [0, 1, 2, 2]])
def test_a_tetrahedron_without_volume_is_refused(corners):
    with pytest.raises(MeshError, match="no positive volume, the first is 0"):
        TetMesh(CORNERS, [corners])
