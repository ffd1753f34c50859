"""Cholesky factorization of a small dense matrix, for scenes with few unknowns.

The coordinates of a reduced body are all coupled: their matrix has no zeros that a sparse
factorization could use.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.linalg.blas import dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from softrobot_twin.compilation import KERNEL, njit
from softrobot_twin.solvers.factorization import Condensed, LowRankCondensed, NodeRows
from softrobot_twin.traced_stage import clear


@njit(**KERNEL)
def write_rows(row_index, node_index, blocks, out):
    """Write H, whose entries are those of `NodeRows`, as a dense array.

    Args:
        row_index: Row of each entry, shape (entry_count,).
        node_index: Unknown of each entry, same shape.
        blocks: Derivative by that unknown, shape (entry_count, 3).
        out: Takes H, shape (row_count, 3 node_count).
    """
    out[:] = 0.0
    for e in range(len(row_index)):
        r, n = row_index[e], 3 * node_index[e]
        for i in range(3):
            out[r, n + i] += blocks[e, i]


class DenseCholesky:
    """See `Factorization`; the lower triangle is stored column by column as a square matrix."""

    name = "dense Cholesky"
    is_traceable = True

    def __init__(self, rows: np.ndarray, columns: np.ndarray, node_count: int):
        """Allocate the matrix.

        Args:
            rows: Not used: all unknowns are taken as coupled.
            columns: Not used.
            node_count: Number of unknowns, three numbers each.
        """
        self.elimination_rank = np.arange(node_count)
        self._node_count, self._size = node_count, 3 * node_count
        self.storage = np.zeros(self._size**2)
        # Column-major: a view of the storage by (row, column).
        self._matrix = self.storage.reshape(self._size, self._size).T
        self._factor = np.zeros((self._size, self._size), order="F")
        self._solved = np.empty((self._size, 0), order="F")

    def slots(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.slots`."""
        rows, columns = np.asarray(rows, np.int64), np.asarray(columns, np.int64)
        if np.any(rows < columns):
            raise ValueError("a block lies above the diagonal of the elimination order")
        if np.any(columns < 0) or np.any(rows >= self._node_count):
            raise ValueError("a block lies outside the pattern")
        return 3 * (columns * self._size + rows), np.full(rows.shape, self._size, np.int64)

    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.blocks`."""
        columns, rows = np.triu_indices(self._node_count)
        return rows, columns

    def prepare_rows(self, node_index: np.ndarray, row_count: int) -> None:
        """Nothing to prepare: memory for rows is small."""

    def clear(self) -> None:
        """See `Factorization.clear`."""
        clear(self.storage)

    def matrix(self) -> sp.csc_array:
        """The assembled matrix A, full and symmetric, shape (3 node_count, 3 node_count)."""
        lower = np.tril(self._matrix)
        return sp.csc_array(lower + np.tril(lower, -1).T)

    def factor(self) -> bool:
        """See `Factorization.factor`."""
        if self._size == 0:
            return True
        self._factor[:] = self._matrix
        factor, info = dpotrf(self._factor, lower=1, clean=0, overwrite_a=1)
        self._factor = factor
        # NaN passes dpotrf, but not its own comparison.
        return info == 0 and bool(np.isfinite(factor[-1, -1]))

    def _solve_lower(self, H: NodeRows, b: np.ndarray) -> np.ndarray:
        """L⁻¹ [Hᵀ b], shape (3 node_count, row_count + 1)."""
        columns = np.empty((H.row_count + 1, self._size))
        write_rows(H.row_index, H.node_index, H.blocks, columns[:-1])
        columns[-1] = b.ravel()
        self._solved = dtrsm(1.0, self._factor, columns.T, lower=1, overwrite_b=1)
        return self._solved

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `Factorization.condense`."""
        Y = self._solve_lower(H, b)
        W = Y.T @ Y
        return Condensed(np.ascontiguousarray(W[:-1, :-1]), W[:-1, -1].copy())

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> LowRankCondensed | None:
        """See `Factorization.condense_low_rank`."""
        if 2 * self._size > H.row_count:
            return None
        Y = self._solve_lower(H, b)
        Yt = np.ascontiguousarray(Y[:, :-1].T)
        return LowRankCondensed(Yt, Yt @ Y[:, -1])

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """See `Factorization.expand`."""
        Y = self._solved
        right = Y[:, -1] + Y[:, :-1] @ multipliers
        return dtrsv(self._factor, right, lower=1, trans=1, overwrite_x=1).reshape(-1, 3)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """See `Factorization.solve`."""
        right = np.array(b, float).ravel()
        right = dtrsv(self._factor, right, lower=1, overwrite_x=1)
        return dtrsv(self._factor, right, lower=1, trans=1, overwrite_x=1).reshape(-1, 3)
