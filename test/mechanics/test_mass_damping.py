"""Facts of damping in proportion to mass."""

import numpy as np

from softrobot_twin.mechanics.inertia import MassDamping, lumped_masses

from .test_inertia import DENSITY, consistent

STEP, ALPHA = 0.004, 3.0


def mass_damping(mesh, free_index, _):
    nodes = np.flatnonzero(free_index >= 0)
    masses = lumped_masses(mesh, DENSITY)[nodes]
    return MassDamping(nodes, free_index[nodes], masses, ALPHA)


def displaced(positions, amount, seed):
    return positions + amount * np.random.default_rng(seed).standard_normal(positions.shape)


def begin(bound, positions, step=STEP):
    for term in bound.terms:
        term.begin_step(positions, np.full((len(bound.free), 3), 7.0), step)


def test_mass_damping_force_is_proportional_to_mass_and_velocity(block, bind):
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
        A.toarray(), -bound.slopes_of_forces(x, 1e-4), atol=1e-9 * np.abs(A).max()
    )
    assert np.sum(forces * velocities) < 0.0


def test_a_free_body_with_mass_damping_slows_down_as_backward_euler_predicts(block, bind):
    mesh = block(cells=(1, 1, 1))
    bound = bind((mass_damping, mesh, 1.0, 0.0), (consistent, mesh, 1.0, 0.0))
    x, velocities = mesh.node_positions.copy(), np.tile([1.0, 2.0, -1.0], (mesh.node_count, 1))
    for term in bound.terms:
        term.begin_step(x, velocities, STEP)
    forces, A = bound.assemble(x)
    moved = np.linalg.solve(A.toarray(), forces.ravel()).reshape(-1, 3)
    momentum = bound.terms[1].momentum
    np.testing.assert_allclose(
        momentum(moved / STEP), momentum(velocities) / (1.0 + ALPHA * STEP), rtol=1e-9
    )
