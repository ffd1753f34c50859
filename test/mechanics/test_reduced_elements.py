"""Facts of elements in the coordinates of a basis: projection, derivatives, objectivity."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.reduced_elements import (
    ReducedElements,
    SampledPoints,
    all_points,
    point_gradients,
)

# A law that turns, a linear one, and one that does not turn.
LAWS = ("corotational", "linear", "neo_hookean")
MODES = 12


def smooth_basis(positions, modes, drawn_rng):
    """Random waves, as smooth as modes of a body, of largest displacement one."""
    waves = 6.0 * drawn_rng.standard_normal((3, modes, 3))
    phases = 2.0 * np.pi * drawn_rng.random((3, modes))
    basis = np.cos(np.einsum("ni,jmi->njm", positions, waves) + phases)
    return basis / np.linalg.norm(basis, axis=1).max(axis=0)


def reduced(mesh, law, basis, sampled=None):
    """The term, whose coordinates are the first nodes of what it gets as positions."""
    (part,) = mesh.blocks()
    sampled = all_points(part) if sampled is None else sampled
    blocks = np.arange(basis.shape[2] // 3)
    return ReducedElements(point_gradients(part, sampled, basis), law, blocks, blocks)


def forces_of(term, q):
    forces = np.zeros((len(q) // 3, 3))
    term.add_forces(q.reshape(-1, 3), forces)
    return forces.ravel()


@pytest.mark.parametrize("name", LAWS)
def test_all_points_give_the_projected_forces_and_the_energy_of_the_mesh(name, block, bind, drawn_rng):
    mesh, law = block(), law_named(name).of_moduli(1.0e5, 0.4)
    basis = smooth_basis(mesh.node_positions, MODES, drawn_rng)
    q = 0.01 * drawn_rng.standard_normal(MODES)
    term = reduced(mesh, law, basis)
    bound = bind((lambda mesh, free, lame: Elements(mesh, free, law), mesh, 1.0e5, 0.4))
    positions, (whole,) = mesh.node_positions + basis @ q, bound.terms
    forces, _ = bound.forces(positions)
    expected = np.einsum("nim,ni->m", basis, forces)
    np.testing.assert_allclose(forces_of(term, q), expected, atol=1e-12 * np.abs(expected).max())
    assert term.energy(q.reshape(-1, 3)) == pytest.approx(whole.energy(positions), rel=1e-12)
    by_point = term.point_forces(q).sum(axis=0)
    np.testing.assert_allclose(-by_point, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", LAWS)
def test_the_stiffness_is_the_derivative_of_the_forces(name, block, drawn_rng):
    mesh, law = block(), law_named(name).of_moduli(1.0e5, 0.4)
    term = reduced(mesh, law, smooth_basis(mesh.node_positions, MODES, drawn_rng))
    q, step = 0.005 * drawn_rng.standard_normal(MODES), 1.0e-6
    slopes = np.column_stack([
        (forces_of(term, q - step * e) - forces_of(term, q + step * e)) / (2.0 * step)
        for e in np.eye(MODES)
    ])  # fmt: skip
    forces_of(term, q)
    K = term.stiffness(projected=False)
    np.testing.assert_allclose(K, slopes, atol=1e-6 * np.abs(slopes).max())
    np.testing.assert_allclose(K, K.T, atol=1e-6 * np.abs(K).max())


@pytest.mark.parametrize("name", LAWS)
def test_a_projected_stiffness_has_no_negative_eigenvalue(name, block, drawn_rng):
    mesh, law = block(), law_named(name).of_moduli(1.0e5, 0.4)
    basis = smooth_basis(mesh.node_positions, MODES, drawn_rng)
    term = reduced(mesh, law, basis)
    # Crushed to half its height, where the exact stiffness of turning laws is indefinite.
    q = 0.05 * drawn_rng.standard_normal(MODES)
    forces_of(term, q)
    eigenvalues = np.linalg.eigvalsh(term.stiffness(projected=True))
    assert eigenvalues[0] >= -1e-6 * eigenvalues[-1]


def test_the_products_of_rows_are_those_of_the_whole_derivative(block, drawn_rng):
    mesh, law = block(), law_named("corotational").of_moduli(1.0e5, 0.4)
    term = reduced(mesh, law, smooth_basis(mesh.node_positions, MODES, drawn_rng))
    changes = np.empty_like(term.gradients)
    for size in (1e-4, 1e-2, 1e-1):  # in the last state some points are inside out
        forces_of(term, size * drawn_rng.standard_normal(MODES))
        for projected in (False, True):
            if projected and size > 0.05:
                continue
            rows = term.padded_stiffness(projected).copy()
            whole = term.by_matrices(changes, projected)
            np.testing.assert_allclose(rows, whole, atol=3e-6 * np.abs(whole).max())


@pytest.mark.parametrize("name", ["corotational", "neo_hookean"])
def test_sampled_points_store_the_same_energy_in_a_rotated_state(name, block, drawn_rng):
    """Objectivity does not need all points: every point is objective."""
    mesh, law = block(), law_named(name).of_moduli(1.0e5, 0.4)
    x = mesh.node_positions
    # Modes u = A x, for nine matrices A, and three translations.
    affine = np.zeros((len(x), 3, 12))
    for i in range(3):
        for j in range(3):
            affine[:, i, 3 * i + j] = x[:, j]
        affine[:, i, 9 + i] = 1.0
    chosen = np.sort(drawn_rng.choice(mesh.cell_count, 9, replace=False))
    sampled = SampledPoints(chosen, np.zeros(9, np.int64), 1.0 + drawn_rng.random(9))
    term = reduced(mesh, law, affine, sampled)
    F = np.eye(3) + 0.1 * drawn_rng.standard_normal((3, 3))
    R = Rotation.random(random_state=int(drawn_rng.integers(2**31))).as_matrix()

    def energy(deformation):
        q = np.concatenate([(deformation - np.eye(3)).ravel(), drawn_rng.standard_normal(3)])
        return term.energy(q.reshape(-1, 3)), forces_of(term, q)

    assert energy(R @ F)[0] == pytest.approx(energy(F)[0], rel=1e-10)
    stored, forces = energy(R)
    assert stored < 1e-12 * energy(F)[0]
    assert np.abs(forces).max() < 1e-9 * np.abs(energy(F)[1]).max()


def test_points_of_other_cells_are_left_to_other_terms(block, drawn_rng):
    mesh = block()
    basis = smooth_basis(mesh.node_positions, 3, drawn_rng)
    some = np.arange(0, mesh.cell_count, 2)
    (part,) = mesh.blocks(some)
    sampled = SampledPoints(np.array([1, 2, 4, 5]), np.zeros(4, np.int64), np.ones(4))
    found = point_gradients(part, sampled, basis)
    (whole,) = mesh.blocks()
    expected = point_gradients(
        whole, SampledPoints(np.array([2, 4]), np.zeros(2, np.int64), np.ones(2)), basis
    )
    np.testing.assert_array_equal(found.gradients, expected.gradients)
    np.testing.assert_array_equal(found.weights, expected.weights)
