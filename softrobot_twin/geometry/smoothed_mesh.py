"""Linear tetrahedra whose deformation gradient is smoothed over edges.

Each tetrahedron T has a constant deformation gradient F_T and the volume V_T. It gives a sixth of
its volume to each of its edges, and the deformation gradient of an edge is the mean over the ring of
tetrahedra around it:

    V_e = Σ_T V_T / 6,    F_e = Σ_T (V_T / 6) F_T / V_e

The energy is Σ_e V_e Ψ(F_e): a point of quadrature belongs to an edge, its nodes are those of the
ring, and no unknown is added. The mean is softer than its parts, which makes up for most of the
stiffness by which linear tetrahedra are wrong. Rings never cross from one material to another.

Source: Cazes and Meschke 2013.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import CellBlock, SomeCells, cells_of
from softrobot_twin.geometry.shape_functions import (
    EDGES,
    LINEAR_TETRAHEDRON,
    IntegrationPoints,
    integration_points,
)
from softrobot_twin.geometry.tet_mesh import TetMesh


class EdgeRings(NamedTuple):
    """Edges with the tetrahedra around them, as `Elements` takes cells.

    Edges are sorted by the number of nodes in their rings.

    Attributes:
        node_positions: Node positions at rest [m], shape (node_count, 3).
        cells: Nodes of each ring, its last one repeated, shape (edge_count, most nodes of a ring).
        node_counts: Number of nodes of each ring, shape (edge_count,).
        points: Gradients, zero where a node is repeated, and volumes of the edges.
        places: The first tetrahedron of each ring, times six, and which of its edges this is,
            shape (edge_count,).
        tets: The tetrahedra, which the mean over a ring cannot tell to be inside out.
    """

    node_positions: np.ndarray
    cells: np.ndarray
    node_counts: np.ndarray
    points: IntegrationPoints
    places: np.ndarray
    tets: TetMesh | SomeCells

    shape_functions = LINEAR_TETRAHEDRON


class SmoothedMesh(TetMesh):
    """Tetrahedra that fill a body; their strain is smoothed over edges."""

    def strained_blocks(self, cells: np.ndarray | None = None) -> tuple[CellBlock, ...]:
        """See `CellMesh.strained_blocks`: the edges of the tetrahedra."""
        rings = edge_rings(cells_of(self, cells))
        places = rings.places
        if cells is not None:
            tets, edges = np.divmod(places, len(EDGES))
            places = len(EDGES) * cells[tets] + edges
        return (CellBlock(rings, places, rings.points.weights[:, 0], self.load_shares),)


def smooth(mesh: TetMesh) -> SmoothedMesh:
    """The same tetrahedra, with smoothed strain.

    Args:
        mesh: The tetrahedra.
    """
    return SmoothedMesh(mesh.node_positions, mesh.cells)


def edge_rings(mesh: TetMesh | SomeCells) -> EdgeRings:
    """The rings of tetrahedra around edges.

    Args:
        mesh: The tetrahedra of one material.
    """
    tets, node_count = mesh.cells, len(mesh.node_positions)
    points = integration_points(mesh.node_positions, tets, LINEAR_TETRAHEDRON)
    ends = np.sort(tets[:, EDGES], axis=2)
    _, places, edges = np.unique(
        ends[..., 0] * node_count + ends[..., 1], return_index=True, return_inverse=True
    )
    edges = edges.reshape(-1, len(EDGES))
    shares = np.repeat(points.weights / len(EDGES), len(EDGES), axis=1)
    volumes = np.bincount(edges.ravel(), shares.ravel())
    # Every node of a tetrahedron is in the rings of its six edges.
    keys, place = np.unique(edges[:, :, None] * node_count + tets[:, None], return_inverse=True)
    edge, node = np.divmod(keys, node_count)
    weighted = (shares / volumes[edges])[:, :, None, None] * points.gradients
    sums = [np.bincount(place.ravel(), weighted[..., i].ravel()) for i in range(3)]
    counts = np.bincount(edge)
    order = np.argsort(counts, kind="stable")
    first = np.concatenate([[0], np.cumsum(counts)])
    column = np.arange(len(keys)) - first[edge]
    # The last node of each ring is repeated up to the longest one.
    cells = np.repeat(node[first[1:] - 1][:, None], counts.max(), axis=1)
    gradients = np.zeros((*cells.shape, 3))
    cells[edge, column] = node
    gradients[edge, column] = np.stack(sums, axis=1)
    ringed = IntegrationPoints(gradients[order, None], volumes[order, None])
    return EdgeRings(mesh.node_positions, cells[order], counts[order], ringed, places[order], mesh)
