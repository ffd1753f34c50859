"""Digital twin and controller of soft robots: finite elements, Lagrange multipliers, inverse QP.

The method is that of Coevoet 2017, "Software toolkit for modeling, simulation and control of soft
robots", as all sources in docs/references.md. docs/equations.md lists where each of its equations is
computed.

Importing the package sets the number of BLAS threads to one, and the instruction set that kernels
and BLAS use to one that many machines have, unless the environment sets them.

    import softrobot_twin as st
    robot = st.load("finger.yaml")
    result = robot.step(st.targets(tip=[0.01, 0.0, 0.12]))

See docs/python.md.
"""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.kernels.blas_threads import use_one_blas_thread
from softrobot_twin.kernels.instruction_set import choose_level

if TYPE_CHECKING:
    from softrobot_twin.scene import Scene
    from softrobot_twin.scripting import (
        Equilibria,
        Pose,
        Result,
        Robot,
        SceneWarning,
        Status,
        build,
        efforts,
        hold,
        hull_volume,
        load,
        setpoints,
        targets,
    )
    from softrobot_twin.scripting.vector_environment import VectorEnvironment

__all__ = [
    "Equilibria",
    "Pose",
    "Result",
    "Robot",
    "SceneWarning",
    "SoftRobotTwinError",
    "Status",
    "build",
    "efforts",
    "hold",
    "hull_volume",
    "load",
    "setpoints",
    "targets",
    "vector_env",
]

# With several threads, small BLAS calls become up to fifty times slower on a busy machine.
if "OPENBLAS_NUM_THREADS" not in os.environ:
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    if "numpy" in sys.modules:
        use_one_blas_thread()
choose_level(os.environ)


def vector_env(
    scene: Path | str | Scene | Robot, count: int, workers: Any = None, **options: Any
) -> VectorEnvironment:
    """Builds many robots of one scene that learn at once, each to reach for targets.

    Args:
        scene: See `VectorEnvironment`, as all further arguments.
        count: Number of robots.
        workers: Number of processes, or a client of Dask; None for a process on each core.
        **options: Such as ``states=64, randomize={"cables.*.rate": (0.04, 0.06)}``.

    Returns:
        A `gymnasium.vector.VectorEnv`.

    Raises:
        MissingExtraError: gymnasium is not installed.
        CommandError: See `VectorEnvironment`.
        SceneError: See `VectorEnvironment`.
        WorkerError: See `VectorEnvironment`.
    """
    from softrobot_twin.scripting.vector_environment import VectorEnvironment

    return VectorEnvironment(scene, count, workers, **options)


# Hidden from type checkers: with it they would take any name.
if not TYPE_CHECKING:

    def __getattr__(name):
        """Imports the names of `scripting` when the first of them is used.

        They bring numpy, numba and the whole simulation, a second or more. A node must listen to
        signals before it imports these, and a worker process may need a few modules only.
        """
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        # All that is imported stays: to look through it again and again for garbage takes an eighth.
        was_enabled = gc.isenabled()
        gc.disable()
        try:
            import softrobot_twin.scripting as scripting
        finally:
            if was_enabled:
                gc.enable()
        found = getattr(scripting, name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    """What completion offers: not the modules that are imported here."""
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
