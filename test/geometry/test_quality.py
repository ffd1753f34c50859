import numpy as np
import pytest

from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.tet_mesh import TetMesh

REGULAR = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)


def test_a_regular_tetrahedron_has_quality_one():
    assert radius_ratios(TetMesh(REGULAR, [[0, 2, 1, 3]])) == pytest.approx([1.0], abs=1e-14)


def test_ratio_is_that_of_the_two_spheres(block):
    mesh = block()
    for tet, ratio in zip(mesh.cells, radius_ratios(mesh), strict=True):
        corners = mesh.node_positions[tet]
        edges = corners[1:] - corners[0]
        circumcentre = np.linalg.solve(2 * edges, (edges**2).sum(axis=1))
        normals = np.linalg.inv(edges).T
        normals = np.vstack([-normals.sum(axis=0), normals])
        # The centre and radius of the sphere that is as far from all four faces.
        rows = np.column_stack([normals, -np.linalg.norm(normals, axis=1)])
        inscribed = np.linalg.solve(rows, [-1.0, 0.0, 0.0, 0.0])[3]
        assert ratio == pytest.approx(3 * inscribed / np.linalg.norm(circumcentre), rel=1e-10)


def test_quality_does_not_depend_on_size_or_place(block):
    mesh = block()
    moved = TetMesh(mesh.node_positions * 1e-4 + 3e-4, mesh.cells)
    np.testing.assert_allclose(radius_ratios(moved), radius_ratios(mesh), rtol=1e-9)


def test_quality_goes_to_zero_as_a_tetrahedron_flattens():
    flattened = [
        radius_ratios(TetMesh(REGULAR * [1, 1, height], [[0, 2, 1, 3]]))[0]
        for height in (0.5, 0.05, 5e-3, 5e-6)
    ]
    assert flattened == sorted(flattened, reverse=True)
    assert 0.0 <= flattened[-1] < 2e-5
