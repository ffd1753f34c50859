"""Compiled kernels on disk, each kept until a source that it is made of changes.

numba's own cache compiles a kernel anew when its own file changes, but not when a kernel or a
constant changes that it takes from another file. Here an entry's name contains a hash of the
kernel's *closure*: its source file and all files of this package that this file imports, directly
or not. A law is no import of the kernels that call it: numba finds it by the type of its
parameters. So the closures of the modules that define the types of the arguments are hashed too.

Neither the place of the package nor the times of its files count: checkouts and installed packages
of the same sources share entries. An entry is one file that is moved into its place as a whole, and
its name says all that it depends on. Of several processes that need the same kernel, one compiles it
and the others wait for the entry.

A release brings the entries of its scenes in one archive, `SHIPPED`, which is looked at first. Where
kernels must be compiled, other processes help: see `kernels_ahead.py`.

Kernels and types from outside of this package are not kept: what they import is not known.
"""

from __future__ import annotations

import fcntl
import logging
import os
import pickle
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import llvmlite.binding
import numba
from numba.core import event, sigutils, types
from numba.core.caching import _Cache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from softrobot_twin.kernels.machine_code import Library

if TYPE_CHECKING:
    from zipfile import ZipFile

_ROOT = Path(__file__).parents[1]
SHIPPED = Path(__file__).with_name("kernels.zip")
"""Archive of entries that came with the package; a clone has none until `make dist`."""
_PACKAGE = __name__.split(".")[0]
# It begins with a line break, which is found faster than the begin of a line.
_IMPORT = re.compile(rf"\n(?:from|import) ({_PACKAGE}[\w.]*)(?: import (\([^)]*\)|.*))?")
_DAY = 24 * 3600
# An entry that was not used for so long is deleted [s].
_SECONDS_KEPT = 7 * _DAY
# Bytes of the hash of an entry's content, at its beginning: the file may be damaged.
_DIGEST = 32
# Digits of the hashes in an entry's name.
_SHORT = 16


@cache
def _source(module: str) -> bytes | None:
    """Content of a module's file; None where it is none of this package."""
    name, *parts = module.split(".")
    path = os.path.join(_ROOT, *parts)
    for file in (f"{path}.py", f"{path}/__init__.py"):
        if name == _PACKAGE and os.path.isfile(file):
            return Path(file).read_bytes()
    return None


@cache
def _imports(module: str) -> frozenset[str]:
    """Modules of this package that a module imports."""
    found = set()
    for origin, names in _IMPORT.findall("\n" + _source(module).decode()):
        parts = {f"{origin}.{name}" for name in re.findall(r"\w+", names)}
        found |= {name for name in {origin, *parts} if _source(name) is not None}
    # This file makes no code.
    return frozenset(found - {__name__})


@cache
def closure(module: str) -> frozenset[str]:
    """Names of a module and all modules of this package that it imports, directly or not.

    Args:
        module: Its full name.
    """
    found, new = {module}, [module]
    while new:
        added = _imports(new.pop()) - found
        found |= added
        new += added
    return frozenset(found)


@cache
def closure_hash(module: str) -> str:
    """Hash of the sources of a module's closure.

    Args:
        module: Its full name.
    """
    state = sha256()
    for name in sorted(closure(module)):
        state.update(name.encode() + b"\0" + _source(name) + b"\0")
    return state.hexdigest()


@cache
def kernel_folder() -> Path:
    """The folder of the entries, which exists and can be written.

    It is the environment's NUMBA_CACHE_DIR; otherwise one in the user's folder of caches; and where
    this cannot be written, a temporary one, for this process and those that it starts.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(chosen or Path(home, _PACKAGE, "kernels"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix=f"{_PACKAGE}-kernels-"))
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
    _delete_unused(folder)
    return folder


def _delete_unused(folder: Path) -> None:
    """Deletes entries that were not used for a week; it looks once a day."""
    last = folder / "last_cleaned"
    if last.is_file() and time.time() - last.stat().st_mtime < _DAY:
        return
    last.touch()
    for entry in folder.glob("*.nbc*"):
        # Another process may delete the same ones.
        try:
            if time.time() - entry.stat().st_mtime > _SECONDS_KEPT:
                entry.unlink()
        except FileNotFoundError:
            pass


def _content(entry: Path) -> bytes | None:
    """Code of an entry, of the package or on disk; None where there is none or it is damaged."""
    shipped = _shipped_entries(os.getpid())
    if shipped is not None and entry.name in shipped.NameToInfo:
        content = shipped.read(entry.name)
    elif entry.is_file():
        content = entry.read_bytes()
        if time.time() - entry.stat().st_mtime > _DAY:
            entry.touch()
    else:
        return None
    digest, code = content[:_DIGEST], content[_DIGEST:]
    return code if sha256(code).digest() == digest else None


@cache
def _shipped_entries(process: int) -> ZipFile | None:
    """The archive of the package, opened by each process: they must not share a place in it."""
    if not SHIPPED.is_file():
        return None
    from zipfile import ZipFile

    return ZipFile(SHIPPED)


@cache
def _lock_file(process: int) -> Any:
    """A file of which each byte locks an entry. The system frees them when the process ends."""
    return (kernel_folder() / "lock").open("ab")


def lock(place: int, waits: bool = True) -> bool:
    """Locks a place for this process against others.

    Args:
        place: A number; those of entries are large.
        waits: Whether it waits while another process has it.

    Returns:
        Whether this process has it now. Without a lock, two processes may do the same.
    """
    try:
        fcntl.lockf(_lock_file(os.getpid()), fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB), 1, place)
    except OSError:
        return False
    return True


def _free(place: int) -> None:
    with suppress(OSError):
        fcntl.lockf(_lock_file(os.getpid()), fcntl.LOCK_UN, 1, place)


used: dict[str, tuple[str, str, tuple[types.Type, ...]]] = {}
"""What this process has asked for: module, name and types of arguments, by name of the entry."""
_before_compilation: list[Callable[[], None]] = []
# So many kernels are compiled before it pays to start other processes.
_FEW = 5
_missed: set[str] = set()


def before_compilation(begin: Callable[[], None]) -> None:
    """Calls a function once, when this process has to compile more than a few kernels from now on.

    Args:
        begin: The function.
    """
    _before_compilation[:] = [begin]
    _missed.clear()


def _modules_of_types(type_: types.Type) -> Iterator[str]:
    """Names of the modules that define a type of an argument and the types in it."""
    if isinstance(type_, types.BaseNamedTuple):
        yield type_.instance_class.__module__
    if isinstance(type_, types.BaseTuple):
        for part in type_:
            yield from _modules_of_types(part)


class KeptLibrary(Library):
    """Machine code from the disk. Its bitcode is parsed when a kernel is compiled that calls it."""

    def __init__(self, codegen, state, names, environments) -> None:
        """Take the machine code.

        Args:
            codegen: That of `machine_code`, of the machine that the code is for.
            state: As `serialize_using_object_code` gives it.
            names: Functions that Python or a driver may call.
            environments: Names of the places of its objects of Python.
        """
        name, _, (code, self._bitcode) = state
        super().__init__(codegen, name)
        self._code, self._environments, self._finalized = code, environments, True
        self._names = {one for one in names if one.encode() in code}

    def _has(self, name):
        return name in self._names

    def _make_machine_code(self):
        self.enable_object_caching()
        self._set_compiled_object(self._code)
        JITCodeLibrary._finalize_final_module(self)
        self._codegen._engine._defined_symbols |= {*self._names, *self._environments}
        self._codegen.set_environments(self._environments)

    def _get_module_for_linking(self):
        self._shared_module = self._shared_module or llvmlite.binding.parse_bitcode(self._bitcode)
        return self._shared_module


@cache
def _prepare(target_context) -> None:
    """Lets numba know all types, once: no code that is loaded needs what is declared later."""
    target_context.refresh()


def _place(entry: Path) -> int:
    """Where the lock of an entry is."""
    return int(entry.stem[-_SHORT:], 16) >> 2


class KernelCache(_Cache):
    """The entries of one kernel, in place of numba's cache.

    Attributes:
        cache_path: The folder of all entries.
    """

    def __init__(self, function) -> None:
        """Args: function: The kernel's Python function, of this package."""
        self._function = function
        # Read now: a file that changes while this process runs is not the source of its kernels.
        self._own = closure_hash(function.__module__)
        self._locked: list[int] = []

    @property
    def cache_path(self) -> str:
        """The folder of all entries."""
        return str(kernel_folder())

    def _entry(self, signature, codegen) -> Path | None:
        """Where the code for a signature belongs; None where it depends on what is not known."""
        function = self._function
        arguments, returned = sigutils.normalize_signature(signature)
        modules = {name for type_ in arguments for name in _modules_of_types(type_)}
        if None in map(_source, modules):
            return None
        cells = tuple(cell.cell_contents for cell in function.__closure__ or ())
        depends_on = (
            numba.__version__, sys.version_info[:2], codegen.magic_tuple(),
            numba.config.USING_SVML, str(arguments), str(returned),
            function.__code__.co_firstlineno, function.__code__.co_code,
            dumps(cells) if cells else None, sorted(map(closure_hash, modules)),
        )  # fmt: skip
        name = f"{function.__module__}.{function.__qualname__}".removeprefix(f"{_PACKAGE}.")
        rest = sha256(repr(depends_on).encode()).hexdigest()
        return kernel_folder() / f"{name}-{self._own[:_SHORT]}-{rest[:_SHORT]}.nbc"

    def load_overload(self, sig, target_context):
        """The compiled kernel for a signature; None where it is not kept or its file is damaged.

        Args:
            sig: Types of the arguments, as numba gives them.
            target_context: numba's, of the machine that the code is for.
        """
        _prepare(target_context)
        entry = self._entry(sig, target_context.codegen())
        if entry is None:
            return None
        used[entry.name] = self._function.__module__, self._function.__qualname__, sig
        code = _content(entry)
        if code is None:
            _missed.add(entry.name)
            if len(_missed) > _FEW and _before_compilation:
                _before_compilation.pop()()
            place = _place(entry)
            lock(place)
            code = _content(entry)
            if code is None:
                self._locked.append(place)  # Until it is compiled, or that fails.
                return None
            _free(place)
        state, fndesc, own, signature, _, lifted, annotation, begins, others = pickle.loads(code)
        for begin in begins:
            begin()
        codegen = target_context.codegen()
        if state[1] == "object":
            names = fndesc.llvm_func_name, fndesc.llvm_cpython_wrapper_name
            places = [environment.env_name for environment in (own, *others)]
            library = KeptLibrary(codegen, state, names, places)
        else:
            library = codegen.unserialize_library(state)
        result = CompileResult(
            target_context=target_context, typing_context=target_context.typing_context,
            entry_point=target_context.get_executable(library, fndesc, own), library=library,
            fndesc=fndesc, environment=own, signature=signature, type_annotation=annotation,
            lifted=lifted, reload_init=begins, referenced_envs=others, objectmode=False,
            typing_error=None, call_helper=None, metadata=None,
        )  # fmt: skip
        return result

    def save_overload(self, sig, data) -> None:
        """Keeps a compiled kernel.

        Args:
            sig: Types of the arguments, as numba gives them.
            data: The compiled kernel.
        """
        entry = self._entry(sig, data.codegen)
        if entry is None:
            return
        try:
            self._save(entry, data)
        finally:
            self.free()

    def _save(self, entry: Path, data) -> None:
        if data.lifted or data.library.has_dynamic_globals:
            raise TypeError(f"{entry.stem} holds addresses of this process and cannot be kept")
        code = dumps(data._reduce())
        unfinished = entry.with_suffix(f".nbc{uuid4().hex}")
        try:
            unfinished.write_bytes(sha256(code).digest() + code)
            unfinished.replace(entry)
        except OSError as error:
            unfinished.unlink(missing_ok=True)
            logging.getLogger(_PACKAGE).warning("a compiled kernel is not kept: %s", error)

    def free(self) -> None:
        """Lets other processes have the entry that this one has compiled, or has not."""
        if self._locked:
            _free(self._locked.pop())

    def enable(self) -> None:
        """Does nothing: it is always on."""

    def disable(self) -> None:
        """Refuses; numba never asks for it."""
        raise NotImplementedError

    def flush(self) -> None:
        """Refuses; numba never asks for it."""
        raise NotImplementedError


class _FreeAfterFailure(event.Listener):
    """Frees the lock of a kernel that could not be compiled, which is not saved."""

    def on_start(self, began: event.Event) -> None:
        """Before a kernel is compiled."""

    def on_end(self, ended: event.Event) -> None:
        """After it, or after it failed."""
        kernel = ended.data["dispatcher"]
        if isinstance(kernel._cache, KernelCache) and ended.data["args"] not in kernel.overloads:
            kernel._cache.free()


event.register("numba:compile", _FreeAfterFailure())
