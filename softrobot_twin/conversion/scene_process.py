"""Runs a SOFA scene in Python against stand-ins of SOFA's modules, in a process of its own.

``python -m softrobot_twin.conversion.scene_process SCENE.py TREE.json`` writes the tree of what the
file's ``createScene`` builds. Nothing is simulated: components only keep their values. Modules that
are not installed are stood in by objects that accept everything, and are told.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import runpy
import sys
import sysconfig
import traceback
import types
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.conversion import prefabs, stand_ins
from softrobot_twin.conversion.scene_tree import json_value, to_plain
from softrobot_twin.conversion.stand_ins import Controller, Node, Nothing, Prefab

SOFA = ("Sofa", "SofaRuntime", "SofaGui", "SofaImGui", "SofaTypes", "SofaDeformable")
"""Modules that SOFA itself has; they are always stood in."""
HELPERS = ("stlib3", "splib3", "softrobots", "stlib", "splib")
"""Packages whose prefabs are known; what is installed goes before."""


class _Module(stand_ins.Attributes, types.ModuleType):
    """A module in which every name stands for something."""

    __path__: list[str] = []

    def __init__(self, name: str):
        super().__init__(name)
        self.__file__ = f"<{name}>"
        is_known = name.split(".")[0] in HELPERS
        known = prefabs.KNOWN if is_known else {}
        if is_known and "numerics" in name.split("."):
            from softrobot_twin.conversion.splib_numerics import NUMERICS

            known = known | NUMERICS
        if "inverse" in name.split("."):
            known = known | {key.removeprefix("inverse."): one for key, one in known.items() if "." in key}
        self.__all__ = [key for key in known if "." not in key]
        self.__dict__.update(known)
        if name.split(".")[0] == "Sofa":
            self.__dict__.update(Node=Node, Controller=Controller, Prefab=Prefab, RawPrefab=Prefab,
                                 Object=stand_ins.Component, DataEngine=Controller, ForceField=Controller,
                                 Core=self)  # fmt: skip

    def _attribute(self, name: str) -> Any:
        return Nothing(label="" if self.__name__.split(".")[0] in SOFA else f"{self.__name__}.{name}")


class _StandIns(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds the modules of SOFA, or where it is the last one those that nothing else finds."""

    def __init__(self, is_last: bool):
        self.is_last = is_last

    def find_spec(self, name, path=None, target=None):
        """See `importlib`; a module below one that is stood in is stood in too.

        Args:
            name: Dotted name.
            path: Folders of the package; not read.
            target: Not read.
        """
        top = name.split(".")[0]
        is_ours = top in SOFA or self.is_last and (
            isinstance(sys.modules.get(top), _Module) or top == name and not _asks_library())  # fmt: skip
        return importlib.machinery.ModuleSpec(name, self, is_package=True) if is_ours else None

    def create_module(self, spec):
        """The module.

        Args:
            spec: Its name.
        """
        return _Module(spec.name)

    def exec_module(self, module):
        """Nothing runs in it.

        Args:
            module: The module.
        """


def _asks_library() -> bool:
    """Whether an installed module imports: it may try what is not there, such as an accelerator."""
    files = (frame.f_code.co_filename for frame, _ in traceback.walk_stack(sys._getframe(2)))
    file = next((file for file in files if "importlib" not in file), None)
    paths = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
    return file is not None and any(Path(file).is_relative_to(path) for path in paths)


def record(file: Path) -> dict:
    """Runs a file and records its scene.

    Args:
        file: The Python file.

    Returns:
        The tree as `to_plain` writes it, with ``missing`` modules, and with ``error`` and where it is, ``at``,
        if the file stopped.
    """
    sys.meta_path[:] = [_StandIns(is_last=False), *sys.meta_path, _StandIns(is_last=True)]
    folder = file.resolve().parent
    sys.path.insert(0, str(folder))
    sys.argv = [str(file)]
    os.chdir(folder)
    root = Node("root", folder=str(folder))
    stand_ins.Recorder.folder = folder
    recorded: dict[str, Any] = {}
    try:
        names = runpy.run_path(str(file), run_name="scene")
        if "createScene" in names:
            names["createScene"](root)
        else:
            recorded |= {"error": "has no function createScene", "at": ""}
    except BaseException as error:  # foreign code may raise anything, and call exit
        frames = [f" at {Path(frame.filename).name}:{frame.lineno}"
                  for frame in traceback.extract_tb(error.__traceback__)
                  if Path(frame.filename).is_relative_to(folder)]  # fmt: skip
        recorded |= {"error": f"{type(error).__name__}: {' '.join(str(error).split())[:300]}",
                     "at": frames[-1] if frames else ""}  # fmt: skip
    missing = [name for name, module in sys.modules.items() if isinstance(module, _Module)
               and "." not in name and name not in SOFA + HELPERS]  # fmt: skip
    return recorded | to_plain(root) | {"missing": missing, "unknown": list(dict.fromkeys(stand_ins.Recorder.unknown))}


if __name__ == "__main__":
    np.set_printoptions(threshold=sys.maxsize)
    _output = Path(sys.argv[2]).resolve()
    _output.write_text(json.dumps(record(Path(sys.argv[1])), default=json_value))
    os._exit(0)  # threads and exit hooks of the scene do not keep the process
