"""Nodes that a file puts on the edges of ten-node tetrahedra, found by the corners beside them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.quadratic import EDGES

# A node this far from the middle of its edge, relative to the edge, makes it a curved edge.
_CURVED = 1e-3
# Gmsh numbers the last two edges the other way round than VTK and Abaqus.
_GMSH_ORDER = [0, 1, 2, 3, 5, 4]


class PlacedMidEdgeNodes(NamedTuple):
    """Nodes on edges, each once.

    Attributes:
        nodes: Their numbers in the file, shape (mid_count,).
        ends: The two corners that each lies between, shape (mid_count, 2).
        curved: Places, in `nodes`, of those off the middle of their edge.
        furthest: Number in the file of the one that is furthest off.
        offset: How far [m].
    """

    nodes: np.ndarray
    ends: np.ndarray
    curved: np.ndarray
    furthest: int
    offset: float


def place_mid_edge_nodes(
    positions: np.ndarray, tets: np.ndarray, mid_nodes: np.ndarray
) -> PlacedMidEdgeNodes:
    """Finds the edge of each node that is no corner.

    Args:
        positions: Node positions [m], shape (node_count, 3).
        tets: Corners of the tetrahedra, shape (tet_count, 4).
        mid_nodes: Nodes on their edges, −1 where there are none, shape (tet_count, 6). Of the two
            orders in use the one is taken in which they lie nearer to the middles.

    Returns:
        The nodes on edges.
    """
    has_mids = (mid_nodes >= 0).all(axis=1)
    ends = np.sort(tets[has_mids][:, EDGES], axis=2)
    middles = positions[ends].mean(axis=2)
    orders = [mid_nodes[has_mids], mid_nodes[has_mids][:, _GMSH_ORDER]]
    mids = min(orders, key=lambda order: float(np.abs(positions[order] - middles).sum()))
    nodes, first = np.unique(mids, return_index=True)
    ends = ends.reshape(-1, 2)[first]
    offsets = np.linalg.norm(positions[nodes] - positions[ends].mean(axis=1), axis=1)
    lengths = np.linalg.norm(positions[ends[:, 0]] - positions[ends[:, 1]], axis=1)
    worst = int(offsets.argmax())
    return PlacedMidEdgeNodes(
        nodes, ends, np.flatnonzero(offsets > _CURVED * lengths), int(nodes[worst]),
        float(offsets[worst]),
    )  # fmt: skip
