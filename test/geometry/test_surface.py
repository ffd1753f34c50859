import numpy as np
import pytest

from softrobot_twin.geometry.surface import boundary_faces, boundary_triangles


def test_surface_encloses_the_volume_of_the_body(block):
    mesh = block()
    corners = mesh.node_positions[boundary_triangles(mesh.cells)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert np.einsum("ti,ti->", normals, corners.mean(axis=1)) / 3 == pytest.approx(mesh.volume)
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-15)


def test_surface_is_closed_with_each_edge_used_once_in_each_direction(block):
    triangles = boundary_triangles(block().cells)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert {tuple(edge) for edge in edges} == {tuple(edge[::-1]) for edge in edges}


def test_normals_point_away_from_the_tetrahedron_behind(block):
    mesh = block()
    faces = boundary_faces(mesh.cells)
    corners = mesh.node_positions[faces.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    behind = mesh.node_positions[mesh.cells[faces.tets]].mean(axis=1)
    assert (np.einsum("ti,ti->t", normals, corners.mean(axis=1) - behind) > 0).all()
    for triangle, tet in zip(faces.triangles, faces.tets, strict=True):
        assert set(triangle) < set(mesh.cells[tet])


def test_a_box_has_two_triangles_for_each_cell_face(block):
    triangles = boundary_triangles(block(cells=(2, 3, 4)).cells)
    assert triangles.shape == (2 * 2 * (2 * 3 + 3 * 4 + 4 * 2), 3)
    assert triangles.dtype == np.int64
