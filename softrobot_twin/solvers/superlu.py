"""SuperLU through scipy: available everywhere, and the reference for faster factorizations."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.solvers.factorization import Condensed, NodeRows, block_slots

OPTIONS = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


class SuperLU:
    """LU of the symmetric matrix in symmetric mode, without pivoting.

    Attributes:
        negative_count: Negative eigenvalues of the matrix that was factorized last; None where rows
            were exchanged, so that the pivots do not tell.
    """

    name = "SuperLU"
    is_traceable = True

    def __init__(self, rows: np.ndarray, columns: np.ndarray, node_count: int):
        """Lay out the lower blocks of a node graph.

        Args:
            rows: Free nodes of coupled pairs, any order, duplicates allowed.
            columns: Their partners; the diagonal is implied.
            node_count: Number of free nodes.
        """
        self.elimination_rank = np.arange(node_count)
        self._node_count = node_count
        rows, columns = np.asarray(rows), np.asarray(columns)
        low, high = np.maximum(rows, columns), np.minimum(rows, columns)
        diagonal = self.elimination_rank
        keys = np.unique(
            np.concatenate([high * node_count + low, diagonal * (node_count + 1)]).astype(np.int64)
        )
        self._keys = keys
        self.storage = np.zeros(9 * len(keys))
        self._gather = self._full_pattern(keys // node_count, keys % node_count)
        self._lu = None
        self.negative_count: int | None = None
        self._solution = None

    def _full_pattern(self, columns, rows) -> np.ndarray:
        """Index structure of the full matrix, and where each of its entries is stored."""
        n = 3 * self._node_count
        local_column, local_row = np.divmod(np.arange(9), 3)
        i = (3 * rows[:, None] + local_row).ravel()
        j = (3 * columns[:, None] + local_column).ravel()
        place = np.arange(len(i))
        mirrored = np.repeat(rows != columns, 9)
        full = sp.coo_array(
            (
                np.concatenate([place, place[mirrored]]) + 1,
                (np.concatenate([i, j[mirrored]]), np.concatenate([j, i[mirrored]])),
            ),
            shape=(n, n),
        ).tocsc()
        full.sort_indices()
        self._indices = full.indices.astype(np.int32)
        self._indptr = full.indptr.astype(np.int32)
        return full.data - 1

    def slots(self, rows, columns) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.slots`."""
        rank = self.elimination_rank
        return block_slots(self._keys, rank[rows], rank[columns], self._node_count)

    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.blocks`."""
        return self._keys % self._node_count, self._keys // self._node_count

    def prepare_rows(self, node_index: np.ndarray, row_count: int) -> None:
        """Nothing to prepare: every solve is a full one.

        Args:
            node_index: Node of each entry of the rows; not read.
            row_count: Number of rows; not read.
        """

    def clear(self) -> None:
        """See `Factorization.clear`."""
        clear(self.storage)

    def matrix(self) -> sp.csc_array:
        """The assembled matrix A, full and symmetric, shape (3 node_count, 3 node_count)."""
        n = 3 * self._node_count
        return sp.csc_array((self.storage[self._gather], self._indices, self._indptr), shape=(n, n))

    def factor(self) -> bool:
        """See `Factorization.factor`; the signs of the pivots tell definiteness."""
        self.negative_count = None
        if self._node_count == 0:
            return True
        if not np.all(np.isfinite(self.storage)):
            return False
        try:
            self._lu = splu(sp.csc_matrix(self.matrix()), **OPTIONS)
        except RuntimeError:  # exactly singular
            return False
        # With no pivoting A = P L D Lᵀ Pᵀ, and the pivots are the diagonal of U.
        rows_kept = np.array_equal(self._lu.perm_r, self._lu.perm_c)
        pivots = self._lu.U.diagonal()
        self.negative_count = int(np.count_nonzero(pivots < 0.0)) if rows_kept else None
        return rows_kept and bool(np.all(pivots > 0.0))

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `Factorization.condense`; full solves, because SuperLU does not give L alone."""
        Ht = H.transposed(self._node_count)
        right = np.column_stack([Ht, b.reshape(-1)])
        self._solution = self._lu.solve(right) if len(right) else right
        W = Ht.T @ self._solution[:, :-1]
        return Condensed(0.5 * (W + W.T), Ht.T @ self._solution[:, -1])

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> None:
        """See `Factorization.condense_low_rank`; never, because SuperLU does not give L alone."""
        return None

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """See `Factorization.expand`; the solves are kept from `condense`."""
        dx = self._solution[:, -1] + self._solution[:, :-1] @ multipliers
        return dx.reshape(-1, 3)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """See `Factorization.solve`."""
        return self._lu.solve(np.ascontiguousarray(b).reshape(-1)).reshape(-1, 3)
