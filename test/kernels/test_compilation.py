"""Kernels have only what they need, and those that only kernels call say so."""

import ast
import json
import os
import re
import subprocess
import sys
from collections import Counter

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

from softrobot_twin.kernels.compilation import INNER, KERNEL, Kernel, njit
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
from test.places import PACKAGE

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


def first_of(numbers, place):
    return numbers[place]


def test_a_kernel_is_compiled_once_for_all_numbers_and_for_read_only_arrays():
    first = njit(**{**KERNEL, **UNCACHED})(first_of)
    calls = njit(**{**KERNEL, **UNCACHED})(lambda numbers, k: first(numbers, k) + first(numbers, 2))
    numbers = np.arange(3.0)
    frozen = np.arange(3.0)
    frozen.setflags(write=False)
    assert calls(numbers, 1) == calls(frozen, 1) == calls(frozen, 1) == 3.0
    assert first(frozen, 1) == first(numbers, 1) == 1.0
    assert len(first.overloads) == len(calls.overloads) == 1


def test_read_only_arrays_in_a_record_are_arrays_as_any_other():
    take = njit(**{**KERNEL, **UNCACHED})(lambda record: record[0][0] + record[1])
    frozen = np.ones(1)
    frozen.setflags(write=False)
    assert take((np.ones(1), 2.0)) == take((frozen, 2.0)) == 3.0
    assert len(take.overloads) == 1


def arrays_in(values):
    for value in values:
        if isinstance(value, np.ndarray):
            yield value
        elif isinstance(value, tuple):
            yield from arrays_in(value)


@pytest.mark.parametrize("scene", ["diamond", pytest.param("finger", marks=pytest.mark.exhaustive),
                                   pytest.param("fetch", marks=pytest.mark.exhaustive)])  # fmt: skip
def test_no_kernel_writes_an_array_that_is_read_only(monkeypatch, scene):
    """numba would refuse such a kernel, if read-only arrays had a type of their own."""
    count, call = 0, CPUDispatcher.__call__

    def checked(kernel, *given):
        nonlocal count
        frozen = [array for array in arrays_in(given) if not array.flags.writeable]
        copies = [array.copy() for array in frozen]
        returned = call(kernel, *given)
        for array, copy in zip(frozen, copies, strict=True):
            np.testing.assert_array_equal(array, copy, kernel.py_func.__name__)
        count += len(frozen)
        return returned

    monkeypatch.setattr(Kernel.__base__, "__call__", checked, raising=False)
    Simulation(load_scene(PACKAGE.parent / "config" / "scenes" / f"{scene}.yaml")).warm_up()
    assert count > 50


@pytest.fixture(scope="module")
def nodes() -> list[ast.AST]:
    """Nodes of the syntax trees of all sources."""
    trees = [ast.parse(path.read_text()) for path in PACKAGE.rglob("*.py")]
    return [node for tree in trees for node in ast.walk(tree)]


@pytest.mark.exhaustive
def test_a_kernel_that_is_read_where_it_is_called_is_called_at_one_place(nodes):
    named = Counter(node.id for node in nodes if isinstance(node, ast.Name))
    named.update(node.attr for node in nodes if isinstance(node, ast.Attribute))
    options = {
        node.name: text
        for node in nodes if isinstance(node, ast.FunctionDef)
        for text in map(ast.unparse, node.decorator_list) if text.startswith("njit(")
    }  # fmt: skip
    read = [name for name, chosen in options.items() if re.search(r"ONCE|\binline=", chosen)]
    assert len(read) > 100
    assert [name for name in read if named[name] != 1] == []


# What the scenes of this package compile, as it would be kept on disk.
COMPILED = """
import json, logging, sys
from pathlib import Path
from softrobot_twin.kernels.kernel_cache import KernelCache
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
found = {}
def record(cache, signature, data):
    function = cache._function
    name = f"{function.__module__}.{function.__qualname__}".removeprefix("softrobot_twin.")
    kinds = list(map(str, data.signature.args))
    found.setdefault(name, {})[str(kinds)] = kinds
KernelCache.load_overload, KernelCache.save_overload = lambda *_: None, record
logging.disable(logging.WARNING)
for scene in sorted(Path(sys.argv[1]).glob("*.yaml")):
    Simulation(load_scene(scene)).warm_up()
json.dump({name: list(kinds.values()) for name, kinds in found.items()}, sys.stdout)
"""
MOST_KERNELS = 500
# Kernels that are compiled for more than one kind of arguments, and why.
REASONS = dict.fromkeys(
    ("mechanics.element_assembly." + name for name in ("add_energies", "add_forces", "add_stiffness")),
    "laws",
) | {
    "geometry.matrix3.rows": "blocks of matrices, and numbers of four bytes",
    "geometry.vector3.row": "blocks of matrices, numbers of four bytes, and cells of grids",
    "geometry.vector3.set_row": "cells of grids",
    "mechanics.laws.small_displacement.hooke": "laws",
    "mechanics.stencil.add_block": "numbers of four bytes",
    "mechanics.stencil.add_stencil_matrix": "numbers of four bytes",
    "solvers.contact_law.copy_into": "numbers of rows",
    "kernels.traced_stage.clear": "counts",
}


@pytest.mark.exhaustive
@pytest.mark.timeout(1800)
def test_the_scenes_need_at_most_500_kernels_and_none_twice_without_a_reason():
    run = subprocess.run(
        [sys.executable, "-c", COMPILED, PACKAGE.parent / "config" / "scenes"],
        env={**os.environ, "NUMBA_OPT": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = json.loads(run.stdout)
    assert sum(map(len, found.values())) <= MOST_KERNELS
    assert {name for name, kinds in found.items() if len(kinds) > 1} <= set(REASONS)
