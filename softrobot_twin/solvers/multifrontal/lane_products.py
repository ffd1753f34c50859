"""What is done with Y besides solving: Hᵀ goes in, W = YᵀY and x = y + Y λ come out.

Y lies body by body, and each front has rows in a range of strips only, see row_lanes.py; b is in
the lane after the last row.
"""

from __future__ import annotations

from numba import njit

from softrobot_twin.solvers.multifrontal.tiles import NARROW, WIDE, subtract_product
from softrobot_twin.solvers.multifrontal.vector_code import (
    KERNEL,
    STRIP,
    STRIP_BYTES,
    address,
)


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
def gram(fronts, places, pieces, ranges, rows, Y, room, W, free):
    """W ← YᵀY and free ← Yᵀ y, added up over the pieces.

    Args:
        fronts: Layout of the fronts.
        places: Row of Y at which each node of a reached front begins, else -1, by rank.
        pieces: The parts of Y.
        ranges: Strips with rows of each front.
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
        room[: lanes * count] = 0.0
        depth, line, strip, end = 0, 0, 0, 0
        for s in range(pieces[p].first_front, pieces[p].end_front):
            if places[fronts[s].first_rank] < 0:
                continue
            if ranges[s, 0] != strip or ranges[s, 1] != end:
                _subtract_gram(pieces[p], strip, end, depth, line, Y, room)
                strip, end = ranges[s, 0], ranges[s, 1]
                line += depth
                depth = 0
            depth += fronts[s].columns
        _subtract_gram(pieces[p], strip, end, depth, line, Y, room)
        for i in range(count):
            row, line = rows[pieces[p].row_start + i], i * lanes
            for j in range(i, count):
                column = rows[pieces[p].row_start + j]
                W[row, column] -= room[line + j]
                W[column, row] = W[row, column]
            free[row] -= room[line + count]


@njit(**KERNEL)
def _subtract_gram(part, first_strip, end_strip, depth, line, Y, room):
    """Subtract what some rows of Y, with the same range of strips, give to YᵀY of a piece.

    The product is symmetric: strips before a bar are left out.
    """
    lanes, last = part.lanes, part.row_count // STRIP
    at, to = address(Y) + 8 * (part.start + line * lanes), address(room)
    joined = last + 1 if end_strip >= last else end_strip
    for start in range(STRIP * first_strip, min(STRIP * end_strip, part.row_count), WIDE):
        strip = start // STRIP
        bar, column = at + 8 * start, to + 8 * start * lanes
        subtract_product(
            WIDE, joined - strip, depth, at + STRIP_BYTES * strip, lanes, bar, lanes,
            column + STRIP_BYTES * strip, lanes,
        )  # fmt: skip
        if joined <= last:  # b stands apart
            subtract_product(
                WIDE, 1, depth, at + STRIP_BYTES * last, lanes, bar, lanes,
                column + STRIP_BYTES * last, lanes,
            )  # fmt: skip


@njit(**KERNEL)
def gather_lines(pieces, rows, Y, Yt, free):
    """Yᵀ with one line for each row of H, and free ← Yᵀ y.

    Args:
        pieces: The parts of Y.
        rows: See `gram`.
        Y: L⁻¹ Hᵀ, and L⁻¹ b in the lane after the last row.
        Yt: Written where it is not zero, shape (row_count, rank).
        free: Added to, shape (row_count,).
    """
    first = 0
    for p in range(len(pieces)):
        count, lanes = pieces[p].row_count, pieces[p].lanes
        if count == 0:
            continue
        for line in range(pieces[p].dof_count):
            at = pieces[p].start + line * lanes
            b = Y[at + count]
            for lane in range(count):
                row = rows[pieces[p].row_start + lane]
                Yt[row, first + line] = Y[at + lane]
                free[row] += Y[at + lane] * b
        first += pieces[p].dof_count


@njit(**KERNEL)
def combine(
    fronts, places, pieces, ranges, rows, arrival, y, Y, multipliers, chosen, factors, x
):
    """x ← y + Y λ, by rank, shape (dof_count,).

    They are added in the order in which the rows came, whatever their lanes.

    Args:
        fronts: Layout of the fronts.
        places: See `gram`.
        pieces: See `gram`.
        ranges: See `gram`.
        rows: See `gram`.
        arrival: Lanes in the order in which their rows came, piece by piece.
        y: L⁻¹ b by rank where a front is not reached.
        Y: L⁻¹ Hᵀ, and L⁻¹ b where a front is reached.
        multipliers: λ, shape (row_count,).
        chosen: Room for the lanes of a front, as many as rows.
        factors: Room for their multipliers.
        x: Written.
    """
    for p in range(len(pieces)):
        part = pieces[p]
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
            _combine_lanes(
                fronts[s].columns, Y[part.start + part.lanes * place :], part.lanes,
                part.row_count, chosen[:count], factors, x[first:],
            )  # fmt: skip


@njit(**KERNEL)
def _combine_lanes(columns, Y, lanes, b_lane, chosen, factors, x):
    """A reached front, three rows at once: their sums do not wait for each other."""
    line = 0
    for i in range(0, columns, NARROW):
        b = line + b_lane
        x_1, x_2, x_3 = Y[b], Y[b + lanes], Y[b + 2 * lanes]
        for k in range(len(chosen)):
            at = line + chosen[k]
            x_1 += Y[at] * factors[k]
            x_2 += Y[at + lanes] * factors[k]
            x_3 += Y[at + 2 * lanes] * factors[k]
        x[i], x[i + 1], x[i + 2] = x_1, x_2, x_3
        line += NARROW * lanes
