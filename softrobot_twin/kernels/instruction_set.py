"""One instruction set for all machines of a kind, so that the same input gives the same bits on each.

numba compiles for the processor that it runs on; OpenBLAS and numpy take the loops written for it,
which add in another order or round otherwise than those for the next processor. Here all three are
told the *level* of the machine: the instructions that processors of the last ten years have. Its
name is a part of the names of kernels on disk, in place of the processor's.

This module imports nothing that is slow to import: numpy and numba read the environment when they
are imported, so it must be set before.
"""

from __future__ import annotations

import platform
import re
import sys
from collections.abc import MutableMapping
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from softrobot_twin.kernels.blas_threads import loaded_blas_core

PROCESSOR = Path("/proc/cpuinfo")
"""Where the system says what its processors have."""


class Level(NamedTuple):
    """Instructions that a kind of machines has.

    Attributes:
        name: Name of the processor for LLVM.
        flags: What the system says of a processor that has them.
        features: What LLVM says of it.
        blas_core: Name of the processor for OpenBLAS.
    """

    name: str
    flags: frozenset[str]
    features: str
    blas_core: str


# The loops of OpenBLAS 0.3.34 for Haswell and Zen crash in products and solves of some 64 unknowns on.
_X86_64 = (
    Level("x86-64-v3", frozenset("avx avx2 bmi1 bmi2 f16c fma abm movbe".split()),
          "+avx,+avx2,+bmi,+bmi2,+f16c,+fma,+lzcnt,+movbe", "Sandybridge"),
    Level("x86-64-v2", frozenset("cx16 lahf_lm popcnt sse4_1 sse4_2 ssse3".split()),
          "+cx16,+popcnt,+sahf,+sse4.2", "Nehalem"),
    Level("x86-64", frozenset(), "+sse2", "Prescott"),
)  # fmt: skip
_BASELINES = {"aarch64": Level("generic", frozenset(), "+neon", "ARMV8")}
# No level has these, and with them numpy's exp, log, tan and argsort give something else.
_AVX512_FLAGS = frozenset("avx512f avx512bw avx512cd avx512dq avx512vl".split())
_AVX512, _AVX512_SINCE_2_4 = "AVX512F AVX512_SKX", "X86_V4"


def level_of_machine() -> tuple[Level | None, set[str]]:
    """The highest level that this machine has, None for an unknown kind; and its flags."""
    machine = platform.machine()
    if machine != "x86_64":
        return _BASELINES.get(machine), set()
    try:
        with PROCESSOR.open(encoding="utf-8") as lines:
            # The first processor stands for all.
            flags = set(next((line for line in lines if line.startswith("flags")), "").split())
    except OSError:
        flags = set()  # Not Linux.
    return next(level for level in _X86_64 if level.flags <= flags), flags


def choose_level(environment: MutableMapping[str, str]) -> None:
    """Names the level of this machine to numba, OpenBLAS and numpy, unless the user named another.

    Where numpy was imported before, OpenBLAS and numpy have chosen for this processor; processes
    that this one starts then do the same.

    Args:
        environment: Variables of the environment, such as `os.environ`; they are changed.
    """
    level, flags = level_of_machine()
    # Vector code of Intel's library, where one is installed, is not rounded alike.
    environment.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    if level is None:
        return
    if not {"NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"} & environment.keys():
        environment.update(NUMBA_CPU_NAME=level.name, NUMBA_CPU_FEATURES=level.features)
    core, left_out = level.blas_core, _AVX512 if _AVX512_FLAGS <= flags else ""
    if "numpy" in sys.modules:
        core, left_out = loaded_blas_core(), ""
    elif left_out and _numpy_version() >= (2, 4):
        left_out = _AVX512_SINCE_2_4
    if core is not None:
        environment.setdefault("OPENBLAS_CORETYPE", core)
    environment.setdefault("NPY_DISABLE_CPU_FEATURES", left_out)


def _numpy_version() -> tuple[int, ...]:
    """Version of numpy; numpy is not imported."""
    text = Path(find_spec("numpy").origin).with_name("version.py").read_text(encoding="utf-8")
    return tuple(map(int, re.search(r'version = "(\d+)\.(\d+)', text).groups()))
