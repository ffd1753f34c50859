"""The factorization that a step sees: assembly's storage, factor, condense, expand."""

from __future__ import annotations

import numpy as np

from softrobot_twin.solvers.factorization import Condensed, LowRankCondensed, NodeRows
from softrobot_twin.solvers.multifrontal import lane_products, solves
from softrobot_twin.solvers.multifrontal.elimination_tree import NONE
from softrobot_twin.solvers.multifrontal.layout import BLOCK, lay_out
from softrobot_twin.solvers.multifrontal.numeric import SUCCESS, factorize
from softrobot_twin.solvers.multifrontal.ordering import best_elimination
from softrobot_twin.solvers.multifrontal.row_lanes import RowLanes
from softrobot_twin.solvers.multifrontal.symbolic import node_graph, renumbered
from softrobot_twin.solvers.multifrontal.tiles import WIDE
from softrobot_twin.solvers.multifrontal.vector_code import STRIP

# W is given by its factor where its rank is at most this share of its rows.
LOW_RANK = 0.5
_BLOCK_STRIDE = 3  # between the columns of a block, which is stored in one piece


class Multifrontal:
    """Multifrontal Cholesky factorization A = LLᵀ in 3×3 blocks.

    Buffers are allocated at set-up; they grow only when rows H arrive that need more room than was
    prepared (see `prepare_rows`). The work of a step follows from its own rows. The same input
    gives the same bits. Not to be used by two threads at once; the interpreter's lock is released
    inside.

    Attributes:
        name: What diagnostics and benchmarks call it.
        elimination_rank: Place of each free node in the elimination order, shape (node_count,).
        storage: Where assembly adds the lower blocks; `factor` leaves it as it is, so that a
            matrix can be changed and factorized again.
        elimination: The fronts.
        layout: Where they lie in memory.
    """

    name = "multifrontal Cholesky"

    def __init__(
        self,
        rows: np.ndarray,
        columns: np.ndarray,
        node_count: int,
        coordinates: np.ndarray | None = None,
        order: np.ndarray | None = None,
    ):
        """Analyse a node graph.

        Args:
            rows: Free nodes of coupled pairs, any order, duplicates allowed.
            columns: Their partners; the diagonal is implied.
            node_count: Number of free nodes.
            coordinates: Positions of the nodes [m], shape (node_count, 3), for a better order of
                thick bodies.
            order: Node to eliminate at each rank, shape (node_count,); by default the best found.

        Raises:
            ValueError: A pair names no node, or the order is no permutation.
        """
        graph = node_graph(rows, columns, node_count)
        self.elimination = best_elimination(graph, coordinates, order)
        self.elimination_rank = self.elimination.rank
        structure = renumbered(graph, self.elimination.order)
        self.layout = lay_out(self.elimination, *structure)
        self._node_count = node_count
        self.storage = aligned(BLOCK * len(self.layout.block_keys))
        self._panels = aligned(self.layout.panels_size)
        self._updates = aligned(self.layout.updates_size)
        self._triangles = aligned(self.layout.triangles_size)
        self._y = aligned(3 * node_count)
        self._x = aligned(3 * node_count)
        self._dx = np.zeros((node_count, 3))
        self._tallest = STRIP * int(self.layout.fronts["strips"].max(initial=1))
        self._nowhere = np.full(node_count, NONE)
        self._row_count = 0
        self._lanes = RowLanes(self.elimination)
        self._Y, self._gram, self._work = aligned(0), aligned(0), aligned(0)
        self.prepare_rows(np.zeros(0, dtype=np.int64))

    def slots(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.slots`."""
        row_rank, column_rank = self.elimination_rank[rows], self.elimination_rank[columns]
        if np.any(row_rank < column_rank):
            raise ValueError("a block lies above the diagonal of the elimination order")
        keys, wanted = self.layout.block_keys, column_rank * self._node_count + row_rank
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        if np.any(keys[place] != wanted):
            raise ValueError("a block lies outside the pattern")
        return BLOCK * place, np.full(place.shape, _BLOCK_STRIDE, dtype=np.int64)

    def clear(self) -> None:
        """See `Factorization.clear`."""
        self.storage[:] = 0.0

    def factor(self) -> bool:
        """See `Factorization.factor`."""
        layout = self.layout
        failed_at = factorize(
            layout.fronts, layout.children, layout.runs, layout.block_places,
            self.storage, self._panels, self._updates, self._triangles,
        )  # fmt: skip
        return failed_at == SUCCESS

    def prepare_rows(self, node_index: np.ndarray, row_count: int = 0) -> None:
        """Make ready for rows H, so that `condense` need not.

        Args:
            node_index: Free nodes that rows may touch.
            row_count: Most rows that may come.
        """
        ranks = self.elimination_rank[np.asarray(node_index, dtype=np.int64)]
        self._make_room(*self._lanes.most_sizes(ranks, row_count))

    def _make_room(self, size: int, lanes: int, gram_size: int) -> None:
        """Let Y, and what is made from it, be at least as large."""
        # Products are made six lanes at a time, and read that many past the last row.
        if size + WIDE > len(self._Y):
            self._Y = aligned(size + WIDE)
        if gram_size > len(self._gram):
            self._gram = aligned(gram_size)
        if self._tallest * lanes > len(self._work):
            self._work = aligned(self._tallest * lanes)

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `Factorization.condense`; forward solves only, W = YᵀY with Y = L⁻¹Hᵀ."""
        self._place(H)
        self._solve_forward(H, b)
        k, lanes, layout = H.row_count, self._lanes, self.layout
        W, free = np.empty((k, k)), np.empty(k)
        lane_products.gram(
            layout.fronts, lanes.places, lanes.pieces, lanes.strips, lanes.rows,
            self._Y, self._gram, W, free,
        )  # fmt: skip
        return Condensed(W, free)

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> LowRankCondensed | None:
        """See `Factorization.condense_low_rank`; the rank is at most that of the reached fronts."""
        lanes, k = self._lanes, H.row_count
        self._place(H)
        rank = lanes.rank
        if k == 0 or rank > LOW_RANK * k:
            return None
        self._solve_forward(H, b)
        Yt, free = np.zeros((k, rank)), np.zeros(k)
        lane_products.gather_lines(lanes.pieces, lanes.rows, self._Y, Yt, free)
        return LowRankCondensed(Yt, free)

    def _place(self, H: NodeRows) -> None:
        """Give the rows their lanes in Y, and Y its room."""
        lanes = self._lanes
        self._ranks = self.elimination_rank[np.asarray(H.node_index, dtype=np.int64)]
        lanes.place(np.ascontiguousarray(H.row_index, dtype=np.int64), self._ranks, H.row_count)
        self._make_room(lanes.size, lanes.work_size, lanes.gram_size)
        self._row_count = H.row_count

    def _solve_forward(self, H: NodeRows, b: np.ndarray) -> None:
        """Y ← L⁻¹ Hᵀ and y ← L⁻¹ b, for rows that have been placed."""
        lanes, layout = self._lanes, self.layout
        lane_products.spread_rows(
            self._ranks, np.ascontiguousarray(H.blocks, dtype=np.float64), lanes.lane,
            lanes.places, lanes.piece, self.elimination.front, lanes.pieces, lanes.size, self._Y,
        )  # fmt: skip
        b = np.ascontiguousarray(b, dtype=np.float64).reshape(self._node_count, 3)
        solves.by_rank(self.elimination_rank, b, self._y)
        solves.forward(
            layout.fronts, layout.rows, self._panels, self._triangles, lanes.places, lanes.piece,
            lanes.pieces, lanes.strips, self._y, self._Y, self._work,
        )  # fmt: skip

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """See `Factorization.expand`; the result is overwritten by the next call.

        Raises:
            ValueError: There are not as many multipliers as rows were condensed.
        """
        multipliers = np.ascontiguousarray(multipliers, dtype=np.float64)
        if multipliers.shape != (self._row_count,):
            raise ValueError(f"{multipliers.size} multipliers for {self._row_count} rows")
        lanes = self._lanes
        lane_products.combine(
            self.layout.fronts, lanes.places, lanes.pieces, lanes.strips, lanes.rows,
            lanes.arrival, self._y, self._Y, multipliers, lanes.chosen, self._work, self._x,
        )  # fmt: skip
        return self._back()

    def solve(self, b: np.ndarray) -> np.ndarray:
        """A⁻¹ b, shape (node_count, 3), or column by column, shape (3 node_count, count)."""
        b = np.asarray(b, dtype=np.float64)
        if b.shape == (self._node_count, 3):
            return self._solve_one(b)
        columns = [self._solve_one(column.reshape(-1, 3)).reshape(-1) for column in b.T]
        return np.stack(columns, axis=1) if columns else np.zeros(b.shape)

    def _solve_one(self, b: np.ndarray) -> np.ndarray:
        layout = self.layout
        solves.by_rank(self.elimination_rank, np.ascontiguousarray(b), self._x)
        solves.forward(
            layout.fronts, layout.rows, self._panels, self._triangles,
            self._nowhere, self._lanes.piece, self._lanes.pieces, self._lanes.strips,
            self._x, self._Y, self._work,
        )  # fmt: skip
        return self._back().copy()

    def _back(self) -> np.ndarray:
        """L⁻ᵀ x, in the order of nodes."""
        solves.backward(
            self.layout.fronts, self.layout.rows, self._panels, self._triangles,
            self._x, self._work,
        )  # fmt: skip
        solves.by_node(self.elimination_rank, self._x, self._dx)
        return self._dx


def aligned(size: int) -> np.ndarray:
    """Zeros that begin at a cache line, shape (size,)."""
    room = np.zeros(size + STRIP)
    start = -room.ctypes.data // 8 % STRIP
    return room[start : start + size]
