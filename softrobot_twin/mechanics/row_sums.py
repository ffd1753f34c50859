"""Weighted sums of the rows of a dense array, in vector registers, in single or double precision.

numba compiles loops, but does not let us decide which sums stay in registers; see `vector_code` of the
multifrontal solver. Here `ROWS` sums of `WIDTH` neighbouring columns stay there while all rows go by.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from softrobot_twin.kernels.compilation import KERNEL, njit

# Columns that are summed at once: several vectors, so that none waits for the one before.
WIDTH = 16
# Sums in registers of `add_squares`.
ROWS = 4
_INDEX = ir.IntType(32)


def row_sums(count: int):
    """Make the intrinsic for a number of sums.

    Args:
        count: Number of sums.

    Returns:
        ``sums(depth, a, a_first, a_row, a_step, b, b_first, b_step, c, c_first, c_step, adds)``: to
        `WIDTH` numbers of c from place c_first + r c_step it adds Σ_j a[a_first + r a_row + j a_step]
        times those of b from b_first + j b_step, for r < count and j < depth. Places are numbered
        through the whole of an array. Where `adds` is 0, it begins with zeros.
    """

    @intrinsic
    def sums(_typing, depth, a, a_first, a_row, a_step, b, b_first, b_step, c, c_first, c_step, adds):
        kinds = depth, a, a_first, a_row, a_step, b, b_first, b_step, c, c_first, c_step, adds
        return types.void(*kinds), _written(count)

    return sums


def _written(count: int):
    """What writes the instructions; see `row_sums`."""

    def write(context, builder, signature, values):
        depth, _, a_first, a_row, a_step, _, b_first, b_step, _, c_first, c_step, adds = values
        a, b, c = (
            builder.gep(context.make_array(signature.args[k])(context, builder, values[k]).data, [first])
            for k, first in ((1, a_first), (5, b_first), (8, c_first))
        )
        number = a.type.pointee
        vector, bytes_each = ir.VectorType(number, WIDTH), 4 if number == ir.FloatType() else 8
        multiply_add = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector] * 3),
            f"llvm.fmuladd.v{WIDTH}f{8 * bytes_each}",
        )  # fmt: skip
        undefined, first_lane = ir.Constant(vector, ir.Undefined), ir.Constant(_INDEX, 0)
        everywhere = ir.Constant(ir.VectorType(_INDEX, WIDTH), [0] * WIDTH)

        def times(stride, r: int):
            return builder.mul(stride, ir.Constant(stride.type, r))

        def load(place):
            return builder.load(builder.bitcast(place, vector.as_pointer()), align=bytes_each)

        targets = [builder.gep(c, [times(c_step, r)]) for r in range(count)]
        is_added = builder.icmp_signed("!=", adds, ir.Constant(adds.type, 0))
        zeros = ir.Constant(vector, [0.0] * WIDTH)
        found = [
            cgutils.alloca_once_value(builder, builder.select(is_added, load(target), zeros))
            for target in targets
        ]
        with cgutils.for_range(builder, depth) as loop:
            right = load(builder.gep(b, [builder.mul(b_step, loop.index)]))
            begin = builder.mul(a_step, loop.index)
            for r, own in enumerate(found):
                factor = builder.load(builder.gep(a, [builder.add(begin, times(a_row, r))]))
                left = builder.insert_element(undefined, factor, first_lane)
                left = builder.shuffle_vector(left, undefined, everywhere)
                builder.store(builder.call(multiply_add, [left, right, builder.load(own)]), own)
        for own, target in zip(found, targets, strict=True):
            place = builder.bitcast(target, vector.as_pointer())
            builder.store(builder.load(own), place, align=bytes_each)

    return write


_four = row_sums(ROWS)


@njit(**KERNEL)
def add_squares(first, count, rows, squares):
    """Add Σ x xᵀ of some rows x to the lower triangle of a matrix, and some of what is above.

    Args:
        first: The first row.
        count: Number of rows.
        rows: All rows, shape (row_count, n); n is a multiple of `WIDTH`.
        squares: The matrix, shape (n, n); added to.
    """
    n = len(squares)
    for i in range(0, n, ROWS):
        for j in range(0, i + ROWS, WIDTH):
            _four(
                count, rows, first * n + i, 1, n, rows, first * n + j, n, squares, i * n + j, n, 1
            )
