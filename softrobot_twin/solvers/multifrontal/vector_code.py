"""Vector instructions on doubles at raw addresses, written through LLVM from within numba.

numba compiles loops, but does not let us decide which values stay in registers, and this decides
the speed of the inner loops of a factorization. A numba *intrinsic* may write LLVM instructions
instead of Python. `VectorCode` is the vocabulary for that: loads and stores of whole vectors,
fused multiply-adds, counted loops. LLVM turns it into AVX-512, AVX2 or NEON.

Addresses are 64-bit integers in bytes; all offsets and strides here are counted in doubles.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.core.registry import cpu_target

from softrobot_twin.kernels.compilation import INNER, njit

# Rows are processed in strips of eight doubles, a cache line, whatever the width of a vector.
STRIP = 8
STRIP_BYTES = 8 * STRIP


def doubles_per_vector() -> int:
    """Doubles in one vector register of the machine that numba compiles for."""
    features = cpu_target.target_context.codegen().magic_tuple()[2].split(",")
    if "+avx512f" in features:
        return 8
    return 4 if "+avx" in features else 2


VECTOR_WIDTH = doubles_per_vector()
VECTORS = STRIP // VECTOR_WIDTH  # vectors in a strip
# Strips a tile may be tall, so that a tile of six columns stays in registers (32, else 16).
TALLEST = 4 if VECTOR_WIDTH == 8 else 1

DOUBLE = ir.DoubleType()
INTEGER = ir.IntType(64)
VECTOR = ir.VectorType(DOUBLE, VECTOR_WIDTH)
ZERO = ir.Constant(VECTOR, [0.0] * VECTOR_WIDTH)
_INDEX = ir.IntType(32)


@njit(**INNER)
def address(array):
    """Where an array begins in memory."""
    return np.int64(array.ctypes.data)


class Variable:
    """A value that changes along a loop; LLVM keeps it in a register."""

    def __init__(self, builder: ir.IRBuilder, value: ir.Value):
        self._builder = builder
        self._slot = cgutils.alloca_once_value(builder, value)

    def get(self) -> ir.Value:
        """The present value."""
        return self._builder.load(self._slot)

    def set(self, value: ir.Value) -> None:
        """Give it a new value.

        Args:
            value: The value, of the type that it was made with.
        """
        self._builder.store(value, self._slot)


class VectorCode:
    """Writes instructions at the place where an intrinsic is called."""

    def __init__(self, builder: ir.IRBuilder):
        self.builder = builder

    def integer(self, value: int) -> ir.Value:
        """A constant.

        Args:
            value: Its value.
        """
        return ir.Constant(INTEGER, value)

    def variable(self, value: ir.Value) -> Variable:
        """A value that changes along a loop.

        Args:
            value: Its value at the beginning.
        """
        return Variable(self.builder, value)

    @contextmanager
    def repeat(self, count: ir.Value) -> Iterator[ir.Value]:
        """A loop over what is written inside; gives the index.

        Args:
            count: How many times the loop runs, an integer.
        """
        with cgutils.for_range(self.builder, count) as loop:
            yield loop.index

    def at(self, address: ir.Value, offset: ir.Value | int) -> ir.Value:
        """The address `offset` doubles further.

        Args:
            address: An address, as an integer.
            offset: How far from it [doubles].
        """
        if isinstance(offset, int):
            return self.builder.add(address, self.integer(8 * offset)) if offset else address
        return self.builder.add(address, self.builder.shl(offset, self.integer(3)))

    def columns(self, address: ir.Value, stride: ir.Value, count: int) -> list[ir.Value]:
        """The addresses of `count` columns that lie `stride` doubles apart.

        Args:
            address: Address of the first column.
            stride: Distance of the columns [doubles].
            count: How many columns.
        """
        steps = [self.builder.mul(self.integer(n), stride) for n in range(count)]
        return [self.at(address, step) for step in steps]

    def load(self, address: ir.Value, offset: int = 0, kind: ir.Type = DOUBLE) -> ir.Value:
        """One double, or a vector of neighbours, of any alignment.

        Args:
            address: An address, as an integer.
            offset: How far from it the value lies [doubles].
            kind: `DOUBLE`, or the type of a vector of them.
        """
        pointer = self.builder.inttoptr(self.at(address, offset), kind.as_pointer())
        return self.builder.load(pointer, align=8)

    def store(self, value: ir.Value, address: ir.Value, offset: int = 0) -> None:
        """Write a double or a vector.

        Args:
            value: The double or the vector.
            address: An address, as an integer.
            offset: How far from it the value goes [doubles].
        """
        pointer = self.builder.inttoptr(self.at(address, offset), value.type.as_pointer())
        self.builder.store(value, pointer, align=8)

    def splat(self, scalar: ir.Value) -> ir.Value:
        """A vector of one value.

        Args:
            scalar: The value of all its places.
        """
        kind = ir.VectorType(scalar.type, VECTOR_WIDTH)
        undefined = ir.Constant(kind, ir.Undefined)
        first = self.builder.insert_element(undefined, scalar, ir.Constant(_INDEX, 0))
        zeros = ir.Constant(ir.VectorType(_INDEX, VECTOR_WIDTH), [0] * VECTOR_WIDTH)
        return self.builder.shuffle_vector(first, undefined, zeros)

    def multiply_add(self, a: ir.Value, b: ir.Value, c: ir.Value) -> ir.Value:
        """a b + c, fused where the machine can.

        Args:
            a, b, c: Doubles, or vectors of the same width.
        """
        return self._call("llvm.fmuladd", [a, b, c])

    def square_root(self, a: ir.Value) -> ir.Value:
        """√a of a double.

        Args:
            a: A double.
        """
        return self._call("llvm.sqrt", [a])

    def sum(self, vector: ir.Value) -> ir.Value:
        """The sum over a vector, halves first.

        Args:
            vector: The vector.
        """
        values = [vector]
        width = VECTOR_WIDTH
        while width > 1:
            width //= 2
            low, high = (
                self.builder.shuffle_vector(
                    values[-1],
                    ir.Constant(values[-1].type, ir.Undefined),
                    ir.Constant(
                        ir.VectorType(_INDEX, width), list(range(part * width, (part + 1) * width))
                    ),
                )
                for part in (0, 1)
            )
            values.append(self.builder.fadd(low, high))
        return self.builder.extract_element(values[-1], ir.Constant(_INDEX, 0))

    def zero_below(self, first: ir.Value, vector: ir.Value, offset: int = 0) -> ir.Value:
        """The vector, with zeros where index + offset is less than `first`.

        Args:
            first: The least index that is kept, an integer.
            vector: The vector.
            offset: Index of its first place.
        """
        numbers = list(range(offset, offset + VECTOR_WIDTH))
        indices = ir.Constant(ir.VectorType(INTEGER, VECTOR_WIDTH), numbers)
        kept = self.builder.icmp_signed(">=", indices, self.splat(first))
        return self.builder.select(kept, vector, ZERO)

    def _call(self, name: str, arguments: list[ir.Value]) -> ir.Value:
        kind = arguments[0].type
        suffix = f"v{VECTOR_WIDTH}f64" if kind == VECTOR else "f64"
        signature = ir.FunctionType(kind, [kind] * len(arguments))
        function = cgutils.get_or_insert_function(
            self.builder.module, signature, f"{name}.{suffix}"
        )
        return self.builder.call(function, arguments)
