"""What is said while kernels are compiled."""

from types import SimpleNamespace

import numba
import pytest

from softrobot_twin import compilation
from softrobot_twin.compilation import CompilationProgress

pytestmark = pytest.mark.libraries


def compilation_of(function=lambda x: x, njit=compilation.njit):
    """What numba tells before and after it compiles a kernel."""
    return SimpleNamespace(data={"dispatcher": njit()(function)})


def test_a_long_compilation_tells_every_few_seconds_how_far_it_is(caplog):
    now = [100.0]
    progress = CompilationProgress(lambda: now[0])
    progress.known = 60
    for _ in range(20):
        kernel, called = compilation_of(), compilation_of()
        progress.on_start(kernel)
        now[0] += 0.5
        progress.on_start(called)
        now[0] += 0.5
        progress.on_end(called)
        progress.on_end(kernel)
        now[0] += 100.0  # What lies between is no compilation.
    assert (len(progress.compiled), progress.seconds) == (40, 20.0)
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 4
    assert "compiled 8 of at most 60 kernels in 4 s, now " in lines[0]


def test_a_short_compilation_is_silent(caplog):
    now = [0.0]
    progress = CompilationProgress(lambda: now[0])
    for _ in range(3):
        progress.on_start(compilation_of())
        now[0] += 0.5
        progress.on_end(compilation_of())
    assert not caplog.records


def test_kernels_for_other_types_and_numbas_own_functions_do_not_add_to_the_count(caplog):
    now = [0.0]
    progress = CompilationProgress(lambda: now[0])
    progress.known = 1
    for each in [compilation_of()] * 4 + [compilation_of(njit=numba.njit)] * 4:
        progress.on_start(each)
        now[0] += 1.0
        progress.on_end(each)
    assert len(progress.compiled) == 1
    progress.on_start(compilation_of())
    assert "compiled 1 of at most 1 kernels" in caplog.records[-1].getMessage()
