"""Properties of the machine on which times are measured: processor, versions, memory."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "daqp", "rerun-sdk")
"""Libraries of a loop with a view."""
NUMERICAL_LIBRARIES = ("numpy", "scipy", "numba", "daqp")
"""Libraries of a step."""
BLAS_THREADS = "OPENBLAS_NUM_THREADS"


def versions(libraries: tuple[str, ...] = LIBRARIES) -> dict[str, str | None]:
    """Versions of the libraries; None for one that is not installed as a package.

    Args:
        libraries: Names of distributions.
    """
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in ("softrobot_twin", *libraries):
        found[name.removesuffix("-sdk")] = installed_version(name)
    # The package name differs between the wheels and a sourced installation.
    found["rclpy"] = installed_version("rclpy") or installed_version("ros-jazzy-rclpy")
    return found


def installed_version(name: str) -> str | None:
    """Version of a library; None where it is not installed as a package.

    Args:
        name: Name of the distribution.
    """
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
    """Machine and versions in one line, with the requested number of BLAS threads.

    Args:
        libraries: Names of distributions.
    """
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


