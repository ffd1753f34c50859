"""A factorization of A + Σ k h hᵀ, with a few rows h that couple many unknowns.

With the rows h in S and C = diag(1/k), the Woodbury identity gives

    (A + Sᵀ C⁻¹ S)⁻¹ = A⁻¹ - A⁻¹ Sᵀ (C + S A⁻¹ Sᵀ)⁻¹ S A⁻¹,

so S is condensed below the rows H of each system, and eliminated from it.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.solvers.factorization import Condensed, Factorization, NodeRows


NO_ROWS = NodeRows(*np.empty((2, 0), np.int64), np.empty((0, 3)), 0)


class DenseStiffness:
    """See `Factorization`; A is that of another one, whose storage is used."""

    def __init__(self, inner: Factorization):
        """Take the factorization of A.

        Args:
            inner: It.
        """
        self._inner, self.name = inner, inner.name
        self.elimination_rank, self.storage = inner.elimination_rank, inner.storage
        self.slots, self.blocks = inner.slots, inner.blocks
        self.prepare_rows, self.clear, self.factor = inner.prepare_rows, inner.clear, inner.factor
        self._rows, self._compliance = NO_ROWS, np.empty(0)

    def set_rows(self, rows: NodeRows, stiffness: np.ndarray) -> None:
        """Set the rows h.

        Args:
            rows: They.
            stiffness: k of each, positive, shape (row_count,).
        """
        self._rows, self._compliance = rows, 1.0 / stiffness

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> None:
        """None: W is formed as a whole; see `Factorization.condense_low_rank`."""

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `Factorization.condense`."""
        own, count = self._rows, H.row_count
        found = self._inner.condense(
            NodeRows(
                np.concatenate([H.row_index, count + own.row_index]),
                np.concatenate([H.node_index, own.node_index]),
                np.concatenate([H.blocks, own.blocks]), count + own.row_count,
            ),
            b,
        )  # fmt: skip
        G, across = found.W[:count, :count], found.W[count:, :count]
        M = np.diag(self._compliance) + found.W[count:, count:]
        solved = np.linalg.solve(M, np.column_stack([across, found.free[count:]]))
        self._of_multipliers, self._of_forces = solved[:, :-1], solved[:, -1]
        W = G - across.T @ self._of_multipliers
        return Condensed(0.5 * (W + W.T), found.free[:count] - across.T @ self._of_forces)

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """See `Factorization.expand`."""
        own = -self._of_forces - self._of_multipliers @ multipliers
        return self._inner.expand(np.concatenate([multipliers, own]))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """See `Factorization.solve`."""
        self.condense(NO_ROWS, b)
        return self.expand(np.empty(0)).copy()
