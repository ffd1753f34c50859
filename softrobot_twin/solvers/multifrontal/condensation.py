"""Condensation: L⁻¹ and L⁻ᵀ applied to the right-hand sides of a step, and W = YᵀY.

A step needs Y = L⁻¹ Hᵀ and y = L⁻¹ b, then W = YᵀY and Yᵀy, and later x = y + Y λ and one backward
solve. Each row of H is a *column* of Y. Rows of H touch few nodes, and forward elimination carries
them only towards the root: the fronts on those paths are *reached*, and Y has rows only there. b is
dense and goes through all fronts.

Bodies that touch each other only through constraints are separate *trees* of the forest of fronts.
L⁻¹Hᵀ of a tree is not zero only in the columns of the rows that touch it. So each tree has its own
part of Y, with as many columns as rows touch it: a finger does not pay for the contacts of another
one, and W is summed over the trees.

    Y    tree by tree: one row for each degree of freedom of the reached fronts, one column for each
         row of H, and b in the column after the last; columns are padded to whole strips of eight,
         so that a row of Y is one or a few vectors
    y    one number for each degree of freedom, used where a front is not reached

Within a tree, a column is zero until the elimination reaches the first node of its row of H. Where
the columns fill more than one strip, they are sorted by that node. Columns that meet in a subtree
are then neighbours, and each front works only on the strips of its own columns.

In reached fronts the kernels of the factorization do the work: Y's rows are treated like further
rows of the panel. Elsewhere L's columns are multiplied with a single vector.

Everything follows from the rows of the step, of which there may be none or hundreds; the memory is
one buffer that only grows.

Arguments of the kernels here:
    front: Layout of one front.
    panel, triangle: Addresses of its L and of its diagonal blocks.
    place: Row of Y at which its first node begins.
    stride: Doubles between rows of Y.
    first_strip, end_strip: Columns of Y, in strips of eight.
    target, target_stride: Where the result goes, and doubles between its rows.
    work: Memory for the rows of a front, shape (work_size,).
    rank: Place of each node in the elimination order, shape (node_count,).
    result: What is written.
"""

from __future__ import annotations

import numpy as np

from softrobot_twin.kernels.compilation import INNER, KERNEL, ONCE, njit
from softrobot_twin.kernels.worker_threads import finish, take, wait_for
from softrobot_twin.solvers.multifrontal.dense_kernels import (
    NARROW,
    TRIANGLE,
    WIDE,
    add_node,
    add_strips,
    copy_node,
    negate_product,
    solve_backward,
    solve_forward,
    solve_product,
    subtract_columns,
    subtract_dots,
    subtract_product,
)
from softrobot_twin.solvers.multifrontal.numeric_factorization import bar_width
from softrobot_twin.solvers.multifrontal.symbolic import NONE, Elimination
from softrobot_twin.solvers.multifrontal.vector_code import STRIP, STRIP_BYTES, address

_NO_STRIP = 2**62

# One tree. A tree that no row touches has no columns.
TREE = np.dtype([
    ("first_front", np.int64),
    ("end_front", np.int64),
    ("dof_count", np.int64),  # of its reached fronts: rows of its part of Y
    ("row_count", np.int64),  # rows of H that touch it, one column each; b is in the column after
    ("row_start", np.int64),  # where they are listed in `rows`
    ("stride", np.int64),     # doubles between rows of its part of Y: its columns, in whole strips
    ("start", np.int64),      # offset of its part of Y
    ("entry_end", np.int64),  # in the list of entries by tree
])  # fmt: skip
NODE_BYTES = 24


class ConstraintColumns:
    """Where each row of H is stored in Y.

    Attributes:
        trees: One `TREE` each, in elimination order.
        tree: Tree of each front, shape (front_count,).
        places: Row of its tree's part of Y at which each node begins, by rank; -1 at the first
            node of a front that is not reached, shape (node_count,).
        rows: Row of H in each column, tree by tree.
        arrival: Columns in the order in which their rows came, tree by tree.
        column: Column of each entry of H.
        strips: First strip and end of the strips with columns of each front,
            shape (front_count, 2).
        chosen: Buffer for the columns of a tree.
        size: Doubles in Y.
        work_size: Most columns of a tree, padding included.
        gram_size: Most doubles of a tree's product YᵀY.
        rank: Rows of Y that are not zero, of the trees that rows touch.
    """

    def __init__(self, elimination: Elimination):
        """Find the trees of a forest."""
        self._elimination = elimination
        parent, first = elimination.parent, elimination.first
        ends = np.flatnonzero(parent == NONE) + 1  # postorder: a root ends its tree
        self.trees = np.zeros(len(ends), dtype=TREE)
        self.trees["first_front"] = np.concatenate([[0], ends])[: len(ends)]
        self.trees["end_front"] = ends
        self.tree = np.repeat(np.arange(len(ends)), ends - self.trees["first_front"])
        self.places = np.full(int(first[-1]), NONE)
        self.strips = np.zeros((len(parent), 2), dtype=np.int64)
        self._bucket = np.full(len(parent), NONE)
        self._allocate(0, 0)
        self._measure()

    def _allocate(self, entry_count: int, row_count: int) -> None:
        """Allocate the index arrays."""
        arrays = np.zeros((8, entry_count), dtype=np.int64)
        self.rows, self.arrival, self.column, self.chosen, self._order = arrays[:5]
        self._sorting = arrays[5:]
        self._placed = np.zeros((2, entry_count), dtype=np.int64)
        self._placed_count = NONE
        self._column_of_row = np.zeros(row_count, dtype=np.int64)

    def are_placed(self, row_index: np.ndarray, ranks: np.ndarray) -> bool:
        """Whether the rows of H have their columns; see `place`."""
        return _same(row_index, ranks, self._placed, self._placed_count)

    def place(self, row_index: np.ndarray, ranks: np.ndarray, row_count: int) -> None:
        """Assign the rows of H their columns.

        Args:
            row_index: Row of each entry, shape (entry_count,).
            ranks: Rank of the node of each entry, shape (entry_count,).
            row_count: Number of rows.
        """
        if len(row_index) > len(self.column) or row_count > len(self._column_of_row):
            entries = max(len(row_index), 2 * len(self.column))
            self._allocate(entries, max(row_count, 2 * len(self._column_of_row)))
        elimination = self._elimination
        _reach_fronts(elimination.front, elimination.parent, ranks, self.places, elimination.first)
        _place_fronts(elimination.first, self.places, self.trees)
        _assign_columns(
            elimination.front, self.tree, row_index, ranks, self.trees, self._order,
            self._column_of_row, self.rows, self.column,
        )  # fmt: skip
        _sort_columns(
            elimination.front, ranks, self.trees, self._order, self.rows, self.arrival, self.column,
            self._bucket, self._sorting,
        )  # fmt: skip
        _find_strips(elimination.front, elimination.parent, ranks, self.column, self.strips)
        self._measure()
        self._placed_count = len(row_index)
        _note(row_index, ranks, self._placed)

    def _measure(self) -> None:
        self.size, self.work_size, self.gram_size, self.rank = _stack_trees(self.trees)

    def most_sizes(self, ranks: np.ndarray, row_count: int) -> tuple[int, int, int]:
        """Size, work size and gram size that rows on some nodes may need, given by rank.

        Args:
            ranks: Place of each reached node in the elimination order, shape (reached_count,).
            row_count: Number of rows.
        """
        if len(ranks) > len(self.column) or row_count > len(self._column_of_row):
            self._allocate(len(ranks), row_count)
        elimination = self._elimination
        _reach_fronts(elimination.front, elimination.parent, ranks, self.places, elimination.first)
        _place_fronts(elimination.first, self.places, self.trees)
        self.trees["row_count"] = row_count
        self._placed_count = NONE
        return _stack_trees(self.trees)[:3]


@njit(**KERNEL)
def _same(row_index, ranks, placed, placed_count):
    """True if these are the entries placed last."""
    if len(ranks) != placed_count:
        return False
    for e in range(len(ranks)):
        if row_index[e] != placed[0, e] or ranks[e] != placed[1, e]:
            return False
    return True


@njit(**KERNEL)
def _note(row_index, ranks, placed):
    """Note the entries that are placed."""
    for e in range(len(ranks)):
        placed[0, e], placed[1, e] = row_index[e], ranks[e]


@njit(**KERNEL)
def write_ranks(elimination_rank, node_index, ranks):
    """Write the rank of the node of each entry.

    Args:
        elimination_rank: Rank of each node, shape (node_count,).
        node_index: Node of each entry, shape (entry_count,).
        ranks: Takes their ranks, shape (entry_count,).
    """
    for e in range(len(node_index)):
        ranks[e] = elimination_rank[node_index[e]]


@njit(**KERNEL)
def _reach_fronts(front, parent, ranks, places, first):
    """Mark the fronts of some nodes and all their ancestors, at their first node: 0, else -1."""
    for s in range(len(parent)):
        places[first[s]] = NONE
    for rank in ranks:
        s = front[rank]
        while s != NONE and places[first[s]] == NONE:
            places[first[s]] = 0
            s = parent[s]


@njit(**KERNEL)
def _place_fronts(first, places, trees):
    """Stack the nodes of the reached fronts, tree by tree."""
    for p in range(len(trees)):
        place = 0
        for s in range(trees[p].first_front, trees[p].end_front):
            if places[first[s]] != NONE:
                for rank in range(first[s], first[s + 1]):
                    places[rank] = place
                    place += 3
        trees[p].dof_count = place


@njit(**KERNEL)
def _assign_columns(front, tree, row_index, ranks, trees, order, column_of_row, rows, column):
    """List the rows that touch each tree, in the order in which they came."""
    for p in range(len(trees)):
        trees[p].entry_end = 0
        trees[p].row_count = 0
    for e in range(len(ranks)):
        trees[tree[front[ranks[e]]]].entry_end += 1
    start = 0
    for p in range(len(trees)):
        count = trees[p].entry_end
        trees[p].entry_end = start
        start += count
    for e in range(len(ranks)):
        p = tree[front[ranks[e]]]
        order[trees[p].entry_end] = e
        trees[p].entry_end += 1
    # Each tree's entries now end where its counter stands. A row has its column in a tree if the
    # list of that tree names it there; what is left over from other trees does not.
    column_of_row[:] = 0
    begin = start = 0
    for p in range(len(trees)):
        trees[p].row_start = start
        count = 0
        for o in range(begin, trees[p].entry_end):
            e = order[o]
            row = row_index[e]
            known = column_of_row[row]
            if known >= count or rows[start + known] != row:
                known = column_of_row[row] = count
                rows[start + count] = row
                count += 1
            column[e] = known
        begin = trees[p].entry_end
        start += count
        trees[p].row_count = count


@njit(**KERNEL)
def _sort_columns(front, ranks, trees, order, rows, arrival, column, bucket, sorting):
    """Sort the columns of trees with several strips by the first front of their rows."""
    first, following, sorted_rows = sorting[0], sorting[1], sorting[2]
    begin = 0
    for p in range(len(trees)):
        start, count, end = trees[p].row_start, trees[p].row_count, trees[p].entry_end
        for k in range(count):
            arrival[start + k] = k
        if count >= STRIP:
            for k in range(count):
                first[start + k] = trees[p].end_front
            for o in range(begin, end):
                k = start + column[order[o]]
                first[k] = min(first[k], front[ranks[order[o]]])
            for k in range(start + count - 1, start - 1, -1):
                following[k] = bucket[first[k]]
                bucket[first[k]] = k
            place = start
            for s in range(trees[p].first_front, trees[p].end_front):
                k = bucket[s]
                bucket[s] = NONE
                while k != NONE:
                    sorted_rows[place] = rows[k]
                    arrival[k] = place - start
                    place += 1
                    k = following[k]
            for k in range(start, start + count):
                rows[k] = sorted_rows[k]
            for o in range(begin, end):
                column[order[o]] = arrival[start + column[order[o]]]
        begin = end


@njit(**KERNEL)
def _find_strips(front, parent, ranks, column, strips):
    """Range of strips with columns of each front; ancestors contain the ranges of descendants."""
    for s in range(len(parent)):
        strips[s, 0], strips[s, 1] = _NO_STRIP, 0
    for e in range(len(ranks)):
        s, strip = front[ranks[e]], column[e] // STRIP
        strips[s, 0] = min(strips[s, 0], strip)
        strips[s, 1] = max(strips[s, 1], strip + 1)
    for s in range(len(parent)):
        if parent[s] != NONE:
            strips[parent[s], 0] = min(strips[parent[s], 0], strips[s, 0])
            strips[parent[s], 1] = max(strips[parent[s], 1], strips[s, 1])


@njit(**KERNEL)
def _stack_trees(trees):
    """Place each tree's part of Y; the size of all, the widest part, the largest product, the rank.
    """
    size = widest = most_gram = rank = 0
    for p in range(len(trees)):
        stride = STRIP * (trees[p].row_count // STRIP + 1) if trees[p].dof_count > 0 else 0
        trees[p].stride = stride
        trees[p].start = size
        size += stride * trees[p].dof_count
        widest = max(widest, stride)
        most_gram = max(most_gram, (stride + WIDE) * stride)
        if trees[p].row_count > 0:
            rank += trees[p].dof_count
    return size, max(widest, STRIP), most_gram, rank


@njit(**KERNEL)
def spread_rows(ranks, blocks, column, places, tree, front, trees, size, Y):
    """Y ← Hᵀ, whose entries are given as node blocks.

    Args:
        ranks: Rank of the node of each entry, shape (entry_count,).
        blocks: The entries, shape (entry_count, 3).
        column: Column of each, from `ConstraintColumns`, as are places, tree, trees and size.
        places: See column.
        tree: See column.
        front: Front of each rank.
        trees: See column.
        size: See column.
        Y: All trees, shape (size or more,).
    """
    Y[:size] = 0.0
    for entry in range(len(ranks)):
        part = trees[tree[front[ranks[entry]]]]
        place = part.start + part.stride * places[ranks[entry]] + column[entry]
        for i in range(3):
            Y[place + i * part.stride] += blocks[entry, i]


@njit(**KERNEL)
def gram(fronts, places, trees, ranges, rows, Y, product, W, free):
    """W ← YᵀY and free ← Yᵀ y, added up over the trees.

    Args:
        fronts: Layout of the fronts.
        places: Row of Y at which each node of a reached front begins, else -1, by rank.
        trees: The parts of Y.
        ranges: Strips with rows of each front.
        rows: Row of H in each column, tree by tree.
        Y: L⁻¹ Hᵀ.
        product: Buffer for the product of one tree.
        W: Written, shape (row_count, row_count).
        free: Written, shape (row_count,).
    """
    W[:] = 0.0
    free[:] = 0.0
    for p in range(len(trees)):
        stride, count = trees[p].stride, trees[p].row_count
        product[: stride * count] = 0.0
        depth, line, strip, end = 0, 0, 0, 0
        for s in range(trees[p].first_front, trees[p].end_front):
            if places[fronts[s].first_rank] < 0:
                continue
            if ranges[s, 0] != strip or ranges[s, 1] != end:
                _subtract_gram(trees[p], strip, end, depth, line, Y, product)
                strip, end = ranges[s, 0], ranges[s, 1]
                line += depth
                depth = 0
            depth += fronts[s].columns
        _subtract_gram(trees[p], strip, end, depth, line, Y, product)
        for i in range(count):
            row, line = rows[trees[p].row_start + i], i * stride
            for j in range(i, count):
                column = rows[trees[p].row_start + j]
                W[row, column] -= product[line + j]
                W[column, row] = W[row, column]
            free[row] -= product[line + count]


@njit(**INNER)
def _subtract_gram(part, first_strip, end_strip, depth, line, Y, product):
    """Subtract the part of YᵀY of a tree that comes from rows with the same range of strips.

    The product is symmetric: strips before a bar are left out.
    """
    stride, last = part.stride, part.row_count // STRIP
    at, to = address(Y) + 8 * (part.start + line * stride), address(product)
    joined = last + 1 if end_strip >= last else end_strip
    for start in range(STRIP * first_strip, min(STRIP * end_strip, part.row_count), WIDE):
        strip = start // STRIP
        bar, column = at + 8 * start, to + 8 * start * stride
        subtract_product(
            WIDE, joined - strip, depth, at + STRIP_BYTES * strip, stride, bar, stride,
            column + STRIP_BYTES * strip, stride,
        )  # fmt: skip
        if joined <= last:  # b stands apart
            subtract_product(
                WIDE, 1, depth, at + STRIP_BYTES * last, stride, bar, stride,
                column + STRIP_BYTES * last, stride,
            )  # fmt: skip


@njit(**KERNEL)
def gather_factor(trees, rows, Y, Yt, free):
    """Yᵀ with one line for each row of H, and free ← Yᵀ y.

    Args:
        trees: The parts of Y.
        rows: See `gram`.
        Y: L⁻¹ Hᵀ, and L⁻¹ b in the column after the last row.
        Yt: Written where it is not zero, shape (row_count, rank).
        free: Added to, shape (row_count,).
    """
    first = 0
    for p in range(len(trees)):
        count, stride = trees[p].row_count, trees[p].stride
        if count == 0:
            continue
        for line in range(trees[p].dof_count):
            at = trees[p].start + line * stride
            b = Y[at + count]
            for column in range(count):
                row = rows[trees[p].row_start + column]
                Yt[row, first + line] = Y[at + column]
                free[row] += Y[at + column] * b
        first += trees[p].dof_count


@njit(**KERNEL)
def combine(fronts, places, trees, ranges, rows, arrival, y, Y, multipliers, chosen, factors, x):
    """x ← y + Y λ, by rank, shape (dof_count,).

    The columns are added in the order in which their rows came, wherever they are stored.

    Args:
        fronts: Layout of the fronts.
        places: See `gram`.
        trees: See `gram`.
        ranges: See `gram`.
        rows: See `gram`.
        arrival: Columns in the order in which their rows came, tree by tree.
        y: L⁻¹ b by rank where a front is not reached.
        Y: L⁻¹ Hᵀ, and L⁻¹ b where a front is reached.
        multipliers: λ, shape (row_count,).
        chosen: Buffer for the columns of a front, shape (row_count,).
        factors: Buffer for their multipliers, same shape.
        x: Written.
    """
    for p in range(len(trees)):
        part = trees[p]
        for s in range(part.first_front, part.end_front):
            first, place = 3 * fronts[s].first_rank, places[fronts[s].first_rank]
            if place < 0:
                for i in range(fronts[s].columns):
                    x[first + i] = y[first + i]
                continue
            count = 0
            for k in range(part.row_start, part.row_start + part.row_count):
                if ranges[s, 0] <= arrival[k] // STRIP < ranges[s, 1]:
                    chosen[count] = arrival[k]
                    factors[count] = multipliers[rows[part.row_start + arrival[k]]]
                    count += 1
            _combine_columns(
                fronts[s].columns, Y[part.start + part.stride * place :], part.stride,
                part.row_count, chosen[:count], factors, x[first:],
            )  # fmt: skip


@njit(**ONCE)
def _combine_columns(columns, Y, stride, b_column, chosen, factors, x):
    """A reached front, three rows at once: three independent sums."""
    line = 0
    for i in range(0, columns, NARROW):
        b = line + b_column
        x_1, x_2, x_3 = Y[b], Y[b + stride], Y[b + 2 * stride]
        for k in range(len(chosen)):
            at = line + chosen[k]
            x_1 += Y[at] * factors[k]
            x_2 += Y[at + stride] * factors[k]
            x_3 += Y[at + 2 * stride] * factors[k]
        x[i], x[i + 1], x[i + 2] = x_1, x_2, x_3
        line += NARROW * stride


@njit(**KERNEL)
def by_rank(rank, values, result):
    """Put values of nodes, shape (node_count, 3), in elimination order, shape (dof_count,)."""
    for node in range(len(rank)):
        first = 3 * rank[node]
        for i in range(3):
            result[first + i] = values[node, i]


@njit(**KERNEL)
def by_node(rank, values, result):
    """Put values in elimination order, shape (dof_count,), by node, shape (node_count, 3)."""
    for node in range(len(rank)):
        first = 3 * rank[node]
        for i in range(3):
            result[node, i] = values[first + i]


@njit(**KERNEL)
def forward(
    waits_for_all, state, done, fronts, rows, panels, triangles, places, tree, trees, ranges, y, Y,
    work,
):  # fmt: skip
    """y ← L⁻¹ y and Y ← L⁻¹ Y, in place, by all threads that call this.

    Strips of Y never meet, so each thread takes a group of each tree's strips. Trees begin with
    different groups: those of fewer strips than threads are shared out.

    Args:
        waits_for_all: Whether to return when all groups are done, or when none is left to begin.
        state: State of the list of groups; empty without threads.
        done: Whether each group is done, shape (group_count,); likewise.
        fronts: Layout of the fronts.
        rows: Ranks of the nodes below the fronts' own.
        panels: L.
        triangles: Its diagonal blocks.
        places: Row of Y at which each node of a reached front begins, else -1, by rank.
        tree: Tree of each front.
        trees: The parts of Y.
        ranges: Strips with rows of each front, see `ConstraintColumns.strips`.
        y: b by rank, shape (dof_count,); where a front is reached Y takes it over.
        Y: Hᵀ, as `spread_rows` leaves it.
        work: Buffer of the first group, shape (most rows of a front × widest tree,).
    """
    group_count = max(1, len(done))
    group = take(state) if len(done) else 0
    while group < group_count:
        own = work if group == 0 else np.empty(len(work))
        _forward_group(
            group, group_count, fronts, rows, panels, triangles, places, tree, trees, ranges, y, Y, own
        )
        if not len(done):
            return
        finish(group, done)
        group = take(state)
    if waits_for_all:
        for other in range(group_count):
            if not wait_for(other, state, done):
                return


@njit(**ONCE)
def _forward_group(
    group, group_count, fronts, rows, panels, triangles, places, tree, trees, ranges, y, Y, work
):
    """One group of strips of each tree; that of b does the fronts that are not reached."""
    for s in range(len(fronts)):
        front = fronts[s]
        panel = address(panels) + 8 * front.panel
        triangle = address(triangles) + 8 * front.triangles
        place = places[front.first_rank]
        part = trees[tree[s]]
        last, turn = part.row_count // STRIP, (group + tree[s]) % group_count
        low, high = (last + 1) * turn // group_count, (last + 1) * (turn + 1) // group_count
        has_b = low < high and high == last + 1
        if place < 0:
            if has_b:
                _forward_single(front, rows, panel, triangle, address(y), work)
            continue
        if has_b:
            take_over(front, part, place, y, Y)
        at, work_at, stride = address(Y) + 8 * part.start, address(work), part.stride
        strip, end = ranges[s, 0], ranges[s, 1]
        if end >= last:
            end = last + 1
        elif has_b:  # b stands apart
            _forward_columns(
                front, rows, panel, triangle, places, at, stride, place, last, last + 1, work_at
            )
        strip, end = max(strip, low), min(end, high)
        if strip < end:
            _forward_columns(
                front, rows, panel, triangle, places, at, stride, place, strip, end, work_at
            )


@njit(**INNER)
def take_over(front, part, place, y, Y):
    """Add b, of y, to the column that stands for it in the rows of Y of a reached front.

    Args:
        front: See above.
        part: Of Y, the part of the front's tree.
        place: See above.
        y: b by rank, shape (dof_count,).
        Y: The parts of Y, one after the other, shape (size,).
    """
    first, b_place = 3 * front.first_rank, part.start + part.stride * place + part.row_count
    for i in range(front.columns):
        Y[b_place + part.stride * i] += y[first + i]


@njit(**ONCE)
def _forward_single(front, rows, panel, triangle, y, work):
    """A front with the one right-hand side at address y."""
    solve_single(front, panel, triangle, y, work)
    entry = address(work) + 8 * (front.padding + front.columns)
    for p in range(front.row_start, front.row_end):
        add_node(y + NODE_BYTES * rows[p], entry)
        entry += NODE_BYTES


@njit(**ONCE)
def solve_single(front, panel, triangle, y, work):
    """The front's own rows of y, and in `work` what its rows below are to lose."""
    for i in range(front.padding + front.columns, STRIP * front.strips):
        work[i] = 0.0
    work_at = address(work)
    own = y + NODE_BYTES * front.first_rank
    entry = work_at + 8 * front.padding
    for i in range(0, front.columns, NARROW):
        copy_node(entry + 8 * i, own + 8 * i)
    start = 0
    while start < front.columns:
        width = bar_width(start, front.columns)
        solve_forward(width, triangle, entry + 8 * start)
        for i in range(start, start + width, NARROW):
            copy_node(own + 8 * i, entry + 8 * i)
        # Rows of this strip above the bar's end are done with: what they become is not read.
        strip = (front.padding + start + width) // STRIP
        subtract_columns(
            width, front.strips - strip,
            panel + STRIP_BYTES * strip + 8 * start * front.stride, front.stride,
            own + 8 * start, work_at + STRIP_BYTES * strip,
        )  # fmt: skip
        start += width
        triangle += 8 * TRIANGLE


@njit(**INNER)
def _forward_columns(front, rows, panel, triangle, places, Y, stride, place, first_strip, end_strip, work):
    """A reached front, a range of strips of Y at once; Y and work are addresses."""
    strips = end_strip - first_strip
    solve_columns(
        front, panel, triangle, Y, stride, place, first_strip, end_strip, work, STRIP * strips
    )
    Y += STRIP_BYTES * first_strip
    for p in range(front.row_start, front.row_end):
        target = Y + 8 * stride * places[rows[p]]
        if STRIP * strips == stride:
            add_strips(target, work, NARROW * strips)
        else:
            for i in range(NARROW):
                add_strips(target + 8 * stride * i, work + STRIP_BYTES * strips * i, strips)
        work += NARROW * STRIP_BYTES * strips


@njit(**ONCE)
def solve_columns(front, panel, triangle, Y, stride, place, first_strip, end_strip, target, target_stride):
    """The front's own rows of Y, and at `target` what its rows below are to lose."""
    strips = end_strip - first_strip
    own = Y + STRIP_BYTES * first_strip + 8 * stride * place
    entry = panel + 8 * front.padding
    start = 0
    while start < front.columns:
        width = bar_width(start, front.columns)
        solve_product(
            width, strips, start, own, stride, entry + 8 * start, front.stride,
            own + 8 * stride * start, stride, triangle,
        )  # fmt: skip
        start += width
        triangle += 8 * TRIANGLE
    while start < front.rows:
        width = bar_width(start, front.rows)
        negate_product(
            width, strips, front.columns, own, stride, entry + 8 * start, front.stride,
            target, target_stride,
        )  # fmt: skip
        start += width
        target += 8 * target_stride * width


@njit(**KERNEL)
def backward(fronts, rows, panels, triangles, x, work):
    """x ← L⁻ᵀ x, in place.

    Args:
        fronts: Layout of the fronts, shape (front_count,) of `FRONT`.
        rows: Ranks of the nodes below the fronts' own; `Layout.rows`, flat.
        panels: L, shape (panels_size,).
        triangles: Diagonal blocks of L, shape (triangles_size,).
        x: A vector by rank, shape (dof_count,); changed.
        work: Memory for the rows of one front.
    """
    x_at, work_at = address(x), address(work)
    for s in range(len(fronts) - 1, -1, -1):
        front = fronts[s]
        panel = address(panels) + 8 * front.panel
        entry = work_at + 8 * front.padding
        target = entry + 8 * front.columns
        for p in range(front.row_start, front.row_end):
            copy_node(target, x_at + NODE_BYTES * rows[p])
            target += NODE_BYTES
        own = x_at + NODE_BYTES * front.first_rank
        triangle = address(triangles) + 8 * front.triangles
        start = WIDE * ((front.columns - 1) // WIDE)
        while start >= 0:
            width = bar_width(start, front.columns)
            end = front.padding + start + width
            strip = end // STRIP
            subtract_dots(
                width, front.strips - strip, end % STRIP,
                panel + STRIP_BYTES * strip + 8 * start * front.stride, front.stride,
                work_at + STRIP_BYTES * strip, own + 8 * start,
            )  # fmt: skip
            solve_backward(width, triangle + 8 * TRIANGLE * (start // WIDE), own + 8 * start)
            for i in range(start, start + width, NARROW):
                copy_node(entry + 8 * i, own + 8 * i)
            start -= WIDE
