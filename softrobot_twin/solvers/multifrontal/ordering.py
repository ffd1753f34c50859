"""Which node to eliminate when: several orders are tried, the cheapest is taken.

No order is best for every body. Minimum degree eliminates what has fewest neighbours left, which
suits the thin limbs of most soft robots; nested dissection cuts the body in halves and eliminates
the cuts last, which suits thick ones. Both leave much to chance, and to analyse an order takes
milliseconds, so a number of each is tried, and judged by what factorizing would cost.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spilu

from softrobot_twin.solvers.multifrontal.nested_dissection import dissection_levels
from softrobot_twin.solvers.multifrontal.symbolic import (
    Elimination,
    analyse,
    subgraph,
    with_longer_runs,
)

# Numberings from which minimum degree is started: ties between nodes fall differently.
MINIMUM_DEGREE_STARTS = 24


def best_elimination(
    graph: sp.csr_array, coordinates: np.ndarray | None = None, order: np.ndarray | None = None
) -> Elimination:
    """Find an elimination order of a graph, and its fronts.

    Args:
        graph: Symmetric graph of the nodes, without loops.
        coordinates: Positions of the nodes, shape (node_count, 3); where there are none, the
            graph's own distances serve to cut it.
        order: The order to use, if it is not to be searched, shape (node_count,).

    Raises:
        ValueError: The order is not a permutation of the nodes.
    """
    node_count = graph.shape[0]
    if order is not None:
        if not np.array_equal(np.sort(order), np.arange(node_count)):
            raise ValueError(f"the order is not a permutation of 0..{node_count - 1}")
        return with_longer_runs(graph, analyse(graph, order))
    eliminations = (analyse(graph, o) for o in candidate_orders(graph, coordinates))
    best = min(eliminations, key=lambda elimination: elimination.cost)
    return with_longer_runs(graph, best)


def candidate_orders(
    graph: sp.csr_array, coordinates: np.ndarray | None = None
) -> Iterator[np.ndarray]:
    """Orders worth trying; see `best_elimination`."""
    node_count = graph.shape[0]
    yield minimum_degree(graph)
    random = np.random.default_rng(0)
    for _ in range(MINIMUM_DEGREE_STARTS - 1):
        start = random.permutation(node_count)
        yield start[minimum_degree(subgraph(graph, start))]
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
    """Multiple minimum degree, as SuperLU has it on board, shape (node_count,)."""
    node_count = graph.shape[0]
    if node_count < 2:
        return np.arange(node_count)
    # An incomplete factorization that keeps nothing takes no longer than its ordering.
    dominant = sp.csc_matrix(graph + sp.identity(node_count) * (2.0 * node_count))
    factors = spilu(
        dominant, drop_tol=1.0, fill_factor=1.0, drop_rule="basic",
        permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True},
    )  # fmt: skip
    return np.argsort(factors.perm_c)
