"""Springs along a path of points, such as a tube that a cable runs in."""

import numpy as np
import pytest

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.springs import Springs, segments
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU


def springs_along(path, axial_stiffness, rest_positions, free_index):
    """One spring of stiffness E A / L₀ a stretch, as for the tube of a scene."""
    first, second, lengths = segments(path, rest_positions)
    return Springs(first, second, axial_stiffness / lengths, lengths, 0.0, free_index)


def test_springs_along_a_path_are_as_stiff_as_the_path_however_it_is_cut(world):
    ends_of_path = world.positions[[1, 2]]
    x = np.vstack([world.positions, np.linspace(*ends_of_path, 6)[[1, 1, 3]]])
    free_index = np.concatenate([world.free_index, [-1, -1, -1]])
    count = len(world.positions)
    path = world.nodes(1, count, count + 1, count + 2, 2)
    term = springs_along(path, 100.0, x, free_index)
    assert term.spring_count == 3
    assert term.energy(x) == pytest.approx(0.0, abs=1e-20)
    length = np.linalg.norm(ends_of_path[1] - ends_of_path[0])
    assert 1.0 / np.sum(1.0 / term.stiffness) == pytest.approx(100.0 / length)
    stretched = 1.01 * x
    assert term.energy(stretched) == pytest.approx(0.5 * 100.0 / length * (0.01 * length) ** 2)


def test_a_hung_chain_of_masses_carries_the_weight_below_each_spring():
    count, weight = 4, np.array([0.0, 0.0, -2.0])
    x = np.zeros((count + 1, 3))
    x[:, 2] = -0.1 * np.arange(count + 1)
    free_index = np.arange(-1, count)
    path = BarycentricMapping(np.arange(count + 1)[:, None], np.ones((count + 1, 1)))
    springs = springs_along(path, 50.0, x, free_index)
    weights = Gravity(np.ones(count), weight)
    matrix = SuperLU(*stencil_pairs(springs.stencils()), count)
    springs.bind(matrix.elimination_rank, matrix.slots)
    positions = x.copy()
    for _ in range(40):
        forces = np.zeros((count, 3))
        matrix.clear()
        for term in (springs, weights):
            if term is weights:
                term.add_forces(positions, forces)
            else:
                term.add(positions, forces, matrix.storage, True)
        K = matrix.matrix().toarray() + 1e-9 * np.eye(3 * count)
        positions[1:] += np.linalg.solve(K, forces.ravel()).reshape(-1, 3)
    tensions = springs.stiffness * (springs.lengths(positions) - springs.rest_lengths)
    np.testing.assert_allclose(tensions, 2.0 * np.arange(count, 0, -1), rtol=1e-6)
