"""Facts of inertia, lumped and consistent."""

import numpy as np
import pytest
from scipy.linalg import eigh

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import quadratic_values
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.inertia import (
    ConsistentInertia,
    LumpedInertia,
    borne_masses,
    lumped_masses,
    mass_shares,
)
from test.builder import builder

DENSITY, STEP, GRAVITY = 1070.0, 0.004, np.array([1.0, -2.0, -9.81])


def lumped(mesh, free_index, _):
    nodes = np.flatnonzero(free_index >= 0)
    return LumpedInertia(nodes, free_index[nodes], lumped_masses(mesh, DENSITY)[nodes])


def consistent(mesh, free_index, _):
    return ConsistentInertia(mesh, free_index, DENSITY, np.flatnonzero(free_index >= 0))


KINDS = {"lumped": lumped, "consistent": consistent}


@pytest.fixture(params=["linear", "smoothed", "quadratic"])
def mesh(request, block):
    """A box of tetrahedra of either order."""
    made = block(cells=(1, 2, 2))
    return made if request.param == "linear" else add_mid_edge_nodes(made)


@builder(params=list(KINDS))
def moving(request, mesh, bind, /, fixed=(), step=STEP):
    """The box's inertia in the middle of a step: mesh, bound terms, q₀, v₀."""
    bound = bind((KINDS[request.param], mesh, 1.0, 0.0), fixed=fixed)
    rng = np.random.default_rng(0)
    start = mesh.node_positions + 0.01 * rng.standard_normal((mesh.node_count, 3))
    velocities = rng.standard_normal((len(bound.free), 3))
    bound.terms[0].begin_step(start, velocities, step)
    return bound, start, velocities


def mass_matrix(bound, positions):
    """M by the system matrix of a step of one second, shape (3 free, 3 free)."""
    free = np.zeros((len(bound.free), 3))
    bound.terms[0].begin_step(positions, free, 1.0)
    return bound.assemble(positions)[1].toarray()


def test_element_masses_are_the_integrals_of_the_shape_functions(block, tet_rule):
    points, weights = tet_rule()
    linear = block(cells=(1, 1, 1))
    for mesh, N in ((linear, points), (add_mid_edge_nodes(linear), quadratic_values(points))):
        exact = np.einsum("q,qa,qb->ab", weights, N, N)
        np.testing.assert_allclose(mass_shares(mesh), exact, atol=1e-15)


def test_lumped_masses_are_positive_and_weigh_what_the_body_weighs(mesh):
    masses = lumped_masses(mesh, DENSITY)
    assert masses.min() > 0.0
    assert masses.sum() == pytest.approx(DENSITY * mesh.volume)


def test_lumped_masses_keep_the_centre_of_mass(mesh):
    masses = lumped_masses(mesh, DENSITY)
    corners = mesh.corner_mesh
    centroids = corners.node_positions[corners.cells].mean(axis=1)
    np.testing.assert_allclose(
        masses @ mesh.node_positions, DENSITY * corners.volumes @ centroids, rtol=1e-12
    )


def test_the_mass_matrix_is_symmetric_and_positive_definite(mesh, moving):
    bound, _, _ = moving(fixed=[0, 3])
    M = mass_matrix(bound, mesh.node_positions)
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M)[0] > 0.0


def test_the_mass_matrix_moved_as_a_whole_has_the_mass_of_the_body(mesh, moving):
    M = mass_matrix(moving()[0], mesh.node_positions)
    along = np.tile([0.6, 0.0, 0.8], mesh.node_count)
    assert along @ M @ along == pytest.approx(DENSITY * mesh.volume)


def test_the_matrix_is_minus_the_derivative_of_the_force(moving):
    bound, start, _ = moving(fixed=[1, 2, 5])
    x = start + 1e-3 * np.random.default_rng(1).standard_normal(start.shape)
    forces, A = bound.assemble(x)
    np.testing.assert_array_equal(bound.forces(x)[0], forces)
    slopes = bound.slopes_of_forces(x, 1e-4)
    np.testing.assert_allclose(A.toarray(), -slopes, atol=1e-9 * np.abs(A).max())


def test_accelerations_are_forces_over_the_mass_matrix(mesh, moving):
    bound, start, _ = moving(fixed=[1, 2])
    forces = np.random.default_rng(2).standard_normal((len(bound.free), 3))
    found = np.zeros_like(forces)
    bound.terms[0].add_accelerations(start, forces, found)
    M = mass_matrix(bound, start)
    np.testing.assert_allclose((M @ found.ravel()).reshape(-1, 3), forces, atol=1e-10)


def test_steady_motion_needs_no_force(moving):
    bound, start, velocities = moving()
    x = start.copy()
    x[bound.free] += STEP * velocities
    scale = np.abs(bound.forces(start)[0]).max()
    assert np.abs(bound.forces(x)[0]).max() < 1e-11 * scale


def test_the_inertia_force_is_minus_the_rate_of_momentum(mesh, moving):
    bound, start, velocities = moving()
    x = start + 1e-3 * np.random.default_rng(2).standard_normal(start.shape)
    after = (x - start)[bound.free] / STEP
    term = bound.terms[0]
    lost = (term.momentum(velocities) - term.momentum(after)) / STEP
    np.testing.assert_allclose(bound.forces(x)[0].sum(axis=0), lost, rtol=1e-10)


def test_kinetic_energy_is_that_of_the_mass_matrix(mesh, moving):
    bound, start, velocities = moving(fixed=[0, 4])
    M = mass_matrix(bound, start)
    v = velocities.ravel()
    assert bound.terms[0].kinetic_energy(start, velocities) == pytest.approx(0.5 * v @ M @ v)


def test_consistent_mass_has_the_kinetic_energy_of_a_rigid_box_exactly(mesh, bind):
    bound = bind((consistent, mesh, 1.0, 0.0))
    size = np.ptp(mesh.node_positions, axis=0)
    centre = mesh.node_positions.min(axis=0) + 0.5 * size
    linear, spin = np.array([0.3, -0.4, 0.5]), np.array([2.0, -1.0, 3.0])
    mass = DENSITY * np.prod(size)
    inertia = mass / 12.0 * (np.sum(size**2) - size**2)
    velocities = linear + np.cross(spin, mesh.node_positions - centre)
    energy = 0.5 * mass * linear @ linear + 0.5 * inertia @ spin**2
    kinetic = bound.terms[0].kinetic_energy(mesh.node_positions, velocities)
    assert kinetic == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(bound.terms[0].momentum(velocities), mass * linear, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_free_fall_drops_by_h_squared_g_in_the_first_step(mesh, bind, kind):
    bound = bind((KINDS[kind], mesh, 1.0, 0.0))
    still = np.zeros((mesh.node_count, 3))
    bound.terms[0].begin_step(mesh.node_positions, still, STEP)
    _, A = bound.assemble(mesh.node_positions)
    if kind == "consistent":
        weights = still.copy()
        Gravity(borne_masses(mesh, DENSITY), GRAVITY).add_forces(None, weights)
    else:
        weights = np.outer(lumped_masses(mesh, DENSITY), GRAVITY)
    drop = np.linalg.solve(A.toarray(), weights.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(drop, np.tile(STEP**2 * GRAVITY, (mesh.node_count, 1)), rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_free_body_that_vibrates_keeps_its_momentum(block, bind, kind):
    mesh = add_mid_edge_nodes(block(cells=(1, 1, 2)))
    bound = bind(("corotational", mesh, 1e5, 0.3), (KINDS[kind], mesh, 1.0, 0.0))
    inertia = bound.terms[1]
    x = mesh.node_positions.copy()
    velocities = np.random.default_rng(3).standard_normal(x.shape)
    before = inertia.momentum(velocities)
    for _ in range(3):
        start = x.copy()
        inertia.begin_step(start, velocities, STEP)
        for _ in range(6):
            forces, A = bound.assemble(x)
            x = x + np.linalg.solve(A.toarray(), forces.ravel()).reshape(-1, 3)
        assert np.abs(bound.forces(x)[0]).max() < 1e-8 * np.abs(before).max() / STEP
        velocities = (x - start) / STEP
        assert bound.terms[0].energy(x) > 0.0
    np.testing.assert_allclose(inertia.momentum(velocities), before, rtol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_a_cantilever_vibrates_at_the_frequency_of_beam_theory(block, bind, kind):
    length, depth, young = 1.0, 0.1, 1.0e6
    mesh = add_mid_edge_nodes(block(size=(length, depth, depth), cells=(8, 1, 1), shake=0))
    fixed = np.flatnonzero(mesh.node_positions[:, 0] < 1e-9)
    still = np.zeros((mesh.node_count - len(fixed), 3))
    stiff = bind(("linear", mesh, young, 0.0), fixed=fixed)
    heavy = bind((KINDS[kind], mesh, 1.0, 0.0), fixed=fixed)
    heavy.terms[0].begin_step(mesh.node_positions, still, 1.0)
    K, M = (bound.assemble(mesh.node_positions)[1].toarray() for bound in (stiff, heavy))
    found = np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=[0, 1]))
    # Euler and Bernoulli's, lowered by shear: 1/ω² is about the sum of both (Dunkerley).
    speed = np.sqrt(young / DENSITY)
    bending = 1.8751041**2 / length**2 * speed * depth / np.sqrt(12.0)
    shear = 0.5 * np.pi / length * speed * np.sqrt(5.0 / 6.0 / 2.0)
    expected = (bending**-2 + shear**-2) ** -0.5
    assert found == pytest.approx([expected, expected], rel=0.02)
