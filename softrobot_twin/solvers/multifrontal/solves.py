"""Forward up the tree, backward down: L⁻¹ and L⁻ᵀ applied to the right-hand sides of a step.

A step needs Y = L⁻¹ Hᵀ and y = L⁻¹ b, and later one backward solve. Rows of H touch few nodes, and
forward elimination carries them only towards the root: the fronts on those paths are *reached*, and
only there has Y rows. b is dense and goes through all fronts.

    Y    body by body (see row_lanes.py): one row a degree of freedom of the reached fronts, one
         *lane* a row of H, and b in the lane after the last; lanes fill whole strips, so that a
         row is one or a few vectors
    y    one number a degree of freedom, used where a front is not reached

In reached fronts the kernels of the factorization do the work: Y's rows are treated like further
rows of the panel. Elsewhere L's columns are multiplied with a single vector.
"""

from __future__ import annotations

from numba import njit

from softrobot_twin.solvers.multifrontal.column_products import subtract_columns, subtract_dots
from softrobot_twin.solvers.multifrontal.dense_front import bar_width
from softrobot_twin.solvers.multifrontal.moves import add_node, add_strips, copy_node
from softrobot_twin.solvers.multifrontal.tiles import (
    NARROW,
    WIDE,
    negate_product,
    solve_product,
)
from softrobot_twin.solvers.multifrontal.triangles import (
    TRIANGLE,
    solve_backward,
    solve_forward,
)
from softrobot_twin.solvers.multifrontal.vector_code import (
    KERNEL,
    STRIP,
    STRIP_BYTES,
    address,
)

_NODE_BYTES = 24


@njit(**KERNEL)
def by_rank(rank, values, result):
    """Put values of nodes, shape (node_count, 3), in elimination order, shape (dof_count,)."""
    for node in range(len(rank)):
        first = 3 * rank[node]
        for i in range(3):
            result[first + i] = values[node, i]


@njit(**KERNEL)
def by_node(rank, values, result):
    """Undo `by_rank`."""
    for node in range(len(rank)):
        first = 3 * rank[node]
        for i in range(3):
            result[node, i] = values[first + i]


@njit(**KERNEL)
def spread_rows(ranks, blocks, lane, places, piece, front, pieces, size, Y):
    """Y ← Hᵀ, whose entries are given as node blocks.

    Args:
        ranks: Rank of the node of each entry, shape (entry_count,).
        blocks: The entries, shape (entry_count, 3).
        lane: Lane of each, from `RowLanes`, as are places, piece, pieces and size.
        places: See lane.
        piece: See lane.
        front: Front of each rank.
        pieces: See lane.
        size: See lane.
        Y: All pieces, shape (size or more,).
    """
    Y[:size] = 0.0
    for entry in range(len(ranks)):
        part = pieces[piece[front[ranks[entry]]]]
        place = part.start + part.lanes * places[ranks[entry]] + lane[entry]
        for i in range(3):
            Y[place + i * part.lanes] += blocks[entry, i]


@njit(**KERNEL)
def forward(fronts, rows, panels, triangles, places, piece, pieces, y, Y, work):
    """y ← L⁻¹ y and Y ← L⁻¹ Y, in place.

    Args:
        fronts: Layout of the fronts.
        rows: Ranks of the nodes below the fronts' own.
        panels: L.
        triangles: Its diagonal blocks.
        places: Row of Y at which each node of a reached front begins, else -1, by rank.
        piece: Piece of each front.
        pieces: The parts of Y.
        y: b by rank, shape (dof_count,); where a front is reached Y takes it over.
        Y: Hᵀ, as `spread_rows` leaves it.
        work: Room, shape (most rows of a front × most lanes,).
    """
    for s in range(len(fronts)):
        front = fronts[s]
        panel = address(panels) + 8 * front.panel
        triangle = address(triangles) + 8 * front.triangles
        place = places[front.first_rank]
        if place < 0:
            _forward_single(front, rows, panel, triangle, address(y), work)
            continue
        part = pieces[piece[s]]
        first = 3 * front.first_rank
        b_place = part.start + part.lanes * place + part.row_count
        for i in range(front.columns):
            Y[b_place + part.lanes * i] += y[first + i]
        _forward_lanes(
            front, rows, panel, triangle, places, address(Y) + 8 * part.start, part.lanes, place,
            address(work),
        )  # fmt: skip


@njit(**KERNEL)
def _forward_single(front, rows, panel, triangle, y, work):
    """A front with the one right-hand side at address y."""
    for i in range(front.padding + front.columns, STRIP * front.strips):
        work[i] = 0.0
    work_at = address(work)
    own = y + _NODE_BYTES * front.first_rank
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
    entry += 8 * front.columns
    for p in range(front.row_start, front.row_end):
        add_node(y + _NODE_BYTES * rows[p], entry)
        entry += _NODE_BYTES


@njit(**KERNEL)
def _forward_lanes(front, rows, panel, triangle, places, Y, lanes, place, work):
    """A reached front, all lanes of Y at once; Y and work are addresses."""
    strips = lanes // STRIP
    own = Y + 8 * lanes * place
    entry = panel + 8 * front.padding
    start = 0
    while start < front.columns:
        width = bar_width(start, front.columns)
        solve_product(
            width, strips, start, own, lanes, entry + 8 * start, front.stride,
            own + 8 * lanes * start, lanes, triangle,
        )  # fmt: skip
        start += width
        triangle += 8 * TRIANGLE
    target = work
    while start < front.rows:
        width = bar_width(start, front.rows)
        negate_product(
            width, strips, front.columns, own, lanes, entry + 8 * start, front.stride,
            target, lanes,
        )  # fmt: skip
        start += width
        target += 8 * lanes * width
    for p in range(front.row_start, front.row_end):
        add_strips(Y + 8 * lanes * places[rows[p]], work, 3 * strips)
        work += _NODE_BYTES * lanes


@njit(**KERNEL)
def gram(pieces, rows, Y, room, W, free):
    """W ← YᵀY and free ← Yᵀ y, added up over the pieces.

    Args:
        pieces: The parts of Y.
        rows: Row of H in each lane, piece by piece.
        Y: L⁻¹ Hᵀ.
        room: Room for the product of one piece.
        W: Written, shape (row_count, row_count).
        free: Written, shape (row_count,).
    """
    W[:] = 0.0
    free[:] = 0.0
    for p in range(len(pieces)):
        lanes, count = pieces[p].lanes, pieces[p].row_count
        at, room_at = address(Y) + 8 * pieces[p].start, address(room)
        for start in range(0, count, WIDE):
            # The product is symmetric: strips before the bar are known already.
            strip = start // STRIP
            negate_product(
                WIDE, lanes // STRIP - strip, pieces[p].dof_count, at + STRIP_BYTES * strip, lanes,
                at + 8 * start, lanes, room_at + 8 * start * lanes + STRIP_BYTES * strip, lanes,
            )  # fmt: skip
        for i in range(count):
            row, line = rows[pieces[p].row_start + i], i * lanes
            for j in range(i, count):
                column = rows[pieces[p].row_start + j]
                W[row, column] -= room[line + j]
                W[column, row] = W[row, column]
            free[row] -= room[line + count]


@njit(**KERNEL)
def combine(fronts, places, pieces, rows, y, Y, multipliers, own, x):
    """x ← y + Y λ, by rank, shape (dof_count,); own is room for the multipliers of a piece."""
    for p in range(len(pieces)):
        part = pieces[p]
        for k in range(part.row_count):
            own[k] = multipliers[rows[part.row_start + k]]
        for s in range(part.first_front, part.end_front):
            first, place = 3 * fronts[s].first_rank, places[fronts[s].first_rank]
            if place < 0:
                for i in range(fronts[s].columns):
                    x[first + i] = y[first + i]
            else:
                lines = Y[part.start + part.lanes * place :]
                _combine_lanes(
                    fronts[s].columns, lines, part.lanes, part.row_count, own, x[first:]
                )


@njit(**KERNEL)
def _combine_lanes(columns, Y, lanes, count, multipliers, x):
    """A reached front, three rows at once: their sums do not wait for each other."""
    line = 0
    for i in range(0, columns, NARROW):
        a, b, c = Y[line + count], Y[line + lanes + count], Y[line + 2 * lanes + count]
        for k in range(count):
            a += Y[line + k] * multipliers[k]
            b += Y[line + lanes + k] * multipliers[k]
            c += Y[line + 2 * lanes + k] * multipliers[k]
        x[i], x[i + 1], x[i + 2] = a, b, c
        line += NARROW * lanes


@njit(**KERNEL)
def backward(fronts, rows, panels, triangles, x, work):
    """x ← L⁻ᵀ x, in place; see `forward`."""
    x_at, work_at = address(x), address(work)
    for s in range(len(fronts) - 1, -1, -1):
        front = fronts[s]
        panel = address(panels) + 8 * front.panel
        entry = work_at + 8 * front.padding
        target = entry + 8 * front.columns
        for p in range(front.row_start, front.row_end):
            copy_node(target, x_at + _NODE_BYTES * rows[p])
            target += _NODE_BYTES
        own = x_at + _NODE_BYTES * front.first_rank
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
