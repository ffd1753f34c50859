"""A factorization of A + Σ k h hᵀ, with a few rows h that couple many unknowns.

With the rows h in S and C = diag(1/k), A + Sᵀ C⁻¹ S has the inverse that the unknowns of

    [ A   Sᵀ ] [ x ]   [ b ]
    [ S  -C  ] [ y ] = [ 0 ]

have, so S is condensed above the rows H of each system, and eliminated from it, rows of positive k
first. The whole is positive definite where as many pivots of C + S A⁻¹ Sᵀ are positive as k are, less
the negative eigenvalues of A (the inertia of the system from both sides; Nocedal and Wright
2006, section 16.3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.solvers.factorization import Condensed, Factorization, NodeRows, laid_out_like

NO_ROWS = NodeRows(*np.empty((2, 0), np.int64), np.empty((0, 3)), 0)


@njit(**KERNEL)
def eliminate(G, free, compliance):
    """Eliminate the first rows y of G y + free + C y = 0; what is left of G and free is condensed.

    Args:
        G: Compliance of all rows, shape (n, n); overwritten: by U and the unit factor L in the lines
            and columns of the first rows, by the condensed compliance below.
        free: Free violations, shape (n,); overwritten alike.
        compliance: C of the first rows, shape (s,).

    Returns:
        How many pivots are positive; -1 where one is zero or no number.
    """
    s, n, positive_count = len(compliance), len(free), 0
    for k in range(s):
        G[k, k] += compliance[k]
    for k in range(s):
        pivot = G[k, k]
        if not (pivot > 0.0 or pivot < 0.0):
            return -1
        positive_count += pivot > 0.0
        for i in range(k + 1, n):
            factor = G[i, k] / pivot
            G[i, k] = factor
            free[i] -= factor * free[k]
            for j in range(k + 1, n):
                G[i, j] -= factor * G[k, j]
    return positive_count


@njit(**KERNEL)
def write_condensed(G, free, W, left):
    """Write what `eliminate` left of the last rows.

    Args:
        G: See there, shape (n, n).
        free: See there, shape (n,).
        W: Takes the symmetric compliance of the last m rows, shape (m, m).
        left: Takes their free violations, shape (m,).
    """
    s = len(free) - len(left)
    for i in range(len(left)):
        left[i] = free[s + i]
        for j in range(len(left)):
            W[i, j] = 0.5 * (G[s + i, s + j] + G[s + j, s + i])


@njit(**KERNEL)
def substitute(G, free, count, loads):
    """Loads y of the first rows from those of the others, after `eliminate`.

    Args:
        G: See there, shape (n, n).
        free: See there, shape (n,).
        count: How many rows are eliminated, s.
        loads: Of all rows, shape (m,), s <= m <= n; the first s are overwritten.
    """
    for k in range(count - 1, -1, -1):
        value = -free[k]
        for j in range(k + 1, len(loads)):
            value -= G[k, j] * loads[j]
        loads[k] = value / G[k, k]


@njit(**KERNEL)
def reduce_moves(G, moved):
    """moved ← L⁻¹ moved, shape (s,), by the factor L of `eliminate` in G, shape (n, n)."""
    for k in range(len(moved)):
        for i in range(k + 1, len(moved)):
            moved[i] -= G[i, k] * moved[k]


@njit(**KERNEL)
def order_by_sign(stiffness, place, compliance):
    """Place rows of positive k before those of negative k.

    Args:
        stiffness: k of each row, shape (row_count,).
        place: Takes the new place of each row, same shape.
        compliance: Takes 1/k at these places, same shape.

    Returns:
        How many are positive.
    """
    positive_count = next_place = 0
    for is_positive in (True, False):
        for row in range(len(stiffness)):
            if (stiffness[row] > 0.0) == is_positive:
                place[row], compliance[next_place] = next_place, 1.0 / stiffness[row]
                next_place += 1
        if is_positive:
            positive_count = next_place
    return positive_count


@njit(**KERNEL)
def append_rows(row_index, node_index, blocks, place, first, all_rows, all_nodes, all_blocks):
    """Write entries of rows behind others.

    Args:
        row_index: Row of each entry, shape (entry_count,).
        node_index: Unknown of each, same shape.
        blocks: The entries, shape (entry_count, 3).
        place: Row that each row becomes, shape (row_count,).
        first: Number of entries that are there already.
        all_rows: Takes the rows.
        all_nodes: Takes the unknowns.
        all_blocks: Takes the entries.
    """
    for entry in range(len(row_index)):
        all_rows[first + entry] = place[row_index[entry]]
        all_nodes[first + entry] = node_index[entry]
        for i in range(3):
            all_blocks[first + entry, i] = blocks[entry, i]


class DenseStiffness:
    """See `Factorization`; A is that of another one, whose storage is used.

    The rows are those that their terms give when it is factorized. Whether the whole is positive
    definite is not known before it is condensed.
    """

    def __init__(self, inner: Factorization, terms: Sequence):
        """Take the factorization of A.

        Args:
            inner: It.
            terms: All that have `dense_rows`, see `DenseRows`, and `clear_dense_rows`.
        """
        self._inner, self.name, self._terms = inner, inner.name, list(terms)
        self.elimination_rank, self.storage = inner.elimination_rank, inner.storage
        self.slots = inner.slots
        self.is_traceable = getattr(inner, "is_traceable", False)
        self._place, self._compliance, self._below = np.empty(0, np.int64), np.empty(0), np.empty(0, np.int64)
        self._positive_count = self._entry_count = 0
        self._negative_count: int | None = 0
        # The rows h, then H, in the same arrays as long as there are as many; loads of both.
        self._joined, self._loads = NO_ROWS, np.empty(0)
        self._eliminated: Condensed | None = None

    def clear(self) -> None:
        """See `Factorization.clear`; no rows are left either."""
        self._inner.clear()
        for term in self._terms:
            term.clear_dense_rows()

    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.blocks`."""
        return self._inner.blocks()

    def prepare_rows(self, node_index: np.ndarray, row_count: int) -> None:
        """See `Factorization.prepare_rows`."""
        parts = [term.dense_rows for term in self._terms]
        self._inner.prepare_rows(
            np.unique(np.concatenate([node_index, *(part.node_index for part in parts)])),
            row_count + sum(len(part.stiffness) for part in parts),
        )

    def factor(self) -> bool:
        """Take the rows, and factorize A; False if it cannot be told whether the whole is definite."""
        parts = [term.dense_rows for term in self._terms]
        stiffness = np.concatenate([part.stiffness for part in parts])
        if len(stiffness) != len(self._place):
            self._place, self._compliance = np.empty(len(stiffness), np.int64), np.empty(len(stiffness))
        self._positive_count = order_by_sign(stiffness, self._place, self._compliance)
        below = len(self._joined.row_index) - self._entry_count
        self._entry_count = 0
        self._make_room(sum(len(part.row_index) for part in parts) + below)
        first = 0
        for part in parts:
            self._append(part, self._place[first:])
            first += len(part.stiffness)
        self._eliminated = None
        is_definite = self._inner.factor()
        self._negative_count = 0 if is_definite else getattr(self._inner, "negative_count", None)
        return self._negative_count is not None

    def _make_room(self, entry_count: int) -> None:
        """Keep the rows h, in arrays for a number of entries."""
        if len(self._joined.row_index) != entry_count:
            kept, own = self._entry_count, self._joined
            self._joined = NodeRows(*np.empty((2, entry_count), np.int64), np.empty((entry_count, 3)), 0)
            for new, old in zip(self._joined[:3], own[:3]):
                new[:kept] = old[:kept]

    def _append(self, rows: tuple, place: np.ndarray) -> None:
        """Write rows behind those that are there; see `append_rows`."""
        append_rows(*rows[:3], place, self._entry_count, *self._joined[:3])
        self._entry_count += len(rows.row_index)

    @property
    def _own(self) -> NodeRows:
        """The rows h."""
        return NodeRows(*(part[: self._entry_count] for part in self._joined[:3]), len(self._place))

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> None:
        """None: W is formed as a whole; see `Factorization.condense_low_rank`."""

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `Factorization.condense`.

        Raises:
            numpy.linalg.LinAlgError: The whole is not positive definite.
        """
        s, entries = len(self._place), self._entry_count
        if len(self._below) != H.row_count or len(self._loads) != s + H.row_count:
            self._below, self._loads = s + np.arange(H.row_count), np.empty(s + H.row_count)
        self._make_room(entries + len(H.row_index))
        self._append(H, self._below)
        self._entry_count = entries
        if self._joined.row_count != len(self._loads):
            self._joined = self._joined._replace(row_count=len(self._loads))
        self._eliminated = found = self._inner.condense(self._joined, b)
        if eliminate(*found, self._compliance) != self._positive_count - self._negative_count:
            raise np.linalg.LinAlgError("rows of a stiffness make it indefinite")
        condensed = Condensed(np.empty((H.row_count, H.row_count)), np.empty(H.row_count))
        write_condensed(*found, *condensed)
        return condensed

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """See `Factorization.expand`."""
        count = len(self._place)
        self._loads[count:] = multipliers
        substitute(*self._eliminated, count, self._loads)
        return self._inner.expand(self._loads)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """See `Factorization.solve`; what was condensed last stays."""
        if self._eliminated is None:
            self.condense(NO_ROWS, np.zeros_like(b))
        own, found = self._own, self._inner.solve(b)
        along = np.einsum("ij,ij->i", own.blocks, found[own.node_index])
        # Without rows these would be integers.
        moved = np.bincount(own.row_index, along, own.row_count).astype(float)
        reduce_moves(self._eliminated.W, moved)
        loads = np.empty(own.row_count)
        substitute(self._eliminated.W, moved, own.row_count, loads)
        forces = np.array(b)
        np.add.at(forces, own.node_index, own.blocks * loads[own.row_index, None])
        return self._inner.solve(forces)


def with_rows_of(term, factorization: Factorization) -> DenseStiffness:
    """A factorization that takes the dense rows of one more term.

    Args:
        term: Has `dense_rows` and `clear_dense_rows`, see `DenseStiffness`.
        factorization: That of the others, which is changed if it takes dense rows already.
    """
    if not isinstance(factorization, DenseStiffness):
        return DenseStiffness(factorization, [term])
    factorization._terms.append(term)
    return factorization


def laid_out_alike(factorization: Factorization) -> tuple[Factorization, np.ndarray]:
    """A factorization of the same class, pattern and dense rows, and its places; see `laid_out_like`."""
    if not isinstance(factorization, DenseStiffness):
        return laid_out_like(factorization, type(factorization))
    inner = without_rows(factorization)
    inner, places = laid_out_like(inner, type(inner))
    return DenseStiffness(inner, factorization._terms), places


def without_rows(factorization: Factorization) -> Factorization:
    """The factorization of what is assembled, without dense rows.

    Args:
        factorization: A factorization, with dense rows or without.
    """
    return factorization._inner if isinstance(factorization, DenseStiffness) else factorization
