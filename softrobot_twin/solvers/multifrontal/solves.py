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
def forward(fronts, rows, panels, triangles, places, piece, pieces, ranges, y, Y, work):
    """y ← L⁻¹ y and Y ← L⁻¹ Y, in place.

    Args:
        fronts: Layout of the fronts.
        rows: Ranks of the nodes below the fronts' own.
        panels: L.
        triangles: Its diagonal blocks.
        places: Row of Y at which each node of a reached front begins, else -1, by rank.
        piece: Piece of each front.
        pieces: The parts of Y.
        ranges: Strips with rows of each front, see `RowLanes.strips`.
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
        first, lanes = 3 * front.first_rank, part.lanes
        b_place = part.start + lanes * place + part.row_count
        for i in range(front.columns):
            Y[b_place + lanes * i] += y[first + i]
        at, room = address(Y) + 8 * part.start, address(work)
        strip, end, last = ranges[s, 0], ranges[s, 1], part.row_count // STRIP
        if end >= last:
            end = last + 1
        else:  # b stands apart
            _forward_lanes(
                front, rows, panel, triangle, places, at, lanes, place, last, last + 1, room
            )
        _forward_lanes(front, rows, panel, triangle, places, at, lanes, place, strip, end, room)


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
def _forward_lanes(
    front, rows, panel, triangle, places, Y, lanes, place, first_strip, end_strip, work
):
    """A reached front, a range of strips of Y at once; Y and work are addresses."""
    strips = end_strip - first_strip
    Y += STRIP_BYTES * first_strip
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
            target, STRIP * strips,
        )  # fmt: skip
        start += width
        target += STRIP_BYTES * strips * width
    for p in range(front.row_start, front.row_end):
        target = Y + 8 * lanes * places[rows[p]]
        if STRIP * strips == lanes:
            add_strips(target, work, NARROW * strips)
        else:
            for i in range(NARROW):
                add_strips(target + 8 * lanes * i, work + STRIP_BYTES * strips * i, strips)
        work += NARROW * STRIP_BYTES * strips


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
