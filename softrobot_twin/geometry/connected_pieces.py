"""Pieces of a graph, such as those of a mesh whose parts do not touch."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def connected_pieces(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
    """The piece that each vertex is in, counted from 0, int32, shape (count,).

    Args:
        first: First vertex of each edge, shape (edge_count,).
        second: Second vertex, same shape.
        count: Number of vertices.
    """
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
