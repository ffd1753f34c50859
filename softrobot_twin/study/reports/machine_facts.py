"""On what machine, and with which versions, figures were taken."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LIBRARIES = ("numpy", "scipy", "osqp", "rerun-sdk")
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
