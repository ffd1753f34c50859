"""Facts of what fills cavities: sealed gas and liquids."""

import numpy as np
import pytest

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from softrobot_twin.mechanics.liquid_filling import LiquidFilling
from softrobot_twin.mechanics.sealed_gas import SealedGas
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU

GRAVITY = np.array([1.0, -2.0, -9.0])
FILLINGS = {
    "gas": lambda *place: SealedGas(*place, np.array([1.3e5, 9e4]), np.array([1e5, 1e5])),
    "liquid": lambda *place: LiquidFilling(*place, np.array([1000.0, 700.0]), GRAVITY),
}


@pytest.fixture(params=["nodes", "points"])
def cavity(request, block):
    """A mesh, and the walls of a cavity: its surface, or points inside it."""
    mesh = block(cells=(2, 2, 2))
    if request.param == "nodes":
        triangles = boundary_triangles(mesh.cells)
        nodes = np.arange(mesh.node_count)
        return mesh, CavitySurface(
            "own", BarycentricMapping(nodes[:, None], np.ones((len(nodes), 1))), triangles
        )
    inner = block(size=(0.1, 0.15, 0.2), cells=(1, 1, 2), shake=0.0)
    found = locate_points(mesh, inner.node_positions + [0.04, 0.07, 0.09])
    carriers = BarycentricMapping(*mesh.carriers(found.cells, found.barycentric_weights))
    return mesh, CavitySurface("inner", carriers, boundary_triangles(inner.cells))


def filled(filling, cavity, fixed=(0, 5)):
    mesh, surface = cavity
    free = np.setdiff1d(np.arange(mesh.node_count), fixed)
    free_index = np.full(mesh.node_count, -1)
    free_index[free] = np.arange(len(free))
    term = FILLINGS[filling]((surface, surface), free_index, mesh.node_positions)
    matrix = SuperLU(*stencil_pairs(term.stencils()), len(free))
    term.bind(matrix.elimination_rank, matrix.slots)
    x = mesh.node_positions + 0.01 * np.random.default_rng(0).standard_normal(
        mesh.node_positions.shape
    )
    return term, matrix, free, x


def forces_of(term, x, free):
    forces = np.zeros((len(free), 3))
    assert term.add_forces(x, forces) == 0
    return forces


@pytest.mark.parametrize("filling", FILLINGS)
def test_forces_are_minus_the_gradient_of_the_energy(filling, cavity, slopes):
    term, _, free, x = filled(filling, cavity)
    gradient = slopes(term.energy, x, free, 1e-6)
    forces = forces_of(term, x, free)
    np.testing.assert_allclose(forces.ravel(), -gradient, atol=1e-7 * np.abs(forces).max())


@pytest.mark.parametrize("filling", FILLINGS)
def test_stiffness_and_dense_rows_are_the_derivative_of_the_forces(filling, cavity, slopes):
    term, matrix, free, x = filled(filling, cavity)
    forces = np.zeros((len(free), 3))
    matrix.clear()
    term.add(x, forces, matrix.storage, False)
    K = matrix.matrix().toarray()
    rows = term.dense_rows
    assert (rows is None) == (filling == "liquid")
    if rows is not None:
        H = np.zeros((len(rows.stiffness), len(free), 3))
        np.add.at(H, (rows.row_index, rows.node_index), rows.blocks)
        H = H.reshape(len(H), -1)
        K += H.T @ (rows.stiffness[:, None] * H)
    np.testing.assert_allclose(K, K.T, atol=1e-13 * np.abs(K).max())
    slope = slopes(lambda y: forces_of(term, y, free).ravel(), x, free, 1e-6)
    np.testing.assert_allclose(K, -slope, atol=1e-7 * np.abs(K).max())


def test_a_gas_obeys_boyle(cavity):
    term, _, _, x = filled("gas", cavity)
    np.testing.assert_allclose(term.pressures(cavity[0].node_positions), [3e4, -1e4], rtol=1e-9)
    np.testing.assert_allclose(
        term.pressures(0.5 ** (1 / 3) * x), 2.0 * (term.pressures(x) + 1e5) - 1e5, rtol=1e-9
    )


def test_the_weight_of_a_liquid_is_borne_by_its_walls(cavity):
    term, _, free, x = filled("liquid", cavity, fixed=())
    volumes = term.walls.volumes(x)
    weight = (volumes[:, None] * np.outer([1000.0, 700.0], GRAVITY)).sum(axis=0)
    np.testing.assert_allclose(forces_of(term, x, free).sum(axis=0), weight, rtol=1e-10)


def test_a_gas_is_never_compressed_to_nothing(cavity):
    term, _, _, _ = filled("gas", cavity)
    rest = cavity[0].node_positions
    assert term.largest_share(rest, 0.9 * rest) == 1.0
    share = term.largest_share(rest, rest * [1.0, 1.0, -1.0])
    assert 0.0 < share < 0.5
