"""The numeric factorization: up the tree, front by front."""

from __future__ import annotations

from numba import njit

from softrobot_twin.solvers.multifrontal.dense_front import factor_panel, make_update
from softrobot_twin.solvers.multifrontal.moves import (
    add_node_columns,
    clear_strips,
    place_block,
)
from softrobot_twin.solvers.multifrontal.vector_code import (
    KERNEL,
    STRIP,
    STRIP_BYTES,
    address,
)

SUCCESS = -1
_BLOCK_BYTES = 72


@njit(**KERNEL)
def factorize(fronts, children, runs, block_places, storage, panels, updates, triangles):
    """A = L Lᵀ.

    Args:
        fronts: Layout of the fronts, children before parents.
        children: Fronts whose updates a front takes up.
        runs: Where updates go.
        block_places: Where the matrix's blocks go in `panels`.
        storage: The matrix's lower blocks, nine doubles each.
        panels: Where L is written.
        updates: Room for the updates.
        triangles: Where the triangles of L are written.

    Returns:
        -1, or the first front that is not positive definite.
    """
    panels_at, updates_at = address(panels), address(updates)
    storage_at, triangles_at = address(storage), address(triangles)
    for s in range(len(fronts)):
        front = fronts[s]
        panel = panels_at + 8 * front.panel
        _fill_panel(front, panel, panels_at, storage_at, block_places)
        entry = panel + 8 * front.padding
        for k in range(front.child_start, front.child_end):
            child = fronts[children[k]]
            _add_update(
                updates_at, child, runs, child.run_start, child.run_split, entry, front.stride
            )
        if not factor_panel(
            panel, front.stride, front.padding, front.columns, front.strips,
            triangles_at + 8 * front.triangles,
        ):  # fmt: skip
            return s
        if front.rows == front.columns:
            continue
        update = updates_at + 8 * front.update
        make_update(
            panel, front.stride, front.padding, front.columns, front.rows, front.strips,
            update, front.update_stride,
        )  # fmt: skip
        # Where entry (0, 0) of the front would be if the update held all of it.
        entry = update + 8 * (front.update_padding - front.columns * (1 + front.update_stride))
        for k in range(front.child_start, front.child_end):
            child = fronts[children[k]]
            _add_update(
                updates_at, child, runs, child.run_split, child.run_end, entry,
                front.update_stride,
            )  # fmt: skip
    return SUCCESS


@njit(**KERNEL)
def _fill_panel(front, panel, panels_at, storage_at, block_places):
    """Clear the panel's lower part, and put the matrix's blocks there."""
    for column in range(front.columns):
        strip = (front.padding + column) // STRIP
        clear_strips(panel + 8 * column * front.stride + STRIP_BYTES * strip, front.strips - strip)
    for p in range(front.block_start, front.block_end):
        place_block(
            panels_at + 8 * block_places[p], front.stride, storage_at + _BLOCK_BYTES * p
        )


@njit(**KERNEL)
def _add_update(updates_at, child, runs, first_run, end_run, entry, stride):
    """Add those columns of a child's update that certain runs hold (extend-add).

    Args:
        updates_at: Address of all updates.
        child: Layout of the child.
        runs: Where updates go.
        first_run: First of the runs.
        end_run: End of the runs; the rows go on to the child's last run.
        entry: Address of entry (0, 0) of the parent's front.
        stride: Distance of the columns there.
    """
    source_entry = updates_at + 8 * (child.update + child.update_padding)
    source_step, step = 8 * (1 + child.update_stride), 8 * (1 + stride)
    for k in range(first_run, end_run):
        run = runs[k]
        for column in range(0, run.count, 3):
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
