"""Digital twin and controller of soft robots: finite elements, Lagrange multipliers, inverse QP.

The method is that of Coevoet et al., "Software toolkit for modeling, simulation and control of
soft robots", Advanced Robotics 31 (2017). The rooms of this package mirror its equations.

Importing it chooses, where the environment does not, one thread for BLAS and a place for compiled
kernels; both must be known before numpy and numba are first imported.
"""

import os
from hashlib import sha1
from pathlib import Path

# With more threads small BLAS calls fall to a fiftieth of their speed on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _kernel_cache() -> str:
    """A folder for the kernels of just these sources.

    numba rebuilds a kernel when its own file changes, not when one that it calls does.
    """
    root = Path(__file__).parent
    sources = sorted((str(path.relative_to(root)), path) for path in root.rglob("*.py"))
    state = "".join(
        f"{name} {path.stat().st_mtime_ns} {path.stat().st_size}\n" for name, path in sources
    )
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return str(home / "softrobot_twin" / f"kernels-{sha1(state.encode()).hexdigest()[:12]}")


os.environ.setdefault("NUMBA_CACHE_DIR", _kernel_cache())
