"""The factorization as a step uses it: storage of the matrix, factor, condense, expand."""

from __future__ import annotations

from copy import copy

import numpy as np

from softrobot_twin.kernels.traced_stage import TracedStages, clear
from softrobot_twin.kernels.worker_threads import Team, WatchedTeam, run_alone, team_of
from softrobot_twin.solvers.factorization import (
    BLOCK,
    Condensed,
    LowRankCondensed,
    NodeRows,
    block_slots,
)
from softrobot_twin.solvers.multifrontal import condensation, front_tasks
from softrobot_twin.solvers.multifrontal.condensation import ConstraintColumns
from softrobot_twin.solvers.multifrontal.dense_kernels import WIDE
from softrobot_twin.solvers.multifrontal.front_tasks import (
    TaskList,
    factorize_by_tasks,
    plan_tasks,
    task_begins,
)
from softrobot_twin.solvers.multifrontal.memory_layout import lay_out, plan_updates, update_sizes
from softrobot_twin.solvers.multifrontal.numeric_factorization import SUCCESS, factorize
from softrobot_twin.solvers.multifrontal.ordering import best_elimination
from softrobot_twin.solvers.multifrontal.symbolic import NONE, node_graph, renumbered
from softrobot_twin.solvers.multifrontal.vector_code import STRIP

# W is given by its factor where its rank is at most this share of its rows.
LOW_RANK = 0.5


class Multifrontal:
    """Multifrontal Cholesky factorization A = LLᵀ in 3×3 blocks.

    Buffers are allocated at set-up; they grow only for rows H that need more memory than was
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
        team: Threads that factorize; None for the calling one alone.
    """

    name = "multifrontal Cholesky"
    is_traceable = True

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
        self._tasks: TaskList | None = None
        self.team: Team | None = None
        self._shares_strips = False
        self._tallest = STRIP * int(self.layout.fronts["strips"].max(initial=1))
        self._nowhere = np.full(node_count, NONE)
        self._take_no_rows(True)

    def _take_no_rows(self, are_traced: bool) -> None:
        """Allocate memory for vectors and for rows."""
        self._y, self._x = aligned(3 * self._node_count), aligned(3 * self._node_count)
        self._dx = np.zeros((self._node_count, 3))
        self._row_count = 0
        self._columns = ConstraintColumns(self.elimination)
        self.Y, self.gram, self.work = aligned(0), aligned(0), aligned(0)
        self._W, self._free, self._ranks = np.empty((0, 0)), np.empty(0), np.empty(0, np.int64)
        self.stages, self.memory_count = TracedStages(are_traced, self._condense, self._is_placed), 0
        self.prepare_rows(np.zeros(0, dtype=np.int64))

    def with_other_rows(self) -> Multifrontal:
        """The same factor, always that of the last `factor`, for rows that come between a step's.

        What a step knows of its own rows stays as it is.
        """
        other = copy(self)
        other._take_no_rows(False)
        return other

    def slots(self, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.slots`."""
        rank = self.elimination_rank
        return block_slots(self.layout.block_keys, rank[rows], rank[columns], self._node_count)

    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Factorization.blocks`."""
        columns, rows = np.divmod(self.layout.block_keys, self._node_count)
        return self.elimination.order[rows], self.elimination.order[columns]

    def clear(self) -> None:
        """See `Factorization.clear`."""
        clear(self.storage)

    def use_threads(self, thread_count: int) -> None:
        """Factorize by several threads where they gain by it; the bits stay the same.

        Args:
            thread_count: Most threads.
        """
        before, self.team = self._tasks, None
        tasks = self._tasks = plan_tasks(self.elimination, self.layout, thread_count)
        if tasks is not before:
            fronts, children = self.layout.fronts, self.layout.children
            begins = None if tasks is None else task_begins(tasks, len(fronts))
            fronts["update"], size = plan_updates(update_sizes(fronts), fronts, children, begins)
            self.layout = self.layout._replace(updates_size=size)
            self._updates = aligned(size)
        if tasks is not None:
            self.team = team_of(tasks.thread_count)
            self._watched = WatchedTeam(self.team)
        # A right-hand side reads each entry of L once, about one a cycle.
        self._shares_strips = tasks is not None and self.layout.panels_size >= front_tasks.LEAST_COST
        if self._shares_strips:
            # A stage that is traced runs on one thread.
            self.stages = TracedStages(False, self._condense, self._is_placed)

    @property
    def thread_count(self) -> int:
        """Threads that factorize."""
        return 1 if self._tasks is None else self._tasks.thread_count

    def factor(self) -> bool:
        """See `Factorization.factor`."""
        layout, tasks = self.layout, self._tasks
        arguments = (
            layout.fronts, layout.children, layout.runs, layout.block_places,
            self.storage, self._panels, self._updates, self._triangles,
        )  # fmt: skip
        if tasks is None:
            return factorize(*arguments) == SUCCESS
        return self._watched.run(
            len(tasks.tasks), factorize_by_tasks, tasks.tasks, tasks.waits, *arguments
        ) == SUCCESS  # fmt: skip

    def prepare_rows(self, node_index: np.ndarray, row_count: int = 0) -> None:
        """Reserve memory for rows H, so that `condense` need not.

        Args:
            node_index: Free nodes that rows may touch.
            row_count: Most rows that may come.
        """
        ranks = self.elimination_rank[np.asarray(node_index, dtype=np.int64)]
        self._reserve(*self._columns.most_sizes(ranks, row_count))

    def _reserve(self, size: int, widest: int, gram_size: int) -> None:
        """Enlarge Y and the buffers made from it where they are too small."""
        # Products are computed six columns at a time, and read that many past the last row.
        for name, needed in (("Y", size + WIDE), ("gram", gram_size), ("work", self._tallest * widest)):
            if needed > len(getattr(self, name)):
                setattr(self, name, aligned(needed))
                self._forget()

    def _forget(self) -> None:
        """Note that arrays were allocated anew, which traces know by their addresses."""
        self.stages.forget()
        self.memory_count += 1

    def condense(self, H: NodeRows, b: np.ndarray) -> Condensed:
        """See `Factorization.condense`; forward solves only, W = YᵀY with Y = L⁻¹Hᵀ."""
        if len(self._free) != H.row_count:
            self._W, self._free = np.empty((H.row_count, H.row_count)), np.empty(H.row_count)
            self._forget()
        self._row_count = H.row_count
        self.stages.run(0, H.row_index, H.node_index, H.blocks, b)
        return Condensed(self._W.copy(), self._free.copy())

    def _condense(
        self, row_index: np.ndarray, node_index: np.ndarray, blocks: np.ndarray, b: np.ndarray
    ) -> None:
        """Write W and the free violation of rows."""
        H, columns, layout = NodeRows(row_index, node_index, blocks, self._row_count), self._columns, self.layout
        if not self._is_placed(row_index, node_index):
            self._assign_columns(H)
        self._solve_forward(H, b)
        condensation.gram(
            layout.fronts, columns.places, columns.trees, columns.strips, columns.rows,
            self.Y, self.gram, self._W, self._free,
        )  # fmt: skip

    def condense_low_rank(self, H: NodeRows, b: np.ndarray) -> LowRankCondensed | None:
        """See `Factorization.condense_low_rank`; the rank is at most that of the reached fronts."""
        columns, k = self._columns, H.row_count
        self._row_count = k
        if not self.stages.run(1, H.row_index, H.node_index):
            self._assign_columns(H)
            # A trace of `condense` has the sizes of the columns before.
            self.stages.forget()
        rank = columns.rank
        if k == 0 or rank > LOW_RANK * k:
            return None
        self._solve_forward(H, b)
        Yt, free = np.zeros((k, rank)), np.zeros(k)
        condensation.gather_factor(columns.trees, columns.rows, self.Y, Yt, free)
        return LowRankCondensed(Yt, free)

    def _is_placed(self, row_index: np.ndarray, node_index: np.ndarray) -> bool:
        """Whether rows have their columns in Y."""
        if len(self._ranks) != len(node_index):
            self._ranks = np.empty(len(node_index), np.int64)
        condensation.write_ranks(self.elimination_rank, np.asarray(node_index, dtype=np.int64), self._ranks)
        return self._columns.are_placed(np.ascontiguousarray(row_index, dtype=np.int64), self._ranks)

    def _assign_columns(self, H: NodeRows) -> None:
        """Assign rows, whose ranks are known, their columns in Y, and reserve its memory."""
        columns = self._columns
        before = columns.column
        rows = np.ascontiguousarray(H.row_index, dtype=np.int64)
        columns.place(rows, self._ranks, H.row_count)
        if columns.column is not before:
            self._forget()
        self._reserve(columns.size, columns.work_size, columns.gram_size)

    def _solve_forward(self, H: NodeRows, b: np.ndarray) -> None:
        """Y ← L⁻¹ Hᵀ and y ← L⁻¹ b, for rows that have been placed."""
        columns, layout = self._columns, self.layout
        condensation.spread_rows(
            self._ranks, np.ascontiguousarray(H.blocks, dtype=np.float64), columns.column,
            columns.places, columns.tree, self.elimination.front, columns.trees, columns.size,
            self.Y,
        )  # fmt: skip
        b = np.ascontiguousarray(b, dtype=np.float64).reshape(self._node_count, 3)
        condensation.by_rank(self.elimination_rank, b, self._y)
        arguments = (
            layout.fronts, layout.rows, self._panels, self._triangles, columns.places,
            columns.tree, columns.trees, columns.strips, self._y, self.Y, self.work,
        )  # fmt: skip
        if not self._shares_strips or columns.work_size <= STRIP:
            run_alone(condensation.forward, *arguments)
        else:
            self._watched.run(self.team.count, condensation.forward, *arguments)

    def expand(self, multipliers: np.ndarray) -> np.ndarray:
        """See `Factorization.expand`; the result is overwritten by the next call.

        Raises:
            ValueError: There are not as many multipliers as rows were condensed.
        """
        multipliers = np.ascontiguousarray(multipliers, dtype=np.float64)
        if multipliers.shape != (self._row_count,):
            raise ValueError(f"{multipliers.size} multipliers for {self._row_count} rows")
        columns = self._columns
        condensation.combine(
            self.layout.fronts, columns.places, columns.trees, columns.strips, columns.rows,
            columns.arrival, self._y, self.Y, multipliers, columns.chosen, self.work, self._x,
        )  # fmt: skip
        return self._back()

    def solve(self, b: np.ndarray) -> np.ndarray:
        """A⁻¹ b, shape (node_count, 3), or column by column, shape (3 node_count, count).

        Args:
            b: Right-hand side [N], shape (node_count, 3); or several as columns, shape (3
                node_count, count).
        """
        b = np.asarray(b, dtype=np.float64)
        if b.shape == (self._node_count, 3):
            return self._solve_one(b)
        columns = [self._solve_one(column.reshape(-1, 3)).reshape(-1) for column in b.T]
        return np.stack(columns, axis=1) if columns else np.zeros(b.shape)

    def _solve_one(self, b: np.ndarray) -> np.ndarray:
        layout = self.layout
        condensation.by_rank(self.elimination_rank, np.ascontiguousarray(b), self._x)
        run_alone(
            condensation.forward, layout.fronts, layout.rows, self._panels, self._triangles,
            self._nowhere, self._columns.tree, self._columns.trees, self._columns.strips,
            self._x, self.Y, self.work,
        )  # fmt: skip
        return self._back().copy()

    def _back(self) -> np.ndarray:
        """L⁻ᵀ x, in the order of nodes."""
        condensation.backward(
            self.layout.fronts, self.layout.rows, self._panels, self._triangles,
            self._x, self.work,
        )  # fmt: skip
        condensation.by_node(self.elimination_rank, self._x, self._dx)
        return self._dx


def aligned(size: int) -> np.ndarray:
    """Zeros, aligned to a cache line, shape (size,).

    Args:
        size: How many doubles.
    """
    buffer = np.zeros(size + STRIP)
    start = -buffer.ctypes.data // 8 % STRIP
    return buffer[start : start + size]
