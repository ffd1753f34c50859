"""The product at the heart of the factorization, C ← C - A Bᵀ, in tiles that stay in registers.

All arithmetic of a multifrontal Cholesky worth counting is one operation: columns of a panel lose
the product of earlier columns. A kernel here works on a *bar* of C, as wide as one or two nodes
(three or six columns) and any number of strips of eight rows tall:

    negate     C ← -A Bᵀ
    subtract   C ← C - A Bᵀ
    solve      C ← (C - A Bᵀ) T⁻ᵀ        with T the bar's own triangular block

A is as tall as C, B as tall as C is wide, both have `depth` columns. The bar is cut into tiles of
up to four strips; a tile of 32 × 6 needs 24 registers of AVX-512 for its sums, and each step of
depth loads four vectors of A and six numbers of B for 24 fused multiply-adds, so that the
multipliers never wait. Nothing is packed or copied: A, B and C stay where the panel has them.
"""

from __future__ import annotations

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from softrobot_twin.solvers.multifrontal.vector_code import (
    KERNEL,
    LANES,
    STRIP,
    TALLEST,
    VECTOR,
    VECTORS,
    ZERO,
    VectorCode,
)

# Columns of the bars: the three of one node, or of two.
NARROW = 3
WIDE = 6

_SIGNATURE = types.void(*[types.int64] * 9)


def _tile(code: VectorCode, mode: str, width: int, height: int, operands: tuple) -> None:
    """Write the product of one tile, `height` strips tall."""
    depth, a, a_stride, b, b_stride, c, c_stride, triangle = operands
    vectors = range(height * VECTORS)
    c_columns = code.columns(c, c_stride, width)
    sums = [
        [
            code.variable(ZERO if mode == "negate" else code.load(column, LANES * m, VECTOR))
            for m in vectors
        ]
        for column in c_columns
    ]
    a_column, b_column = code.variable(a), code.variable(b)
    with code.repeat(depth):
        left = [
            code.builder.fneg(code.load(a_column.get(), LANES * m, VECTOR)) for m in vectors
        ]
        for n in range(width):
            right = code.splat(code.load(b_column.get(), n))
            for m in vectors:
                sums[n][m].set(code.multiply_add(left[m], right, sums[n][m].get()))
        a_column.set(code.at(a_column.get(), a_stride))
        b_column.set(code.at(b_column.get(), b_stride))
    values = [[entry.get() for entry in column] for column in sums]
    if mode == "solve":
        _solve_tile(code, values, triangle)
    for column, place in zip(values, c_columns, strict=True):
        for m in vectors:
            code.store(column[m], place, LANES * m)


def _solve_tile(code: VectorCode, values: list[list[ir.Value]], triangle: ir.Value) -> None:
    """Write X T⁻ᵀ of a tile in registers; T has its diagonal inverted, and WIDE rows."""
    for n, column in enumerate(values):
        for j in range(n):
            entry = code.splat(code.builder.fneg(code.load(triangle, WIDE * j + n)))
            for m in range(len(column)):
                column[m] = code.multiply_add(values[j][m], entry, column[m])
        inverse = code.splat(code.load(triangle, (WIDE + 1) * n))
        column[:] = [code.builder.fmul(value, inverse) for value in column]


def _bar(mode: str, width: int):
    """Make the intrinsic of one mode and width: tall tiles first, then what is left."""

    @intrinsic
    def bar(_typing, strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle):
        def write(_context, builder, _signature, arguments):
            code = VectorCode(builder)
            strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle = arguments
            a_rows, c_rows = code.variable(a), code.variable(c)

            def tile(height):
                operands = (
                    depth, a_rows.get(), a_stride, b, b_stride, c_rows.get(), c_stride, triangle
                )  # fmt: skip
                _tile(code, mode, width, height, operands)

            tallest = code.integer(TALLEST)
            with code.repeat(builder.sdiv(strips, tallest)):
                tile(TALLEST)
                a_rows.set(code.at(a_rows.get(), STRIP * TALLEST))
                c_rows.set(code.at(c_rows.get(), STRIP * TALLEST))
            rest = builder.srem(strips, tallest)
            for height in range(1, TALLEST):
                with builder.if_then(builder.icmp_signed("==", rest, code.integer(height))):
                    tile(height)

        return _SIGNATURE, write

    return bar


_negate_wide, _negate_narrow = _bar("negate", WIDE), _bar("negate", NARROW)
_subtract_wide, _subtract_narrow = _bar("subtract", WIDE), _bar("subtract", NARROW)
_solve_wide, _solve_narrow = _bar("solve", WIDE), _bar("solve", NARROW)


@njit(**KERNEL)
def negate_product(width, strips, depth, a, a_stride, b, b_stride, c, c_stride):
    """C ← -A Bᵀ of a bar.

    Args:
        width: Columns of C and rows of B, `WIDE` or `NARROW`.
        strips: Height of C and A in strips of eight rows.
        depth: Columns of A and B.
        a: Address of A.
        a_stride: Distance of its columns.
        b: Address of B.
        b_stride: Distance of its columns.
        c: Address of C.
        c_stride: Distance of its columns.
    """
    if width == WIDE:
        _negate_wide(strips, depth, a, a_stride, b, b_stride, c, c_stride, 0)
    else:
        _negate_narrow(strips, depth, a, a_stride, b, b_stride, c, c_stride, 0)


@njit(**KERNEL)
def subtract_product(width, strips, depth, a, a_stride, b, b_stride, c, c_stride):
    """C ← C - A Bᵀ of a bar; see `negate_product`."""
    if width == WIDE:
        _subtract_wide(strips, depth, a, a_stride, b, b_stride, c, c_stride, 0)
    else:
        _subtract_narrow(strips, depth, a, a_stride, b, b_stride, c, c_stride, 0)


@njit(**KERNEL)
def solve_product(width, strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle):
    """C ← (C - A Bᵀ) T⁻ᵀ of a bar; see `negate_product`.

    Args:
        triangle: Address of T, lower, columns `WIDE` doubles apart, its diagonal inverted.
    """
    if width == WIDE:
        _solve_wide(strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle)
    else:
        _solve_narrow(strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle)
