"""Kernels have only what they need, and those that only kernels call say so."""

import ast
import gc
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
