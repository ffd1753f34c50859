"""Facts of the estimate of the discretization error."""

import numpy as np
import pytest

from softrobot_twin.mechanics.corotational import CorotationalTets
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU


def bound_term(mesh):
    term = CorotationalTets(mesh, np.arange(mesh.node_count), lame_parameters(1.0e5, 0.3))
    matrix = SuperLU(*stencil_pairs(term.stencils()), mesh.node_count)
    term.bind(matrix.elimination_rank, matrix.slots)
    return term


def test_uniform_strain_has_no_error(block):
    mesh = block(shake=0.3)
    stretched = mesh.node_positions @ np.array([[1.1, 0.1, 0.0], [0.1, 0.9, 0.0], [0, 0, 1.0]])
    assert bound_term(mesh).relative_energy_error(stretched) < 1e-20


def test_a_body_at_rest_or_turned_has_none_either(block):
    mesh = block()
    assert bound_term(mesh).relative_energy_error(mesh.node_positions) == pytest.approx(0.0)


def test_the_estimate_falls_with_the_square_of_the_mesh_size_in_smooth_bending(block):
    shares = []
    for cells in (4, 8):
        mesh = block(size=(1, 1, 1), cells=(cells,) * 3, shake=0.0)
        x = mesh.node_positions
        bent = x + 1e-3 * np.column_stack([x[:, 0] * x[:, 2], 0 * x[:, 0], -0.5 * x[:, 0] ** 2])
        shares.append(bound_term(mesh).relative_energy_error(bent))
    assert 1.4 < np.log2(shares[0] / shares[1]) < 2.6
