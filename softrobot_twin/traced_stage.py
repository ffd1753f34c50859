"""A stage of a step that runs kernels only: traced once, then run by one compiled driver.

A stage in Python asks each term for its share, and a term calls a kernel or two: the questions
take as long as small kernels do. They have the same answers in most steps. So a stage is traced:
the kernels that it called, with their arguments, and what they returned. The driver then calls them by
their addresses, from a table in which arrays are addresses, shapes and strides. It is compiled once
for all scenes, and a scene compiles nothing but a short piece of machine code for each signature,
which loads the arguments.

What a kernel returns decides how Python goes on, so it must return the same as when it was traced;
else the driver stops, and the stage is run in Python from its beginning. So a kernel that finds
something out must not change it, and a stage begins with arrays that it clears. Arrays that are made anew
each time cannot be traced: a trace counts when the next one has the same arrays. Between
kernels, a stage may only do what follows from what they returned: it must not compute with numbers.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from operator import is_
from threading import Lock, get_ident

import numpy as np
from llvmlite import ir
from numba import types, typeof
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from softrobot_twin.compilation import KERNEL, Kernel, njit

# Traces that may differ from the one before; after as many a stage runs in Python as often
# as told here, and twice as often each time, up to the last number. So many runs by the driver make
# up for a trace that differs.
FEW, FIRST_WAIT, LONGEST_WAIT, PAYING_RUNS = 4, 64, 256, 8
NEVER = 2**62
# Words that are kept for what a kernel returns.
RETURNED = 4
_CODES = {bool: "?", int: "q", float: "d"}
_WORD = ir.IntType(64)


@intrinsic
def _call(typing_context, address, arguments):
    """Call a piece of machine code that takes the address of its arguments, and gives a status."""

    def generate(context, builder, signature, values):
        function = ir.FunctionType(_WORD, [_WORD]).as_pointer()
        return builder.call(builder.inttoptr(values[0], function), [values[1]])

    return types.int64(types.int64, types.int64), generate


@njit(**KERNEL)
def run_calls(calls, memory, expected):
    """Call kernels one after the other, while they return what is expected.

    Args:
        calls: Address of the code that loads its arguments, and its first word in the memory,
            shape (call_count, 2).
        memory: What each returns, then its arguments, shape (word_count,); changed.
        expected: What each is to return, at the same places, shape (word_count,).

    Returns:
        How many of them returned what is expected.
    """
    begin = memory.ctypes.data
    for c in range(len(calls)):
        first = calls[c, 1]
        if _call(calls[c, 0], begin + 8 * first) != 0:
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
_loaders: dict[tuple, tuple[int, object]] = {}


@global_compiler_lock
def _loader(kernel: Kernel, argument_types: tuple) -> int:
    """Address of code that loads the arguments of one signature of a kernel, and calls it."""
    if (kernel, argument_types) in _loaders:
        return _loaders[kernel, argument_types][0]
    compiled = kernel.overloads[argument_types]
    target = cpu_target.target_context
    kind = target.call_conv.get_function_type(compiled.signature.return_type, argument_types)
    name = f"load_{len(_loaders)}"
    library = target.codegen().create_library(name)
    module = library.create_ir_module(name)
    function = ir.Function(module, ir.FunctionType(_WORD, [_WORD]), name)
    builder = ir.IRBuilder(function.append_basic_block())
    place = function.args[0]
    words = enumerate(kind.args[2:], start=RETURNED)
    arguments = [
        builder.load(builder.inttoptr(builder.add(place, _WORD(8 * k)), one.as_pointer()))
        for k, one in words
    ]
    code = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
    status = builder.call(
        builder.inttoptr(_WORD(code), kind.as_pointer()),
        [builder.inttoptr(place, kind.args[0]), builder.alloca(kind.args[1].pointee), *arguments],
    )  # fmt: skip
    builder.ret(builder.sext(status, _WORD))
    library.add_ir_module(module)
    library.finalize()
    _loaders[kernel, argument_types] = library.get_pointer_to_function(name), library
    return _loaders[kernel, argument_types][0]


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
        self.is_traceable, self.are_known, self._runs = is_traceable, False, 0
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
            known.trace, known.table, known.is_known = new, None, False
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
    calls, first = [], 0
    for (kernel, given, _), words in zip(trace.calls, trace.words):
        calls.append((_loader(kernel, tuple(map(typeof, given))), first))
        first += len(words)
    expected = np.array([word for words in trace.words for word in words], np.int64)
    return np.array(calls, np.int64).reshape(-1, 2), expected.copy(), expected
