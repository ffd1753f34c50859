"""Numeric factorization: the dense factorization of each front, up the tree.

A front is a lower trapezoid: its first columns, the *panel*, are complete and are factorized; what
they leave of the remaining rows and columns, the *update*, is added into the parent front.

        ┌ T₁          ┐
        │ L  T₂       │          panel: columns of L, the triangles T stored apart
        │ L  L   U    │          update: U = - L₂ L₂ᵀ, later added into the parent
        └ L  L   U  U ┘

Rows are aligned to the lower end of the panel's storage, so that columns *end* on a whole strip of
eight; the strip in which a column begins also holds rows above the diagonal. The numbers computed
there are never read by anything else.

Arguments of the kernels here:
    front: Layout of one front.
    first, start, end: Fronts, or columns of one front.
    are_some: Whether the columns are not all; a constant, so that all need no code for it.
    first_block, end_block: The matrix's blocks in these columns.
    panels_at, updates_at: Addresses of the panels and of the updates.
    fronts, children, runs, block_places, storage, panels, updates, triangles: Their shapes are told
        by `factorize`.
"""

from __future__ import annotations

from softrobot_twin.kernels.compilation import INNER, KERNEL, njit
from softrobot_twin.solvers.multifrontal.dense_kernels import (
    NARROW,
    TRIANGLE,
    WIDE,
    add_node_columns,
    clear_strips,
    factor_triangle,
    negate_product,
    place_block,
    solve_product,
    subtract_product,
)
from softrobot_twin.solvers.multifrontal.vector_code import STRIP, STRIP_BYTES, address

SUCCESS = -1
_BLOCK_BYTES = 72
# Strips that hold all of a diagonal block: six rows may straddle two.
_DIAGONAL_STRIPS = 2


@njit(**INNER)
def bar_width(start, end):
    """Columns of the bar from column `start` of those before `end`: two nodes, or the last one."""
    return WIDE if start + WIDE <= end else NARROW


@njit(**KERNEL)
def factor_panel(panel, stride, padding, first, columns, strips, triangles):
    """Factorize columns of a panel, each bar by all bars left of it.

    Args:
        panel: Address of the panel, at its first, padded row.
        stride: Distance of its columns.
        padding: Unused rows at the top.
        first: First of the columns; those left of it are factorized.
        columns: End of the columns.
        strips: Height, padding included, in strips of eight rows.
        triangles: Address of the triangles of these columns, one after the other.

    Returns:
        False if the matrix is not positive definite.
    """
    start = first
    while start < columns:
        width = bar_width(start, columns)
        strip = (padding + start) // STRIP
        left = panel + STRIP_BYTES * strip
        bar = left + 8 * start * stride
        diagonal = panel + 8 * (padding + start)
        height = min(_DIAGONAL_STRIPS, strips - strip)
        # The bar's own triangle first: the rest of the bar needs it.
        subtract_product(width, height, start, left, stride, diagonal, stride, bar, stride)
        if not factor_triangle(width, diagonal + 8 * start * stride, stride, triangles):
            return False
        solve_product(width, height, 0, left, stride, diagonal, stride, bar, stride, triangles)
        below = STRIP_BYTES * height
        solve_product(
            width, strips - strip - height, start,
            left + below, stride, diagonal, stride, bar + below, stride, triangles,
        )  # fmt: skip
        start += width
        triangles += 8 * TRIANGLE
    return True


@njit(**KERNEL)
def make_update(panel, stride, padding, columns, start, rows, strips, update, update_stride):
    """U = - L₂ L₂ᵀ, lower part, of some columns.

    Args:
        panel: Address of the factorized panel, at its first, padded row.
        stride: Distance of its columns.
        padding: Unused rows at the top.
        columns: Number of columns of the panel.
        start: First column of U that is written, as a row of the front.
        rows: End of the columns of U, likewise.
        strips: Height, padding included, in strips of eight rows.
        update: Address of the update, at the strip in which its first row lies.
        update_stride: Distance of its columns.
    """
    first_strip = (padding + columns) // STRIP
    while start < rows:
        width = bar_width(start, rows)
        strip = (padding + start) // STRIP
        left = panel + STRIP_BYTES * strip
        bar = update + STRIP_BYTES * (strip - first_strip) + 8 * (start - columns) * update_stride
        right = panel + 8 * (padding + start)
        negate_product(
            width, strips - strip, columns, left, stride, right, stride, bar, update_stride
        )
        start += width


@njit(**KERNEL)
def factorize(fronts, children, runs, block_places, storage, panels, updates, triangles):
    """A = L Lᵀ.

    Args:
        fronts: Layout of the fronts, children before parents, shape (front_count,) of `FRONT`.
        children: Fronts whose updates a front adds, shape (front_count,).
        runs: Where updates go, shape (run_count,) of `RUN`.
        block_places: Where the matrix's blocks go in `panels`, shape (block_count,).
        storage: The matrix's lower blocks [N/m], nine doubles each.
        panels: Where L is written, shape (panels_size,).
        updates: Memory of the updates, shape (updates_size,).
        triangles: Where the triangles of L are written, shape (triangles_size,).

    Returns:
        -1, or the first front that is not positive definite.
    """
    return factor_fronts(
        0, len(fronts), fronts, children, runs, block_places, storage, panels, updates, triangles
    )


@njit(**INNER)
def factor_fronts(first, end, fronts, children, runs, block_places, storage, panels, updates, triangles):
    """The same of fronts `first` to `end`, whose other children are factorized."""
    panels_at, updates_at, triangles_at = address(panels), address(updates), address(triangles)
    for s in range(first, end):
        front = fronts[s]
        panel = panels_at + 8 * front.panel
        fill_columns(
            front, 0, front.columns, front.block_start, front.block_end, panels_at, storage,
            block_places,
        )  # fmt: skip
        add_to_panel(
            front, False, 0, front.columns, fronts, children, runs, panels_at, updates_at
        )
        if not factor_panel(
            panel, front.stride, front.padding, 0, front.columns, front.strips,
            triangles_at + 8 * front.triangles,
        ):  # fmt: skip
            return s
        if front.rows > front.columns:
            make_update_columns(
                front, False, front.columns, front.rows, fronts, children, runs, panels_at,
                updates_at,
            )  # fmt: skip
    return SUCCESS


@njit(**INNER)
def make_update_columns(front, are_some, start, end, fronts, children, runs, panels_at, updates_at):
    """Columns of a front's update, those of its children's updates included."""
    update = updates_at + 8 * front.update
    make_update(
        panels_at + 8 * front.panel, front.stride, front.padding, front.columns, start, end,
        front.strips, update, front.update_stride,
    )  # fmt: skip
    # Where entry (0, 0) of the front would be if the update held all of it.
    entry = update + 8 * (front.update_padding - front.columns * (1 + front.update_stride))
    for k in range(front.child_start, front.child_end):
        child = fronts[children[k]]
        _add_update(
            updates_at, child, runs, child.run_split, child.run_end, are_some, start, end, entry,
            front.update_stride,
        )  # fmt: skip


@njit(**INNER)
def fill_columns(front, start, end, first_block, end_block, panels_at, storage, block_places):
    """Clear the lower part of columns of the panel, and copy the matrix's blocks into them."""
    panel, storage_at = panels_at + 8 * front.panel, address(storage)
    for column in range(start, end):
        strip = (front.padding + column) // STRIP
        clear_strips(panel + 8 * column * front.stride + STRIP_BYTES * strip, front.strips - strip)
    for p in range(first_block, end_block):
        place_block(
            panels_at + 8 * block_places[p], front.stride, storage_at + _BLOCK_BYTES * p
        )


@njit(**INNER)
def add_to_panel(front, are_some, start, end, fronts, children, runs, panels_at, updates_at):
    """Add the updates of a front's children to columns of its panel."""
    entry = panels_at + 8 * (front.panel + front.padding)
    for k in range(front.child_start, front.child_end):
        child = fronts[children[k]]
        _add_update(
            updates_at, child, runs, child.run_start, child.run_split, are_some, start, end, entry,
            front.stride,
        )  # fmt: skip


@njit(**INNER)
def _add_update(updates_at, child, runs, first_run, end_run, are_some, start, end, entry, stride):
    """Add those columns of a child's update that certain runs hold (extend-add).

    Args:
        updates_at: Address of all updates.
        child: Layout of the child.
        runs: Where updates go.
        first_run: First of the runs.
        end_run: End of the runs; the rows continue to the child's last run.
        are_some: Whether not all of these columns are added to, but those from `start` to `end`.
        start: First column of the parent's front that is added to.
        end: End of these columns.
        entry: Address of entry (0, 0) of the parent's front.
        stride: Distance of the columns there.
    """
    source_entry = updates_at + 8 * (child.update + child.update_padding)
    source_step, step = 8 * (1 + child.update_stride), 8 * (1 + stride)
    for k in range(first_run, end_run):
        run = runs[k]
        first, last = 0, run.count
        if are_some:
            first, last = max(first, start - run.target), min(last, end - run.target)
        for column in range(first, last, 3):
            source_column, column_there = run.source + column, run.target + column
            source = source_entry + source_step * source_column
            target = entry + step * column_there
            add_node_columns(target, stride, source, child.update_stride, run.count - column)
            for below in range(k + 1, child.run_end):
                rows = runs[below]
                add_node_columns(
                    target + 8 * (rows.target - column_there), stride,
                    source + 8 * (rows.source - source_column), child.update_stride, rows.count,
                )  # fmt: skip
