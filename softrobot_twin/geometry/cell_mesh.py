"""The protocol of a mesh, as elements, masses and carried points use it."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple, Protocol

import numpy as np

from softrobot_twin.geometry.shape_functions import (
    IntegrationPoints,
    ShapeFunctions,
    integration_points,
)


class CellMesh(Protocol):
    """Cells that fill a body.

    Elements need only the first three attributes, and have `points` as a fourth one if integration
    points do not follow from them, and `node_counts` where cells have different numbers of nodes
    (`smoothed_mesh.py`); the others serve points, loads and pictures. Meshes that scenes can have inherit from this class. Their cells are
    tetrahedra with straight edges, with nodes at the corners and possibly between them, or
    hexahedra and tetrahedra side by side (`hexahedral_mesh.py`). What follows below is that of
    meshes with cells of one kind; a mesh with several has other `blocks`, and rows of `cells` of
    fewer nodes repeat their last one.

    Attributes:
        node_positions: Node positions at rest [m], shape (node_count, 3).
        cells: Node indices, shape (cell_count, nodes of a cell).
        shape_functions: The cells' shape functions.
        corner_mesh: The same cells by their corners, a `TetMesh` or `HexahedralMesh`, whose nodes
            come first.
        mid_edge_ends: The corners that each further node lies between: the two ends of an edge for
            one at its middle, shape (node_count - corner count, 2). Such a node is held where all
            of these corners are.
        volumes: Volumes of the cells [m³], shape (cell_count,).
        load_shares: Share of a uniform load on a cell that each of its nodes carries.
        surface_triangles: Node indices of the surface, shape (triangle_count, 3).
    """

    node_positions: np.ndarray
    cells: np.ndarray
    shape_functions: ShapeFunctions
    corner_mesh: CellMesh
    mid_edge_ends: np.ndarray
    volumes: np.ndarray
    load_shares: np.ndarray
    surface_triangles: np.ndarray

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.node_positions)

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.cells)

    def blocks(self, cells: np.ndarray | None = None) -> tuple[CellBlock, ...]:
        """The cells, apart by their kind.

        Args:
            cells: Indices of some cells in rising order, shape (cell_count,); None for all.

        Returns:
            A block for each kind of which there are any.
        """
        chosen = slice(None) if cells is None else cells
        return (CellBlock(cells_of(self, cells), chosen, self.volumes[chosen], self.load_shares),)

    def strained_blocks(self, cells: np.ndarray | None = None) -> tuple[CellBlock, ...]:
        """What bears the strain of cells, for elements: the cells themselves, apart by their kind.

        Args:
            cells: Indices of some cells in rising order, shape (cell_count,); None for all.
        """
        return self.blocks(cells)

    @property
    def cell_counts(self) -> dict[str, int]:
        """Number of cells of each kind, by the plural of its name."""
        return {"tets": self.cell_count}

    @property
    def volume(self) -> float:
        """Volume of the body [m³]."""
        return float(self.volumes.sum())

    @property
    def bounding_box(self) -> np.ndarray:
        """Smallest and largest coordinates [m], shape (2, 3)."""
        return np.stack([self.node_positions.min(axis=0), self.node_positions.max(axis=0)])

    def renumbered(self, node_positions: np.ndarray, first_node: int) -> CellMesh:
        """The same cells among the nodes of several bodies.

        Args:
            node_positions: Positions of all nodes [m], shape (all_node_count, 3).
            first_node: Index of this mesh's first node among them.
        """
        ...

    def carriers(self, cells: np.ndarray, barycentric_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes that carry points inside cells, and their weights.

        Args:
            cells: Cell of each point, shape (point_count,).
            barycentric_weights: Barycentric coordinates in it, shape (point_count, 4).

        Returns:
            Nodes and weights, each of shape (point_count, nodes of a cell).
        """
        ...


class CornerMesh(CellMesh, Protocol):
    """A mesh all of whose nodes are corners."""

    @property
    def corner_mesh(self) -> CornerMesh:
        """Itself."""
        return self

    @property
    def mid_edge_ends(self) -> np.ndarray:
        """Empty, shape (0, 2)."""
        return np.empty((0, 2), dtype=np.int64)

    def carriers(self, cells: np.ndarray, barycentric_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `CellMesh.carriers`: the corners of the cells; of hexahedra with eight weights."""
        return self.cells[cells], barycentric_weights


class InnerNodesMesh(CellMesh, Protocol):
    """A dataclass of a mesh with nodes beside the corners of its cells. Arrays are read-only.

    Its fields are `corner_mesh`, `node_positions`, and arrays of indices of nodes.
    """

    def __post_init__(self) -> None:
        for field in fields(self)[1:]:
            getattr(self, field.name).setflags(write=False)

    @property
    def volumes(self) -> np.ndarray:
        """Volumes of the cells [m³], shape (cell_count,)."""
        return self.corner_mesh.volumes

    def renumbered(self, node_positions: np.ndarray, first_node: int) -> CellMesh:
        """See `CellMesh.renumbered`."""
        indices = {field.name: getattr(self, field.name) + first_node for field in fields(self)[2:]}
        return replace(
            self, corner_mesh=self.corner_mesh.renumbered(node_positions, first_node),
            node_positions=np.array(node_positions), **indices,
        )  # fmt: skip


class SomeCells(NamedTuple):
    """Some cells of a mesh, as far as elements need a mesh.

    Attributes:
        node_positions: Positions of all nodes of the mesh at rest [m], shape (node_count, 3).
        cells: Node indices, shape (cell_count, nodes of a cell).
        shape_functions: The cells' shape functions.
        points: Their own gradients and volumes; None for those of the shape functions.
    """

    node_positions: np.ndarray
    cells: np.ndarray
    shape_functions: ShapeFunctions
    points: IntegrationPoints | None = None


class CellBlock(NamedTuple):
    """Cells of one kind of a mesh, for elements and masses.

    Attributes:
        mesh: The cells, over all nodes of the mesh.
        places: A number of each cell of its own: its index among all cells of the mesh, see also
            `EdgeRings`; or a slice of all.
        volumes: Their volumes [m³], shape (block_cell_count,).
        load_shares: Share of a uniform load that each node of a cell carries, shape (nodes of a
            cell,) or, where cells differ, (block_cell_count, nodes of a cell).
        mass_shares: ∫N_a N_b dV / V of each cell, shape (block_cell_count, nodes, nodes); None
            where it is the same for all cells and follows from the shape functions.
    """

    mesh: CellMesh
    places: np.ndarray | slice
    volumes: np.ndarray
    load_shares: np.ndarray
    mass_shares: np.ndarray | None = None

    @property
    def numbers(self) -> np.ndarray:
        """The places as an array, shape (block_cell_count,)."""
        return np.arange(len(self.volumes)) if isinstance(self.places, slice) else self.places


def points_of(mesh: CellMesh, cells: np.ndarray | None = None) -> IntegrationPoints:
    """Gradients and volumes at the quadrature points of cells.

    Args:
        mesh: The cells, as far as elements need them.
        cells: Indices of some of them, perhaps several times, shape (cell_count,); None for all.

    Returns:
        The mesh's own `points`, or those of its shape functions if it has none.
    """
    own, some = getattr(mesh, "points", None), slice(None) if cells is None else cells
    if own is None:
        return integration_points(mesh.node_positions, mesh.cells[some], mesh.shape_functions)
    return own if cells is None else IntegrationPoints(*(values[some] for values in own))


def node_counts_of(mesh: CellMesh) -> np.ndarray:
    """Number of nodes of each cell, shape (cell_count,).

    Args:
        mesh: The cells, as far as elements need them.
    """
    own = getattr(mesh, "node_counts", None)
    return np.full(*mesh.cells.shape) if own is None else own


def cells_of(mesh: CellMesh, cells: np.ndarray | None) -> CellMesh | SomeCells:
    """Some cells of a mesh.

    Args:
        mesh: The mesh.
        cells: Their indices, shape (cell_count,); None for all.

    Returns:
        The cells, over all nodes of the mesh; the mesh itself for all.
    """
    every = cells is None
    return mesh if every else SomeCells(mesh.node_positions, mesh.cells[cells], mesh.shape_functions)
