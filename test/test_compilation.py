"""Kernels have only what they need, and those that only kernels call say so."""

import ast
import gc
import re
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core import event

from softrobot_twin.compilation import INNER, KERNEL, njit

PACKAGE = Path(__file__).resolve().parents[1] / "softrobot_twin"
UNCACHED = {"cache": False}


@njit(**{**INNER, **UNCACHED})
def twice(x):
    return 2.0 * x


@njit(**{**KERNEL, **UNCACHED})
def four_times(x):
    return twice(twice(x))


def test_an_inner_kernel_is_called_by_kernels_and_refuses_python():
    assert four_times(1.5) == 6.0
    with pytest.raises(TypeError, match="twice is called by kernels only"):
        twice(1.5)


def test_numbas_own_njit_refuses_the_options_of_an_inner_kernel():
    """It would make a kernel that crashes where Python calls it."""
    with pytest.raises(KeyError, match="only_kernels_call"):
        numba.njit(**INNER)(lambda x: x)(1.0)


def test_the_collector_waits_while_a_kernel_is_compiled_and_not_longer():
    seen = []

    class Watch(event.Listener):
        def on_start(self, event):
            seen.append(gc.isenabled())

        def on_end(self, event):
            pass

    @njit(**{**KERNEL, **UNCACHED})
    def broken(x):
        return x.no_such_attribute

    watch = Watch()
    event.register("numba:run_pass", watch)
    try:
        for enabled in (True, False):
            (gc.enable if enabled else gc.disable)()
            four_times(np.float32(enabled) if enabled else 1j)
            assert gc.isenabled() is enabled
            with pytest.raises(Exception, match="no_such_attribute"):
                broken(1.0)
            assert gc.isenabled() is enabled
    finally:
        gc.enable()
        event.unregister("numba:run_pass", watch)
    assert seen and not any(seen)


def test_all_kernels_take_their_options_from_one_place():
    outside = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in PACKAGE.rglob("*.py") if path.name != "compilation.py"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module == "numba"
        and {"njit", "jit"} & {name.name for name in node.names}
    ]  # fmt: skip
    assert outside == []


# An entry of a docstring: names of arguments, and what is said of them. Vectors and matrices that
# are tuples have no shape; how many numbers they have is said.
ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", re.MULTILINE)
ELSEWHERE = re.compile(r"are as in `(\w+)`")
# Kernels whose first argument is an array, and the builtin that measures one.
TAKE_AN_ARRAY = {"len", "row", "rows", "set_row", "set_rows"}


def public_kernels() -> list[tuple[Path, ast.FunctionDef]]:
    """Every kernel of the package whose name has no leading underscore, and its file."""
    return [
        (path.relative_to(PACKAGE), node)
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
        and any(ast.unparse(each).startswith("njit(") for each in node.decorator_list)
    ]  # fmt: skip


def array_arguments(kernel: ast.FunctionDef) -> set[str]:
    """Arguments that the kernel indexes or measures."""
    used = set()
    for node in ast.walk(kernel):
        if isinstance(node, ast.Subscript):
            used.add(ast.unparse(node.value))
        elif isinstance(node, ast.Attribute) and node.attr in {"shape", "size"}:
            used.add(ast.unparse(node.value))
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in TAKE_AN_ARRAY:
            used.add(ast.unparse(node.args[0]))
    return used & {each.arg for each in kernel.args.args}


def test_arrays_among_the_arguments_of_a_kernel_are_found():
    source = "def add(x, y, z, count): row(x, 0); y[count] += z.shape[0]"
    assert array_arguments(ast.parse(source).body[0]) == {"x", "y", "z"}


def test_every_public_kernel_has_a_docstring():
    kernels = public_kernels()
    assert len(kernels) > 500
    bare = [f"{path}:{node.name}" for path, node in kernels if not ast.get_docstring(node)]
    assert bare == []


def arrays_of_module(path: Path) -> set[str]:
    """Arguments whose shape the docstring of a module tells, once for all of its kernels."""
    text = ast.get_docstring(ast.parse(path.read_text())) or ""
    told = {
        name for names, what in ENTRY.findall(text) if "shape" in what or "number" in what
        for name in names.split(", ")
    }  # fmt: skip
    for other in ELSEWHERE.findall(text):
        told |= arrays_of_module(path.with_name(f"{other}.py"))
    return told


def test_a_module_tells_shapes_for_all_of_its_kernels(tmp_path):
    (tmp_path / "surface.py").write_text('"""Surfaces:\n    x, y: Of shape (n, 3).\nEnd."""')
    module = tmp_path / "module.py"
    module.write_text(
        '"""Arguments:\n    p: A point, three\n        numbers.\n    q: A point.\n'
        'Others are as in `surface`.\n"""'
    )
    assert arrays_of_module(module) == {"p", "x", "y"}


def test_docstrings_tell_shapes_of_all_arrays_of_public_kernels():
    silent = [
        f"{path}:{node.name}" for path, node in public_kernels()
        if "shape" not in (ast.get_docstring(node) or "")
        and array_arguments(node) - arrays_of_module(PACKAGE / path)
    ]  # fmt: skip
    assert silent == []
