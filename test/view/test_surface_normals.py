import numpy as np
import pytest

from softrobot_twin.view.picture import SurfaceNormals

pytestmark = pytest.mark.libraries


def test_normals_of_a_box_point_out_of_its_corners():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in squares for t in ((a, b, c), (a, c, d))])
    normals = SurfaceNormals(triangles, 8).at(corners)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(8))
    assert (np.einsum("ij,ij->i", normals, corners) > 1.0).all()


def test_normals_are_the_sum_over_the_faces_by_area():
    random = np.random.default_rng(1)
    positions = random.random((30, 3))
    triangles = random.integers(0, 30, (80, 3))
    a, b, c = positions[triangles].transpose(1, 0, 2)
    sums = np.zeros((30, 3))
    for corner in range(3):
        np.add.at(sums, triangles[:, corner], np.cross(b - a, c - a))
    expected = sums / np.linalg.norm(sums, axis=1)[:, None]
    assert SurfaceNormals(triangles, 30).at(positions) == pytest.approx(expected)


def test_a_vertex_without_area_gets_no_normal():
    triangles = np.array([[0, 1, 2], [3, 3, 3]])
    normals = SurfaceNormals(triangles, 5).at(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0],
                                                        [5, 5, 5], [6, 6, 6]], float))
    assert normals[:3] == pytest.approx(np.array([[0, 0, 1]] * 3))
    assert (normals[3:] == 0.0).all()
