"""Products of a panel's columns with one vector: the solves with a single right-hand side.

The panel is read in bars of three or six columns, so that the vector is read and written once for
six columns; memory, not arithmetic, is the limit here.
"""

from __future__ import annotations

from numba import njit, types
from numba.extending import intrinsic

from softrobot_twin.solvers.multifrontal.tiles import NARROW, WIDE
from softrobot_twin.solvers.multifrontal.vector_code import (
    KERNEL,
    LANES,
    STRIP,
    VECTOR,
    VECTORS,
    ZERO,
    VectorCode,
)

_ADDRESS = types.int64


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
                    value = code.load(places[0].get(), LANES * m, VECTOR)
                    for place, factor in zip(places[1:], factors, strict=True):
                        entry = code.load(place.get(), LANES * m, VECTOR)
                        value = code.multiply_add(entry, factor, value)
                    code.store(value, places[0].get(), LANES * m)
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
                    value = code.load(places[0].get(), LANES * m, VECTOR)
                    value = code.zero_below(first.get(), value, LANES * m)
                    for place, total in zip(places[1:], sums, strict=True):
                        entry = code.load(place.get(), LANES * m, VECTOR)
                        entry = code.zero_below(first.get(), entry, LANES * m)
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
