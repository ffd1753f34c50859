"""What is said while kernels are compiled."""

from types import SimpleNamespace

import numba
import pytest

from softrobot_twin.kernels import compilation
from softrobot_twin.kernels.compilation import CompilationProgress

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
