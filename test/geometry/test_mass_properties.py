import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.mass_properties import surface_mass_properties
from softrobot_twin.geometry.surface import boundary_triangles

TET = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def test_a_tetrahedron_has_the_textbook_mass_properties():
    points = np.vstack([np.zeros(3), np.eye(3)])
    found = surface_mass_properties(points, TET)
    assert found.volume == pytest.approx(1 / 6)
    np.testing.assert_allclose(found.centroid, 0.25)
    # ∫ x² = 1/60 and ∫ x y = 1/120 about the right-angled corner.
    about_corner = np.full((3, 3), -1 / 120) + np.eye(3) * (2 / 60 + 1 / 120)
    steiner = (3 / 16 * np.eye(3) - np.full((3, 3), 1 / 16)) / 6
    np.testing.assert_allclose(found.inertia, about_corner - steiner, atol=1e-16)


def test_a_moved_block_has_the_mass_properties_of_a_moved_block(block):
    a, b, c = 0.2, 0.3, 0.4
    mesh = block(size=(a, b, c))
    turn = Rotation.from_rotvec([0.3, 0.5, -0.8]).as_matrix()
    shift = np.array([5.0, -3.0, 2.0])
    points = mesh.node_positions @ turn.T + shift
    found = surface_mass_properties(points, boundary_triangles(mesh.cells))
    volume = a * b * c
    inertia = volume / 12 * np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    assert found.volume == pytest.approx(volume, rel=1e-12)
    np.testing.assert_allclose(found.centroid, turn @ [a / 2, b / 2, c / 2] + shift, rtol=1e-12)
    np.testing.assert_allclose(found.inertia, turn @ inertia @ turn.T, atol=1e-12 * volume)


CORNERS = np.vstack([np.zeros(3), np.eye(3)])


@pytest.mark.parametrize("points, triangles, reason", [
    (CORNERS, TET[:3], "belongs to 1 triangles; in a closed"),
    (CORNERS, np.vstack([TET[:1, ::-1], TET[1:]]), "belongs to two, with opposite directions"),
    (CORNERS, TET[:, ::-1], "outwards"),
    (np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 0]]), TET, "outwards"),
], ids=["open", "flipped triangle", "inside out", "flat"])  # fmt: skip
def test_a_surface_that_encloses_nothing_is_refused(points, triangles, reason):
    with pytest.raises(MeshError, match=reason):
        surface_mass_properties(points, triangles)
