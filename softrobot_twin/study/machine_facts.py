"""Properties of the machine on which times are measured: versions, memory, speed of dense
products; and measurements without garbage collection.
"""

from __future__ import annotations

import gc
import os
import platform
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import thread_time

import numpy as np

LIBRARIES = ("numpy", "scipy", "osqp", "rerun-sdk")
"""Libraries of a loop with a view."""
NUMERICAL_LIBRARIES = ("numpy", "scipy", "numba", "osqp", "daqp")
"""Libraries of a step."""
BLAS_THREADS = "OPENBLAS_NUM_THREADS"


def versions(libraries: tuple[str, ...] = LIBRARIES) -> dict[str, str | None]:
    """Versions of the libraries; None for one that is not installed as a package."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("softrobot_twin", *libraries):
        found[name.removesuffix("-sdk")] = _version(name)
    # The package name differs between the wheels and a sourced installation.
    found["rclpy"] = _version("rclpy") or _version("ros-jazzy-rclpy")
    return found


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def machine() -> dict[str, str | int | None]:
    """System, processor and its cores."""
    return {"system": platform.platform(), "architecture": platform.machine(),
            "processor": _processor_name(), "cores": os.cpu_count()}


def _processor_name() -> str | None:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or None
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or None


def describe_machine(libraries: tuple[str, ...]) -> str:
    """Machine and versions in one line, with the requested number of BLAS threads."""
    here = machine()
    found = {name: number for name, number in versions(libraries).items() if number}
    found.pop("rclpy", None)
    return (f"{here['processor']}, {here['cores']} cores, {platform.system()} "
            f"{here['architecture']}; "
            f"{BLAS_THREADS}={os.environ.get(BLAS_THREADS, 'unset')}; "
            + ", ".join(f"{name} {number}" for name, number in found.items()))


def resident_bytes() -> int | None:
    """Resident memory [B]; None where it is not known."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def page_faults() -> int:
    """Number of page faults of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt


_SIZE = 512


class DenseSpeed:
    """Times products of two square matrices in double precision."""

    def __init__(self) -> None:
        generator = np.random.default_rng(1)
        self._a, self._b = generator.standard_normal((2, _SIZE, _SIZE))
        self._c = np.empty((_SIZE, _SIZE))

    def measure(self) -> float:
        """Speed of one product, after another one that fills the caches [flop/s].

        It is measured in processor time, which does not include other processes.
        """
        np.matmul(self._a, self._b, out=self._c)
        start = thread_time()
        np.matmul(self._a, self._b, out=self._c)
        return 2.0 * _SIZE**3 / (thread_time() - start)


@cache
def _set_loaded_modules_aside() -> None:
    """Takes what lives as long as the process out of later collections, once.

    Modules make up most objects: a collection that visits them takes some tenths of a second, and a
    study begins many measurements.
    """
    gc.collect()
    gc.freeze()


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Collects garbage now and disables the collector inside the context."""
    was_on = gc.isenabled()
    _set_loaded_modules_aside()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
