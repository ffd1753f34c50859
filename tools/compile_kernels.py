"""Compiles the kernels of all scenes of this package, in two processes:

    python tools/compile_kernels.py

Those that are kept on disk already are only read.
"""

from __future__ import annotations

import fcntl
import logging
import time
from multiprocessing import get_context
from pathlib import Path

SCENES = Path(__file__).resolve().parents[1] / "config" / "scenes"
# These have the most kernels in common with others, and few with each other.
FIRST = ("bar", "trunk_device")


def compile_each_kernel_once() -> None:
    """Lets only one of several processes compile a kernel; the others load the result.

    numba looks for a kernel on disk at the beginning of `Dispatcher.compile`, so whoever waited
    for the lock finds it there. Kernels call each other without a circle: no two processes can
    wait for each other.
    """
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    from softrobot_twin.kernel_cache import kernel_folder

    compile_or_load = Dispatcher.compile
    folder = kernel_folder() / "locks"
    folder.mkdir(parents=True, exist_ok=True)
    held = set()

    def compile_or_wait(dispatcher, signature):
        name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}"
        # Every thread takes numba's own lock first, so that no deadlock is possible.
        with global_compiler_lock, open(folder / name, "w") as lock:
            if name in held:
                return compile_or_load(dispatcher, signature)
            fcntl.flock(lock, fcntl.LOCK_EX)
            held.add(name)
            try:
                return compile_or_load(dispatcher, signature)
            finally:
                held.discard(name)

    Dispatcher.compile = compile_or_wait


def warm_up(scene: Path) -> None:
    """Builds a scene and takes every path of a step."""
    from softrobot_twin.scene import load_scene
    from softrobot_twin.simulation import Simulation

    logging.disable(logging.WARNING)
    Simulation(load_scene(scene)).warm_up()


def main() -> None:
    """Warms up all scenes."""
    began = time.monotonic()
    scenes = sorted(SCENES.glob("*.yaml"), key=lambda scene: scene.stem not in FIRST)
    with get_context("spawn").Pool(2, compile_each_kernel_once) as pool:
        for number, _ in enumerate(pool.imap_unordered(warm_up, scenes), start=1):
            print(f"\rkernels of {number} of {len(scenes)} scenes are compiled, "
                  f"{time.monotonic() - began:.0f} s", end="", flush=True)  # fmt: skip
    print()


if __name__ == "__main__":
    main()
