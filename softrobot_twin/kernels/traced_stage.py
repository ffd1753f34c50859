"""A stage of a step that runs kernels only: traced once, then run by one compiled driver.

A stage in Python asks each term for its share, and a term calls a kernel or two: the questions
take as long as small kernels do. They have the same answers in most steps. So a stage is traced:
the kernels that it called, with their arguments, and what they returned. The driver then calls them by
their addresses, from a table in which arrays are addresses, shapes and strides. It is compiled once
for kernels of any arguments: by the calling conventions of Linux they lie in registers or on the
stack, in an order that does not depend on the signature.

What a kernel returns decides how Python goes on, so it must return the same as when it was traced;
else the driver stops, and the stage is run in Python from its beginning. So a kernel that finds
something out must not change it, and a stage begins with arrays that it clears. Arrays that are made anew
each time cannot be traced: a trace counts when the next one has the same arrays. Between
kernels, a stage may only do what follows from what they returned: it must not compute with numbers.
"""

from __future__ import annotations

import platform
import struct
from bisect import bisect_left
from collections.abc import Callable
from operator import is_
from threading import Lock, get_ident

import numpy as np
from llvmlite import ir
from numba import types, typeof
from numba.core import cgutils
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from softrobot_twin.kernels.compilation import KERNEL, Kernel, kind_of, njit

# Traces that may differ from the one before; after as many a stage runs in Python as often
# as told here, and twice as often each time, up to the last number. So many runs by the driver make
# up for a trace that differs.
FEW, FIRST_WAIT, LONGEST_WAIT, PAYING_RUNS = 4, 64, 256, 8
NEVER = 2**62
# Words that are kept for what a kernel returns.
RETURNED = 4
_CODES = {bool: "?", int: "q", float: "d"}
_WORD, _FLOAT, _STATUS = ir.IntType(64), ir.DoubleType(), ir.IntType(32)
# Arguments in registers: integers and addresses beside the two that numba puts first, and floats.
# The others lie on the stack, one word each (System V ABI for x86-64; AAPCS64).
_INTEGERS = {"x86_64": 4, "aarch64": 6}.get(platform.machine(), 0)
_FLOATS = 8
# Words on the stack for which the driver has code. A kernel does not look at words behind its own.
_STACKS = (8, 16, 24, 48, 96, 128, 256, 512)


@intrinsic
def _call(typing_context, address, place, stack):
    """Call a kernel with the arguments at a place, of which some lie on the stack; gives a status."""

    def generate(context, builder, signature, values):
        address, place, stack = values
        status = cgutils.alloca_once_value(builder, _STATUS(-1))
        error = cgutils.alloca_once(builder, ir.IntType(8).as_pointer())
        words, end = builder.inttoptr(place, _WORD.as_pointer()), builder.append_basic_block()
        choice = builder.switch(stack, end)
        for k, count in enumerate(_STACKS):
            choice.add_case(_WORD(k), block := builder.append_basic_block())
            builder.position_at_end(block)
            kinds = [_WORD] * _INTEGERS + [_FLOAT] * _FLOATS + [_WORD] * count
            addresses = [builder.gep(words, [_WORD(RETURNED + j)]) for j in range(len(kinds))]
            given = [words, error] + [
                builder.load(builder.bitcast(one, kind.as_pointer()))
                for one, kind in zip(addresses, kinds)
            ]
            kernel = ir.FunctionType(_STATUS, [one.type for one in given]).as_pointer()
            builder.store(builder.call(builder.inttoptr(address, kernel), given), status)
            builder.branch(end)
        builder.position_at_end(end)
        return builder.sext(builder.load(status), _WORD)

    return types.int64(types.int64, types.int64, types.int64), generate


@njit(**KERNEL)
def run_calls(calls, memory, expected):
    """Call kernels one after the other, while they return what is expected.

    Args:
        calls: Address of each, its first word in the memory, and which of the `_STACKS` it takes,
            shape (call_count, 3).
        memory: What each returns, then its arguments, shape (word_count,); changed.
        expected: What each is to return, at the same places, shape (word_count,).

    Returns:
        How many of them returned what is expected.
    """
    begin = memory.ctypes.data
    for c in range(len(calls)):
        first = calls[c, 1]
        if _call(calls[c, 0], begin + 8 * first, calls[c, 2]) != 0:
            return c
        for word in range(first, first + RETURNED):
            if memory[word] != expected[word]:
                return c
    return len(calls)


@njit(**KERNEL)
def clear(numbers):
    """Set numbers, shape (count,), to zero."""
    for k in range(len(numbers)):
        numbers[k] = 0.0


_is_tracing = Lock()
_entries: dict[tuple, tuple[int, list[bool]]] = {}


def _entry(kernel: Kernel, argument_types: tuple) -> tuple[int, list[bool]]:
    """Address of a kernel's code for one signature, and which words of its arguments are floats."""
    key = kernel, argument_types
    if key not in _entries:
        compiled = kernel.overloads[argument_types]
        convention = cpu_target.target_context.call_conv
        kind = convention.get_function_type(compiled.signature.return_type, argument_types)
        address = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
        _entries[key] = address, [one == _FLOAT for one in kind.args[2:]]
    return _entries[key]


def _loaded(words: list[int], is_float: list[bool]) -> tuple[list[int], int]:
    """Words of arguments as registers and the stack take them, and which of the `_STACKS` it is."""
    registers, stack = ([], []), []
    for word, floats in zip(words, is_float, strict=True):
        is_full = len(registers[floats]) == (_FLOATS if floats else _INTEGERS)
        (stack if is_full else registers[floats]).append(word)
    if len(stack) > _STACKS[-1]:
        raise KeyError(len(stack))
    filled = [(kind + [0] * count)[:count] for kind, count in zip(registers, (_INTEGERS, _FLOATS))]
    return filled[0] + filled[1] + stack, bisect_left(_STACKS, len(stack))


def _words(value: object) -> list[int]:
    """An argument as the kernel takes it: of an array its address, shape and strides.

    Raises:
        TypeError: It is of a kind that cannot be traced.
    """
    if isinstance(value, np.ndarray):
        return [0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides]
    if isinstance(value, tuple):
        return [word for part in value for word in _words(part)]
    if isinstance(value, bool | int | np.integer | np.bool_):
        return [int(value)]
    if isinstance(value, float):
        return list(struct.unpack("q", struct.pack("d", value)))
    raise TypeError(f"a {type(value).__name__} cannot be traced")


def _returned(value: object) -> list[int]:
    """What a kernel returned, as it writes it.

    Raises:
        TypeError: It is an array.
    """
    values = value if isinstance(value, tuple) else () if value is None else (value,)
    if not all(type(one) in _CODES for one in values):
        raise TypeError(f"a {type(value).__name__} cannot be expected")
    packed = struct.pack("@" + "".join(_CODES[type(one)] for one in values), *values)
    if len(packed) > 8 * RETURNED:
        raise TypeError(f"{len(values)} numbers cannot be expected")
    packed += bytes(8 * RETURNED - len(packed))
    return list(struct.unpack(f"{RETURNED}q", packed))


class Trace:
    """The kernels that a stage called, and what it returned.

    Attributes:
        calls: Each kernel, its arguments, and what it returned.
        words: What each returned, and its arguments, as words of the driver's memory.
        result: What the stage returned: it follows from what the kernels returned.
    """

    def __init__(self, stage: Callable, arguments: tuple):
        """Run a stage in Python, and record its kernels.

        Args:
            stage: The stage.
            arguments: Its arguments.
        """
        self.calls: list[tuple[Kernel, tuple, object]] = []
        thread = get_ident()

        def call(kernel: Kernel, *given):
            returned = super(Kernel, kernel).__call__(*given)
            if get_ident() == thread:
                self.calls.append((kernel, given, returned))
            return returned

        Kernel.__call__ = call
        try:
            self.result = stage(*arguments)
        finally:
            del Kernel.__call__
        self.words: list[list[int]] | None = None
        try:
            self.words = [
                _returned(returned) + [word for one in given for word in _words(one)]
                for _, given, returned in self.calls
            ]
        except TypeError:
            pass  # It cannot be run by the driver.

    def is_same(self, other: Trace | None) -> bool:
        """Whether another one called the same kernels with the same arrays and numbers.

        Args:
            other: Another trace; None for none.
        """
        return other is not None and self.words == other.words and all(
            one[0] is another[0] for one, another in zip(self.calls, other.calls)
        )


class TracedStages:
    """Stages that the driver runs while they do the same as before.

    What terms remember beside their arrays follows from what kernels returned. One stage may read
    what another one left there: so where one does something else, none is taken for known. One that
    does not run any more hinders the others no longer; when it runs again, all are learned anew.
    """

    def __init__(self, is_traceable: bool, *stages: Callable):
        """Take the stages.

        Args:
            is_traceable: Whether all that they call may be traced; else they run in Python.
            stages: Each is called with the same arrays in most steps.
        """
        self._stages = [_Known(stage) for stage in stages]
        self.is_traceable, self.are_known, self._runs = is_traceable and _INTEGERS > 0, False, 0
        self.begin_anew()

    def run(self, place: int, *arguments):
        """Run one of them.

        Args:
            place: Which.
            arguments: Its arguments.

        Returns:
            What it returns.
        """
        known = self._stages[place]
        is_same = all(map(is_, arguments, known.arguments))
        if (
            self.are_known and known.is_known and is_same
            and run_calls(*known.table) == len(known.table[0])
        ):  # fmt: skip
            self._driven += 1
            return known.trace.result
        if self.are_known or not is_same:
            self.forget()
        known.arguments = arguments
        self._wait -= self._wait > 0
        if self._wait or not _is_tracing.acquire(blocking=False):
            return known.stage(*arguments)
        try:
            return self.trace_stage(known, arguments)
        finally:
            _is_tracing.release()

    def begin_anew(self) -> None:
        """Forget, and learn without waiting."""
        self._changes, self._driven, self._next_wait = 0, 0, FIRST_WAIT
        self._wait = 0 if self.is_traceable else NEVER
        self.forget()

    def forget(self) -> None:
        """Let the next run of each be one in Python: something else than the arrays has changed."""
        self.are_known = False
        for known in self._stages:
            known.is_known = False

    def trace_stage(self, known: _Known, arguments: tuple):
        """Run a stage in Python, and learn what it did; the second of two equal traces counts.

        Args:
            known: What is known of it.
            arguments: Its arguments.

        Returns:
            What it returns.
        """
        was_known, last_run = known.is_known, known.last_run
        self._runs += 1
        known.last_run, known.is_used = self._runs, True
        new = Trace(known.stage, arguments)
        if new.words is None:
            self.is_traceable, self._wait = False, NEVER
        elif new.is_same(known.trace):
            try:
                known.table = known.table or _laid_out(new)
            except KeyError:  # numba converts an argument of a kernel that has no code for its type.
                self.is_traceable, self._wait = False, NEVER
                return new.result
            known.is_known = True
            for one in self._stages:
                # It did not run since this one was known.
                if was_known and not one.is_known and one.last_run < last_run:
                    one.is_used = False
            self.are_known = all(one.is_known or not one.is_used for one in self._stages)
        else:
            self.forget()
            known.trace, known.table = new, None
            self._changes = max(0, self._changes - self._driven // PAYING_RUNS) + 1
            self._driven = 0
            if self._changes > FEW * len(self._stages):
                self._changes, self._wait = 0, self._next_wait
                self._next_wait = min(2 * self._wait, LONGEST_WAIT)
        return new.result


class _Known:
    """What is known of one stage."""

    def __init__(self, stage: Callable):
        self.stage, self.arguments, self.is_known = stage, (), False
        self.is_used, self.last_run = False, 0
        self.trace: Trace | None = None
        self.table: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None


def _laid_out(trace: Trace) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Arguments of the driver; see `run_calls`.

    Raises:
        KeyError: A kernel has no code for exactly the types of its arguments.
    """
    calls, words = [], []
    for (kernel, given, _), own in zip(trace.calls, trace.words):
        address, is_float = _entry(kernel, tuple(kind_of(typeof(one)) for one in given))
        loaded, stack = _loaded(own[RETURNED:], is_float)
        calls.append((address, len(words), stack))
        words += own[:RETURNED] + loaded
    # It also reads the words of the stack that its last kernel does not have.
    expected = np.array(words + [0] * _STACKS[-1], np.int64)
    return np.array(calls, np.int64).reshape(-1, 3), expected.copy(), expected
