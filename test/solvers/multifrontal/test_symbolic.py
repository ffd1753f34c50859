"""Facts of orders, fronts and the layout of memory: everything that is found before numbers."""

import numpy as np
import pytest
import scipy.sparse as sp

from softrobot_twin.solvers.multifrontal.ordering import (
    best_elimination,
    bisect,
    candidate_orders,
    dissection_levels,
    distances_as_places,
    minimum_degree,
)
from softrobot_twin.solvers.multifrontal.symbolic import analyse, node_graph, subgraph


def random_graph(count, seed, mean_degree=4):
    rng = np.random.default_rng(seed)
    return node_graph(*rng.integers(0, count, (2, count * mean_degree // 2)), count)


def box(*shape):
    index = np.arange(np.prod(shape)).reshape(shape)
    sides = [np.moveaxis(index, axis, 0) for axis in range(3)]
    low = np.concatenate([side[:-1].ravel() for side in sides])
    high = np.concatenate([side[1:].ravel() for side in sides])
    places = np.stack(np.unravel_index(np.arange(index.size), shape), axis=1).astype(float)
    return node_graph(low, high, index.size), places


GRAPHS = {
    "empty": node_graph([], [], 0), "one node": node_graph([], [], 1),
    "nodes apart": node_graph([], [], 5), "box": box(4, 5, 6)[0], "long box": box(3, 3, 40)[0],
    **{f"random {seed}": random_graph(20 + 30 * seed, seed, 2 + seed) for seed in range(5)},
}  # fmt: skip


@pytest.fixture(params=list(GRAPHS), ids=str)
def graph(request):
    return GRAPHS[request.param]


def filled(graph, order):
    """Structure of L by elimination, one node after the other, dense."""
    pattern = graph.toarray()[np.ix_(order, order)] != 0
    np.fill_diagonal(pattern, True)
    for j in range(len(pattern)):
        below = np.flatnonzero(pattern[j + 1 :, j]) + j + 1
        pattern[np.ix_(below, below)] = True
    return np.tril(pattern)


def test_an_order_has_the_fill_of_minimum_degree():
    chain = node_graph(np.arange(99), np.arange(1, 100), 100)
    structure = filled(chain, minimum_degree(chain))
    assert structure.sum() == 199  # no fill at all


def test_the_best_candidate_is_taken():
    graph, places = box(7, 7, 7)
    best = best_elimination(graph, places)
    assert best.cost == min(analyse(graph, o).cost for o in candidate_orders(graph, places))


def test_separators_separate():
    graph, places = box(6, 6, 9)
    for positions in (places, None):
        level = dissection_levels(graph, positions)
        remaining = subgraph(graph, np.flatnonzero(level > 0))
        count, _ = sp.csgraph.connected_components(remaining, directed=False)
        assert count > 1
        assert np.sum(level == 0) <= 36


def test_a_long_body_is_cut_across():
    graph, places = box(3, 3, 40)
    for positions in (places, distances_as_places(graph)):
        side, separator = bisect(graph, positions)
        assert separator.sum() == 9
        assert 0.2 < side.mean() < 0.8
