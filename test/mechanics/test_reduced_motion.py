"""Facts of inertia and damping in the coordinates of a basis: projection, derivatives, objectivity."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.mechanics.inertia import scalar_mass_matrix
from softrobot_twin.mechanics.material import LameParameters
from softrobot_twin.mechanics.reduced_elements import all_points, point_gradients
from softrobot_twin.mechanics.reduced_motion import (
    ReducedInertia,
    ReducedMassDamping,
    ReducedStrainRateDamping,
)
from softrobot_twin.mechanics.strain_rate_damping import StrainRateDamping
from softrobot_twin.simulation.build import bound_factorization
from softrobot_twin.solvers.superlu import SuperLU

from .test_reduced_elements import MODES, forces_of, smooth_basis

STEP, BETA, LAME = 0.01, 3e-3, LameParameters(1.4e5, 3.6e4)
KINDS = ("inertia", "mass damping", "strain-rate damping")


def mass_of(mesh, basis):
    M = scalar_mass_matrix(mesh, 1000.0)
    return sum(basis[:, i].T @ (M @ basis[:, i]) for i in range(3))


def term_of(kind, mesh, basis):
    """A bound term, and its storage."""
    count = basis.shape[2] // 3
    nodes = np.arange(count)
    if kind == "inertia":
        term = ReducedInertia(nodes, nodes, mass_of(mesh, basis))
    elif kind == "mass damping":
        term = ReducedMassDamping(nodes, nodes, mass_of(mesh, basis), 7.0)
    else:
        (part,) = mesh.blocks()
        points = point_gradients(part, all_points(part), basis)
        term = ReducedStrainRateDamping(points, LAME, BETA, nodes, nodes)
    return term, bound_factorization(SuperLU, [term], count)


def begun(term, rng, step=STEP, size=0.01):
    """Begins a step where coordinates and velocities are random; gives the coordinates."""
    q, v = size * rng.standard_normal((2, MODES))
    term.begin_step(q.reshape(-1, 3), v.reshape(-1, 3), step)
    return q, v


@pytest.mark.parametrize("kind", KINDS)
def test_the_matrix_is_minus_the_derivative_of_the_force(kind, block, drawn_rng):
    mesh = block()
    term, made = term_of(kind, mesh, smooth_basis(mesh.node_positions, MODES, drawn_rng))
    q, _ = begun(term, drawn_rng)
    for move in (0.0, 0.003):
        at, eps = q + move * drawn_rng.standard_normal(MODES), 1e-7
        slopes = np.column_stack([
            (forces_of(term, at - eps * e) - forces_of(term, at + eps * e)) / (2 * eps)
            for e in np.eye(MODES)])  # fmt: skip
        made.clear()
        forces = np.zeros((MODES // 3, 3))
        term.add(at.reshape(-1, 3), forces, made.storage, False)
        found = made.matrix().toarray()
        np.testing.assert_allclose(found, slopes, atol=1e-6 * np.abs(slopes).max())
        np.testing.assert_allclose(forces.ravel(), forces_of(term, at), atol=1e-12 * np.abs(forces).max())


def test_damping_of_all_points_is_that_of_the_mesh(block, bind, drawn_rng):
    """Of a strained body, that moves far."""
    mesh = block()
    basis = smooth_basis(mesh.node_positions, MODES, drawn_rng)
    term, _ = term_of("strain-rate damping", mesh, basis)
    bound = bind((lambda mesh, free, _: StrainRateDamping(mesh, free, LAME, BETA), mesh, 1.0, 0.3))
    (whole,) = bound.terms
    q, _ = begun(term, drawn_rng)
    whole.begin_step(mesh.node_positions + basis @ q, np.zeros_like(mesh.node_positions), STEP)
    after = q + 0.01 * drawn_rng.standard_normal(MODES)
    forces, _ = bound.forces(mesh.node_positions + basis @ after)
    expected = np.einsum("nim,ni->m", basis, forces)
    np.testing.assert_allclose(forces_of(term, after), expected, atol=1e-11 * np.abs(expected).max())


def test_a_turn_of_a_strained_body_has_no_damping_force(block, drawn_rng):
    """The basis spans all turns about one axis, and random shapes turned with them."""
    mesh = block()
    x = mesh.node_positions
    shape = x + 0.05 * np.abs(x).max() * smooth_basis(x, 3, drawn_rng)[:, :, 0]
    turned = shape @ Rotation.from_rotvec([0.2, 0.9, -0.4]).as_matrix().T
    basis = np.stack([shape - x, turned - x, np.ones_like(x)], axis=2)
    term, _ = term_of("strain-rate damping", mesh, basis)
    positions = np.eye(3)[:1]
    term.begin_step(positions, np.zeros((1, 3)), STEP)
    size = np.abs(forces_of(term, np.array([1.001, 0.0, 0.0]))).max()
    assert np.abs(forces_of(term, np.array([0.0, 1.0, 0.02]))).max() < 1e-9 * size


def test_damping_only_takes_work_whatever_the_motion(block, drawn_rng):
    mesh = block()
    for kind in ("mass damping", "strain-rate damping"):
        term, _ = term_of(kind, mesh, smooth_basis(mesh.node_positions, MODES, drawn_rng))
        for size in (1e-3, 1e-2, 1e-1):
            q, _ = begun(term, drawn_rng, size=min(size, 0.01))
            move = size * drawn_rng.standard_normal(MODES)
            assert forces_of(term, q + move) @ move < 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_in_statics_there_is_no_force(kind, block, drawn_rng):
    mesh = block()
    term, made = term_of(kind, mesh, smooth_basis(mesh.node_positions, MODES, drawn_rng))
    assert not forces_of(term, np.full(MODES, 0.01)).any()
    q, _ = begun(term, drawn_rng, step=np.inf)
    made.clear()
    forces = np.zeros((MODES // 3, 3))
    term.add((q + 0.01).reshape(-1, 3), forces, made.storage, False)
    assert not forces.any() and np.abs(made.storage).max() < 1e-12


def test_inertia_is_that_of_the_nodes_along_the_basis(block, bind, drawn_rng):
    mesh = block()
    basis = smooth_basis(mesh.node_positions, MODES, drawn_rng)
    term, _ = term_of("inertia", mesh, basis)
    q, v = begun(term, drawn_rng)
    M = scalar_mass_matrix(mesh, 1000.0)
    after = q + 0.01 * drawn_rng.standard_normal(MODES)
    acceleration = ((after - q) / STEP - v) / STEP
    expected = -np.einsum("nim,ni->m", basis, M @ (basis @ acceleration))
    np.testing.assert_allclose(forces_of(term, after), expected, atol=1e-12 * np.abs(expected).max())
    moving = basis @ v
    energy = term.kinetic_energy(q.reshape(-1, 3), v.reshape(-1, 3))
    assert energy == pytest.approx(0.5 * np.sum(moving * (M @ moving)), rel=1e-12)
    accelerations = np.zeros((MODES // 3, 3))
    term.add_accelerations(q.reshape(-1, 3), forces_of(term, after).reshape(-1, 3), accelerations)
    np.testing.assert_allclose(accelerations.ravel(), -acceleration, rtol=1e-6)
