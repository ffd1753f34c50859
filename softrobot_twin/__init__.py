"""Digital twin and controller of soft robots: finite elements, Lagrange multipliers, inverse QP.

The method is that of Coevoet et al., "Software toolkit for modeling, simulation and control of
soft robots", Advanced Robotics 31 (2017). docs/equations.md lists where each of its equations is
computed.

Importing the package sets the number of BLAS threads to one and the folder of numba's compiled
kernels, unless the environment sets them. The folder must be set before numba is first imported.

    import softrobot_twin as st
    robot = st.load("finger.yaml")
    result = robot.step(st.targets(tip=[0.01, 0.0, 0.12]))

See docs/python.md.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
import time
from hashlib import sha1
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from softrobot_twin.blas_threads import use_one_blas_thread
from softrobot_twin.errors import SoftRobotTwinError

if TYPE_CHECKING:
    from softrobot_twin.scripting import (
        Pose,
        Result,
        Robot,
        SceneWarning,
        Status,
        build,
        efforts,
        hold,
        load,
        setpoints,
        targets,
    )

__all__ = [
    "Pose",
    "Result",
    "Robot",
    "SceneWarning",
    "SoftRobotTwinError",
    "Status",
    "build",
    "efforts",
    "hold",
    "load",
    "setpoints",
    "targets",
]

_SECONDS_KEPT = 7 * 24 * 3600
_CONSTANT = re.compile(rb"\b[A-Z][A-Z_]+\b")


def _kernel_sources() -> dict[str, bytes]:
    """Source files that compiled kernels depend on: files that use numba, directly or by `njit`,
    and files whose constants they import.

    Returns:
        Content of each file, by module name.
    """
    root = Path(__file__).parent
    contents = {
        ".".join((__name__, *path.relative_to(root).with_suffix("").parts)): path.read_bytes()
        for path in sorted(root.rglob("*.py"))
    }
    found = {module for module, content in contents.items()
             if b"njit" in content or b"numba" in content}  # fmt: skip
    for module in tuple(found):
        imports = re.findall(
            rb"^from (softrobot_twin[\w.]+) import (\([^)]*\)|.*)", contents[module], re.M
        )
        found.update(source.decode() for source, names in imports if _CONSTANT.search(names))
    return {module: content for module, content in contents.items() if module in found}


def _kernel_folder() -> str:
    """Path of a cache folder that belongs to the present kernel sources and numba version.

    numba recompiles a kernel when its own file changes, but not when a kernel that it calls in
    another file changes. Therefore the folder's name contains a hash of all these sources. Folders
    of other sources are deleted after a week.
    """
    state = sha1(version("numba").encode())
    for module, content in _kernel_sources().items():
        state.update(module.encode() + content)
    name = f"kernels-{state.hexdigest()[:12]}"
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softrobot_twin"
    if (home / name).is_dir() and os.access(home / name, os.W_OK):
        return str(home / name)
    try:
        (home / name).mkdir(parents=True, exist_ok=True)
        for old in home.glob("kernels-*"):
            if time.time() - old.stat().st_mtime > _SECONDS_KEPT:
                shutil.rmtree(old, ignore_errors=True)
    except OSError:
        return tempfile.mkdtemp(prefix="softrobot_twin-kernels-")
    return str(home / name)


# With several threads, small BLAS calls become up to fifty times slower on a busy machine.
if "OPENBLAS_NUM_THREADS" not in os.environ:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    if "numpy" in sys.modules:
        use_one_blas_thread()
if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = _kernel_folder()


# Hidden from type checkers: with it they would take any name.
if not TYPE_CHECKING:

    def __getattr__(name):
        """Imports the names of `scripting` when the first of them is used.

        They bring numpy, numba and the whole simulation, a second or more. A node must listen to
        signals before it imports these, and a worker process may need a few modules only.
        """
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        import softrobot_twin.scripting as scripting

        found = getattr(scripting, name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    """What completion offers: not the modules that are imported here."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
