"""One thread of OpenBLAS also where it was loaded before the package could ask for one.

OpenBLAS reads `OPENBLAS_NUM_THREADS` when it is loaded, which is when numpy or scipy is imported
first. Small products become up to fifty times slower with several threads on a busy machine: they
wait for a thread whose core another program has, up to 100 ms in a real-time thread.
"""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

_MAPS = Path("/proc/self/maps")
_SETTERS = tuple(
    f"{prefix}openblas_set_num_threads{suffix}"
    for prefix in ("scipy_", "") for suffix in ("64_", "")
)  # fmt: skip
"""Names of the function in the wheels of numpy and scipy, and in a library of the system."""


def use_one_blas_thread() -> list[str]:
    """Sets one thread in each OpenBLAS that this process has loaded.

    Returns:
        Paths of these libraries.
    """
    try:
        lines = _MAPS.read_text().splitlines()
    except OSError:
        return []  # Not Linux.
    fields = (line.split(maxsplit=5) for line in lines if "openblas" in line)
    paths = sorted({field[5] for field in fields if len(field) == 6})
    return [path for path in paths if _set_one_thread(path)]


def _set_one_thread(path: str) -> bool:
    """Sets one thread in a loaded library; false where it has no such function."""
    try:
        library = ctypes.CDLL(path, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
    except OSError:
        return False
    for name in _SETTERS:
        if hasattr(library, name):
            getattr(library, name)(1)
            return True
    return False
