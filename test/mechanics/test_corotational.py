"""Facts of corotational tetrahedra: linear ones, quadratic ones, and those of smoothed strain."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import quadratic_values
from softrobot_twin.geometry.smoothed_mesh import smooth
from softrobot_twin.mechanics.material import lame_parameters
from test.builder import builder, each_of

YOUNG, POISSON = 2.0e5, 0.4
GRADIENT = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.1], [0.0, 0.05, 1.05]])


kind = each_of(["linear", "quadratic", "smoothed"])


@builder
def body(kind, block, bind, /, fixed=(), **shape):
    """A box of tetrahedra of a kind."""
    mesh = part = block(**shape)
    if kind == "quadratic":
        mesh = part = add_mid_edge_nodes(mesh)
    elif kind == "smoothed":
        part = smooth(mesh).strained_blocks(None)[0].mesh
    return mesh, bind(("corotational", part, YOUNG, POISSON), fixed=fixed)


def deformed(mesh, amount, seed=0):
    rng = np.random.default_rng(seed)
    size = np.ptp(mesh.node_positions)
    return mesh.node_positions + amount * size * rng.standard_normal((mesh.node_count, 3))


def inside(mesh):
    low, high = mesh.node_positions.min(axis=0), mesh.node_positions.max(axis=0)
    return np.all((mesh.node_positions > low + 1e-9) & (mesh.node_positions < high - 1e-9), axis=1)


@pytest.mark.parametrize("degrees", [0, 1, 45, 90, 135, 180, 270, 359, 360])
def test_rigid_rotation_stores_no_energy_and_makes_no_force(body, degrees):
    mesh, bound = body(cells=(1, 2, 2))
    axis = np.array([0.36, 0.48, 0.8])
    turned = Rotation.from_rotvec(np.radians(degrees) * axis).apply(mesh.node_positions)
    forces, K = bound.assemble(turned + [1.0, -2.0, 3.0])
    assert np.abs(forces).max() < 1e-12 * YOUNG * 0.1**2
    assert bound.energy(turned) < 1e-24 * YOUNG * mesh.volume
    values = np.linalg.eigvalsh(K.toarray())
    assert values[:6] == pytest.approx(0.0, abs=1e-10 * values[-1])
    assert values[6] > 1e-6 * values[-1]


@pytest.mark.parametrize("kind, amount", [
    ("linear", 0.01), ("linear", 0.05), ("linear", 0.08), ("quadratic", 0.01), ("quadratic", 0.04),
    ("smoothed", 0.01), ("smoothed", 0.04),
])  # fmt: skip
def test_forces_and_stiffness_are_the_slopes_of_the_energy(body, amount):
    mesh, bound = body(cells=(1, 2, 1), fixed=[0, 1, 2])
    bound.assert_slopes(deformed(mesh, amount))


def test_tangent_at_rest_is_linear_elasticity(body):
    mesh, bound = body(cells=(1, 1, 1))
    _, K = bound.assemble(mesh.node_positions)
    strain = np.array([[2.0, 0.3, -0.1], [0.3, -1.0, 0.4], [-0.1, 0.4, 0.5]])
    u = (mesh.node_positions @ strain).ravel()
    lame, shear = lame_parameters(YOUNG, POISSON)
    density = shear * np.sum(strain**2) + 0.5 * lame * np.trace(strain) ** 2
    assert 0.5 * u @ K @ u == pytest.approx(density * mesh.volume)


def test_projected_tangent_has_no_negative_curvature_where_the_exact_one_has(body):
    mesh, bound = body(cells=(1, 1, 2))
    exact, projected = bound.least_curvatures(deformed(mesh, 0.01) * [0.35, 1.0, 0.6])
    assert exact < -1e-3 and projected > -1e-12


def test_projected_tangent_is_the_exact_one_where_nothing_is_negative(body):
    mesh, bound = body(cells=(1, 1, 2))
    stretched = mesh.node_positions * 1.1
    exact, projected = (bound.assemble(stretched, p)[1].toarray() for p in (False, True))
    np.testing.assert_array_equal(exact, projected)


def test_patch_of_uniform_strain_is_in_balance_inside(body):
    mesh, bound = body(cells=(3, 3, 3), shake=0.3)
    forces, _ = bound.assemble(mesh.node_positions @ GRADIENT.T)
    assert inside(mesh).sum() >= 8
    assert np.abs(forces[inside(mesh)]).max() < 1e-12 * np.abs(forces).max()


@pytest.mark.parametrize("kind", ["linear", "quadratic"])
def test_a_collapsed_element_is_counted_and_pushed_back_to_positive_volume(body):
    mesh, bound = body(cells=(1, 1, 1))
    assert bound.forces(mesh.node_positions)[1] == 0
    for scale in (0.0, -0.3):
        flat = mesh.node_positions * [1.0, 1.0, scale]
        forces, inverted = bound.forces(flat)
        assert inverted == len(mesh.cells)
        assert np.all(np.isfinite(forces))
        assert np.all(np.isfinite(bound.assemble(flat, projected=True)[1].toarray()))
        assert np.sum(forces[:, 2] * (mesh.node_positions[:, 2] - flat[:, 2])) > 0.0


def smooth_load(x):
    """A smooth displacement that vanishes on the faces of a unit cube, and -div σ of it."""
    lame, shear = lame_parameters(1.0, 0.3)
    s, c = np.sin(np.pi * x), np.cos(np.pi * x)
    exact = np.zeros_like(x)
    exact[..., 0] = np.prod(s, axis=-1)
    load = np.pi**2 * np.stack([
        (lame + 4 * shear) * np.prod(s, axis=-1),
        -(lame + shear) * c[..., 0] * c[..., 1] * s[..., 2],
        -(lame + shear) * c[..., 0] * s[..., 1] * c[..., 2],
    ], axis=-1)  # fmt: skip
    return exact, load


def solve_manufactured(mesh, bind, points, weights):
    """L2 error of the small displacement under that load."""
    N = points if mesh.cells.shape[1] == 4 else quadratic_values(points)
    exact, load = smooth_load(np.einsum("qa,kai->kqi", N, mesh.node_positions[mesh.cells]))
    volumes = mesh.volumes[:, None] * weights
    nodal = np.zeros((mesh.node_count, 3))
    np.add.at(nodal, mesh.cells, np.einsum("kq,qa,kqi->kai", volumes, N, load))
    bound = bind(("corotational", mesh, 1.0, 0.3), fixed=np.flatnonzero(~inside(mesh)))
    bound.assemble(mesh.node_positions)
    assert bound.matrix.factor()
    u = np.zeros((mesh.node_count, 3))
    u[bound.free] = bound.matrix.solve(nodal[bound.free])
    error = np.einsum("qa,kai->kqi", N, u[mesh.cells]) - exact
    return np.sqrt(np.sum(volumes * np.sum(error**2, axis=2)))


@pytest.mark.parametrize("kind, counts, order, bar", [
    ("linear", (6, 12), 2.0, 0.4), ("quadratic", (3, 6), 3.0, 0.3),
])  # fmt: skip
def test_displacement_converges_by_the_order_of_the_element(
    block, bind, tet_rule, kind, counts, order, bar
):
    errors = []
    for n in counts:
        mesh = block(size=(1, 1, 1), cells=(n, n, n), shake=0)
        mesh = mesh if kind == "linear" else add_mid_edge_nodes(mesh)
        errors.append(solve_manufactured(mesh, bind, *tet_rule()))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=bar)
