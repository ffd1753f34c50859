"""Modes of displacements, and few points that do the work of all."""

import numpy as np
import pytest

from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.reduction.reduction_basis import (
    blocks_of,
    leading,
    mode_count_of,
    proper_modes,
    rest_stiffness,
    work_of,
)
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation.building.scene_layout import lay_out
from softrobot_twin.solvers import FACTORIZATIONS
from test.scene_changes import entries_of, yaml_file

MATERIALS = {
    "linear": {"law": "corotational", "young_modulus": 2.0e5, "poisson_ratio": 0.4, "density": 1e3},
    "quadratic": {"law": "neo_hookean", "young_modulus": 2.0e5, "poisson_ratio": 0.4,
                  "density": 1e3},
    "smoothed": {"law": "neo_hookean", "young_modulus": 2.0e5, "poisson_ratio": 0.4,
                 "density": 1e3},
}  # fmt: skip


@pytest.fixture(scope="module", params=list(MATERIALS))
def body(request, column):
    """A column of two materials: straight tetrahedra, quadratic or smoothed rubber."""
    mapping = entries_of(column, {"body.element": request.param})
    mapping["body"] |= {"material": MATERIALS[request.param], "volume": "per_element"}
    stiff = {**MATERIALS["linear"], "young_modulus": 4.0e5}
    mapping["body"]["materials"] = [
        {**stiff, "box": {"minimum": [-1, -1, 0.06], "maximum": [1, 1, 1]}}
    ]
    scene = yaml_file(column.parent / f"two_{request.param}.yaml", mapping)
    return lay_out(load_scene(scene), []).bodies[0]


def bent(body, drawn_rng, count):
    """Smooth displacements of a column that is held at its foot [m].

    They are drawn from a box, as a training draws its states: points found for some of them are
    asked about others from the same box, not about a rare one far outside.
    """
    points = body.mesh.node_positions
    height = points[:, 2:] / 0.1
    found = []
    for a, b, c, d in drawn_rng.uniform(-1.5, 1.5, (count, 4)):
        turn = np.column_stack([-points[:, 1], points[:, 0], 0 * points[:, 0]])
        found.append(height**2 * [0.01 * a, 0.01 * b, 0.0] + d * height * turn
                     + height * [0.0, 0.0, 0.002 * c])  # fmt: skip
        found[-1][:, 2] -= 0.2 * (a * points[:, 0] + b * points[:, 1]) * height[:, 0]
        found[-1][body.fixed] = 0.0
    return np.array(found)


def bound(term, count):
    """The term, bound to a factorization of its own."""
    rows, columns = stencil_pairs(term.stencils())
    solver = FACTORIZATIONS["multifrontal"](rows, columns, count)
    term.bind(solver.elimination_rank, solver.slots)
    return term


def forces_of(body, displacements):
    """Elastic forces of all elements at displacements [N], shape (node_count, 3)."""
    count = body.mesh.node_count
    forces = np.zeros((count, 3))
    for block, law in blocks_of(body):
        term = bound(Elements(block.mesh, np.arange(count), law), count)
        term.add_forces(body.mesh.node_positions + displacements, forces)
    return forces


def test_the_stiffness_at_rest_is_the_derivative_of_the_forces(body, drawn_rng):
    (u,) = 1e-3 * bent(body, drawn_rng, 1)
    step = 1e-2
    change = (forces_of(body, -step * u) - forces_of(body, step * u)) / (2.0 * step)
    found = (rest_stiffness(body) @ u.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(found, change, atol=1e-5 * np.abs(change).max())


def test_modes_are_orthogonal_in_the_stiffness_and_in_metres(body, drawn_rng):
    K = rest_stiffness(body)
    displacements = bent(body, drawn_rng, 8).astype(np.float32)
    modes = proper_modes(displacements, K, 6)
    flat = modes.basis.reshape(-1, modes.basis.shape[2])
    gram = flat.T @ (K @ flat)
    size = np.sqrt(np.outer(modes.stiffness, modes.stiffness))
    np.testing.assert_allclose(gram / size, np.eye(len(gram)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(modes.basis, axis=1).max(axis=0), 1.0)
    assert (modes.basis[body.fixed] == 0.0).all()
    assert (np.diff(modes.shares[:7]) < 0.0).all()


def test_as_many_modes_as_displacements_give_these_back(body, drawn_rng):
    K, displacements = rest_stiffness(body), bent(body, drawn_rng, 4)
    modes = proper_modes(displacements, K, 30)
    assert modes.basis.shape[2] <= 4 and modes.shares[4] < 1e-12
    coordinates = modes.coordinates(K, displacements)
    back = np.einsum("nim,sm->sni", modes.basis, coordinates)
    np.testing.assert_allclose(back, displacements, atol=1e-9)
    # What the first modes leave out is the share of the energy that was told.
    few = leading(modes, 2)
    left = displacements - np.einsum("nim,sm->sni", few.basis, coordinates[:, :2])

    def energy(u):
        return sum(one.ravel() @ (K @ one.ravel()) for one in u)

    assert energy(left) / energy(displacements) == pytest.approx(modes.shares[2], rel=1e-6)


@pytest.mark.parametrize("energy, count", [(0.5, 3), (0.1, 3), (0.02, 6), (1e-9, 6)])
def test_modes_by_energy_are_the_fewest_in_threes(energy, count):
    assert mode_count_of(np.array([1.0, 0.4, 0.2, 0.05, 0.01, 0.001]), energy) == count


def test_work_of_all_points_is_that_of_the_elements(body, drawn_rng):
    K, displacements = rest_stiffness(body), bent(body, drawn_rng, 6)
    modes = leading(proper_modes(displacements, K, 3), 3)
    states = modes.coordinates(K, displacements)
    work = work_of(body, modes, states, np.random.default_rng(0))
    np.testing.assert_allclose(work.columns.sum(axis=1), work.total,
                               atol=2e-5 * np.abs(work.total).max())  # fmt: skip
    for state, total in zip(states, work.total.reshape(states.shape), strict=True):
        forces = forces_of(body, modes.basis @ state)
        along = -np.tensordot(forces, modes.basis, 2) / np.sqrt(modes.stiffness)
        np.testing.assert_allclose(total, along, atol=1e-6 * np.abs(total).max())
