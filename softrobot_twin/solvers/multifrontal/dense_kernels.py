"""Dense kernels of the factorization and of the solves, in vector registers.

**Products of bars.** Nearly all arithmetic of a multifrontal Cholesky factorization is one
operation: columns of a panel lose the product of earlier columns. A kernel works on a *bar* of C,
as wide as one or two nodes (three or six columns) and any number of strips of eight rows tall:

    negate     C ← -A Bᵀ
    subtract   C ← C - A Bᵀ
    solve      C ← (C - A Bᵀ) T⁻ᵀ        with T the bar's own triangular block

A is as tall as C, B as tall as C is wide, both have `depth` columns. The bar is cut into tiles of
up to four strips. A tile of 32 × 6 needs 24 registers of AVX-512 for its sums, and each step of
depth loads four vectors of A and six numbers of B for 24 fused multiply-adds, so that the
multipliers never wait. Nothing is packed or copied: A, B and C stay in the panel.

**Triangles.** The diagonal blocks of three or six columns stay in registers. A block T (lower,
T Tᵀ = the diagonal block) is stored by columns of `WIDE` doubles, with the *inverse* of each
diagonal entry in its place: every use of T divides by its diagonal.

**Copies and sums.** Clear a panel, copy the matrix's blocks into it, add the updates of children.

**Products with one vector.** For the solves with a single right-hand side, a panel is read in bars,
so that the vector is read and written once for six columns; memory, not arithmetic, is the limit.

All kernels work on raw addresses.

Arguments of the kernels here:
    a, b, c, columns, rows, triangle, x: Addresses of A, B, C, L, the rows of a panel, T and x.
    a_stride, b_stride, c_stride, stride: Distance of the columns of A, B, C and L.
    depth: Columns of A and B.
    skipped: Rows of L that are left out.
    strips: Height in strips of eight rows.
    width: Columns of a bar, `WIDE` or `NARROW`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from inspect import signature

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.solvers.multifrontal.vector_code import (
    DOUBLE,
    STRIP,
    TALLEST,
    VECTOR,
    VECTOR_WIDTH,
    VECTORS,
    ZERO,
    VectorCode,
)

# Columns of the bars: the three of one node, or of two.
NARROW = 3
WIDE = 6
DIRECTIONS = 3

TRIANGLE = WIDE * WIDE  # doubles kept for a block
_ONE = ir.Constant(DOUBLE, 1.0)
_NOTHING = ir.Constant(DOUBLE, 0.0)
_INFINITY = ir.Constant(DOUBLE, float("inf"))
_PAIR = ir.VectorType(DOUBLE, 2)


def _coded(write: Callable, returned: Callable = types.void) -> Callable:
    """Make the intrinsic whose code a function writes; its arguments are integers, such as addresses.

    Args:
        write: Called with the `VectorCode` and the arguments.
        returned: Type of what it returns.
    """

    def kernel(_typing, *arguments):
        def generate(_context, builder, _signature, values):
            return write(VectorCode(builder), *values)

        return returned(*[types.int64] * len(arguments)), generate

    # By it numba passes the arguments one by one.
    kernel.__signature__ = signature(write)
    return intrinsic(kernel)


def _of_width(write: Callable) -> Callable:
    """Make the intrinsic whose first argument is a width, `WIDE` or else `NARROW`, from code for one."""

    def write_both(code: VectorCode, width: ir.Value, *arguments: ir.Value) -> None:
        is_wide = code.builder.icmp_signed("==", width, code.integer(WIDE))
        with code.builder.if_else(is_wide) as (wide, narrow):
            with wide:
                write(code, WIDE, *arguments)
            with narrow:
                write(code, NARROW, *arguments)

    write_both.__signature__ = signature(write)
    return _coded(write_both)


def _tile(code: VectorCode, mode: str, width: int, height: int, operands: tuple) -> None:
    """Write the product of one tile, `height` strips tall."""
    depth, a, a_stride, b, b_stride, c, c_stride, triangle = operands
    vectors = range(height * VECTORS)
    c_columns = code.columns(c, c_stride, width)
    sums = [
        [
            code.variable(ZERO if mode == "negate" else code.load(column, VECTOR_WIDTH * m, VECTOR))
            for m in vectors
        ]
        for column in c_columns
    ]
    a_column, b_column = code.variable(a), code.variable(b)
    with code.repeat(depth):
        left = [
            code.builder.fneg(code.load(a_column.get(), VECTOR_WIDTH * m, VECTOR)) for m in vectors
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
            code.store(column[m], place, VECTOR_WIDTH * m)


def _solve_tile(code: VectorCode, values: list[list[ir.Value]], triangle: ir.Value) -> None:
    """Write X T⁻ᵀ of a tile in registers; T has its diagonal inverted, and WIDE rows."""
    for n, column in enumerate(values):
        for j in range(n):
            entry = code.splat(code.builder.fneg(code.load(triangle, WIDE * j + n)))
            for m in range(len(column)):
                column[m] = code.multiply_add(values[j][m], entry, column[m])
        inverse = code.splat(code.load(triangle, (WIDE + 1) * n))
        column[:] = [code.builder.fmul(value, inverse) for value in column]


def _bar(mode: str, code: VectorCode, width: int, strips, depth, a, a_stride, b, b_stride, c,
         c_stride, triangle) -> None:  # fmt: skip
    """Write the code of one mode and width: tall tiles first, then what is left."""
    builder, a_rows, c_rows = code.builder, code.variable(a), code.variable(c)

    def tile(height):
        operands = depth, a_rows.get(), a_stride, b, b_stride, c_rows.get(), c_stride, triangle
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


_negate, _subtract, _solve = (
    _of_width(partial(_bar, mode)) for mode in ("negate", "subtract", "solve")
)


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
    _negate(width, strips, depth, a, a_stride, b, b_stride, c, c_stride, 0)


@njit(**KERNEL)
def subtract_product(width, strips, depth, a, a_stride, b, b_stride, c, c_stride):
    """C ← C - A Bᵀ of a bar; see `negate_product`."""
    _subtract(width, strips, depth, a, a_stride, b, b_stride, c, c_stride, 0)


@njit(**KERNEL)
def solve_product(width, strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle):
    """C ← (C - A Bᵀ) T⁻ᵀ of a bar; see `negate_product`.

    Args:
        triangle: Address of T, lower, columns `WIDE` doubles apart, its diagonal inverted.
    """
    _solve(width, strips, depth, a, a_stride, b, b_stride, c, c_stride, triangle)


def _triangle_factor(width: int, code: VectorCode, block, stride, triangle) -> ir.Value:
    builder, columns = code.builder, code.columns(block, stride, width)
    c = [[code.load(columns[j], i) for j in range(i + 1)] for i in range(width)]
    positive = ir.Constant(ir.IntType(1), 1)
    for j in range(width):
        pivot = c[j][j]
        above = builder.fcmp_ordered(">", pivot, _NOTHING)
        finite = builder.fcmp_ordered("<", pivot, _INFINITY)
        positive = builder.and_(positive, builder.and_(above, finite))
        # Divide once a column: the root is off the chain from pivot to pivot.
        inverse = builder.fdiv(_ONE, pivot)
        scaled = {k: builder.fneg(builder.fmul(c[k][j], inverse)) for k in range(j + 1, width)}
        for k in range(j + 1, width):
            for i in range(k, width):
                c[i][k] = code.multiply_add(c[i][j], scaled[k], c[i][k])
        root = code.square_root(inverse)
        code.store(root, triangle, (WIDE + 1) * j)
        for i in range(j + 1, width):
            code.store(builder.fmul(c[i][j], root), triangle, WIDE * j + i)
    return positive


def _triangle_solve(transposed: bool, code: VectorCode, width: int, triangle, x) -> None:
    builder, value = code.builder, [code.load(x, i) for i in range(width)]
    for j in reversed(range(width)) if transposed else range(width):
        value[j] = builder.fmul(value[j], code.load(triangle, (WIDE + 1) * j))
        negative = builder.fneg(value[j])
        for i in range(j) if transposed else range(j + 1, width):
            place = WIDE * i + j if transposed else WIDE * j + i
            entry = code.load(triangle, place)
            value[i] = code.multiply_add(entry, negative, value[i])
    for i in range(width):
        code.store(value[i], x, i)


_factor_wide, _factor_narrow = (
    _coded(partial(_triangle_factor, width), types.boolean) for width in (WIDE, NARROW)
)
_forward, _backward = (_of_width(partial(_triangle_solve, is_back)) for is_back in (False, True))


@njit(**KERNEL)
def factor_triangle(width, block, stride, triangle):
    """Cholesky factor of a diagonal block.

    Args:
        width: `WIDE` or `NARROW`.
        block: Address of the block; its lower part is read.
        stride: Distance of its columns.
        triangle: Address where T is written.

    Returns:
        False if a pivot is not positive and finite; T is then undefined.
    """
    if width == WIDE:
        return _factor_wide(block, stride, triangle)
    return _factor_narrow(block, stride, triangle)


@njit(**KERNEL)
def solve_forward(width, triangle, x):
    """x ← T⁻¹ x, for x at an address."""
    _forward(width, triangle, x)


@njit(**KERNEL)
def solve_backward(width, triangle, x):
    """x ← T⁻ᵀ x, for x at an address."""
    _backward(width, triangle, x)


def _add(code: VectorCode, target: ir.Value, source: ir.Value, kind: ir.Type) -> None:
    code.store(code.builder.fadd(code.load(target, 0, kind), code.load(source, 0, kind)), target)


@_coded
def clear_strips(code: VectorCode, address, strips) -> None:
    """Set `strips` times eight doubles to zero.

    Args:
        code: Where the code is written.
        address: Address of the first double.
        strips: How many strips of eight doubles.
    """
    place = code.variable(address)
    with code.repeat(strips):
        for m in range(VECTORS):
            code.store(ZERO, place.get(), VECTOR_WIDTH * m)
        place.set(code.at(place.get(), STRIP))


@_coded
def place_block(code: VectorCode, target, stride, source) -> None:
    """Copy a 3×3 block, stored contiguously by columns, into columns `stride` doubles apart.

    Args:
        code: Where the code is written.
        target: Address of the first column's place.
        stride: Distance of the columns [doubles].
        source: Address of the block's nine doubles.
    """
    for j, column in enumerate(code.columns(target, stride, DIRECTIONS)):
        code.store(code.load(source, DIRECTIONS * j, _PAIR), column)
        code.store(code.load(source, DIRECTIONS * j + 2), column, 2)


@_coded
def add_node_columns(code: VectorCode, target, target_stride, source, source_stride, count) -> None:
    """Add `count` rows of the three columns of a node to three columns elsewhere.

    Args:
        code: Where the code is written.
        target: Address of the first column that is added to.
        target_stride: Distance of these columns [doubles].
        source: Address of the first column that is read.
        source_stride: Distance of those columns [doubles].
        count: How many rows.
    """
    builder = code.builder
    targets = [code.variable(c) for c in code.columns(target, target_stride, DIRECTIONS)]
    sources = [code.variable(c) for c in code.columns(source, source_stride, DIRECTIONS)]

    def add(kind: ir.Type, width: int) -> None:
        for to, origin in zip(targets, sources, strict=True):
            _add(code, to.get(), origin.get(), kind)
            to.set(code.at(to.get(), width))
            origin.set(code.at(origin.get(), width))

    with code.repeat(builder.sdiv(count, code.integer(VECTOR_WIDTH))):
        add(VECTOR, VECTOR_WIDTH)
    width = VECTOR_WIDTH // 2
    while width:
        kind = ir.VectorType(DOUBLE, width) if width > 1 else DOUBLE
        bit = builder.and_(count, code.integer(width))
        with builder.if_then(builder.icmp_signed("!=", bit, code.integer(0))):
            add(kind, width)
        width //= 2


@_coded
def copy_node(code: VectorCode, target, source) -> None:
    """Copy the three doubles of a node.

    Args:
        code: Where the code is written.
        target: Address of the three doubles that are written.
        source: Address of the three that are read.
    """
    for i in range(DIRECTIONS):
        code.store(code.load(source, i), target, i)


@_coded
def add_node(code: VectorCode, target, source) -> None:
    """Add the three doubles of a node.

    Args:
        code: Where the code is written.
        target: Address of the three doubles that are added to.
        source: Address of the three that are read.
    """
    for i in range(DIRECTIONS):
        _add(code, code.at(target, i), code.at(source, i), DOUBLE)


@_coded
def add_strips(code: VectorCode, target, source, strips) -> None:
    """Add `strips` times eight doubles.

    Args:
        code: Where the code is written.
        target: Address of the first double that is added to.
        source: Address of the first that is read.
        strips: How many strips of eight doubles.
    """
    to, origin = code.variable(target), code.variable(source)
    with code.repeat(strips):
        for m in range(VECTORS):
            offset = VECTOR_WIDTH * m
            _add(code, code.at(to.get(), offset), code.at(origin.get(), offset), VECTOR)
        to.set(code.at(to.get(), STRIP))
        origin.set(code.at(origin.get(), STRIP))


def _subtract_columns(code: VectorCode, width: int, strips, columns, stride, x, rows) -> None:
    factors = [code.splat(code.builder.fneg(code.load(x, n))) for n in range(width)]
    places = [code.variable(c) for c in [rows, *code.columns(columns, stride, width)]]
    with code.repeat(strips):
        for m in range(VECTORS):
            value = code.load(places[0].get(), VECTOR_WIDTH * m, VECTOR)
            for place, factor in zip(places[1:], factors, strict=True):
                entry = code.load(place.get(), VECTOR_WIDTH * m, VECTOR)
                value = code.multiply_add(entry, factor, value)
            code.store(value, places[0].get(), VECTOR_WIDTH * m)
        for place in places:
            place.set(code.at(place.get(), STRIP))


def _subtract_dots(code: VectorCode, width: int, strips, skipped, columns, stride, rows, x) -> None:
    places = [code.variable(c) for c in [rows, *code.columns(columns, stride, width)]]
    sums = [code.variable(ZERO) for _ in range(width)]
    first = code.variable(skipped)
    with code.repeat(strips):
        for m in range(VECTORS):
            value = code.load(places[0].get(), VECTOR_WIDTH * m, VECTOR)
            value = code.zero_below(first.get(), value, VECTOR_WIDTH * m)
            for place, total in zip(places[1:], sums, strict=True):
                entry = code.load(place.get(), VECTOR_WIDTH * m, VECTOR)
                entry = code.zero_below(first.get(), entry, VECTOR_WIDTH * m)
                total.set(code.multiply_add(entry, value, total.get()))
        first.set(code.integer(0))
        for place in places:
            place.set(code.at(place.get(), STRIP))
    for n, total in enumerate(sums):
        code.store(code.builder.fsub(code.load(x, n), code.sum(total.get())), x, n)


_columns, _dots = _of_width(_subtract_columns), _of_width(_subtract_dots)


@njit(**KERNEL)
def subtract_columns(width, strips, columns, stride, x, rows):
    """rows ← rows - L x.

    Args:
        width: Columns of L, `WIDE` or `NARROW`.
        strips: Height of L in strips of eight rows.
        columns: Address of L.
        stride: Distance of its columns.
        x: Address of x, `width` doubles.
        rows: Address of the rows.
    """
    _columns(width, strips, columns, stride, x, rows)


@njit(**KERNEL)
def subtract_dots(width, strips, skipped, columns, stride, rows, x):
    """x ← x - Lᵀ rows, without the first `skipped` rows; see `subtract_columns`."""
    _dots(width, strips, skipped, columns, stride, rows, x)
