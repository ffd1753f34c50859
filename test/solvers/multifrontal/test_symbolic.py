"""Facts of orders, fronts and the layout of memory: everything that is found before numbers."""

import numpy as np
import pytest
import scipy.sparse as sp

from softrobot_twin.solvers.multifrontal.condensation import ConstraintColumns
from softrobot_twin.solvers.multifrontal.memory_layout import FirstFit, lay_out
from softrobot_twin.solvers.multifrontal.ordering import (
    best_elimination,
    bisect,
    boundary_sizes,
    candidate_orders,
    dissection_levels,
    distances_as_places,
    minimum_degree,
    vertex_cover,
)
from softrobot_twin.solvers.multifrontal.symbolic import (
    analyse,
    elimination_tree,
    front_cost,
    inverse,
    merge_supernodes,
    node_graph,
    postorder,
    renumbered,
    subgraph,
)


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


@pytest.mark.parametrize("seed", range(6))
def test_a_columns_parent_is_its_first_entry_below_the_diagonal(seed):
    graph = random_graph(40, seed)
    structure = filled(graph, np.arange(40))
    parent = elimination_tree(*renumbered(graph, np.arange(40)))
    for j in range(40):
        below = np.flatnonzero(structure[j + 1 :, j])
        assert parent[j] == (below[0] + j + 1 if len(below) else -1)


@pytest.mark.parametrize("seed", range(6))
def test_a_postorder_keeps_subtrees_together_below_their_roots(seed):
    rng = np.random.default_rng(seed)
    count = 50
    shuffled = rng.permutation(count)
    parent = np.full(count, -1)
    for i in range(count - 3):
        parent[shuffled[i]] = shuffled[rng.integers(i + 1, count)]
    order = postorder(parent, rng.permutation(count))
    place = inverse(order)
    size = np.ones(count, dtype=int)
    for member in order:
        if parent[member] >= 0:
            assert place[parent[member]] > place[member]
            size[parent[member]] += size[member]
    for member in order:
        inside = order[place[member] - size[member] + 1 : place[member] + 1]
        ancestors = {member}
        for other in inside[::-1]:
            assert other in ancestors or parent[other] in ancestors
            ancestors.add(other)


def test_the_fronts_contain_all_fill_of_the_order(graph):
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(graph.shape[0])
        check_fronts(graph, analyse(graph, order))
    check_fronts(graph, best_elimination(graph))


def check_fronts(graph, elimination):
    count = graph.shape[0]
    np.testing.assert_array_equal(np.sort(elimination.order), np.arange(count))
    np.testing.assert_array_equal(elimination.order[elimination.rank], np.arange(count))
    structure = filled(graph, elimination.order)
    held = np.zeros((count, count), dtype=bool)
    for s, parent in enumerate(elimination.parent):
        first, end = elimination.first[s : s + 2]
        rows = elimination.rows[elimination.row_start[s] : elimination.row_start[s + 1]]
        assert end > first
        assert np.all(elimination.front[first:end] == s)
        assert np.all(np.diff(rows) > 0)
        if len(rows):
            assert rows[0] >= end
            assert parent == elimination.front[rows[0]] > s
        else:
            assert parent == -1
        held[np.ix_(np.arange(first, end), np.arange(first, end))] = True
        held[np.ix_(rows, np.arange(first, end))] = True
    assert np.all(held[structure])


def test_an_order_has_the_fill_of_minimum_degree():
    chain = node_graph(np.arange(99), np.arange(1, 100), 100)
    structure = filled(chain, minimum_degree(chain))
    assert structure.sum() == 199  # no fill at all


def test_candidates_are_permutations(graph):
    for order in candidate_orders(graph):
        np.testing.assert_array_equal(np.sort(order), np.arange(graph.shape[0]))


def test_the_best_candidate_is_taken():
    graph, places = box(7, 7, 7)
    best = best_elimination(graph, places)
    assert best.cost == min(analyse(graph, o).cost for o in candidate_orders(graph, places))


def test_a_given_order_is_kept_up_to_its_fill():
    graph, _ = box(4, 4, 4)
    natural = best_elimination(graph, order=np.arange(64))
    assert natural.cost == analyse(graph, np.arange(64)).cost


def test_merging_never_increases_the_cost():
    rng = np.random.default_rng(0)
    for _ in range(20):
        count = 30
        parent = np.array([rng.integers(s + 1, count) for s in range(count - 1)] + [-1])
        columns, rows = rng.integers(1, 5, count), rng.integers(0, 20, count)
        before = sum(front_cost(c, r) for c, r in zip(columns, rows, strict=True))
        merged = columns.copy()
        into = merge_supernodes(merged, rows, parent)
        kept = np.flatnonzero(into == np.arange(count))
        assert merged[kept].sum() == columns.sum()
        assert sum(front_cost(merged[s], rows[s]) for s in kept) <= before
        assert np.all(np.isin(into, kept))


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


@pytest.mark.parametrize("seed", range(8))
def test_a_vertex_cover_touches_every_crossing_edge_and_is_smallest(seed):
    graph = random_graph(14, seed, 5)
    side = np.random.default_rng(seed).random(14) < 0.5
    cover = vertex_cover(graph, side)
    edges = graph.tocoo()
    crossing = side[edges.row] & ~side[edges.col]
    ends = np.stack([edges.row[crossing], edges.col[crossing]])
    assert np.all(cover[ends].any(axis=0))
    subsets = (np.arange(2**14)[:, None] >> np.arange(14)) & 1
    covers = (subsets[:, ends[0]] | subsets[:, ends[1]]).all(axis=1)
    assert cover.sum() == subsets[covers].sum(axis=1).min()


@pytest.mark.parametrize("seed", range(5))
def test_boundary_sizes_are_counted_for_all_cuts_at_once(seed):
    graph, _ = box(3, 4, 4)
    position = np.random.default_rng(seed).permutation(48)
    edges = graph.tocoo()
    sizes = boundary_sizes(graph, position)
    for k in range(49):
        crossing = (position[edges.row] < k) & (position[edges.col] >= k)
        below = np.unique(edges.row[crossing]).size
        above = np.unique(edges.col[crossing]).size
        assert sizes[k] == min(below, above)


def test_blocks_in_use_do_not_overlap(graph):
    elimination = best_elimination(graph)
    layout = lay_out(elimination, *renumbered(graph, elimination.order))
    fronts = layout.fronts
    ends = fronts["panel"] + fronts["stride"] * fronts["columns"]
    np.testing.assert_array_equal(ends[:-1], fronts["panel"][1:])
    owner = np.full(layout.updates_size, -1)
    for s, front in enumerate(fronts):
        size = front["update_stride"] * (front["rows"] - front["columns"])
        here = slice(front["update"], front["update"] + size)
        assert np.all(owner[here] == -1)
        owner[here] = s
        for child in layout.children[front["child_start"] : front["child_end"]]:
            assert elimination.parent[child] == s
            owner[owner == child] = -1
    assert np.unique(layout.block_places).size == len(layout.block_keys)


def test_runs_map_every_row_of_an_update_to_its_position(graph):
    elimination = best_elimination(graph)
    layout = lay_out(elimination, *renumbered(graph, elimination.order))

    def ranks(s):
        own = np.arange(elimination.first[s], elimination.first[s + 1])
        rows = elimination.rows[elimination.row_start[s] : elimination.row_start[s + 1]]
        return own, rows

    for s, front in enumerate(layout.fronts):
        _, rows = ranks(s)
        if not len(rows):
            continue
        own, below = ranks(elimination.parent[s])
        there = np.concatenate([own, below])
        carried = []
        for number in range(front["run_start"], front["run_end"]):
            run = layout.runs[number]
            source = np.arange(run["source"], run["source"] + run["count"])[::3] // 3
            target = np.arange(run["target"], run["target"] + run["count"])[::3] // 3
            np.testing.assert_array_equal(rows[source], there[target])
            in_panel = number < front["run_split"]
            assert np.all((target < len(own)) == in_panel)
            carried.extend(source)
        assert carried == list(range(len(rows)))


def test_reach_is_all_fronts_from_the_nodes_to_the_root():
    graph, _ = box(5, 5, 12)
    elimination = best_elimination(graph)
    structure = filled(graph, elimination.order)
    ranks = elimination.rank[np.array([0, 7, 155])]
    columns = ConstraintColumns(elimination)
    columns.place(np.arange(3), ranks, 3)
    reached = columns.places[elimination.first[elimination.front]] >= 0
    places, dof_count = columns.places[reached], columns.trees["dof_count"].sum()
    unit = np.zeros((300, 3))
    unit[ranks, np.arange(3)] = 1.0
    weights = structure * np.random.default_rng(0).uniform(0.5, 1.0, structure.shape)
    touched = np.flatnonzero(np.linalg.solve(weights + 2 * np.eye(300), unit).any(axis=1))
    assert np.all(reached[touched])
    assert dof_count < 3 * 300
    np.testing.assert_array_equal(np.sort(places), 3 * np.arange(dof_count // 3))


def test_memory_is_reused():
    memory = FirstFit()
    a, b, c = (memory.take(10) for _ in range(3))
    memory.give_back(b, 10)
    assert memory.take(4) == b
    memory.give_back(a, 10)
    assert memory.take(11) == 30  # the rest of b's room is too far from a's
    memory.give_back(b, 4)
    assert memory.take(20) == a
    assert memory.size == 41
    memory.give_back(c, 10)
