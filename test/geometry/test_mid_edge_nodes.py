"""Ten-node tetrahedra of files: the order of their mid-edge nodes."""

import meshio
import numpy as np
import pytest

from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import EDGES

FORMATS = {".msh": "gmsh22", ".vtk": "vtk42", ".vtu": "vtu", ".inp": "abaqus"}


def written(path, points, cells):
    meshio.Mesh(points, [("tetra10", cells)]).write(path, file_format=FORMATS[path.suffix])
    return path


@pytest.fixture
def shuffled(block):
    """A quadratic block whose nodes stand in the file in no order: points, cells, mesh."""
    mesh = add_mid_edge_nodes(block())
    order = np.random.default_rng(3).permutation(mesh.node_count)
    return mesh.node_positions[order], np.argsort(order)[mesh.cells], mesh


# The last order is that of another program.
@pytest.mark.parametrize("suffix, last", [*((suffix, [8, 9]) for suffix in FORMATS), (".vtk", [9, 8])])
def test_ten_nodes_are_corners_and_six_on_straight_edges_in_either_order(suffix, last, shuffled, tmp_path):
    points, cells, mesh = shuffled
    reading = read_solid_mesh(written(tmp_path / f"body{suffix}", points, cells[:, [*range(8), *last]]))
    assert reading.notes == ()
    assert reading.mesh.node_count == mesh.corner_mesh.node_count
    assert reading.mesh.volume == pytest.approx(mesh.volume)
    mids = reading.mid_edge_nodes
    np.testing.assert_allclose(
        points[mids.file_nodes], reading.mesh.node_positions[mids.ends].mean(axis=1), atol=1e-12
    )
    assert len(mids.file_nodes) == len(mesh.mid_edge_ends)


def test_curved_edges_are_straightened_and_reported(block, tmp_path):
    mesh = add_mid_edge_nodes(block())
    points = mesh.node_positions.copy()
    node = mesh.cells[5, 4]
    length = np.linalg.norm(np.subtract(*points[mesh.cells[5, EDGES[0]]]))
    points[node] += [0.0, 0.0, 0.1 * length]
    reading = read_solid_mesh(written(tmp_path / "body.vtk", points, mesh.cells))
    (note,) = reading.notes
    assert f"1 curved edges (the node furthest off, {node}, by {100 * length:.3g} mm)" in note


def test_tetrahedra_of_four_and_ten_nodes_are_read_together(block, tmp_path):
    mesh = add_mid_edge_nodes(block())
    half = mesh.cell_count // 2
    path = tmp_path / "body.vtk"
    meshio.Mesh(
        mesh.node_positions, [("tetra", mesh.cells[:half, :4]), ("tetra10", mesh.cells[half:])]
    ).write(path, file_format="vtk42")
    reading = read_solid_mesh(path)
    assert reading.mesh.cell_count == mesh.cell_count
    assert reading.mesh.volume == pytest.approx(mesh.volume)
