"""Stiffness of segments between patches of many nodes, without blocks for all pairs of them.

The stiffness of a segment r = Σ c_a x_a is c cᵀ ⊗ M, with a matrix M of 3 × 3. Between two patches
of fifty nodes it couples five thousand pairs, and fills the factorization with them (a finger's
takes seven times as long). So each end is put on its heaviest nodes, which gives coefficients ĉ, and
ĉ ĉᵀ ⊗ M is assembled in place of it. With the roots M = Σ q qᵀ, dense rows make up for the
difference,

    c cᵀ ⊗ M = ĉ ĉᵀ ⊗ M + Σ (c ⊗ q)(c ⊗ q)ᵀ - Σ (ĉ ⊗ q)(ĉ ⊗ q)ᵀ,

so that the tangent is the same (`dense_stiffness.py`). What is assembled must be positive definite
where the tangent is: a finger that is compressed by its cables needs their stiffness. On one node
for each end that fails at great tensions. On four, with twice the sums of c, it was more definite
than the tangent in all states of the Finger that were tried.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, ONCE, njit
from softrobot_twin.kernels.traced_stage import clear
from softrobot_twin.mechanics.force_term import DenseRows
from softrobot_twin.mechanics.stencil import add_weighted_matrices, bind_stencils

# Segments that couple more nodes are spread. At 38 it takes as long either way.
MOST_COUPLED = 40
# Nodes that an end is put on, and the sum of ĉ there as a multiple of that of c.
HEAVIEST, HEAVIER = 4, 2.0
# A pivot below this share of the trace is rounding.
NO_ROOT = 1.0e-12


@njit(**ONCE)
def _roots(M, left, q):
    """Vectors q of M = Σ q qᵀ, one in each line of `q`, by a Cholesky factorization with pivots.

    Args:
        M: Symmetric, positive semidefinite, shape (3, 3).
        left: Overwritten, same shape.
        q: Takes the vectors, same shape.

    Returns:
        How many there are; two of zeros without stiffness, so that a cable that becomes slack
        has as many rows.
    """
    left[:] = M
    least, rank = NO_ROOT * (M[0, 0] + M[1, 1] + M[2, 2]), 0
    if least == 0.0:
        q[:] = 0.0
        return 2
    while rank < 3:
        p = 1 if left[1, 1] > left[0, 0] else 0
        p = 2 if left[2, 2] > left[p, p] else p
        if not left[p, p] > least:
            break
        root = np.sqrt(left[p, p])
        for i in range(3):
            q[rank, i] = left[i, p] / root
        for i in range(3):
            for j in range(3):
                left[i, j] -= q[rank, i] * q[rank, j]
        rank += 1
    return rank


@njit(**KERNEL)
def write_roots(matrices, free, c, heavy_free, heavy_c, rows, nodes, blocks, signs, sizes, is_more):
    """Write the rows c ⊗ q, then the rows ĉ ⊗ q.

    Args:
        matrices: M of each segment [N/m], shape (segment_count, 3, 3).
        free: Unknowns of each segment, -1 where fixed, shape (segment_count, width).
        c: Their coefficients, same shape.
        heavy_free: The heaviest of them, shape (segment_count, 2 `HEAVIEST`).
        heavy_c: ĉ, same shape.
        rows: Takes the row of each entry.
        nodes: Takes its unknown.
        blocks: Takes the entries [(N/m)^½], each of shape (3,).
        signs: Takes 1 and -1 for each row.
        sizes: How many rows, and how many entries, there are, shape (2,); changed.
        is_more: Whether these stay, and others are written behind them.
    """
    left, q = np.empty((3, 3)), np.empty((3, 3))
    row, entry = (sizes[0], sizes[1]) if is_more else (0, 0)
    for sign in (1.0, -1.0):
        own_free, own_c = (free, c) if sign > 0.0 else (heavy_free, heavy_c)
        for s in range(len(matrices)):
            for k in range(_roots(matrices[s], left, q)):
                for a in range(own_free.shape[1]):
                    if own_free[s, a] >= 0:
                        rows[entry], nodes[entry] = row, own_free[s, a]
                        for i in range(3):
                            blocks[entry, i] = own_c[s, a] * q[k, i]
                        entry += 1
                signs[row] = sign
                row += 1
    sizes[0], sizes[1] = row, entry


class SpreadStiffness:
    """Adds the stiffness of segments, as few blocks and dense rows."""

    def __init__(self, free: np.ndarray, coefficients: np.ndarray):
        """Choose the heaviest nodes, and allocate.

        Args:
            free: Unknowns of each segment, -1 where fixed, shape (segment_count, width).
            coefficients: c of them, those of one end negative, same shape.
        """
        count = len(free)
        self._free, self._c = free, coefficients
        self._heavy, self._heavy_c = np.full((count, 2 * HEAVIEST), -1), np.zeros((count, 2 * HEAVIEST))
        for end, sign in enumerate((1.0, -1.0)):
            own = slice(end * HEAVIEST, (end + 1) * HEAVIEST)
            weights = np.where(free >= 0, np.maximum(sign * coefficients, 0.0), 0.0)
            heaviest = np.argsort(-weights, axis=1, kind="stable")[:, :HEAVIEST]
            kept = np.take_along_axis(weights, heaviest, axis=1)
            self._heavy[:, own] = np.where(kept > 0.0, np.take_along_axis(free, heaviest, axis=1), -1)
            share = weights.sum(axis=1) / np.maximum(kept.sum(axis=1), np.finfo(float).tiny)
            self._heavy_c[:, own] = HEAVIER * sign * kept * share[:, None]
        # Of a stiffness across the segments, and of one along them, which is added to it.
        rows, entries = 2 * 5 * count, 5 * (np.count_nonzero(free >= 0) + self._heavy.size)
        self._written = (
            *np.zeros((2, entries), np.int64), np.zeros((entries, 3)), np.ones(rows), np.array([rows, 0]),
        )  # fmt: skip

    def stencils(self) -> np.ndarray:
        """The heaviest unknowns of each segment, -1 for none, shape (segment_count, width)."""
        return self._heavy

    def bind(self, elimination_rank: np.ndarray, slots) -> None:
        """See `ConstraintTerm.bind`; the segments' nodes stay in their order."""
        self._bound = bind_stencils(self._heavy, elimination_rank, slots)
        self._heavy, self._heavy_c = map(self._bound.sorted, (self._heavy, self._heavy_c))

    def add(self, matrices: np.ndarray, storage: np.ndarray, is_more: bool = False) -> None:
        """Add c cᵀ ⊗ M of every segment, its dense rows in place of those before.

        Args:
            matrices: M of each [N/m], shape (segment_count, 3, 3).
            storage: The factorization's storage [N/m]; added to.
            is_more: Whether the rows of what was added before stay.
        """
        add_weighted_matrices(matrices, self._heavy_c, self._bound.offsets, self._bound.strides, storage)
        write_roots(matrices, self._free, self._c, self._heavy, self._heavy_c, *self._written, is_more)

    def clear_dense_rows(self) -> None:
        """See `ConstraintTerm.clear_dense_rows`."""
        clear(self._written[-1])

    @property
    def dense_rows(self) -> DenseRows:
        """Rows of what was added; before, as many without entries as there may be."""
        rows, nodes, blocks, signs, (row_count, entry_count) = self._written
        return DenseRows(rows[:entry_count], nodes[:entry_count], blocks[:entry_count], signs[:row_count])
