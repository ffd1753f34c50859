"""Places of an element's stiffness blocks in the system matrix.

A stencil is the small set of nodes that one element (a tetrahedron, a segment of a cable) couples.
Its nodes are sorted by their place in the elimination order once, at set-up, so that each pair
belongs to the lower triangle and a kernel adds its blocks without a test. Indices after all
unknowns, those of carried points (`kinematics`), count as absent: they have no block of their own.

Arguments of the kernels here:
    matrix: In `add_block` three rows of three numbers.
    storage: The factorization's storage [N/m], shape (size,); added to.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import rows, scaled_matrix
from softrobot_twin.geometry.vector3 import dot
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit

Slots = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


class BoundStencils(NamedTuple):
    """Stencils and the places of their blocks.

    The pairs of a stencil of width w are numbered column by column over the lower triangle:
    (0,0) (1,0) … (w-1,0) (1,1) (2,1) …, as (row, column).

    Attributes:
        order: Columns of the unsorted stencil in elimination order,
            shape (stencil_count, width).
        offsets: Place of entry (0,0) of each pair's block in the factor's storage, -1 where a
            node is fixed, shape (stencil_count, width (width + 1) / 2).
        strides: Distance between two columns of that block, same shape.
    """

    order: np.ndarray
    offsets: np.ndarray
    strides: np.ndarray

    def sorted(self, columns: np.ndarray) -> np.ndarray:
        """Columns of unsorted stencils in elimination order.

        Args:
            columns: One for each node of a stencil, shape (stencil_count, width).
        """
        return np.take_along_axis(columns, self.order, axis=1)


def lower_pairs(width: int) -> tuple[np.ndarray, np.ndarray]:
    """Local (row, column) of the lower triangle's pairs, column by column.

    Args:
        width: Number of nodes of the stencil.
    """
    columns, rows = np.triu_indices(width)
    return rows, columns


def of_frames(unknowns: np.ndarray) -> np.ndarray:
    """Both unknowns of frames, -1 where one does not move, shape (element_count, 2 frame_count).

    Args:
        unknowns: Translation of each frame, or -1, shape (element_count, frame_count).
    """
    both = np.repeat(unknowns, 2, axis=1)
    return np.where(both >= 0, both + np.arange(both.shape[1]) % 2, -1)


def stacked(tables: Sequence[np.ndarray], none: float = -1) -> np.ndarray:
    """Tables of one row or more below each other, filled up to a common width of at least one.

    Args:
        tables: Such as stencils, each of shape (count, width) with its own width.
        none: What narrower ones are filled up with.
    """
    width = max([1, *(own.shape[1] for own in tables)])
    return np.concatenate([np.pad(own, ((0, 0), (0, width - own.shape[1])), constant_values=none)
                           for own in tables])  # fmt: skip


def bind_stencils(stencils: np.ndarray, elimination_rank: np.ndarray, slots: Slots) -> BoundStencils:
    """Sort stencils by elimination rank and find the places of their blocks.

    Args:
        stencils: Free-node indices, -1 for a fixed or absent node, carried points ignored,
            shape (stencil_count, width).
        elimination_rank: Place of each free node in the elimination order,
            shape (free_node_count,).
        slots: The factorization's `slots`.

    Returns:
        The sorted order and the places.
    """
    stencils = np.asarray(stencils, dtype=np.int64)
    stencils = np.where(stencils < len(elimination_rank), stencils, -1)
    width = stencils.shape[1]
    rank = np.where(stencils >= 0, np.append(elimination_rank, -1)[stencils], -1)
    order = np.argsort(rank, axis=1, kind="stable")
    sorted_nodes = np.take_along_axis(stencils, order, axis=1)
    lines, columns = lower_pairs(width)
    row_nodes, column_nodes = sorted_nodes[:, lines], sorted_nodes[:, columns]
    present = (row_nodes >= 0) & (column_nodes >= 0)
    offsets = np.full(present.shape, -1, dtype=np.int64)
    strides = np.zeros(present.shape, dtype=np.int64)
    offsets[present], strides[present] = slots(row_nodes[present], column_nodes[present])
    return BoundStencils(order, offsets, strides)


@njit(**INLINED)
def add_block(matrix, offset, stride, storage):
    """Add the block of one pair of nodes to the storage, unless one of them is fixed.

    Args:
        matrix: The block, a matrix of `matrix3`.
        offset: Its place, -1 for none; see `BoundStencils`.
        stride: Distance between two of its columns.
        storage: The factorization's storage [N/m]; added to.
    """
    if offset >= 0 and stride == 3:
        # Contiguous, and so added in vectors.
        for entry in range(9):
            storage[offset + entry] += matrix[entry % 3][entry // 3]
    elif offset >= 0:
        for j in range(3):
            for i in range(3):
                storage[offset + j * stride + i] += matrix[i][j]


@njit(**INLINED)
def add_lever_turning(force, lever, first, out):
    """Add f·ρ 1 - (f ρᵀ + ρ fᵀ)/2, how a force at a lever turns with it, to a block of a matrix.

    Args:
        force: f [N].
        lever: ρ [m].
        first: First row and column of the block.
        out: The matrix, shape (n, n).
    """
    along = dot(force, lever)
    for i in range(3):
        out[first + i, first + i] += along
        for j in range(3):
            out[first + i, first + j] -= 0.5 * (force[i] * lever[j] + lever[i] * force[j])


@njit(**INLINED)
def add_stencil_matrix(order, offsets, strides, matrix, storage):
    """Add the symmetric matrix of one stencil to the storage, wherever both nodes are free.

    Args:
        order: Columns of the stencil in elimination order, shape (width,).
        offsets: Place of each pair's block, -1 for none; see `BoundStencils`.
        strides: Distance between two columns of that block, same shape.
        matrix: By the unsorted stencil, shape (3 width, 3 width).
        storage: The factorization's storage [N/m]; added to.
    """
    pair = 0
    for column in range(len(order)):
        for line in range(column, len(order)):
            a, b = 3 * order[line], 3 * order[column]
            block = rows(matrix[a : a + 3, b : b + 3])
            add_block(block, offsets[pair], strides[pair], storage)
            pair += 1


@njit(**KERNEL)
def add_weighted_matrices(matrices, weights, offsets, strides, storage):
    """Add c_a c_b M to the storage for all pairs of free nodes a, b of every stencil.

    Args:
        matrices: M of each stencil, symmetric [N/m], shape (stencil_count, 3, 3).
        weights: c of its nodes in elimination order, shape (stencil_count, width).
        offsets: Place of each pair's block, -1 for none; see `BoundStencils`.
        strides: Distance between two columns of that block, same shape.
        storage: The factorization's storage [N/m]; added to.
    """
    for s in range(len(matrices)):
        matrix, pair = rows(matrices[s]), 0
        for b in range(weights.shape[1]):
            for a in range(b, weights.shape[1]):
                block = scaled_matrix(matrix, weights[s, a] * weights[s, b])
                add_block(block, offsets[s, pair], strides[s, pair], storage)
                pair += 1


def stencil_pairs(
    stencils: np.ndarray, free_node_count: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of free nodes that stencils couple, as (rows, columns) of a node graph.

    Args:
        stencils: Free-node indices, -1 for a fixed or absent node, shape (stencil_count, width).
        free_node_count: Indices from here on are carried points and left out; None without any.
    """
    if free_node_count is not None:
        stencils = np.where(stencils < free_node_count, stencils, -1)
    width = stencils.shape[1]
    rows = np.repeat(stencils, width, axis=1).ravel()
    columns = np.tile(stencils, (1, width)).ravel()
    present = (rows >= 0) & (columns >= 0)
    return rows[present], columns[present]
