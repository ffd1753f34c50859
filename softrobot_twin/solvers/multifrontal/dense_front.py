"""Partial Cholesky factorization of one front, dense, in place.

A front is a lower trapezoid: its first columns, the *panel*, are complete and are factorized; what
they leave of the remaining rows and columns, the *update*, is handed to the parent front.

        ┌ T₁          ┐
        │ L  T₂       │          panel: columns of L, the triangles T kept apart
        │ L  L   U    │          update: U = - L₂ L₂ᵀ, later added into the parent
        └ L  L   U  U ┘

Rows are pushed to the lower end of the panel's storage, so that columns *end* on a whole strip of
eight; the strip in which a column begins also holds rows above the diagonal. What is computed there
is never read for anything but itself.
"""

from __future__ import annotations

from numba import njit

from softrobot_twin.solvers.multifrontal.tiles import (
    NARROW,
    WIDE,
    negate_product,
    solve_product,
    subtract_product,
)
from softrobot_twin.solvers.multifrontal.triangles import TRIANGLE, factor_triangle
from softrobot_twin.solvers.multifrontal.vector_code import KERNEL, STRIP, STRIP_BYTES

# Strips that hold all of a diagonal block: six rows may straddle two.
_DIAGONAL_STRIPS = 2


@njit(**KERNEL)
def bar_width(start, end):
    """Columns of the bar that starts here: two nodes, or the last one."""
    return WIDE if start + WIDE <= end else NARROW


@njit(**KERNEL)
def factor_panel(panel, stride, padding, columns, strips, triangles):
    """Factorize the columns of a panel, each bar by all bars left of it.

    Args:
        panel: Address of the panel, at its first, padded row.
        stride: Distance of its columns.
        padding: Unused rows at the top.
        columns: Number of columns.
        strips: Height, padding included, in strips of eight rows.
        triangles: Address of the triangles, one after the other.

    Returns:
        False if the matrix is not positive definite.
    """
    start = 0
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
def make_update(panel, stride, padding, columns, rows, strips, update, update_stride):
    """U = - L₂ L₂ᵀ, lower part.

    Args:
        panel: Address of the factorized panel, at its first, padded row.
        stride: Distance of its columns.
        padding: Unused rows at the top.
        columns: Number of columns.
        rows: Number of rows, the columns' own included.
        strips: Height, padding included, in strips of eight rows.
        update: Address of the update, at the strip in which its first row lies.
        update_stride: Distance of its columns.
    """
    first_strip = (padding + columns) // STRIP
    start = columns
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
