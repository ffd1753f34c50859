"""Quadratic tetrahedra: an additional node at the middle of every edge, so that strain is linear.

Edges are straight at rest. Nodes 0 to 3 of a tetrahedron are its corners, nodes 4 to 9 are on its
edges in the order of `EDGES`, which is VTK's. Shape functions: `QuadraticTetrahedron`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.cell_mesh import InnerNodesMesh
from softrobot_twin.geometry.shape_functions import EDGES, QUADRATIC_TETRAHEDRON, quadratic_values
from softrobot_twin.geometry.surface import boundary_faces
from softrobot_twin.geometry.tet_mesh import TetMesh

# A node this far from the middle of its edge, relative to the edge, makes it a curved edge.
_CURVED = 1e-3
# Gmsh numbers the last two edges the other way round than VTK and Abaqus.
_GMSH_ORDER = [0, 1, 2, 3, 5, 4]
# ∫N dV / V: the shares of the corners in a uniform load are negative.
_CORNER_SHARE, _EDGE_SHARE = -1.0 / 20.0, 1.0 / 5.0


@dataclass(frozen=True, eq=False)
class QuadraticMesh(InnerNodesMesh):
    """Ten-node tetrahedra that fill a body. All arrays are read-only.

    Attributes:
        corner_mesh: The same tetrahedra by their corners.
        node_positions: Node positions [m], the corner mesh's first, shape (node_count, 3).
        cells: Node indices, shape (cell_count, 10).
        mid_edge_ends: The two corners next to each mid-edge node, shape (node_count -
            corner_mesh.node_count, 2).
    """

    corner_mesh: TetMesh
    node_positions: np.ndarray
    cells: np.ndarray
    mid_edge_ends: np.ndarray

    shape_functions = QUADRATIC_TETRAHEDRON

    @property
    def load_shares(self) -> np.ndarray:
        """Share of a uniform load on a tetrahedron that each node carries, shape (10,)."""
        return np.array([_CORNER_SHARE] * 4 + [_EDGE_SHARE] * 6)

    @cached_property
    def surface_triangles(self) -> np.ndarray:
        """The surface, each six-node face as four triangles, shape (triangle_count, 3)."""
        faces = boundary_faces(self.corner_mesh.cells)
        behind = self.cells[faces.tets]
        corner = np.argmax(behind[:, None, :4] == faces.triangles[:, :, None], axis=2)
        between = np.empty((4, 4), dtype=np.int64)
        between[EDGES[:, 0], EDGES[:, 1]] = between[EDGES[:, 1], EDGES[:, 0]] = np.arange(4, 10)
        after = np.roll(corner, -1, axis=1)
        a, b, c = faces.triangles.T
        ab, bc, ca = np.take_along_axis(behind, between[corner, after], axis=1).T
        return np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3)

    def carriers(self, tets: np.ndarray, barycentric_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that carry points inside tetrahedra, and their weights.

        Args:
            tets: Tetrahedron of each point, shape (point_count,).
            barycentric_weights: Where in it, shape (point_count, 4).

        Returns:
            Nodes and weights, each of shape (point_count, 10).
        """
        return self.cells[tets], quadratic_values(barycentric_weights)


def add_mid_edge_nodes(mesh: TetMesh) -> QuadraticMesh:
    """Turn linear tetrahedra into quadratic ones of the same shape.

    Args:
        mesh: The linear tetrahedra.

    Returns:
        The quadratic mesh; the linear one's nodes keep their numbers.
    """
    ends = np.sort(mesh.cells[:, EDGES], axis=2).reshape(-1, 2)
    keys, edge = np.unique(ends[:, 0] * mesh.node_count + ends[:, 1], return_inverse=True)
    mid_edge_ends = np.stack(np.divmod(keys, mesh.node_count), axis=1)
    middles = mesh.node_positions[mid_edge_ends].mean(axis=1)
    return QuadraticMesh(
        mesh,
        np.vstack([mesh.node_positions, middles]),
        np.hstack([mesh.cells, mesh.node_count + edge.reshape(-1, 6)]),
        mid_edge_ends,
    )


class PlacedMidEdgeNodes(NamedTuple):
    """Mid-edge nodes, each once.

    Attributes:
        nodes: Their numbers in the file, shape (mid_count,).
        ends: The two corners at the ends of its edge, shape (mid_count, 2).
        curved: Indices into `nodes` of those that are not at the middle of their edge.
        furthest: Number in the file of the one furthest from the middle.
        offset: Its distance from the middle [m].
    """

    nodes: np.ndarray
    ends: np.ndarray
    curved: np.ndarray
    furthest: int
    offset: float


def place_mid_edge_nodes(
    positions: np.ndarray, tets: np.ndarray, mid_nodes: np.ndarray
) -> PlacedMidEdgeNodes:
    """Finds the edge of each mid-edge node.

    Args:
        positions: Node positions [m], shape (node_count, 3).
        tets: Corners of the tetrahedra, shape (tet_count, 4).
        mid_nodes: Mid-edge nodes, −1 where there are none, shape (tet_count, 6). Two orders are in
            use; that with the nodes nearer to the middles is taken.

    Returns:
        The mid-edge nodes.
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
