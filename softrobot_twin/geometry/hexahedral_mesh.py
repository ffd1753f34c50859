"""Hexahedra with eight corners, alone or beside tetrahedra in the same body.

A quadrilateral of a hexahedron's surface may be covered by tetrahedra: two triangles along either of
its diagonals, or one with the other one free. No node is between them, but the faces are of two
kinds, bilinear and of two triangles. So that a uniform strain is in equilibrium across such faces,
hexahedra integrate there over the same two triangles: the mean of a gradient over a cell is

    V ḡ_a = ∮ N_a n dA

whatever the faces are (`_fit_to_tetrahedra`). Displacements are equal at the nodes, and between them to the second order.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.cell_mesh import CellBlock, CornerMesh, SomeCells
from softrobot_twin.geometry.quadrature import hexahedron_rule
from softrobot_twin.geometry.shape_functions import (
    HEXAHEDRON_CORNERS,
    LINEAR_TETRAHEDRON,
    MEAN_HEXAHEDRON,
    TRILINEAR_HEXAHEDRON,
    IntegrationPoints,
    integration_points,
)
from softrobot_twin.geometry.surface import boundary_faces, single_rows
from softrobot_twin.geometry.tet_mesh import tet_volumes

# Faces of a hexahedron, counter-clockwise seen from outside.
HEXAHEDRON_FACES = np.array(
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)
OPPOSITE_FACES = ((0, 1), (2, 4), (3, 5))
# Six tetrahedra around the diagonal from corner 0 to corner 6.
INTO_TETS = np.array([[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]])
# The two triangles of a quadrilateral along each diagonal.
DIAGONAL_HALVES = np.array([[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]])
# Diagonals whose lengths differ by less than this share count as equal.
_EQUAL = 1.0e-6
# Nodes of a tetrahedron in a row of eight: the last one repeatedly.
_PADDED_TET = [0, 1, 2, 3, 3, 3, 3, 3]


def corner_determinants(corners: np.ndarray) -> np.ndarray:
    """det ∂x/∂ξ of hexahedra in their corners and in their middle [m³].

    Args:
        corners: Positions of their corners [m], shape (cell_count, 8, 3).

    Returns:
        Shape (cell_count, 9); a cell of positive values is not inside out.
    """
    places = np.vstack([HEXAHEDRON_CORNERS, np.zeros(3)])
    jacobians = np.einsum("kai,qaj->kqij", corners, TRILINEAR_HEXAHEDRON.slopes(places))
    return np.linalg.det(jacobians)


def scaled_jacobians(corners: np.ndarray) -> np.ndarray:
    """Least determinant of the unit vectors along the three edges in a corner: 1 for a box.

    Args:
        corners: Positions of the corners of hexahedra [m], shape (cell_count, 8, 3).

    Returns:
        Shape (cell_count,).
    """
    slopes = TRILINEAR_HEXAHEDRON.slopes(HEXAHEDRON_CORNERS)
    jacobians = np.einsum("kai,qaj->kqij", corners, slopes)
    lengths = np.linalg.norm(jacobians, axis=2, keepdims=True)
    return np.linalg.det(jacobians / np.where(lengths > 0.0, lengths, 1.0)).min(axis=1)


@dataclass(frozen=True, eq=False)
class HexahedralMesh(CornerMesh):
    """Hexahedra, and tetrahedra beside them, by their corners. Arrays are read-only.

    Cells are numbered tetrahedra first.

    Attributes:
        node_positions: Node positions [m], shape (node_count, 3).
        tets: Node indices of the tetrahedra, of positive volume, shape (tet_count, 4).
        hexahedra: Node indices of the hexahedra, shape (hexahedron_count, 8), upright in all
            corners.

    Raises:
        MeshError: A hexahedron is inside out, or tetrahedra cover a face along both diagonals.
    """

    node_positions: np.ndarray
    tets: np.ndarray
    hexahedra: np.ndarray

    shape_functions = None

    def __post_init__(self) -> None:
        for name, width in (("tets", 4), ("hexahedra", 8)):
            cells = np.array(getattr(self, name), dtype=np.int64).reshape(-1, width)
            cells.setflags(write=False)
            object.__setattr__(self, name, cells)
        positions = np.array(self.node_positions, dtype=np.float64)
        positions.setflags(write=False)
        object.__setattr__(self, "node_positions", positions)
        _ = self._free_faces

    @cached_property
    def cells(self) -> np.ndarray:
        """Corners of each cell, of a tetrahedron the last one repeatedly, shape (cell_count, 8)."""
        return np.concatenate([self.tets[:, _PADDED_TET], self.hexahedra])

    @cached_property
    def as_tets(self) -> np.ndarray:
        """Tetrahedra that fill the same space, six for each hexahedron, shape (n, 4)."""
        return np.concatenate([self.tets, self.hexahedra[:, INTO_TETS].reshape(-1, 4)])

    def centres_at(self, positions: np.ndarray) -> np.ndarray:
        """Mean of the corners of each cell [m], shape (cell_count, 3).

        Args:
            positions: Of the nodes [m], shape (node_count, 3).
        """
        return np.concatenate([positions[self.tets].mean(axis=1), positions[self.hexahedra].mean(axis=1)])

    @cached_property
    def volumes(self) -> np.ndarray:
        """Volumes of the cells [m³], shape (cell_count,)."""
        own = self._points.weights[:, 0]
        return np.concatenate([tet_volumes(self.node_positions, self.tets), own])

    @cached_property
    def _free_faces(self) -> FreeFaces:
        return free_faces(self.node_positions, self.tets, self.hexahedra)

    @property
    def surface_triangles(self) -> np.ndarray:
        """Node indices of the surface, two triangles for a quadrilateral, (triangle_count, 3)."""
        return self._free_faces.triangles

    @property
    def cells_of_surface(self) -> np.ndarray:
        """Cell of each of the `surface_triangles`, shape (triangle_count,)."""
        return self._free_faces.cells

    @cached_property
    def _points(self) -> IntegrationPoints:
        return hexahedron_points(self)

    @cached_property
    def _shares(self) -> tuple[np.ndarray, np.ndarray]:
        """Shares of hexahedra in uniform loads and in mass; see `CellBlock`."""
        rule = hexahedron_rule(3)
        values = TRILINEAR_HEXAHEDRON.values(rule.points)
        slopes = TRILINEAR_HEXAHEDRON.slopes(rule.points)
        corners = self.node_positions[self.hexahedra]
        jacobians = np.einsum("kai,qaj->kqij", corners, slopes)
        shares = np.linalg.det(jacobians) * rule.weights
        shares /= shares.sum(axis=1, keepdims=True)
        return shares @ values, np.einsum("kq,qa,qb->kab", shares, values, values)

    def blocks(self, cells: np.ndarray | None = None) -> tuple[CellBlock, ...]:
        """See `CellMesh.blocks`: tetrahedra, then hexahedra."""
        tet_count = len(self.tets)
        chosen = np.arange(self.cell_count) if cells is None else np.asarray(cells)
        tets, own = chosen[chosen < tet_count], chosen[chosen >= tet_count] - tet_count
        blocks = []
        if len(tets):
            some = SomeCells(self.node_positions, self.tets[tets], LINEAR_TETRAHEDRON)
            shares = np.full(4, 0.25)
            blocks.append(CellBlock(some, tets, self.volumes[tets], shares))
        if len(own):
            points = IntegrationPoints(*(array[own] for array in self._points))
            some = SomeCells(self.node_positions, self.hexahedra[own], MEAN_HEXAHEDRON, points)
            loads, masses = self._shares
            blocks.append(CellBlock(some, own + tet_count, self.volumes[own + tet_count],
                                    loads[own], masses[own]))  # fmt: skip
        return tuple(blocks)

    @property
    def cell_counts(self) -> dict[str, int]:
        """See `CellMesh.cell_counts`."""
        counts = {"hexahedra": len(self.hexahedra), "tets": len(self.tets)}
        return {name: count for name, count in counts.items() if count}

    def renumbered(self, node_positions: np.ndarray, first_node: int) -> HexahedralMesh:
        """See `CellMesh.renumbered`."""
        return HexahedralMesh(node_positions, self.tets + first_node, self.hexahedra + first_node)


@dataclass(frozen=True)
class FreeFaces:
    """The surface of a mesh with hexahedra, and the faces where they meet tetrahedra.

    Attributes:
        triangles: Node indices, outward normals, shape (triangle_count, 3).
        cells: Cell of each, tetrahedra first, shape (triangle_count,).
        shared: Hexahedron and face of each quadrilateral that meets a tetrahedron, shape (n, 2).
        diagonals: Which of its two diagonals the triangles there have: 0 from its first node,
            1 from its second one, shape (n,).
    """

    triangles: np.ndarray
    cells: np.ndarray
    shared: np.ndarray
    diagonals: np.ndarray


def free_faces(positions: np.ndarray, tets: np.ndarray, hexahedra: np.ndarray) -> FreeFaces:
    """Finds the surface, and where hexahedra meet tetrahedra.

    Args:
        positions: Node positions [m], shape (node_count, 3).
        tets: Tetrahedra, shape (tet_count, 4).
        hexahedra: Hexahedra, shape (hexahedron_count, 8).

    Returns:
        The faces. A free quadrilateral is cut along its shorter diagonal, or along that from its
        node of the lowest number where they are equal.

    Raises:
        MeshError: Tetrahedra cover a quadrilateral along both diagonals.
    """
    faces = hexahedra[:, HEXAHEDRON_FACES].reshape(-1, 4)
    owners = single_rows(faces)  # 6 times the cell plus the number of its face
    quads = faces[owners]
    triangles, of_triangles = boundary_faces(tets)
    halves = quads[:, DIAGONAL_HALVES]  # quad, diagonal, half, corner
    taken, covers = _matching(halves.reshape(-1, 3), triangles)
    taken = taken.reshape(len(quads), 2, 2)
    both = np.flatnonzero(taken.any(axis=2).all(axis=1))
    if len(both):
        raise MeshError(
            None, f"tetrahedra meet the face {sorted(quads[both[0]].tolist())} of hexahedron "
            f"{owners[both[0]] // 6} along both of its diagonals, which is not simulated",
        )  # fmt: skip
    is_shared = taken.any(axis=(1, 2))
    lengths = np.linalg.norm(positions[quads[:, :2]] - positions[quads[:, 2:]], axis=2)
    equal = np.abs(lengths[:, 0] - lengths[:, 1]) <= _EQUAL * lengths.max(axis=1, initial=0.0)
    chosen = np.where(equal, quads.argmin(axis=1) % 2, lengths.argmin(axis=1))
    chosen = np.where(is_shared, taken.any(axis=2).argmax(axis=1), chosen)
    every = np.arange(len(quads))
    kept = halves[every, chosen][~taken[every, chosen]]
    cells = np.repeat(owners // 6, 2).reshape(-1, 2)[~taken[every, chosen]]
    shared = np.stack(np.divmod(owners[is_shared], 6), axis=1)
    return FreeFaces(
        np.concatenate([triangles[~covers], kept]),
        np.concatenate([of_triangles[~covers], len(tets) + cells]), shared, chosen[is_shared],
    )  # fmt: skip


def _matching(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which triangles of each set have the same nodes as one of the other set."""
    rows = np.sort(np.concatenate([first, second]), axis=1)
    _, group = np.unique(rows, axis=0, return_inverse=True)
    group = group.ravel()
    mine, theirs = group[: len(first)], group[len(first) :]
    return np.isin(mine, theirs), np.isin(theirs, mine)


def hexahedron_points(mesh: HexahedralMesh) -> IntegrationPoints:
    """Mean gradients and volumes of a mesh's hexahedra.

    Args:
        mesh: The mesh.

    Returns:
        One point of each; see `MeanHexahedron`.
    """
    corners = mesh.node_positions[mesh.hexahedra]
    gradients, weights = integration_points(mesh.node_positions, mesh.hexahedra, TRILINEAR_HEXAHEDRON)
    integrals = np.einsum("kq,kqai->kai", weights, gradients)
    volumes = weights.sum(axis=1)
    shared, diagonals = mesh._free_faces.shared, mesh._free_faces.diagonals
    if len(shared):
        volumes = _fit_to_tetrahedra(corners, integrals, shared, diagonals)
    means = integrals / volumes[:, None, None]
    return IntegrationPoints(np.ascontiguousarray(means[:, None]), volumes[:, None])


def _fit_to_tetrahedra(
    corners: np.ndarray, integrals: np.ndarray, shared: np.ndarray, diagonals: np.ndarray
) -> np.ndarray:
    """Changes V ḡ_a so that a cell's surface has two triangles where it meets tetrahedra; gives V."""
    rows, faces = shared.T
    local = HEXAHEDRON_FACES[faces]
    placed = np.take_along_axis(corners[rows], local[:, :, None], axis=1)
    change = _of_triangles(placed, diagonals) - _of_bilinear(placed)
    np.add.at(integrals, (rows[:, None], local), change)
    # The divergence theorem for x itself: Σ x_a · ∮ N_a n dA = 3 V.
    return np.einsum("kai,kai->k", corners, integrals) / 3.0


def _of_triangles(placed: np.ndarray, diagonals: np.ndarray) -> np.ndarray:
    """∮ N_a n dA of the four nodes of faces made of two triangles [m²], shape (n, 4, 3)."""
    sums = np.zeros_like(placed)
    every = np.arange(len(placed))
    for half in range(2):
        nodes = DIAGONAL_HALVES[diagonals, half]
        a, b, c = (placed[every, nodes[:, k]] for k in range(3))
        np.add.at(sums, (every[:, None], nodes), np.cross(b - a, c - a)[:, None, :] / 6.0)
    return sums


def _of_bilinear(placed: np.ndarray) -> np.ndarray:
    """The same of bilinear faces."""
    sums = np.zeros_like(placed)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for point in corners / np.sqrt(3.0):
        factors = 1.0 + corners * point
        along = np.einsum("a,kai->ki", corners[:, 0] * factors[:, 1] / 4.0, placed)
        across = np.einsum("a,kai->ki", corners[:, 1] * factors[:, 0] / 4.0, placed)
        sums += factors.prod(axis=1)[:, None] / 4.0 * np.cross(along, across)[:, None, :]
    return sums
