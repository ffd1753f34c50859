"""Facts of corotational quadratic tetrahedra."""

import numpy as np
import pytest

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import quadratic_values
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.inertia import borne_masses
from test.builder import builder

YOUNG, POISSON = 2.0e5, 0.4


@builder
def body(block, bind, /, fixed=(), **shape):
    """A box of quadratic tetrahedra."""
    mesh = add_mid_edge_nodes(block(**shape))
    return mesh, bind(("corotational", mesh, YOUNG, POISSON), fixed=fixed)


def inside(mesh):
    low, high = mesh.bounding_box
    x = mesh.node_positions
    return np.all((x > low + 1e-9) & (x < high - 1e-9), axis=1)


def test_quadrature_with_four_points_gives_the_full_rank_of_the_stiffness(bind):
    tet = np.vstack([np.zeros(3), np.eye(3) + 0.1])
    mesh = add_mid_edge_nodes(TetMesh(tet, np.array([[0, 1, 2, 3]])))
    _, K = bind(("corotational", mesh, 1.0, 0.3)).assemble(mesh.node_positions)
    assert np.linalg.matrix_rank(K.toarray(), tol=1e-9) == 24


def test_patch_of_pure_bending_is_in_balance_inside(body):
    mesh, bound = body(cells=(2, 2, 2), shake=0.3)
    x, y, z = mesh.node_positions.T
    # σ_xx = -E κ z and no other stress.
    bent = np.column_stack([-x * z, POISSON * y * z, 0.5 * (x**2 + POISSON * (z**2 - y**2))])
    _, K = bound.assemble(mesh.node_positions)
    forces = (K @ bent.ravel()).reshape(-1, 3)
    assert np.abs(forces[inside(mesh)]).max() < 1e-12 * np.abs(forces).max()
    inertia = np.trapezoid if hasattr(np, "trapezoid") else np.trapz
    heights = np.linspace(0.0, 0.4, 20001)
    energy = 0.5 * YOUNG * 0.2 * 0.3 * inertia(heights**2, heights)
    assert 0.5 * bent.ravel() @ K @ bent.ravel() == pytest.approx(energy, rel=1e-6)


@pytest.fixture
def one(bind):
    """A single element: its mesh and its term."""
    tet = np.vstack([np.zeros(3), np.eye(3)])
    mesh = add_mid_edge_nodes(TetMesh(tet, np.array([[0, 1, 2, 3]])))
    return mesh, bind(("corotational", mesh, 1.0, 0.3))


def test_an_element_inverted_everywhere_is_counted_once(one):
    mesh, bound = one
    assert bound.forces(-mesh.node_positions)[1] == 1


def test_an_element_inverted_at_a_corner_only_is_counted(one):
    mesh, bound = one
    # Along the edge 0-1 the slope at corner 1 is 3 - 4 x, so the fold begins at x = 0.75.
    for middle, count in ((0.74, 0), (0.76, 1)):
        x = mesh.node_positions.copy()
        x[mesh.cells[0, 4], 0] = middle
        assert bound.forces(x)[1] == count


def test_an_element_inverted_between_its_corners_is_counted(one):
    mesh, bound = one
    x = mesh.node_positions.copy()
    x[[8, 6]] += [[0.4, -0.2, 0.8], [1.0, 0.2, 0.2]]
    # Upright at every corner: a small tetrahedron cut off there keeps its orientation.
    for corner in range(4):
        near = np.eye(4)[corner] + 1e-4 * (np.eye(4) - np.eye(4)[corner])
        a, b, c, d = quadratic_values(near) @ x[mesh.cells[0]]
        assert np.linalg.det([b - a, c - a, d - a]) > 0.0
    assert bound.forces(x)[1] == 1


def test_the_stiffness_of_a_sliver_is_that_of_its_energy(bind):
    sliver = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 0.002]])
    mesh = add_mid_edge_nodes(TetMesh(sliver, np.array([[0, 1, 2, 3]])))
    forces, K = bind(("corotational", mesh, 1.0, 0.3)).assemble(mesh.node_positions)
    values = np.linalg.eigvalsh(K.toarray())
    assert np.abs(forces).max() < 1e-12 * values[-1]
    assert values[0] > -1e-12 * values[-1]


def test_nodal_weights_sum_to_the_weight_of_the_body_and_its_moment(block):
    mesh = add_mid_edge_nodes(block())
    masses = borne_masses(mesh, 1070.0)
    assert masses.sum() == pytest.approx(1070.0 * mesh.volume)
    linear = mesh.corner_mesh
    np.testing.assert_allclose(
        masses @ mesh.node_positions, borne_masses(linear, 1070.0) @ linear.node_positions
    )
