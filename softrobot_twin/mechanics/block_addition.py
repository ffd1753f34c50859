"""Adds the stiffness blocks of a batch of elements to the storage of the system matrix.

An entry of a block lies beside the same entry of the other elements (`element_batches.py`), but in
the storage it lies beside the other entries of its own block. Added one by one, the entries take
nearly half of the time of the stiffness. Where the nine entries of each block are contiguous in the
storage, as they are for the multifrontal factorization, four elements are therefore transposed in
vector registers, and each of them adds four entries at once, four more, and the ninth. These are
the same additions in the same order: both ways give the same bits.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.element_batches import BATCH, at

# Elements that are transposed together, and entries that are added at once.
_WIDTH = 4
# Number of the entry that is left over.
_LAST = 8
# Distance of the columns of a block that is stored contiguously.
_CONTIGUOUS = 3
_DOUBLE, _INTEGER, _INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_VECTOR = ir.VectorType(_DOUBLE, _WIDTH)


def _transpose(builder: ir.IRBuilder, rows: list[ir.Value]) -> list[ir.Value]:
    """Write the transposition of a square of vectors, exchanging parts of 1 entry, 2, and so on."""
    rows, size = list(rows), 1
    while size < _WIDTH:
        low = [lane if not lane & size else _WIDTH + lane - size for lane in range(_WIDTH)]
        high = [lane + size if not lane & size else _WIDTH + lane for lane in range(_WIDTH)]
        for i in (i for i in range(_WIDTH) if not i & size):
            rows[i], rows[i + size] = (
                builder.shuffle_vector(
                    rows[i], rows[i + size], ir.Constant(ir.VectorType(_INDEX, _WIDTH), mask)
                )
                for mask in (low, high)
            )
        size *= 2
    return rows


def _at(builder: ir.IRBuilder, address: ir.Value, place: int, kind: ir.Type) -> ir.Value:
    """Pointer to what lies `place` times eight bytes behind an address."""
    moved = builder.add(address, ir.Constant(_INTEGER, 8 * place))
    return builder.inttoptr(moved, kind.as_pointer())


def _add(builder: ir.IRBuilder, target: ir.Value, value: ir.Value) -> None:
    sum_of_both = builder.fadd(builder.load(target, align=8), value)
    builder.store(sum_of_both, target, align=8)


@intrinsic
def _add_contiguous_blocks(_typing, offsets, K, storage):
    """Add the blocks of `_WIDTH` elements; addresses of the first one's offset and entry."""

    def write(_context, builder, _signature, arguments):
        offsets, K, storage = arguments
        parts = [
            _transpose(
                builder,
                [
                    builder.load(_at(builder, K, BATCH * (first + row), _VECTOR), align=8)
                    for row in range(_WIDTH)
                ],
            )
            for first in range(0, _LAST, _WIDTH)
        ]
        for e in range(_WIDTH):
            offset = builder.load(_at(builder, offsets, e, _INTEGER))
            is_present = builder.icmp_signed(">=", offset, ir.Constant(_INTEGER, 0))
            with cgutils.if_likely(builder, is_present):
                block = builder.add(storage, builder.shl(offset, ir.Constant(_INTEGER, 3)))
                for number, part in enumerate(parts):
                    _add(builder, _at(builder, block, _WIDTH * number, _VECTOR), part[e])
                last = builder.load(_at(builder, K, BATCH * _LAST + e, _DOUBLE), align=8)
                _add(builder, _at(builder, block, _LAST, _DOUBLE), last)

    return types.void(types.int64, types.int64, types.int64), write


def are_contiguous(offsets: np.ndarray, strides: np.ndarray) -> bool:
    """Whether the nine entries of every block are contiguous in the storage.

    Args:
        offsets: Place of each block, -1 where a node is fixed, any shape.
        strides: Distance of its columns, same shape.
    """
    return bool((strides[offsets >= 0] == _CONTIGUOUS).all())


@njit(**KERNEL)
def add_contiguous_blocks(offsets, K, storage):
    """Add one block of every element to the storage, wherever both its nodes are free.

    Args:
        offsets: Place of each block, which is contiguous; -1 where a node is fixed, shape (BATCH,).
        K: The blocks, column by column, shape (9 BATCH,).
        storage: The factorization's storage [N/m]; added to.
    """
    for e in range(0, BATCH, _WIDTH):
        _add_contiguous_blocks(
            np.int64(offsets.ctypes.data) + 8 * e, np.int64(K.ctypes.data) + 8 * e,
            np.int64(storage.ctypes.data),
        )  # fmt: skip


@njit(**KERNEL)
def add_blocks(offsets, strides, K, storage):
    """The same for blocks whose columns lie apart.

    Args:
        offsets: Place of each block, -1 where a node is fixed, shape (BATCH,).
        strides: Distance of its columns, shape (BATCH,).
        K: The blocks, column by column, shape (9 BATCH,).
        storage: The factorization's storage [N/m]; added to.
    """
    for e in range(BATCH):
        o = offsets[e]
        if o >= 0:
            for j in range(3):
                storage[o] += K[at(3 * j, e)]
                storage[o + 1] += K[at(3 * j + 1, e)]
                storage[o + 2] += K[at(3 * j + 2, e)]
                o += strides[e]
