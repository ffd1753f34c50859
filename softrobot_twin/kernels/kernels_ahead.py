"""Other processes compile kernels ahead of the one that needs them.

A process learns which kernel it needs, and for which types, only when it calls it. `LIST` holds what
the scenes of this package needed, in order. Where a scene needs kernels that are not on disk, each
further core takes those of the scene most like it, last first, until both meet. What is compiled for
nothing, because the scenes differ or the list is old, costs time of an idle core and no more.
`tools/compile_kernels.py --ship` writes the list.
"""

from __future__ import annotations

import logging
import os
import pickle
import subprocess
import sys
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from softrobot_twin.kernels.kernel_cache import before_compilation, lock

LIST = Path(__file__).with_name("kernels_of_scenes.xz")
"""What scenes needed: a list of `SceneKernels`."""
# More processes would wait for each other, and each takes some 300 MB.
_MOST = 3
_started: list[subprocess.Popen] = []
_log = logging.getLogger(__package__)


class SceneKernels(NamedTuple):
    """The kernels that a scene called from Python.

    Attributes:
        words: See `words`.
        kernels: Module, name and pickled types of the arguments of each, in order of the calls.
    """

    words: frozenset[str]
    kernels: tuple[tuple[str, str, bytes], ...]


def scenes_of_list() -> list[SceneKernels]:
    """What `LIST` holds."""
    import lzma  # Only where kernels are compiled.

    return pickle.loads(lzma.decompress(LIST.read_bytes()))


def words(entry: Any) -> frozenset[str]:
    """Keys of a scene and words among their values, by which scenes are compared.

    Args:
        entry: A scene as mappings and lists, or a part of one.
    """
    if isinstance(entry, dict):
        return frozenset().union(entry, *map(words, entry.values()))
    if isinstance(entry, (list, tuple)):
        return frozenset().union(*map(words, entry))
    return frozenset({entry} if isinstance(entry, str) else ())


def words_of(scene: Any) -> frozenset[str]:
    """Words of a scene; see `words`.

    Args:
        scene: The scene, a `Scene`, whose room lies above this one.
    """
    return words(scene.model_dump(exclude_unset=True))


def help_with(scene: Any) -> None:
    """Has other processes compile, too, when this one must compile kernels of a scene.

    Args:
        scene: The scene.
    """
    before_compilation(lambda: _start(words_of(scene)))


def _start(own: frozenset[str]) -> None:
    """Starts a process for each further core."""
    _log.warning("softrobot_twin: kernels are compiled for this machine, once: a minute or two")
    if not LIST.is_file():
        return
    known = scenes_of_list()
    likeness = [len(own & scene.words) / len(own | scene.words) for scene in known]
    nearest = likeness.index(max(likeness))
    count = min((os.cpu_count() or 1) - 1, _MOST)
    paths = os.pathsep.join(filter(None, sys.path))
    for number in range(count):
        _started.append(subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, *map(str, (nearest, number, count, os.getpid()))],
            env={**os.environ, "PYTHONPATH": paths}, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        ))  # fmt: skip


def compile_ahead(scene: int, number: int, count: int, parent: int) -> None:
    """Compiles every `count`-th kernel that a scene needs, from the last one, while `parent` runs.

    Args:
        scene: Index of the scene in `LIST`.
        number: The process, from zero; of each number there is one on a machine.
        count: How many processes there are.
        parent: Id of the process that started this one.
    """
    if not lock(number, waits=False):
        return
    # Its parent may be bound to one core.
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    kernels = scenes_of_list()[scene].kernels
    for module, name, pickled in kernels[::-1][number::count]:
        if os.getppid() != parent:
            return
        try:
            attrgetter(name)(import_module(module)).compile(pickle.loads(pickled))
        except Exception:  # noqa: S112  Of an older list: whoever needs the kernel says what is wrong.
            continue


if __name__ == "__main__":
    compile_ahead(*map(int, sys.argv[1:]))
