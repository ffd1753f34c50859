"""Facts of the stiffness of segments that is given as few blocks and dense rows."""

import numpy as np
import pytest

from softrobot_twin.constraints import cable
from softrobot_twin.constraints.cable import CablePath, Cables
from softrobot_twin.constraints.spread_stiffness import HEAVIEST
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.solvers.factorization import NodeRows

POINTS = [(0.03, 0.05, 0.07), (0.11, 0.12, 0.2), (0.15, 0.24, 0.31), (0.18, 0.1, 0.33)]


@pytest.fixture
def both(block, bound_term, monkeypatch):
    """Two cables in a block; each with the matrix that it adds to, whole and spread."""
    mesh = add_mid_edge_nodes(block(cells=(2, 2, 2)))
    found = locate_points(mesh.corner_mesh, np.array(POINTS))
    points = BarycentricMapping(*mesh.carriers(found.cells, found.barycentric_weights))
    reverse = BarycentricMapping(points.nodes[::-1], points.barycentric_weights[::-1])
    paths = (CablePath("through", points, np.array([-0.1, 0.0, 0.05])), CablePath("inside", reverse, None))
    monkeypatch.setattr(cable, "MOST_COUPLED", 3)

    def make(may_spread):
        def kind(entries, free_index, rest):
            return Cables(entries, free_index, rest, may_spread=may_spread)

        # Fixed nodes are left out of patches.
        return bound_term(kind, paths, mesh.node_positions, fixed=(0, 5, 30))

    return mesh, make(False), make(True)


def whole(term, matrix):
    """The matrix of a term, shape (3 n, 3 n), with its dense rows."""
    dense, parts = matrix.matrix().toarray(), term.dense_rows
    if parts is not None:
        S = NodeRows(*parts[:3], len(parts.stiffness)).transposed(len(matrix.elimination_rank))
        dense = dense + S @ np.diag(parts.stiffness) @ S.T
    return dense


def states(mesh, rng):
    """A bent body; one whose stretches are rounded; one with a stretch of zero length."""
    x = mesh.node_positions
    bent = x + 0.01 * rng.standard_normal(x.shape)
    return bent, 0.06 * x + 0.02 * (bent - x), np.zeros_like(x)


@pytest.mark.parametrize("tensions", [(3.0, 0.7), (0.0, 2.0), (0.0, 0.0)])
def test_the_tangent_is_that_of_all_blocks(both, tensions, drawn_rng):
    mesh, (term, matrix, _), (spread, lumped, _) = both
    tensions = np.array(tensions)
    for x in states(mesh, drawn_rng):
        for own, storage in ((term, matrix.storage), (spread, lumped.storage)):
            storage[:] = 0.0
            own.add_stiffness(x, tensions, storage)
        expected = whole(term, matrix)
        np.testing.assert_allclose(
            whole(spread, lumped), expected, atol=1e-12 * max(1.0, np.abs(expected).max())
        )


def test_squares_of_cables_are_added_to_it(both, drawn_rng, dense_rows):
    mesh, (term, matrix, free), (spread, lumped, _) = both
    x, stiffness = states(mesh, drawn_rng)[0], np.array([40.0, 0.0])
    added = []
    for own, of in ((term, matrix), (spread, lumped)):
        of.storage[:] = 0.0
        own.add_stiffness(x, np.array([3.0, 0.7]), of.storage)
        before = whole(own, of)
        lacking = own.add_row_stiffness(x, stiffness, of.storage)
        S = NodeRows(*lacking[:3], len(lacking.stiffness)).transposed(len(free))
        added.append(whole(own, of) + S @ np.diag(lacking.stiffness) @ S.T - before)
    h = dense_rows(term, x, free)[0].reshape(2, -1)
    for found in added:
        np.testing.assert_allclose(found, h.T @ np.diag(stiffness) @ h, atol=1e-11 * np.abs(found).max())
    # The next stiffness begins anew.
    lumped.storage[:] = 0.0
    matrix.storage[:] = 0.0
    term.add_stiffness(x, np.ones(2), matrix.storage)
    spread.add_stiffness(x, np.ones(2), lumped.storage)
    expected = whole(term, matrix)
    np.testing.assert_allclose(whole(spread, lumped), expected, atol=1e-12 * np.abs(expected).max())


def test_a_slack_cable_has_as_many_rows_as_a_taut_one(both):
    mesh, _, (spread, lumped, _) = both
    counts = set()
    for tensions in ((1.0, 1.0), (0.0, 1.0), (0.0, 0.0)):
        spread.add_stiffness(mesh.node_positions, np.array(tensions), lumped.storage)
        counts.add((len(spread.dense_rows.stiffness), len(spread.dense_rows.row_index)))
    assert len(counts) == 1


def test_few_nodes_are_coupled(both):
    _, (term, _, _), (spread, _, _) = both
    assert spread.stencils().shape == (len(term.stencils()), 2 * HEAVIEST)
    assert term.dense_rows is None
