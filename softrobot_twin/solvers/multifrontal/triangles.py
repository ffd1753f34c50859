"""The small triangular blocks on the diagonal: three or six columns, in registers throughout.

A block T (lower, T Tᵀ = the diagonal block) is kept by columns of `WIDE` doubles, with the
*inverse* of each diagonal entry in its place: every use of T divides by its diagonal.
"""

from __future__ import annotations

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from softrobot_twin.solvers.multifrontal.tiles import NARROW, WIDE
from softrobot_twin.solvers.multifrontal.vector_code import DOUBLE, KERNEL, VectorCode

TRIANGLE = WIDE * WIDE  # doubles kept for a block
_ONE = ir.Constant(DOUBLE, 1.0)
_NOTHING = ir.Constant(DOUBLE, 0.0)
_INFINITY = ir.Constant(DOUBLE, float("inf"))
_ADDRESS = types.int64


def _factor(width: int):
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


def _solve(width: int, transposed: bool):
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


_factor_wide, _factor_narrow = _factor(WIDE), _factor(NARROW)
_forward_wide, _forward_narrow = _solve(WIDE, False), _solve(NARROW, False)
_backward_wide, _backward_narrow = _solve(WIDE, True), _solve(NARROW, True)


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
