"""Kernels on disk are compiled anew where a source of theirs changed, and only there."""

import os
import pickle
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import CodeType
from zipfile import ZipFile

import pytest
from compile_kernels import run_scene

from softrobot_twin.kernels import kernel_cache, kernels_ahead
from test.places import PACKAGE

MODULES = sorted(
    ".".join((PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts))
    for path in PACKAGE.rglob("*.py") if path.stem not in ("__init__", "__main__")
)  # fmt: skip
# A small package of the same name: `scale` of the constant in `size`, called by `outer`, which also
# calls what belongs to the type in `law`, and has no import of it.
SMALL_PACKAGE = {
    "__init__": "",
    "size": "SIZE = 2.0\n",
    "other": "OTHER = 1.0\n",
    "inner": """
from softrobot_twin.kernels.compilation import INNER, njit
from softrobot_twin.size import (
    SIZE,
)
@njit(**INNER)
def scale(x):
    return SIZE * x
""",
    "dispatch": """
from numba.extending import overload
def response(law): raise NotImplementedError
FOUND = {}
@overload(response)
def _response(law):
    found = FOUND[law.instance_class]
    return lambda law: found(law)
""",
    "law": """
from typing import NamedTuple
from softrobot_twin.dispatch import FOUND
from softrobot_twin.kernels.compilation import INNER, njit
class Law(NamedTuple):
    stiffness: float
@njit(**INNER)
def own_response(law):
    return 10.0 * law.stiffness
FOUND[Law] = own_response
""",
    "outer": """
from softrobot_twin.dispatch import response
from softrobot_twin.inner import scale
from softrobot_twin.kernels.compilation import KERNEL, njit
@njit(**KERNEL)
def outer(law, x):
    return scale(x) + response(law)
""",
}
RUN = """
import sys
from softrobot_twin import law, other, outer
if len(sys.argv) > 1:  # Kernels are compiled when the other side has closed its end.
    print("begun", flush=True)
    sys.stdin.read()
print(outer.outer(law.Law(1.0), 3.0), sum(outer.outer._cache_misses.values()))
"""


@pytest.fixture
def small_package(tmp_path) -> Path:
    folder = tmp_path / "one" / "softrobot_twin"
    folder.mkdir(parents=True)
    for name, content in SMALL_PACKAGE.items():
        (folder / f"{name}.py").write_text(content)
    (folder / "kernels").mkdir()
    for name in ("compilation.py", "kernel_cache.py", "machine_code.py"):
        shutil.copy(PACKAGE / "kernels" / name, folder / "kernels")
    return folder


def environment(package: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    # Python's own compiled files would hide a change by their times.
    return kept | {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(package.parents[1]),
                   "PYTHONDONTWRITEBYTECODE": "1"}


def run(package: Path, code: str = RUN) -> tuple[float, ...]:
    """What `outer` returns, and how many kernels were compiled for Python."""
    done = subprocess.run([sys.executable, "-c", code], env=environment(package),
                          cwd=package.parents[1], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return tuple(map(float, done.stdout.split()))


def begun(package: Path, code: str = RUN, arguments=("wait",), told: str = "begun") -> subprocess.Popen:
    """A process that has told where it is, and goes on when its input ends."""
    process = subprocess.Popen([sys.executable, "-c", code, *arguments], env=environment(package),
                               cwd=package.parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == f"{told}\n"
    return process


def entries(package: Path) -> set[Path]:
    return set((package.parents[1] / "softrobot_twin/kernels").glob("*.nbc"))


@pytest.mark.sampled
@pytest.mark.parametrize("file, old, new, result", [
    ("size", "2.0", "5.0", (25.0, 1)),
    ("inner", "SIZE * x", "SIZE * x + 1.0", (17.0, 1)),
    # A law is compiled into a kernel of a file that does not import it.
    ("law", "10.0", "20.0", (26.0, 1)),
    pytest.param("other", "1.0", "7.0", (16.0, 0), marks=pytest.mark.exhaustive),
    # A module that is there already becomes one of the imports.
    ("inner", "from softrobot_twin.size import", "from softrobot_twin.other import OTHER\n"
     "from softrobot_twin.size import", (16.0, 1)),
])  # fmt: skip
def test_a_change_compiles_the_kernels_that_import_it_and_no_others(small_package, file, old, new, result):
    assert run(small_package) == (16.0, 1)
    assert run(small_package) == (16.0, 0)
    path = small_package / f"{file}.py"
    times = path.stat()
    path.write_text(path.read_text().replace(old, new))
    # The content counts, not the time.
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert run(small_package) == result


@pytest.mark.exhaustive
def test_another_checkout_of_the_same_sources_compiles_nothing(small_package):
    run(small_package)
    other = small_package.parents[1] / "two" / "softrobot_twin"
    shutil.copytree(small_package, other)
    assert run(other) == (16.0, 0)


@pytest.mark.exhaustive
def test_of_processes_that_need_a_kernel_at_once_one_compiles_it(small_package):
    processes = [begun(small_package) for _ in range(3)]
    for process in processes:
        process.stdin.close()
    results = sorted(process.stdout.read().split() for process in processes)
    assert [process.wait() for process in processes] == [0, 0, 0]
    assert results == [["16.0", "0"], ["16.0", "0"], ["16.0", "1"]]
    kept = sorted(entry.name.split("-")[0] for entry in entries(small_package))
    assert kept == ["inner.scale", "law.own_response", "outer.outer"]
    assert run(small_package) == (16.0, 0)


@pytest.mark.exhaustive
def test_nobody_waits_for_a_kernel_that_could_not_be_compiled(small_package):
    code = RUN.replace("print(outer.outer(law.Law(1.0), 3.0)", """
try:
    outer.outer(law.Law(1.0), "text")
except Exception:
    print("failed", flush=True)
sys.stdin.read()
print(1.0""")
    for process in [begun(small_package, code, (), "failed") for _ in range(2)]:
        process.communicate()


def test_kernels_that_came_with_the_package_are_not_compiled(small_package):
    run(small_package)
    with ZipFile(small_package / "kernels" / "kernels.zip", "w") as archive:
        for entry in entries(small_package):
            archive.write(entry, entry.name)
    installed = small_package.parents[1] / "elsewhere" / "two" / "softrobot_twin"
    shutil.copytree(small_package, installed)
    assert run(installed) == (16.0, 0) and not entries(installed)


WRITE_LIST = """
import lzma, pickle
from softrobot_twin import law, outer
from softrobot_twin.kernels import kernel_cache, kernels_ahead
outer.outer(law.Law(1.0), 3.0)
calls = [(module, name, pickle.dumps(types))
         for module, name, types in kernel_cache.used.values() if name == "outer"]
calls += [("softrobot_twin.law", "renamed", calls[0][2])]
kernels_ahead.LIST.write_bytes(
    lzma.compress(pickle.dumps([kernels_ahead.SceneKernels(frozenset(), tuple(calls))])))
"""
AHEAD = """
import os
from softrobot_twin.kernels.kernels_ahead import compile_ahead
compile_ahead(0, 0, 1, os.getppid())
"""


@pytest.mark.exhaustive
def test_another_process_compiles_what_a_list_names(small_package):
    shutil.copy(PACKAGE / "kernels" / "kernels_ahead.py", small_package / "kernels")
    run(small_package, WRITE_LIST)
    for entry in entries(small_package):
        entry.unlink()
    run(small_package, AHEAD.replace("getppid", "getpid"))
    assert not entries(small_package)  # Its parent has ended.
    run(small_package, AHEAD)
    assert run(small_package) == (16.0, 0)


def test_the_list_by_which_processes_compile_ahead_is_of_these_sources():
    """It is written for a release, and here: `python tools/compile_kernels.py --ship`."""
    words = run_scene("finger", ())[1].words
    called = {(module, name, str(types)) for module, name, types in kernel_cache.used.values()}
    nearest = min(kernels_ahead.scenes_of_list(), key=lambda scene: len(scene.words ^ words))
    found = [(module, name, str(pickle.loads(types))) in called
             for module, name, types in nearest.kernels]  # fmt: skip
    assert len(found) > 50 and sum(found) > 0.9 * len(found)


@pytest.mark.exhaustive
def test_a_source_that_changes_in_a_run_is_not_that_of_its_kernels(small_package):
    process = begun(small_package)
    size = small_package / "size.py"
    size.write_text(size.read_text().replace("2.0", "5.0"))
    assert process.communicate()[0].split() == ["16.0", "1"]
    assert run(small_package) == (25.0, 1)


@pytest.mark.exhaustive
def test_a_damaged_entry_is_compiled_anew(small_package):
    run(small_package)
    for entry in entries(small_package):
        entry.write_bytes(entry.read_bytes()[:-10])
    assert run(small_package) == (16.0, 1)
    assert run(small_package) == (16.0, 0)


@pytest.mark.exhaustive
def test_entries_that_nobody_used_for_a_week_are_deleted(small_package):
    run(small_package)
    (outer,) = (entry for entry in entries(small_package) if entry.name.startswith("outer."))
    folder = outer.parent
    now = time.time()
    for name, days in (("old.f-0-0.nbc", 8), ("recent.f-0-0.nbc", 6), ("old.f-0-1.nbcabc", 8)):
        (folder / name).touch()
        os.utime(folder / name, (now, now - days * 24 * 3600))
    # One that is used is as good as new.
    os.utime(outer, (now, now - 6 * 24 * 3600))
    os.utime(folder / "last_cleaned", (now, now - 2 * 24 * 3600))
    assert run(small_package) == (16.0, 0)
    assert {"old.f-0-0.nbc", "old.f-0-1.nbcabc"} & set(os.listdir(folder)) == set()
    assert (folder / "recent.f-0-0.nbc").is_file()
    assert time.time() - outer.stat().st_mtime < 3600


@pytest.mark.exhaustive
def test_the_environment_names_the_folder_and_one_that_cannot_be_written_is_replaced(
        small_package, tmp_path, monkeypatch):  # fmt: skip
    print_folder = "from softrobot_twin.kernels.kernel_cache import kernel_folder; print(kernel_folder())"

    def folder(**variables) -> Path:
        return Path(subprocess.run(
            [sys.executable, "-c", print_folder], env=environment(small_package) | variables,
            capture_output=True, text=True, check=True).stdout.strip())  # fmt: skip

    assert folder() == tmp_path / "softrobot_twin/kernels"
    assert folder(NUMBA_CACHE_DIR=str(tmp_path / "mine")) == tmp_path / "mine"
    (tmp_path / "file").touch()
    replaced = folder(NUMBA_CACHE_DIR=str(tmp_path / "file"))
    assert replaced.is_dir() and replaced.parent != tmp_path
    shutil.rmtree(replaced)


@pytest.mark.exhaustive
def test_a_kernel_or_a_law_from_outside_is_not_kept(small_package):
    code = RUN + """
from typing import NamedTuple
from softrobot_twin.dispatch import FOUND
from softrobot_twin.kernels.compilation import KERNEL, njit
class Own(NamedTuple):
    stiffness: float
@njit(**KERNEL)
def own_response(law):
    return 100.0 * law.stiffness
FOUND[Own] = own_response
print(outer.outer(Own(1.0), 3.0), own_response(Own(2.0)))
"""
    run(small_package)
    before = entries(small_package)
    for _ in range(2):
        assert run(small_package, code) == (16.0, 0, 106.0, 200.0)
    assert entries(small_package) == before


def names_in(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from names_in(constant)


def test_the_closure_of_each_kernel_holds_all_that_it_refers_to():
    from numba.core.dispatcher import Dispatcher

    kernels = {
        kernel for module in MODULES if "njit" in Path(
            PACKAGE.parent.joinpath(*module.split(".")).with_suffix(".py")).read_text()
        for kernel in vars(import_module(module)).values() if isinstance(kernel, Dispatcher)
    }  # fmt: skip
    assert len(kernels) > 600
    lost = []
    for function in (kernel.py_func for kernel in kernels):
        closure = kernel_cache.closure(function.__module__)
        cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
        found = [function.__globals__.get(name) for name in names_in(function.__code__)]
        found += [cell.cell_contents for cell in cells.values()]
        for used in found:
            home = getattr(used, "__module__", None)
            home = getattr(used, "__name__", None) if type(used).__name__ == "module" else home
            if str(home).startswith(PACKAGE.name) and home not in closure:
                lost.append((function.__module__, function.__qualname__, home))
    assert lost == []


def test_what_is_found_by_type_is_in_the_closure_of_the_type_or_of_the_name():
    """Laws belong to the module of their parameters, overloads to that of the name."""
    from numba.core.typing.templates import builtin_registry

    for module in MODULES:
        if module.startswith("softrobot_twin.mechanics"):
            import_module(module)
    from softrobot_twin.mechanics.point_law import LAWS

    laws = {
        (kernel.py_func.__module__, law.parameters.__module__) for law in LAWS.values()
        for kernel in law if hasattr(kernel, "py_func")
        if law.parameters.__module__.startswith(PACKAGE.name)
    }  # fmt: skip
    assert len(laws) > 5
    assert [pair for pair in laws if pair[0] not in kernel_cache.closure(pair[1])] == []
    overloads = {
        (template._overload_func.__module__, template.key.__module__)
        for template in builtin_registry.functions if hasattr(template, "_overload_func")
    }  # fmt: skip
    ours = {pair for pair in overloads if str(pair[0]).startswith(PACKAGE.name)}
    assert len(ours) >= 2 and all(one == other for one, other in ours)
