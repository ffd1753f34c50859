"""Kernels have only what they need, and those that only kernels call say so."""

import os
import subprocess
import sys

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


# What the scenes of this package compile, as it would be kept on disk.
COMPILED = """
import logging, sys
from pathlib import Path
from softrobot_twin.kernels.kernel_cache import KernelCache
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
found = set()
def record(cache, signature, data):
    function = cache._function
    found.add((function.__module__, function.__qualname__, str(data.signature.args)))
KernelCache.load_overload, KernelCache.save_overload = lambda *_: None, record
logging.disable(logging.WARNING)
for scene in sorted(Path(sys.argv[1]).glob("*.yaml")):
    Simulation(load_scene(scene)).warm_up()
print(len(found))
"""


@pytest.mark.exhaustive
@pytest.mark.timeout(1800)
def test_the_scenes_need_at_most_500_kernels():
    run = subprocess.run(
        [sys.executable, "-c", COMPILED, PACKAGE.parent / "config" / "scenes"],
        env={**os.environ, "NUMBA_OPT": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert int(run.stdout) <= 500
