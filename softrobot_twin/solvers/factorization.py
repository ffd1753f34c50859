"""A⁻¹ behind one small interface, so that a step does not depend on the factorization.

The unknowns are the free nodes, three directions each; the matrix is symmetric and made of 3×3
blocks. Assembly adds lower blocks (in elimination order) straight into `storage`.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

BLOCK, BLOCK_STRIDE = 9, 3  # doubles in a block that is stored contiguously, and in its columns


class NodeRows(NamedTuple):
    """Rows of H as node blocks; entries of the same row and node add up.

    Attributes:
        row_index: Row of each entry, shape (entry_count,).
        node_index: Free node of each entry, shape (entry_count,).
        blocks: Derivative by that node's position, shape (entry_count, 3).
        row_count: Number of rows k.
    """

    row_index: np.ndarray
    node_index: np.ndarray
    blocks: np.ndarray
    row_count: int

    def transposed(self, node_count: int) -> np.ndarray:
        """Hᵀ as a dense array, shape (3 node_count, row_count).

        Args:
            node_count: Number of nodes of the system.
        """
        dense = np.zeros((node_count, 3, self.row_count))
        np.add.at(dense, (self.node_index, slice(None), self.row_index), self.blocks)
        return dense.reshape(3 * node_count, self.row_count)


class Condensed(NamedTuple):
    """The system seen from the constraints (Coevoet 2017, eq. 11-14).

    Attributes:
        W: Compliance H A⁻¹ Hᵀ, shape (k, k).
        free: Violation brought by the free motion H A⁻¹ b, shape (k,).
    """

    W: np.ndarray
    free: np.ndarray


class LowRankCondensed(NamedTuple):
    """The system seen from constraints whose compliance is of low rank: W = Yᵀ Y, Y = L⁻¹ Hᵀ.

    Attributes:
        Yt: Yᵀ, one row for each row of H, shape (k, rank).
        free: Violation brought by the free motion H A⁻¹ b, shape (k,).
    """

    Yt: np.ndarray
    free: np.ndarray


class Factorization(Protocol):
    """A⁻¹ of the symmetric node-block matrix.

    Attributes:
        name: What diagnostics and benchmarks call it.
        elimination_rank: Place of each free node in the elimination order, shape (node_count,).
        storage: Where assembly adds the lower blocks, shape (size,).
    """

    name: str
    elimination_rank: np.ndarray
    storage: np.ndarray

    def slots(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where blocks live.

        Args:
            rows: Free nodes, not eliminated before their column's, any shape.
            columns: Free nodes, same shape.

        Returns:
            Offsets of each block's entry (0,0) in `storage`, and the stride between its columns;
            the three rows of a column are contiguous.

        Raises:
            ValueError: A block lies above the diagonal or outside the pattern.
        """

    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodes of all blocks in storage, as rows and columns, each of shape (block_count,)."""

    def prepare_rows(self, node_index: np.ndarray, row_count: int) -> None:
        """Reserve memory for rows H, so that `condense` need not.

        Args:
            node_index: Free nodes that rows may touch.
            row_count: Most rows that may come.
        """

    def clear(self) -> None:
        """Set the matrix to zero; by a kernel, where a member `is_traceable` says so."""

    def factor(self) -> bool:
        """Factorize what was assembled; False if it is not positive definite."""

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """W and the free violation of rows H for a right-hand side b, shape (node_count, 3).

        Args:
            H: The rows.
            b: Right-hand side [N], shape (node_count, 3).
        """

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> LowRankCondensed | None:
        """The same by a factor of W, without forming W.

        Args:
            H: The rows.
            b: Right-hand side [N], shape (node_count, 3).

        Returns:
            The factor; None where W's rank may be above half of its rows, or no factor is
            available: `condense` is to be called then.
        """

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """A⁻¹ (b + Hᵀ λ) for the H and b condensed last, shape (node_count, 3).

        The result may be overwritten by the next call.

        Args:
            multipliers: λ of the rows condensed last, shape (row_count,).
        """

    def solve(self, b: np.ndarray) -> np.ndarray:
        """A⁻¹ b, shape (node_count, 3).

        Args:
            b: Right-hand side [N], shape (node_count, 3).
        """


def block_slots(
    keys: np.ndarray, rows: np.ndarray, columns: np.ndarray, node_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Offsets and column strides of blocks that are stored contiguously, in the order of their keys.

    Args:
        keys: `node_count` times the column, plus the row, of each block stored, ascending.
        rows: Ranks of the rows of the blocks, shape (count,).
        columns: Ranks of their columns, same shape.
        node_count: Number of nodes.

    Raises:
        ValueError: A block lies above the diagonal or outside the pattern.
    """
    if np.any(rows < columns):
        raise ValueError("a block lies above the diagonal of the elimination order")
    wanted = columns * node_count + rows
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    if np.any(keys[place] != wanted):
        raise ValueError("a block lies outside the pattern")
    return BLOCK * place, np.full(place.shape, BLOCK_STRIDE, dtype=np.int64)


def laid_out_like(
    factorization: Factorization, made_by: type[Factorization]
) -> tuple[Factorization, np.ndarray]:
    """A factorization of the same pattern as another one.

    Args:
        factorization: The other one.
        made_by: Class of the new one.

    Returns:
        The new one, and the place of each entry of its storage in that of the other,
        shape (len(storage),).
    """
    rows, columns = factorization.blocks()
    made = made_by(rows, columns, len(factorization.elimination_rank))
    source, source_stride = factorization.slots(rows, columns)
    rank = made.elimination_rank
    is_swapped = rank[rows] < rank[columns]
    target, target_stride = made.slots(
        np.where(is_swapped, columns, rows), np.where(is_swapped, rows, columns)
    )
    j, i = np.divmod(np.arange(9), 3)
    places = np.empty(len(made.storage), np.int64)
    places[target[:, None] + target_stride[:, None] * j + i] = source[:, None] + np.where(
        is_swapped[:, None], source_stride[:, None] * i + j, source_stride[:, None] * j + i
    )
    return made, places
