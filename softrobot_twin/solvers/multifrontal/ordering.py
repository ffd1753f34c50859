"""Elimination orders: several are tried, and the cheapest is taken.

No order is best for every body. Minimum degree eliminates the node with the fewest neighbours left,
which suits the thin limbs of most soft robots. Nested dissection cuts the body into halves and
eliminates the cuts last, which suits thick bodies. Both depend on chance, and analysing an order
takes milliseconds; therefore several orders of each kind are tried and judged by the estimated cost
of the factorization.

Nested dissection places the nodes in space, by their coordinates or, without any, by their
distances in the graph. A half is one side of a plane across one of several directions. Its
separator is the smallest set of nodes that touches every edge between the halves, a minimum vertex
cover, which by König's theorem follows from a maximum matching.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra, maximum_bipartite_matching
from scipy.sparse.linalg import spilu

from softrobot_twin.solvers.multifrontal.symbolic import (
    Elimination,
    analyse,
    inverse,
    renumbered,
    subgraph,
    with_longer_runs,
)

# Initial numberings for minimum degree: ties between nodes are broken differently. Fewer of a large
# mesh, whose nodes all starts together number at most as told, but so many of any.
MINIMUM_DEGREE_STARTS, FEWEST_STARTS, STARTED_NODES = 24, 4, 60_000
# Parts of this size or less are not cut any further.
SMALLEST_PART = 40
# Least share of the nodes on either side of a cut.
SMALLEST_SHARE = 0.2
# Axes along which cuts are tried: principal axes of the part, and between them.
_AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -1, 0], [1, 0, 1], [1, 0, -1]])
PIVOTS = 12
# A search takes half of the time to build a scene, and a scene is often built more than once: for
# its error, its samples. So the last eliminations are kept; nobody writes to them.
_REMEMBERED = 32
_RECENT: dict[bytes, Elimination] = {}


def best_elimination(
    graph: sp.csr_array, coordinates: np.ndarray | None = None, order: np.ndarray | None = None
) -> Elimination:
    """Find an elimination order of a graph, and its fronts.

    Args:
        graph: Symmetric graph of the nodes, without loops.
        coordinates: Positions of the nodes, shape (node_count, 3); where there are none, the
            graph's own distances serve to cut it.
        order: The order to use, if it is not to be searched, shape (node_count,).
    """
    if order is not None:
        return with_longer_runs(graph, analyse(graph, order))
    key = _fingerprint(graph, coordinates)
    found = _RECENT.get(key)
    if found is None:
        eliminations = (analyse(graph, o) for o in candidate_orders(graph, coordinates))
        best = min(eliminations, key=lambda elimination: elimination.cost)
        found = with_longer_runs(graph, best)
        while len(_RECENT) >= _REMEMBERED:
            _RECENT.pop(next(iter(_RECENT)), None)
        _RECENT[key] = found
    return found


def _fingerprint(graph: sp.csr_array, coordinates: np.ndarray | None) -> bytes:
    """The same for graphs whose search gives the same order."""
    digest = hashlib.blake2b()
    for array in (graph.indptr, graph.indices, coordinates):
        digest.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.digest()


def candidate_orders(graph: sp.csr_array, coordinates: np.ndarray | None = None) -> Iterator[np.ndarray]:
    """Orders worth trying; see `best_elimination`."""
    node_count = graph.shape[0]
    yield minimum_degree(graph)
    random = np.random.default_rng(0)
    fitting = STARTED_NODES // max(node_count, 1)
    for _ in range(min(max(fitting, FEWEST_STARTS), MINIMUM_DEGREE_STARTS) - 1):
        start = random.permutation(node_count)
        yield start[_minimum_degree(*renumbered(graph, start))]
    level = dissection_levels(graph, coordinates)
    for depth in range(1, int(level.max(initial=0)) + 1):
        yield _dissected(graph, np.where(level < depth, level, depth))


def _dissected(graph: sp.csr_array, level: np.ndarray) -> np.ndarray:
    """Eliminate level by level, the deepest first, and that by minimum degree."""
    deepest = np.flatnonzero(level == level.max())
    separators = np.flatnonzero(level < level.max())
    separators = separators[np.argsort(-level[separators], kind="stable")]
    inside = deepest[minimum_degree(subgraph(graph, deepest))]
    return np.concatenate([inside, separators])


def minimum_degree(graph: sp.csr_array) -> np.ndarray:
    """Multiple minimum degree, by the implementation inside SuperLU, shape (node_count,).

    Args:
        graph: Adjacency of the nodes, symmetric, shape (node_count, node_count).
    """
    return _minimum_degree(graph.indptr, graph.indices)


def _minimum_degree(indptr: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """The same of a graph given by its neighbours, in any order; see `renumbered`."""
    node_count = len(indptr) - 1
    if node_count < 2:
        return np.arange(node_count)
    # An incomplete factorization that drops everything takes no longer than its ordering.
    ends, diagonal = indptr[1:], 2.0 * node_count
    dominant = sp.csc_matrix(
        (
            np.insert(np.ones(len(indices)), ends, diagonal),
            np.insert(indices, ends, np.arange(node_count)).astype(np.int32),
            (indptr + np.arange(node_count + 1)).astype(np.int32),
        ),
        shape=(node_count, node_count),
    )
    factors = spilu(
        dominant, drop_tol=1.0, fill_factor=1.0, drop_rule="basic",
        permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True},
    )  # fmt: skip
    return np.argsort(factors.perm_c)


def dissection_levels(graph: sp.csr_array, coordinates: np.ndarray | None = None) -> np.ndarray:
    """Depth of the cut that each node belongs to.

    Args:
        graph: Symmetric graph of the nodes, without loops.
        coordinates: Positions of the nodes, shape (node_count, 3).

    Returns:
        0 for nodes of the first separators, 1 for those of the halves', …; nodes of no separator
        have one more than the deepest, shape (node_count,).
    """
    node_count = graph.shape[0]
    level = np.full(node_count, -1)
    parts = [(np.arange(node_count), 0)]
    while parts:
        nodes, depth = parts.pop()
        if len(nodes) <= SMALLEST_PART:
            continue
        part = subgraph(graph, nodes)
        count, component = connected_components(part, directed=False)
        if count > 1:
            parts += [(nodes[component == c], depth) for c in range(count)]
            continue
        places = distances_as_places(part) if coordinates is None else coordinates[nodes]
        side, separator = bisect(part, places)
        level[nodes[separator]] = depth
        for half in (side & ~separator, ~side & ~separator):
            parts.append((nodes[half], depth + 1))
    level[level < 0] = level.max(initial=-1) + 1
    return level


def bisect(graph: sp.csr_array, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut a connected graph in two.

    Args:
        graph: Symmetric graph of at least two nodes.
        places: Positions of the nodes, shape (node_count, 3).

    Returns:
        Masks of the nodes on one side and of the separator, shape (node_count,) each.
    """
    node_count = len(places)
    centred = places - places.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    smallest = max(1, int(SMALLEST_SHARE * node_count))
    sizes = np.arange(smallest, node_count - smallest + 1)
    best, side = np.inf, np.zeros(node_count, dtype=bool)
    for values in (centred @ axes[:, ::-1] @ _AXES.T).T:
        position = inverse(np.argsort(values, kind="stable"))
        badness = boundary_sizes(graph, position)[sizes] / np.minimum(sizes, node_count - sizes)
        if badness.min() < best:
            best, side = badness.min(), position >= sizes[np.argmin(badness)]
    return side, vertex_cover(graph, side)


def boundary_sizes(graph: sp.csr_array, position: np.ndarray) -> np.ndarray:
    """Nodes at the cut between the first k nodes of an order and the others, for all k.

    Args:
        graph: Symmetric graph in which every node has a neighbour.
        position: Place of each node in the order, shape (node_count,).

    Returns:
        The number on the side that has fewer of them, shape (node_count + 1,).
    """
    neighbours = position[graph.indices]
    lowest = np.minimum(np.minimum.reduceat(neighbours, graph.indptr[:-1]), position)
    highest = np.maximum(np.maximum.reduceat(neighbours, graph.indptr[:-1]), position)

    def count_between(after, until):
        """How many nodes have after < k <= until, for all k."""
        changes = np.zeros(len(position) + 2, dtype=np.int64)
        np.add.at(changes, after + 1, 1)
        np.add.at(changes, until + 1, -1)
        return np.cumsum(changes[:-1])

    return np.minimum(count_between(lowest, position), count_between(position, highest))


def vertex_cover(graph: sp.csr_array, side: np.ndarray) -> np.ndarray:
    """Smallest set of nodes that touches all edges between two sides, as a mask.

    Args:
        graph: Adjacency of the nodes, symmetric, shape (node_count, node_count).
        side: Whether a node is on the left side, shape (node_count,).
    """
    left, right = np.flatnonzero(side), np.flatnonzero(~side)
    crossing = sp.csr_matrix(graph[left][:, right])
    partner_of_left = maximum_bipartite_matching(crossing, perm_type="column")
    partner_of_right = maximum_bipartite_matching(crossing, perm_type="row")
    # König: start at unmatched nodes of the left, go right by any edge, back by matched ones.
    left_seen = partner_of_left < 0
    right_seen = np.zeros(len(right), dtype=bool)
    newest = np.flatnonzero(left_seen)
    while len(newest):
        found = np.unique(crossing[newest].indices)
        found = found[~right_seen[found]]
        right_seen[found] = True
        newest = partner_of_right[found]
        newest = newest[newest >= 0]
        newest = newest[~left_seen[newest]]
        left_seen[newest] = True
    cover = np.zeros(len(side), dtype=bool)
    cover[left[~left_seen]] = True
    cover[right[right_seen]] = True
    return cover


def distances_as_places(graph: sp.csr_array) -> np.ndarray:
    """Positions that show a connected graph's distances, shape (node_count, 3).

    Classical scaling of the distances to a few pivots far from each other (Brandes and
    Pich 2006).

    Args:
        graph: Adjacency of the nodes, symmetric, shape (node_count, node_count).
    """
    nearest = np.full(graph.shape[0], np.inf)
    pivot, distances = 0, []
    for _ in range(PIVOTS):
        distances.append(dijkstra(graph, indices=pivot, unweighted=True))
        nearest = np.minimum(nearest, distances[-1])
        pivot = int(np.argmax(nearest))
    squares = np.stack(distances, axis=1) ** 2
    centred = squares - squares.mean(axis=0) - squares.mean(axis=1, keepdims=True) + squares.mean()
    _, axes = np.linalg.eigh(centred.T @ centred)
    return centred @ axes[:, :-4:-1]
