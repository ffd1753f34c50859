"""Moving blocks: clear a panel, put the matrix's blocks into it, add what children left.

These kernels move numbers and hardly compute. They run on raw addresses, in whole vectors.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from softrobot_twin.solvers.multifrontal.vector_code import (
    DOUBLE,
    LANES,
    STRIP,
    VECTOR,
    VECTORS,
    ZERO,
    VectorCode,
)

DIRECTIONS = 3
_PAIR = ir.VectorType(DOUBLE, 2)


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
                code.store(ZERO, place.get(), LANES * m)
            place.set(code.at(place.get(), STRIP))

    return types.void(types.int64, types.int64), write


@intrinsic
def place_block(_typing, target, stride, source):
    """Copy a 3×3 block, stored in one piece by columns, into columns `stride` doubles apart."""

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

        with code.repeat(builder.sdiv(count, code.integer(LANES))):
            add(VECTOR, LANES)
        width = LANES // 2
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
                _add(
                    code, code.at(target.get(), LANES * m), code.at(source.get(), LANES * m), VECTOR
                )
            target.set(code.at(target.get(), STRIP))
            source.set(code.at(source.get(), STRIP))

    return types.void(*[types.int64] * 3), write
