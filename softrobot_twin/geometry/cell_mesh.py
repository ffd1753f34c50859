"""The protocol of a mesh, as elements, masses and carried points use it."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from softrobot_twin.geometry.shape_functions import ShapeFunctions


class CellMesh(Protocol):
    """Cells of one kind that fill a body.

    Elements need only the first three attributes; the others serve points, loads and pictures.

    Attributes:
        node_positions: Node positions at rest [m], shape (node_count, 3).
        cells: Node indices, shape (cell_count, nodes of a cell).
        shape_functions: The cells' shape functions.
        node_count: Number of nodes.
        cell_count: Number of cells.
        volumes: Volumes of the cells [m³], shape (cell_count,).
        load_shares: Share of a uniform load on a cell that each of its nodes carries.
        surface_triangles: Node indices of the surface, shape (triangle_count, 3).
    """

    node_positions: np.ndarray
    cells: np.ndarray
    shape_functions: ShapeFunctions
    node_count: int
    cell_count: int
    volumes: np.ndarray
    load_shares: np.ndarray
    surface_triangles: np.ndarray

    def carriers(
        self, cells: np.ndarray, barycentric_weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that carry points inside cells, and their weights.

        Args:
            cells: Cell of each point, shape (point_count,).
            barycentric_weights: Barycentric coordinates in it, shape (point_count, 4).

        Returns:
            Nodes and weights, each of shape (point_count, nodes of a cell).
        """
        ...
