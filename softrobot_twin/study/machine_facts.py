"""The machine on which figures were taken: versions, memory, and the speed of dense products."""

from __future__ import annotations

import os
import platform
import resource
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import thread_time

import numpy as np

LIBRARIES = ("numpy", "scipy", "osqp", "rerun-sdk")
"""What a loop with a view runs on."""
NUMERICAL_LIBRARIES = ("numpy", "scipy", "numba", "osqp", "daqp")
"""What a step runs on."""
BLAS_THREADS = "OPENBLAS_NUM_THREADS"


def versions(libraries: tuple[str, ...] = LIBRARIES) -> dict[str, str | None]:
    """Versions of what the figures depend on; None for what is not installed as a package."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("softrobot_twin", *libraries):
        found[name.removesuffix("-sdk")] = _version(name)
    # From the wheels it goes by another name than from a sourced installation.
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


def machine_words(libraries: tuple[str, ...]) -> str:
    """The same in one line, with the number of BLAS threads asked for."""
    here = machine()
    found = {name: number for name, number in versions(libraries).items() if number}
    found.pop("rclpy", None)
    return (f"{here['processor']}, {here['cores']} cores, {platform.system()} "
            f"{here['architecture']}; "
            f"{BLAS_THREADS}={os.environ.get(BLAS_THREADS, 'unset')}; "
            + ", ".join(f"{name} {number}" for name, number in found.items()))


def resident_bytes() -> int | None:
    """Memory in RAM now; None where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def page_faults() -> int:
    """Pages that this process had to be given so far."""
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

        By processor time: what other processes take is left out.
        """
        np.matmul(self._a, self._b, out=self._c)
        start = thread_time()
        np.matmul(self._a, self._b, out=self._c)
        return 2.0 * _SIZE**3 / (thread_time() - start)
