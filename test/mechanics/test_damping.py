"""Facts of damping in proportion to mass and to stiffness."""

import numpy as np
import pytest
from scipy.linalg import eigh

from softrobot_twin.geometry.quadratic import add_mid_edge_nodes
from softrobot_twin.mechanics.consistent_inertia import ConsistentInertia
from softrobot_twin.mechanics.corotational import CorotationalTets
from softrobot_twin.mechanics.linear_elastic import LinearElastic
from softrobot_twin.mechanics.mass_damping import MassDamping
from softrobot_twin.mechanics.nodal_masses import lumped_masses
from softrobot_twin.mechanics.quadratic_tets import QuadraticTets
from softrobot_twin.mechanics.stiffness_damping import StiffnessDamping

YOUNG, POISSON, DENSITY = 2.0e5, 0.3, 1070.0
STEP, ALPHA, BETA = 0.004, 3.0, 0.02
LAWS = {
    "corotational": CorotationalTets,
    "quadratic": QuadraticTets,
    "linear law": LinearElastic,
}


def mass_damping(mesh, free_index, _):
    nodes = np.flatnonzero(free_index >= 0)
    masses = lumped_masses(mesh, DENSITY)[nodes]
    return MassDamping(nodes, free_index[nodes], masses, ALPHA)


def stiffness_damping(law):
    return lambda mesh, free_index, lame: StiffnessDamping(law(mesh, free_index, lame), BETA)


def consistent_inertia(mesh, free_index, _):
    return ConsistentInertia(mesh, free_index, DENSITY, np.flatnonzero(free_index >= 0))


@pytest.fixture(params=list(LAWS))
def elastic(request, block, bind):
    """Makes a strained box under a law: mesh, damped terms, plain terms, where it is."""

    def make(fixed=()):
        law, mesh = LAWS[request.param], block(cells=(1, 1, 2))
        if law is QuadraticTets:
            mesh = add_mid_edge_nodes(mesh)
        damped = bind((stiffness_damping(law), mesh, YOUNG, POISSON), fixed=fixed)
        plain = bind((law, mesh, YOUNG, POISSON), fixed=fixed)
        return mesh, damped, plain, displaced(mesh.node_positions, 0.01, seed=0)

    return make


def displaced(positions, amount, seed):
    return positions + amount * np.random.default_rng(seed).standard_normal(positions.shape)


def begin(bound, positions, step=STEP):
    for term in bound.terms:
        term.begin_step(positions, np.full((len(bound.free), 3), 7.0), step)


def derivative(bound, x, difference):
    """∂forces/∂q by central differences, shape (3 free, 3 free)."""
    columns = []
    for node in bound.free:
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += difference
            behind[node, axis] -= difference
            change = bound.forces(ahead)[0] - bound.forces(behind)[0]
            columns.append(change.ravel() / (2 * difference))
    return np.column_stack(columns)


def test_mass_damping_brakes_every_node_by_its_mass_and_velocity(block, bind):
    mesh = block(cells=(1, 2, 2))
    bound = bind((mass_damping, mesh, 1.0, 0.0), fixed=[0, 1])
    x = displaced(mesh.node_positions, 0.01, seed=1)
    begin(bound, mesh.node_positions)
    velocities = (x - mesh.node_positions)[bound.free] / STEP
    masses = lumped_masses(mesh, DENSITY)[bound.free]
    forces, A = bound.assemble(x)
    np.testing.assert_allclose(forces, -ALPHA * masses[:, None] * velocities, rtol=1e-12)
    np.testing.assert_array_equal(bound.forces(x)[0], forces)
    np.testing.assert_allclose(
        A.toarray(), -derivative(bound, x, 1e-4), atol=1e-9 * np.abs(A).max()
    )
    assert np.sum(forces * velocities) < 0.0


def test_mass_damping_slows_a_free_body_as_backward_euler_says(block, bind):
    mesh = block(cells=(1, 1, 1))
    bound = bind((mass_damping, mesh, 1.0, 0.0), (consistent_inertia, mesh, 1.0, 0.0))
    x, velocities = mesh.node_positions.copy(), np.tile([1.0, 2.0, -1.0], (mesh.node_count, 1))
    for term in bound.terms:
        term.begin_step(x, velocities, STEP)
    forces, A = bound.assemble(x)
    moved = np.linalg.solve(A.toarray(), forces.ravel()).reshape(-1, 3)
    momentum = bound.terms[1].momentum
    np.testing.assert_allclose(
        momentum(moved / STEP), momentum(velocities) / (1.0 + ALPHA * STEP), rtol=1e-9
    )


def test_stiffness_damping_is_beta_times_the_rate_of_the_elastic_force(elastic):
    mesh, damped, plain, start = elastic(fixed=[0, 3])
    x = displaced(start, 0.002, seed=2)
    # The step before must leave nothing behind.
    begin(damped, x, 2.0 * STEP)
    begin(damped, start)
    f0, f = plain.forces(start)[0], plain.forces(x)[0]
    expected = f + BETA * (f - f0) / STEP
    for forces in (damped.forces(x)[0], damped.assemble(x)[0]):
        np.testing.assert_allclose(forces, expected, atol=1e-12 * np.abs(expected).max())


def test_damped_matrix_is_minus_the_derivative_of_the_force(elastic):
    _, damped, _, start = elastic(fixed=[0, 3, 4])
    begin(damped, start)
    x = displaced(start, 0.002, seed=2)
    A = damped.assemble(x)[1].toarray()
    np.testing.assert_allclose(A, -derivative(damped, x, 1e-7), atol=1e-6 * np.abs(A).max())


@pytest.mark.parametrize("projected", [False, True])
def test_damped_matrix_is_the_elastic_one_of_a_stiffer_body(elastic, projected):
    _, damped, plain, start = elastic()
    begin(damped, start)
    A, K = (bound.assemble(start, projected)[1].toarray() for bound in (damped, plain))
    np.testing.assert_allclose(A, (1.0 + BETA / STEP) * K, atol=1e-12 * np.abs(A).max())


def test_translation_of_a_strained_body_is_not_damped(elastic):
    _, damped, plain, start = elastic()
    begin(damped, start)
    carried = start + [0.3, -0.2, 0.1]
    expected = plain.forces(carried)[0]
    np.testing.assert_allclose(
        damped.forces(carried)[0], expected, atol=1e-10 * np.abs(expected).max()
    )


def test_stiffness_damping_pushes_a_body_neither_as_a_whole(elastic):
    _, damped, _, start = elastic()
    begin(damped, start)
    forces = damped.forces(displaced(start, 0.002, seed=2))[0]
    assert np.abs(forces.sum(axis=0)).max() < 1e-11 * np.abs(forces).max()


def test_stiffness_damping_takes_power_from_small_motions(elastic):
    mesh, damped, plain, _ = elastic(fixed=[0, 3, 4])
    rest = mesh.node_positions
    begin(damped, rest)
    for seed in range(5):
        x = displaced(rest, 1e-4, seed)
        damping = damped.forces(x)[0] - plain.forces(x)[0]
        velocities = (x - rest)[damped.free] / STEP
        assert np.sum(damping * velocities) < 0.0


def test_without_a_step_or_in_an_endless_one_the_term_is_the_elastic_one(elastic):
    _, damped, plain, start = elastic(fixed=[2])
    expected, K = plain.assemble(start)
    for step in (None, STEP, np.inf):
        if step is not None:
            begin(damped, start, step)
        if step != STEP:
            forces, A = damped.assemble(start)
            np.testing.assert_array_equal(forces, expected)
            np.testing.assert_array_equal(A.toarray(), K.toarray())


def test_energy_and_name_are_those_of_the_true_material(elastic):
    _, damped, plain, start = elastic()
    begin(damped, start)
    assert damped.terms[0].energy(start) == plain.terms[0].energy(start)
    assert damped.terms[0].name == plain.terms[0].name
    estimates = [hasattr(bound.terms[0], "relative_energy_error") for bound in (damped, plain)]
    assert estimates[0] == estimates[1]
    if estimates[0]:
        assert damped.terms[0].relative_energy_error(start) == pytest.approx(
            plain.terms[0].relative_energy_error(start)
        )


def test_elements_inside_out_are_counted_through_the_damping(elastic):
    mesh, damped, _, start = elastic()
    begin(damped, start)
    assert damped.forces(mesh.node_positions)[1] == 0
    assert damped.forces(mesh.node_positions * [1.0, -0.1, 1.0])[1] == mesh.tet_count


def test_a_vibration_dies_away_as_backward_euler_with_rayleighs_damping_says(block, bind):
    mesh = add_mid_edge_nodes(block(cells=(1, 1, 2)))
    fixed = np.flatnonzero(mesh.node_positions[:, 2] < 1e-9)
    bound = bind(
        (stiffness_damping(LinearElastic), mesh, YOUNG, POISSON),
        (consistent_inertia, mesh, 1.0, 0.0),
        fixed=fixed,
    )
    still = np.zeros((len(bound.free), 3))
    K = bound.assemble(mesh.node_positions)[1].toarray()
    bound.terms[1].begin_step(mesh.node_positions, still, 1.0)
    M = bound.assemble(mesh.node_positions)[1].toarray() - K
    squares, modes = eigh(K, M, subset_by_index=[0, 0])
    mode = 1e-3 * modes[:, 0].reshape(-1, 3) / np.abs(modes).max()
    x = mesh.node_positions.copy()
    x[bound.free] += mode
    for term in bound.terms:
        term.begin_step(x, still, STEP)
    forces, A = bound.assemble(x)
    x[bound.free] += np.linalg.solve(A.toarray(), forces.ravel()).reshape(-1, 3)
    inertia, damping = 1.0 / STEP**2, BETA * squares[0] / STEP
    left = (inertia + damping) / (inertia + damping + squares[0])
    np.testing.assert_allclose(
        (x - mesh.node_positions)[bound.free], left * mode, atol=1e-9 * np.abs(mode).max()
    )


@pytest.mark.parametrize("amount", [-1.0, np.inf, np.nan])
def test_damping_that_cannot_be_is_refused(amount, block):
    with pytest.raises(ValueError, match="rate"):
        MassDamping([0], [0], [1.0], amount)
    mesh = block(cells=(1, 1, 1))
    body = CorotationalTets(mesh, np.arange(mesh.node_count), (1.0, 1.0))
    with pytest.raises(ValueError, match="beta"):
        StiffnessDamping(body, amount)
