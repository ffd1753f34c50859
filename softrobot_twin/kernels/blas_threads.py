"""What OpenBLAS does where it was loaded before the package could set its variables.

OpenBLAS reads `OPENBLAS_NUM_THREADS` when it is loaded, which is when numpy or scipy is imported
first. Small products become up to fifty times slower with several threads on a busy machine: they
wait for a thread whose core another program has, up to 100 ms in a real-time thread. So is
`OPENBLAS_CORETYPE`; that cannot be changed later (instruction_set.py).
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_MAPS = Path("/proc/self/maps")
_NAMES = tuple(
    f"{prefix}openblas_{{}}{suffix}" for prefix in ("scipy_", "") for suffix in ("64_", "")
)
"""Names of a function in the wheels of numpy and scipy, and in a library of the system."""


def use_one_blas_thread() -> None:
    """Sets one thread in each OpenBLAS that this process has loaded."""
    for set_threads in _loaded("set_num_threads"):
        set_threads(1)


def loaded_blas_core() -> str | None:
    """The processor whose loops the OpenBLAS has that this process loaded; None without one."""
    for core_name in _loaded("get_corename"):
        core_name.restype = ctypes.c_char_p
        return core_name().decode()
    return None


def _loaded(name: str) -> Iterator[Any]:
    """A function of each loaded OpenBLAS that has it."""
    try:
        lines = _MAPS.read_text().splitlines()
    except OSError:
        return  # Not Linux.
    fields = (line.split(maxsplit=5) for line in lines if "openblas" in line)
    for path in sorted({field[5] for field in fields if len(field) == 6}):
        try:
            library = ctypes.CDLL(path, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
        except OSError:
            continue
        for form in _NAMES:
            if hasattr(library, form.format(name)):
                yield getattr(library, form.format(name))
                break
