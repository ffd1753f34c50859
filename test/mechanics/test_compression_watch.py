"""Whether hexahedra are fine enough for their compression: the share of energy that varies in cells."""

import numpy as np
import pytest

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.shape_functions import hourglass_fields
from softrobot_twin.mechanics.compression_watch import MOST_COMPRESSED, MOST_CONFINED
from softrobot_twin.mechanics.hourglass import hourglass_moduli
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.reduced_elements import ReducedElements, all_points, point_gradients

YOUNG, POISSON, SIDE = 1.0e5, 0.45, 0.02
LAME = lame_parameters(YOUNG, POISSON)


@pytest.fixture
def cells():
    """Cells of hexahedra, one beside the other."""
    (found,) = read_box((2 * SIDE, SIDE, SIDE), (2, 1, 1), of_hexahedra=True).mesh.blocks()
    return found


@pytest.fixture
def term(bind, cells):
    """Their elements."""
    (found,) = bind(("neo_hookean", cells.mesh, YOUNG, POISSON)).terms
    return found


def bent(rest, amount):
    """Moves that stretch one side of each cell along x and compress the other [m]."""
    x = (rest[:, 0] / SIDE) % 2 - 0.5
    return amount * np.outer(x * (rest[:, 2] / SIDE - 0.5), [1.0, 0.0, 0.0])


@pytest.mark.parametrize("height", [0.9, 0.7, 0.4])
def test_uniform_compression_is_never_too_coarse(term, height):
    rest = term.mesh.node_positions
    assert term.coarseness(rest * [1.0, 1.0, height], LAME) < 1e-18


def test_bending_without_compression_is_never_too_coarse(term):
    rest = term.mesh.node_positions
    assert term.coarseness(rest + bent(rest, 0.3 * SIDE), LAME) == 0.0


@pytest.mark.parametrize("stretches", [
    (0.7**-0.5, 0.7**-0.5, 0.7), (1.0, 1.0, 0.7), (1.0, 1.0, 0.9), (0.81**-0.5, 0.81**-0.5, 0.81),
])  # fmt: skip
def test_c_and_d_are_those_of_their_formulas(term, cells, stretches):
    """By the moduli of one cell: free and confined compression, by more than a fifth and less."""
    rest, F = term.mesh.node_positions, np.diag(stretches)
    x = rest @ F.T + bent(rest, 0.1 * SIDE)
    fields, (lame, mu) = hourglass_fields(rest[cells.mesh.cells]), LAME
    varied = 0.0
    moduli = hourglass_moduli(fields, LAME)
    for gammas, M, nodes in zip(fields.gammas, moduli, cells.mesh.cells, strict=True):
        y = (np.linalg.inv(F) @ (gammas @ x[nodes]).T).T.ravel()
        varied += 0.5 * y @ M @ y
    volume, J, least = 2.0 * SIDE**3, np.linalg.det(F), stretches[2]
    energy = varied + 0.5 * mu * volume * (np.trace(F.T @ F) / J ** (2 / 3) - 3.0)
    pressure = (lame + 2.0 * mu / 3.0) * np.log(J)
    c = (1.0 - least) * varied / energy if least < 0.8 else 0.0
    d = 1.5 * pressure**2 * volume / (mu * energy) * (4.0 - 3.0 * least) * varied / energy
    expected = max(c / MOST_COMPRESSED, d / MOST_CONFINED)
    # The moduli of the elements are less by their floor, a hundredth of the least.
    assert term.coarseness(x, LAME) == pytest.approx(expected, rel=0.011, abs=1e-12)


def test_a_state_that_is_stored_and_one_that_is_not_are_as_coarse(term):
    rest = term.mesh.node_positions
    x = rest * [1.2, 1.2, 0.7] + bent(rest, 0.1 * SIDE)
    before = term.coarseness(x, LAME)
    forces = np.zeros_like(rest)
    term.add_forces(x, forces)
    assert before > 1e-3
    assert term.coarseness(x, LAME) == pytest.approx(before, rel=1e-12)
    again = np.zeros_like(rest)
    term.coarseness(rest, LAME)
    term.add_forces(x, again)
    np.testing.assert_array_equal(forces, again)


def test_a_reduced_body_is_as_coarse_as_its_cells(term, cells):
    rest = cells.mesh.node_positions
    basis = np.stack([rest * [1.0, 1.0, 0.0], rest * [0.0, 0.0, -1.0], bent(rest, 1.0)], axis=2)
    points = point_gradients(cells, all_points(cells), basis)
    reduced = ReducedElements(points, law_named("neo_hookean").of_moduli(YOUNG, POISSON),
                              np.arange(1), np.arange(1))  # fmt: skip
    q = np.array([0.2, 0.3, 0.1 * SIDE])
    expected = term.coarseness(rest + basis @ q, LAME)
    assert expected > 1e-3
    assert reduced.coarseness(q.reshape(-1, 3), LAME) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("law", ["linear", "neo_hookean", "corotational"])
def test_a_law_of_small_displacements_is_not_watched(bind, cells, law):
    (found,) = bind((law, cells.mesh, YOUNG, POISSON)).terms
    assert found.has_varied_strain == (law != "linear")
