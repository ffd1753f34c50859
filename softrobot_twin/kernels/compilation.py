"""How kernels are compiled: options of numba, the same in all rooms.

numba makes two functions around each kernel by default: one that Python calls, and one for a table
of function pointers. Nothing here needs the second, and most kernels are called by other kernels
only; so these are left out.

Neither does a kernel copy an array by ``target[:] = source``: with it numba compiles the text of an
error, for seconds.
"""

from __future__ import annotations

import gc
import logging
import time
from collections.abc import Callable

import numba
from numba import types
from numba.core import config, sigutils
from numba.core import event as events
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target

from softrobot_twin.kernels.kernel_cache import KernelCache
from softrobot_twin.kernels.machine_code import Codegen

# Where numba was imported before this package, it has begun to compile for another processor.
config.reload_config()
_code = cpu_target.target_context.codegen()
if _code.magic_tuple()[2] != _code._get_host_cpu_features():
    cpu_target.target_context.init()

_PACKAGE = __name__.split(".")[0] + "."

# Strictly by IEEE: no line may be reordered or fused, so that vector code and the scalar code that
# stands in for it where arrays seem to overlap give the same bits. It costs nothing measurable.
KERNEL = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Options of a kernel that Python calls."""

INNER = {**KERNEL, "only_kernels_call": True, "forceinline": True}
"""Options of a kernel that only kernels call; of the `njit` below, numba's refuses them by name."""

INLINED = {**INNER, "forceinline": True}
"""Options of a small kernel that becomes a part of each kernel that calls it."""

ONCE = {**INNER, "inline": "always"}
"""Options of a kernel that is called at one place: numba reads it there, as a part of its caller."""

UNCACHED = {**KERNEL, "cache": False}
"""Options of a kernel that takes laws from outside this package; it is not kept on disk."""

INNER_UNCACHED = {**INNER, "cache": False}
"""Options of a kernel that takes any law: it is kept on disk with the kernels that call it."""

GENERIC = {**INLINED, "cache": False}
"""As `INNER_UNCACHED`, inlined."""


def _codegen() -> Codegen:
    return cpu_target.target_context.codegen()


_codegen().__class__ = Codegen


def kind_of(argument: types.Type) -> types.Type:
    """The type for which a kernel is compiled that is called with a type.

    Args:
        argument: The type of an argument.
    """
    kind = types.unliteral(argument)
    if isinstance(kind, types.Array):
        return kind.copy(readonly=False)
    if isinstance(kind, types.BaseTuple):
        return types.BaseTuple.from_types(
            tuple(map(kind_of, kind)), getattr(kind, "instance_class", None))  # fmt: skip
    return kind


class _AnyKernel(CPUDispatcher):
    """A kernel that is compiled once for all numbers, and for arrays whether read-only or not.

    numba compiles a kernel anew for each number that is written where it is called, though LLVM
    finds the number when it inlines the kernel; and for arrays that are read-only, to refuse
    kernels that write them. Here a kernel may write only what its docstring says.

    Attributes:
        ready: Types of arguments with which Python can call it.
    """

    ready: set[tuple]

    def get_call_template(self, args: tuple, kws: dict) -> tuple:
        """Finds, or compiles, what a call in another kernel needs.

        Args:
            args: Types of the arguments.
            kws: Types of those that are named.
        """
        kws = {name: kind_of(argument) for name, argument in kws.items()}
        codegen = _codegen()
        was, codegen.is_for_kernels = codegen.is_for_kernels, True
        try:
            return super().get_call_template(tuple(map(kind_of, args)), kws)
        finally:
            codegen.is_for_kernels = was

    def add_overload(self, cres) -> None:
        """Takes what was compiled, or read from disk.

        Args:
            cres: numba's result.
        """
        self.overloads[tuple(cres.signature.args)] = cres

    def compile(self, sig: tuple) -> object:
        """Finds, or compiles, what a call needs.

        Args:
            sig: Types of the arguments.
        """
        arguments, _ = sigutils.normalize_signature(sig)
        kinds = tuple(map(kind_of, arguments))
        with global_compiler_lock:
            compiled = super().compile(kinds)
            if _codegen().is_for_kernels:
                return compiled
            result = self.overloads[kinds]
            if not result.library.is_machine_code:
                # So far only kernels called it.
                compiled = self.targetctx.get_executable(
                    result.library, result.fndesc, result.environment)  # fmt: skip
                self.targetctx.insert_user_function(compiled, result.fndesc, [result.library])
                self.overloads[kinds] = result._replace(entry_point=compiled)
            if result.library.is_unsaved:
                self._cache.save_overload(kinds, result)
            # numba takes none of two that are the same.
            if arguments not in self.ready:
                self.ready.add(arguments)
                self._insert([argument._code for argument in arguments], compiled, False)
            return compiled


class Kernel(_AnyKernel):
    """A kernel that Python calls. `traced_stage` gives it another `__call__` while it records."""


class InnerKernel(_AnyKernel):
    """A kernel that only kernels call. numba crashes where Python calls such a kernel."""

    def __call__(self, *arguments):
        """Refuses.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"{self.py_func.__name__} is called by kernels only (INNER, INLINED, ONCE)")


def njit(**options: object) -> Callable[[Callable], CPUDispatcher]:
    """Compiles a kernel as `numba.njit` does, with the options above.

    A kernel from outside of this package is not kept on disk; see `kernel_cache.py`.

    Args:
        **options: One of the sets above, such as `KERNEL`.
    """

    is_inner = bool(options.pop("only_kernels_call", False))
    is_kept = bool(options.pop("cache", False))

    def compiled(function):
        kernel = numba.njit(**options, no_cpython_wrapper=is_inner)(function)
        if is_kept and function.__module__.startswith(_PACKAGE):
            kernel._cache = KernelCache(function)
        kernel.__class__ = InnerKernel if is_inner else Kernel
        kernel.ready = set()
        _progress.known += 1
        return kernel

    return compiled


SILENT, TOLD_EVERY = 2.0, 4.0
"""Time of compilation in a process before the first line about it, and from line to line [s]."""
_log = logging.getLogger("softrobot_twin")


class CompilationProgress(events.Listener):
    """Tells from time to time how many kernels were compiled, and which is next.

    Attributes:
        known: Kernels of the imported modules: no more can be needed, and a scene needs fewer.
        compiled: Those of them that this process has compiled; those kept on disk are not among
            them. One that is compiled for several types of arguments counts once.
        seconds: Time that this took [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.known = 0
        self.compiled: set[CPUDispatcher] = set()
        self.seconds = self._told_at = 0.0
        self._clock, self._began = clock, 0.0
        self._depth = 0

    def on_start(self, event: events.Event) -> None:
        """Before a kernel is compiled, or one that it calls.

        Args:
            event: numba's event; its data name the kernel.
        """
        now = self._clock()
        if self._depth == 0:
            self._began = now
        self._depth += 1
        seconds = self.seconds + now - self._began
        if seconds < SILENT or seconds - self._told_at < TOLD_EVERY:
            return
        self._told_at = seconds
        function = event.data["dispatcher"].py_func
        module = function.__module__.removeprefix(_PACKAGE)
        _log.warning(
            "softrobot_twin: compiled %d of at most %d kernels in %.0f s, now %s.%s",
            len(self.compiled), self.known, seconds, module, function.__name__,
        )  # fmt: skip

    def on_end(self, event: events.Event) -> None:
        """After it, or after it failed.

        Args:
            event: numba's event; its data name the kernel.
        """
        self._depth -= 1
        # numba compiles functions of its own, too.
        if isinstance(event.data["dispatcher"], (Kernel, InnerKernel)):
            self.compiled.add(event.data["dispatcher"])
        if self._depth == 0:
            self.seconds += self._clock() - self._began


    def elapsed(self) -> float:
        """Time that compilation took so far, also that which goes on [s]."""
        return self.seconds + (self._clock() - self._began if self._depth else 0.0)


_progress = CompilationProgress()


def compilation_time() -> float:
    """Time that this process has compiled kernels for [s]."""
    return _progress.elapsed()


class _CollectLater(events.Listener):
    """Switches Python's garbage collector off while a kernel is compiled.

    The compiler makes many objects, of which most are in use to its end; to look through them again
    and again takes a tenth of its time. numba compiles one kernel at a time, and inside it those
    that it calls.
    """

    def __init__(self) -> None:
        self._depth, self._was_enabled = 0, False

    def on_start(self, event: events.Event) -> None:
        """Before a kernel is compiled."""
        if self._depth == 0:
            self._was_enabled = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: events.Event) -> None:
        """After it, or after it failed."""
        self._depth -= 1
        if self._depth == 0 and self._was_enabled:
            gc.enable()


events.register("numba:compile", _CollectLater())
events.register("numba:compile", _progress)
