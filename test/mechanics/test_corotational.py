"""Facts of corotational tetrahedra."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU

YOUNG, POISSON = 2.0e5, 0.4


def corotational(mesh, free_index, lame):
    return Elements(mesh, free_index, Corotational(*lame))


def make(mesh, fixed=(), young=YOUNG, poisson=POISSON):
    """A term over a mesh, bound to a matrix."""
    free_index = np.full(mesh.node_count, -1)
    free = np.setdiff1d(np.arange(mesh.node_count), fixed)
    free_index[free] = np.arange(len(free))
    term = corotational(mesh, free_index, lame_parameters(young, poisson))
    matrix = SuperLU(*stencil_pairs(term.stencils()), len(free))
    term.bind(matrix.elimination_rank, matrix.slots)
    return term, matrix, free


def assemble(term, matrix, positions, projected=False):
    forces = np.zeros((len(matrix.elimination_rank), 3))
    matrix.clear()
    term.add(positions, forces, matrix.storage, projected)
    return forces, matrix.matrix().toarray()


def deformed(mesh, amount, seed=0):
    rng = np.random.default_rng(seed)
    size = np.ptp(mesh.node_positions)
    return mesh.node_positions + amount * size * rng.standard_normal((mesh.node_count, 3))


@pytest.mark.parametrize("degrees", [0, 1, 45, 90, 135, 180, 270, 359, 360])
def test_rigid_rotation_stores_no_energy_and_makes_no_force(block, degrees):
    mesh = block()
    axis = np.array([0.36, 0.48, 0.8])
    turned = Rotation.from_rotvec(np.radians(degrees) * axis).apply(mesh.node_positions)
    term, matrix, _ = make(mesh)
    forces, K = assemble(term, matrix, turned + [1.0, -2.0, 3.0])
    stress_times_area = YOUNG * 0.1**2
    assert np.abs(forces).max() < 1e-12 * stress_times_area
    assert term.energy(turned) < 1e-24 * YOUNG * mesh.volume
    assert np.linalg.eigvalsh(K)[:6] == pytest.approx(0.0, abs=1e-10 * np.abs(K).max())


def test_force_is_minus_the_gradient_of_the_energy(block):
    mesh = block(cells=(1, 1, 2))
    term, matrix, _ = make(mesh)
    x = deformed(mesh, 0.05)
    forces, _ = assemble(term, matrix, x)
    step = 1e-6
    for node in range(mesh.node_count):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += step
            behind[node, axis] -= step
            slope = (term.energy(ahead) - term.energy(behind)) / (2 * step)
            assert forces[node, axis] == pytest.approx(-slope, abs=1e-5 * np.abs(forces).max())


@pytest.mark.parametrize("amount", [0.01, 0.08])
def test_tangent_is_minus_the_derivative_of_the_force(block, amount):
    mesh = block(cells=(1, 2, 1))
    term, matrix, free = make(mesh, fixed=[0, 1, 2])
    x = deformed(mesh, amount)
    _, K = assemble(term, matrix, x)
    step = 1e-7
    for index, node in enumerate(free):
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += step
            behind[node, axis] -= step
            f_ahead, f_behind = np.zeros((2, len(free), 3))
            term.add_forces(ahead, f_ahead)
            term.add_forces(behind, f_behind)
            column = -(f_ahead - f_behind).ravel() / (2 * step)
            np.testing.assert_allclose(
                K[:, 3 * index + axis], column, atol=1e-6 * np.abs(K).max()
            )


@pytest.mark.parametrize("element", ["linear", "quadratic"])
def test_keeping_the_deformation_of_a_state_changes_no_bit(block, element):
    mesh = block(cells=(2, 2, 3))
    mesh = mesh if element == "linear" else add_mid_edge_nodes(mesh)
    term, matrix, _ = make(mesh, fixed=[0, 3])
    mild, wild = deformed(mesh, 0.001), deformed(mesh, 0.3)
    for positions in (mild, wild, mild):
        forces = np.zeros((len(matrix.elimination_rank), 3))
        assert (term.add_forces(positions, forces) > 0) == (positions is wild)
        kept = assemble(term, matrix, positions)
        # Written to in place, it is another state.
        moved = positions.copy()
        term.add_forces(moved, np.zeros_like(forces))
        moved[5, 1] += 1e-3
        other = assemble(term, matrix, moved)
        for found, at in ((kept, positions), (other, moved)):
            anew = assemble(make(mesh, fixed=[0, 3])[0], matrix, at)
            np.testing.assert_array_equal(found[0], anew[0])
            np.testing.assert_array_equal(found[1], anew[1])
        np.testing.assert_array_equal(forces, kept[0])


def test_tangent_at_rest_is_linear_elasticity(block):
    mesh = block(cells=(1, 1, 1))
    term, matrix, _ = make(mesh)
    _, K = assemble(term, matrix, mesh.node_positions)
    strain = np.array([[2.0, 0.3, -0.1], [0.3, -1.0, 0.4], [-0.1, 0.4, 0.5]])
    u = (mesh.node_positions @ strain).ravel()
    lame, shear = lame_parameters(YOUNG, POISSON)
    density = shear * np.sum(strain**2) + 0.5 * lame * np.trace(strain) ** 2
    assert 0.5 * u @ K @ u == pytest.approx(density * mesh.volume)


def test_projected_tangent_has_no_negative_curvature_where_the_exact_one_has(block):
    mesh = block(cells=(1, 1, 2))
    term, matrix, _ = make(mesh)
    squeezed = mesh.node_positions * [0.35, 1.0, 0.6]
    _, exact = assemble(term, matrix, squeezed)
    _, projected = assemble(term, matrix, squeezed, projected=True)
    scale = np.abs(exact).max()
    assert np.linalg.eigvalsh(exact)[0] < -1e-3 * scale
    assert np.linalg.eigvalsh(projected)[0] > -1e-12 * scale


def test_projected_tangent_is_the_exact_one_where_nothing_is_negative(block):
    mesh = block(cells=(1, 1, 2))
    term, matrix, _ = make(mesh)
    stretched = mesh.node_positions * 1.1
    np.testing.assert_array_equal(
        assemble(term, matrix, stretched)[1],
        assemble(term, matrix, stretched, projected=True)[1],
    )


def test_patch_of_uniform_strain_is_in_balance_inside(block):
    mesh = block(cells=(3, 3, 3), shake=0.3)
    term, matrix, _ = make(mesh)
    gradient = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.0, 0.05, 1.05]])
    forces, _ = assemble(term, matrix, mesh.node_positions @ gradient.T)
    low, high = mesh.bounding_box
    x = mesh.node_positions
    inside = np.all((x > low + 1e-9) & (x < high - 1e-9), axis=1)
    assert inside.sum() == 8
    assert np.abs(forces[inside]).max() < 1e-12 * np.abs(forces).max()


def test_a_collapsed_element_is_pushed_back_to_positive_volume(block):
    mesh = block(cells=(1, 1, 1))
    term, _, _ = make(mesh)
    for scale in (0.0, -0.3):
        flat = mesh.node_positions * [1.0, 1.0, scale]
        forces = np.zeros((mesh.node_count, 3))
        term.add_forces(flat, forces)
        assert np.all(np.isfinite(forces))
        upwards = np.sum(forces[:, 2] * (mesh.node_positions[:, 2] - flat[:, 2]))
        assert upwards > 0.0


def solve_manufactured(mesh):
    """L2 error of a small, smooth displacement that vanishes on the faces of a unit cube."""
    x = mesh.node_positions
    boundary = np.flatnonzero(np.any((x < 1e-9) | (x > 1 - 1e-9), axis=1))
    term, matrix, free = make(mesh, fixed=boundary, young=1.0, poisson=0.3)
    lame, shear = lame_parameters(1.0, 0.3)
    s, c = np.sin(np.pi * x), np.cos(np.pi * x)
    exact = 1e-7 * np.prod(s, axis=1)
    # -div σ for u = (exact, 0, 0).
    load = np.stack(
        [
            1e-7 * np.pi**2 * (lame + 4 * shear) * np.prod(s, axis=1),
            -1e-7 * np.pi**2 * (lame + shear) * c[:, 0] * c[:, 1] * s[:, 2],
            -1e-7 * np.pi**2 * (lame + shear) * c[:, 0] * s[:, 1] * c[:, 2],
        ],
        axis=1,
    )
    corners = load[mesh.cells]
    share = (corners + corners.sum(axis=1, keepdims=True)) * mesh.volumes[:, None, None] / 20
    nodal = np.zeros_like(load)
    np.add.at(nodal, mesh.cells, share)
    assemble(term, matrix, x)
    assert matrix.factor()
    u = np.zeros_like(x)
    u[free] = matrix.solve(nodal[free])
    error = u - np.column_stack([exact, 0 * exact, 0 * exact])
    at_tets = error[mesh.cells].mean(axis=1)
    return np.sqrt(np.sum(mesh.volumes * np.sum(at_tets**2, axis=1))) / 1e-7


def test_displacement_converges_with_the_square_of_the_mesh_size(block):
    errors = [solve_manufactured(block(size=(1, 1, 1), cells=(n, n, n), shake=0)) for n in (6, 12)]
    rate = np.log2(errors[0] / errors[1])
    assert 1.6 < rate < 2.4
