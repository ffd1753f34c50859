"""Facts of corotational quadratic tetrahedra."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import quadratic_values
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.inertia import borne_masses
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.material import lame_parameters

YOUNG, POISSON = 2.0e5, 0.4


def corotational(mesh, free_index, lame):
    return Elements(mesh, free_index, Corotational(*lame))


@pytest.fixture
def body(block, bind):
    """A box of quadratic tetrahedra."""

    def make(fixed=(), **shape):
        mesh = add_mid_edge_nodes(block(**shape))
        return mesh, bind((corotational, mesh, YOUNG, POISSON), fixed=fixed)

    return make


def deformed(mesh, amount, seed=0):
    rng = np.random.default_rng(seed)
    size = np.ptp(mesh.node_positions)
    return mesh.node_positions + amount * size * rng.standard_normal((mesh.node_count, 3))


def inside(mesh):
    low, high = mesh.bounding_box
    x = mesh.node_positions
    return np.all((x > low + 1e-9) & (x < high - 1e-9), axis=1)


@pytest.mark.parametrize("degrees", [0, 1, 45, 90, 135, 180, 270, 359, 360])
def test_rigid_rotation_stores_no_energy_and_makes_no_force(body, degrees):
    mesh, bound = body(cells=(1, 2, 2))
    axis = np.array([0.36, 0.48, 0.8])
    turned = Rotation.from_rotvec(np.radians(degrees) * axis).apply(mesh.node_positions)
    forces, K = bound.assemble(turned + [1.0, -2.0, 3.0])
    stress_times_area = YOUNG * 0.1**2
    assert np.abs(forces).max() < 1e-12 * stress_times_area
    assert bound.terms[0].energy(turned) < 1e-24 * YOUNG * mesh.volume
    values = np.linalg.eigvalsh(K.toarray())
    assert values[:6] == pytest.approx(0.0, abs=1e-10 * values[-1])
    assert values[6] > 1e-6 * values[-1]


def test_quadrature_with_four_points_gives_the_full_rank_of_the_stiffness(bind):
    tet = np.vstack([np.zeros(3), np.eye(3) + 0.1])
    mesh = add_mid_edge_nodes(TetMesh(tet, np.array([[0, 1, 2, 3]])))
    _, K = bind((corotational, mesh, 1.0, 0.3)).assemble(mesh.node_positions)
    assert np.linalg.matrix_rank(K.toarray(), tol=1e-9) == 24


def test_force_is_minus_the_gradient_of_the_energy(body):
    mesh, bound = body(cells=(1, 1, 1))
    x = deformed(mesh, 0.03)
    forces, _ = bound.assemble(x)
    np.testing.assert_allclose(bound.forces(x)[0], forces, atol=1e-12 * np.abs(forces).max())
    step = 1e-6
    for node in range(mesh.node_count):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += step
            behind[node, axis] -= step
            energy = bound.terms[0].energy
            slope = (energy(ahead) - energy(behind)) / (2 * step)
            assert forces[node, axis] == pytest.approx(-slope, abs=1e-5 * np.abs(forces).max())


@pytest.mark.parametrize("amount", [0.01, 0.04])
def test_tangent_is_minus_the_derivative_of_the_force(body, amount):
    mesh, bound = body(cells=(1, 2, 1), fixed=[0, 1, 2, 20])
    x = deformed(mesh, amount)
    K = bound.assemble(x)[1].toarray()
    step = 1e-7
    for index, node in enumerate(bound.free):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += step
            behind[node, axis] -= step
            column = -(bound.forces(ahead)[0] - bound.forces(behind)[0]).ravel() / (2 * step)
            np.testing.assert_allclose(
                K[:, 3 * index + axis], column, atol=1e-6 * np.abs(K).max()
            )


def test_projected_tangent_has_no_negative_curvature_where_the_exact_one_has(body):
    mesh, bound = body(cells=(1, 1, 1))
    squeezed = deformed(mesh, 0.01) * [0.35, 1.0, 0.6]
    exact = np.linalg.eigvalsh(bound.assemble(squeezed)[1].toarray())
    projected = np.linalg.eigvalsh(bound.assemble(squeezed, projected=True)[1].toarray())
    assert exact[0] < -1e-3 * exact[-1]
    assert projected[0] > -1e-12 * exact[-1]


def test_projected_tangent_is_the_exact_one_where_nothing_is_negative(body):
    mesh, bound = body(cells=(1, 1, 2))
    stretched = mesh.node_positions * 1.1
    exact, projected = (bound.assemble(stretched, p)[1].toarray() for p in (False, True))
    np.testing.assert_array_equal(exact, projected)


def test_patch_of_uniform_strain_is_in_balance_inside(body):
    mesh, bound = body(cells=(2, 2, 2), shake=0.3)
    gradient = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.0, 0.05, 1.05]])
    forces, _ = bound.assemble(mesh.node_positions @ gradient.T)
    assert inside(mesh).sum() > 20
    assert np.abs(forces[inside(mesh)]).max() < 1e-12 * np.abs(forces).max()


def test_patch_of_pure_bending_is_in_balance_inside(body):
    mesh, bound = body(cells=(2, 2, 2), shake=0.3)
    x, y, z = mesh.node_positions.T
    # σ_xx = -E κ z and no other stress.
    bent = np.column_stack(
        [-x * z, POISSON * y * z, 0.5 * (x**2 + POISSON * (z**2 - y**2))]
    )
    _, K = bound.assemble(mesh.node_positions)
    forces = (K @ bent.ravel()).reshape(-1, 3)
    assert np.abs(forces[inside(mesh)]).max() < 1e-12 * np.abs(forces).max()
    inertia = np.trapezoid if hasattr(np, "trapezoid") else np.trapz
    heights = np.linspace(0.0, 0.4, 20001)
    energy = 0.5 * YOUNG * 0.2 * 0.3 * inertia(heights**2, heights)
    assert 0.5 * bent.ravel() @ K @ bent.ravel() == pytest.approx(energy, rel=1e-6)


def test_a_collapsed_element_is_counted_and_pushed_back_to_positive_volume(body):
    mesh, bound = body(cells=(1, 1, 1))
    assert bound.forces(mesh.node_positions)[1] == 0
    for scale in (0.0, -0.3):
        flat = mesh.node_positions * [1.0, 1.0, scale]
        forces, inverted = bound.forces(flat)
        assert inverted == mesh.cell_count
        assert np.all(np.isfinite(forces))
        assert np.all(np.isfinite(bound.assemble(flat, projected=True)[1].toarray()))
        assert np.sum(forces[:, 2] * (mesh.node_positions[:, 2] - flat[:, 2])) > 0.0


@pytest.fixture
def one(bind):
    """A single element: its mesh and its term."""
    tet = np.vstack([np.zeros(3), np.eye(3)])
    mesh = add_mid_edge_nodes(TetMesh(tet, np.array([[0, 1, 2, 3]])))
    return mesh, bind((corotational, mesh, 1.0, 0.3))


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
    forces, K = bind((corotational, mesh, 1.0, 0.3)).assemble(mesh.node_positions)
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


def smooth_load(x):
    """A smooth displacement that vanishes on the faces of a unit cube, and -div σ of it."""
    lame, shear = lame_parameters(1.0, 0.3)
    s, c = np.sin(np.pi * x), np.cos(np.pi * x)
    exact = np.zeros_like(x)
    exact[..., 0] = np.prod(s, axis=-1)
    load = np.pi**2 * np.stack(
        [
            (lame + 4 * shear) * np.prod(s, axis=-1),
            -(lame + shear) * c[..., 0] * c[..., 1] * s[..., 2],
            -(lame + shear) * c[..., 0] * s[..., 1] * c[..., 2],
        ],
        axis=-1,
    )
    return exact, load


def solve_manufactured(mesh, bind, rule):
    """L2 error of the small displacement under that load."""
    points, weights = rule
    N = quadratic_values(points)
    exact, load = smooth_load(np.einsum("qa,kai->kqi", N, mesh.node_positions[mesh.cells]))
    volumes = mesh.volumes[:, None] * weights
    nodal = np.zeros((mesh.node_count, 3))
    np.add.at(nodal, mesh.cells, np.einsum("kq,qa,kqi->kai", volumes, N, load))
    bound = bind((corotational, mesh, 1.0, 0.3), fixed=np.flatnonzero(~inside(mesh)))
    bound.assemble(mesh.node_positions)
    assert bound.matrix.factor()
    u = np.zeros((mesh.node_count, 3))
    u[bound.free] = bound.matrix.solve(nodal[bound.free])
    error = np.einsum("qa,kai->kqi", N, u[mesh.cells]) - exact
    return np.sqrt(np.sum(volumes * np.sum(error**2, axis=2)))


def test_displacement_converges_with_the_cube_of_the_mesh_size(block, bind, tet_rule):
    errors = [
        solve_manufactured(
            add_mid_edge_nodes(block(size=(1, 1, 1), cells=(n, n, n), shake=0)), bind, tet_rule()
        )
        for n in (3, 6)
    ]
    assert 2.7 < np.log2(errors[0] / errors[1]) < 3.3
