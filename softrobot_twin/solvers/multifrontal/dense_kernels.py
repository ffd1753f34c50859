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
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from softrobot_twin.compilation import KERNEL, njit
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

_ADDRESS = types.int64
_SIGNATURE = types.void(*[types.int64] * 9)
TRIANGLE = WIDE * WIDE  # doubles kept for a block
_ONE = ir.Constant(DOUBLE, 1.0)
_NOTHING = ir.Constant(DOUBLE, 0.0)
_INFINITY = ir.Constant(DOUBLE, float("inf"))
_PAIR = ir.VectorType(DOUBLE, 2)


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


def _triangle_factor(width: int):
    @intrinsic
    def factor(_typing, block, stride, triangle):
        def write(_context, builder, _signature, arguments):
            code = VectorCode(builder)
            block, stride, triangle = arguments
            columns = code.columns(block, stride, width)
            c = [[code.load(columns[j], i) for j in range(i + 1)] for i in range(width)]
            positive = ir.Constant(ir.IntType(1), 1)
            for j in range(width):
                pivot = c[j][j]
                above = builder.fcmp_ordered(">", pivot, _NOTHING)
                finite = builder.fcmp_ordered("<", pivot, _INFINITY)
                positive = builder.and_(positive, builder.and_(above, finite))
                # Divide once a column: the root is off the chain from pivot to pivot.
                inverse = builder.fdiv(_ONE, pivot)
                scaled = {
                    k: builder.fneg(builder.fmul(c[k][j], inverse)) for k in range(j + 1, width)
                }
                for k in range(j + 1, width):
                    for i in range(k, width):
                        c[i][k] = code.multiply_add(c[i][j], scaled[k], c[i][k])
                root = code.square_root(inverse)
                code.store(root, triangle, (WIDE + 1) * j)
                for i in range(j + 1, width):
                    code.store(builder.fmul(c[i][j], root), triangle, WIDE * j + i)
            return positive

        return types.boolean(_ADDRESS, _ADDRESS, _ADDRESS), write

    return factor


def _triangle_solve(width: int, transposed: bool):
    @intrinsic
    def solve(_typing, triangle, x):
        def write(_context, builder, _signature, arguments):
            code = VectorCode(builder)
            triangle, x = arguments
            value = [code.load(x, i) for i in range(width)]
            for j in reversed(range(width)) if transposed else range(width):
                value[j] = builder.fmul(value[j], code.load(triangle, (WIDE + 1) * j))
                negative = builder.fneg(value[j])
                for i in range(j) if transposed else range(j + 1, width):
                    place = WIDE * i + j if transposed else WIDE * j + i
                    entry = code.load(triangle, place)
                    value[i] = code.multiply_add(entry, negative, value[i])
            for i in range(width):
                code.store(value[i], x, i)

        return types.void(_ADDRESS, _ADDRESS), write

    return solve


_factor_wide, _factor_narrow = _triangle_factor(WIDE), _triangle_factor(NARROW)
_forward_wide, _forward_narrow = _triangle_solve(WIDE, False), _triangle_solve(NARROW, False)
_backward_wide, _backward_narrow = _triangle_solve(WIDE, True), _triangle_solve(NARROW, True)


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
    if width == WIDE:
        _forward_wide(triangle, x)
    else:
        _forward_narrow(triangle, x)


@njit(**KERNEL)
def solve_backward(width, triangle, x):
    """x ← T⁻ᵀ x, for x at an address."""
    if width == WIDE:
        _backward_wide(triangle, x)
    else:
        _backward_narrow(triangle, x)


def _add(code: VectorCode, target: ir.Value, source: ir.Value, kind: ir.Type) -> None:
    code.store(code.builder.fadd(code.load(target, 0, kind), code.load(source, 0, kind)), target)


@intrinsic
def clear_strips(_typing, address, strips):
    """Set `strips` times eight doubles to zero."""

    def write(_context, builder, _signature, arguments):
        code = VectorCode(builder)
        place = code.variable(arguments[0])
        with code.repeat(arguments[1]):
            for m in range(VECTORS):
                code.store(ZERO, place.get(), VECTOR_WIDTH * m)
            place.set(code.at(place.get(), STRIP))

    return types.void(types.int64, types.int64), write


@intrinsic
def place_block(_typing, target, stride, source):
    """Copy a 3×3 block, stored contiguously by columns, into columns `stride` doubles apart."""

    def write(_context, builder, _signature, arguments):
        code = VectorCode(builder)
        target, stride, source = arguments
        for j, column in enumerate(code.columns(target, stride, DIRECTIONS)):
            code.store(code.load(source, DIRECTIONS * j, _PAIR), column)
            code.store(code.load(source, DIRECTIONS * j + 2), column, 2)

    return types.void(types.int64, types.int64, types.int64), write


@intrinsic
def add_node_columns(_typing, target, target_stride, source, source_stride, count):
    """Add `count` rows of the three columns of a node to three columns elsewhere."""

    def write(_context, builder, _signature, arguments):
        code = VectorCode(builder)
        target, target_stride, source, source_stride, count = arguments
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

    return types.void(*[types.int64] * 5), write


@intrinsic
def copy_node(_typing, target, source):
    """Copy the three doubles of a node."""

    def write(_context, builder, _signature, arguments):
        code = VectorCode(builder)
        for i in range(DIRECTIONS):
            code.store(code.load(arguments[1], i), arguments[0], i)

    return types.void(types.int64, types.int64), write


@intrinsic
def add_node(_typing, target, source):
    """Add the three doubles of a node."""

    def write(_context, builder, _signature, arguments):
        code = VectorCode(builder)
        for i in range(DIRECTIONS):
            _add(code, code.at(arguments[0], i), code.at(arguments[1], i), DOUBLE)

    return types.void(types.int64, types.int64), write


@intrinsic
def add_strips(_typing, target, source, strips):
    """Add `strips` times eight doubles."""

    def write(_context, builder, _signature, arguments):
        code = VectorCode(builder)
        target, source = code.variable(arguments[0]), code.variable(arguments[1])
        with code.repeat(arguments[2]):
            for m in range(VECTORS):
                offset = VECTOR_WIDTH * m
                _add(code, code.at(target.get(), offset), code.at(source.get(), offset), VECTOR)
            target.set(code.at(target.get(), STRIP))
            source.set(code.at(source.get(), STRIP))

    return types.void(*[types.int64] * 3), write


def _subtract_columns(width: int):
    @intrinsic
    def subtract(_typing, strips, columns, stride, x, rows):
        def write(_context, builder, _signature, arguments):
            code = VectorCode(builder)
            strips, columns, stride, x, rows = arguments
            factors = [code.splat(builder.fneg(code.load(x, n))) for n in range(width)]
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

        return types.void(*[_ADDRESS] * 5), write

    return subtract


def _subtract_dots(width: int):
    @intrinsic
    def subtract(_typing, strips, skipped, columns, stride, rows, x):
        def write(_context, builder, _signature, arguments):
            code = VectorCode(builder)
            strips, skipped, columns, stride, rows, x = arguments
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
                code.store(builder.fsub(code.load(x, n), code.sum(total.get())), x, n)

        return types.void(*[_ADDRESS] * 6), write

    return subtract


_columns_wide, _columns_narrow = _subtract_columns(WIDE), _subtract_columns(NARROW)
_dots_wide, _dots_narrow = _subtract_dots(WIDE), _subtract_dots(NARROW)


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
    if width == WIDE:
        _columns_wide(strips, columns, stride, x, rows)
    else:
        _columns_narrow(strips, columns, stride, x, rows)


@njit(**KERNEL)
def subtract_dots(width, strips, skipped, columns, stride, rows, x):
    """x ← x - Lᵀ rows, without the first `skipped` rows; see `subtract_columns`."""
    if width == WIDE:
        _dots_wide(strips, skipped, columns, stride, rows, x)
    else:
        _dots_narrow(strips, skipped, columns, stride, rows, x)
