"""Facts of effectors."""

import numpy as np
import pytest

from softrobot_twin.constraints.effector import EffectorPoints, Effectors
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.mechanics.barycentric import BarycentricMapping


def carried(mesh, points):
    found = locate_points(mesh, np.array(points, float))
    return BarycentricMapping(found.nodes, found.barycentric_weights)


@pytest.fixture
def effectors(block):
    mesh = block(cells=(2, 2, 2))
    term = Effectors(
        (
            EffectorPoints("tip", carried(mesh, [(0.1, 0.1, 0.39)]), (0, 1, 2), 1.0),
            EffectorPoints("pad", carried(mesh, [(0.0, 0, 0), (0.2, 0.3, 0.1)]), (2,), 4.0),
        ),
        np.arange(mesh.node_count),
    )
    return mesh, term


def test_an_effector_of_several_points_is_their_mean(effectors):
    mesh, term = effectors
    np.testing.assert_allclose(
        term.positions(mesh.node_positions), [[0.1, 0.1, 0.39], [0.1, 0.15, 0.05]], atol=1e-14
    )


def test_only_the_named_directions_make_rows(effectors):
    _, term = effectors
    assert term.row_count == 4
    assert term.row_effector.tolist() == [0, 0, 0, 1]
    assert term.row_axis.tolist() == [0, 1, 2, 2]
    assert term.row_weights.tolist() == [1, 1, 1, 4]


def test_rows_are_the_derivative_of_the_coordinates(effectors):
    mesh, term = effectors
    stack = RowStack([term])
    x = mesh.node_positions
    stack.evaluate(x)
    H = np.zeros((stack.row_count, mesh.node_count, 3))
    np.add.at(H, (stack.row_index, stack.node_index), stack.blocks)
    at_rest = stack.values.copy()
    move = 1e-3 * np.random.default_rng(0).standard_normal(x.shape)
    stack.evaluate(x + move)
    np.testing.assert_allclose(np.einsum("kni,ni->k", H, move), stack.values - at_rest, atol=1e-15)


def test_fixed_nodes_carry_no_entries(block):
    mesh = block(cells=(1, 1, 1))
    free_index = np.full(mesh.node_count, -1)
    free_index[3] = 0
    term = Effectors(
        (EffectorPoints("e", carried(mesh, [(0.1, 0.15, 0.2)]), (0,), 1.0),), free_index
    )
    assert set(term.entry_nodes) <= {0}


def test_stacked_rows_push_with_their_multipliers(effectors):
    mesh, term = effectors
    stack = RowStack([term])
    stack.evaluate(mesh.node_positions)
    forces = np.zeros((mesh.node_count, 3))
    stack.add_forces(np.array([1.0, 2.0, 3.0, 5.0]), forces)
    np.testing.assert_allclose(forces.sum(axis=0), [1.0, 2.0, 8.0])
