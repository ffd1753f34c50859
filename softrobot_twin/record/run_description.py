"""What a run began with: its scene and the digests of its files, its parameters, its machine."""

from __future__ import annotations

import hashlib
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import yaml
from llvmlite import binding
from pydantic import BaseModel

from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.record.run_values import ACTUATORS, EFFECTORS, MARKERS, TOUCHES, plain
from softrobot_twin.scene import Scene
from softrobot_twin.scene.loading import read_yaml, written_out
from softrobot_twin.simulation import Simulation
from softrobot_twin.tables.channels import FIGURES, registered

_LIBRARIES = ("softrobot_twin", "numpy", "scipy", "numba", "llvmlite", "daqp", "gmsh")
_VARIABLES = (
    "NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES",
    "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS",
)  # fmt: skip


@dataclass(frozen=True)
class RecordedFile:
    """A file that a scene names.

    Attributes:
        name: As the scene names it.
        path: Its absolute path.
        sha256: Digest of its content.
    """

    name: str
    path: str
    sha256: str


@dataclass(frozen=True)
class RunDescription:
    """What a run began with.

    Attributes:
        node: Full name of the node.
        began: Time on the clock of the stamps [ns].
        scene_name: Name of the scene.
        scene_path: Its absolute path.
        scene_text: Its content (YAML), with copies in place of repeated entries.
        files: The files that it names.
        parameters: All parameters of the node, by name.
        settings: The settings of the loop, by name.
        names: Names of the rows of quantities: of actuators, effectors, markers, touches.
        units: Units of the setpoints and efforts of the actuators.
        machine: Versions of libraries, the processor, and variables that change rounding.
    """

    node: str
    began: int
    scene_name: str
    scene_path: str
    scene_text: str
    files: tuple[RecordedFile, ...]
    parameters: dict[str, Any]
    settings: dict[str, Any]
    names: dict[str, list[str]]
    units: dict[str, list[str]]
    machine: dict[str, str]

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> RunDescription:
        """The description from its JSON.

        Args:
            values: What its JSON holds.

        Raises:
            TypeError: An entry is missing or unknown.
        """
        files = tuple(RecordedFile(**file) for file in values["files"])
        return cls(**{**values, "files": files})


def describe(loop: TwinLoop, node: str, began: int, parameters: dict[str, object]) -> RunDescription:
    """Describes a run that begins.

    Args:
        loop: The loop, at rest; its scene was read from a file.
        node: Full name of the node.
        began: Time on the clock of the stamps [ns].
        parameters: All parameters of the node, by name.
    """
    scene = loop.simulation.scene
    path = scene.path.resolve()
    mapping = written_out(read_yaml(path.read_text(encoding="utf-8-sig")), path)
    return RunDescription(
        node, began, scene.name, str(path), scene_text(mapping), tuple(recorded_files(scene)),
        plain(parameters), plain(loop.settings), names_of(loop.simulation),
        units_of(loop.simulation), machine(),
    )  # fmt: skip


def scene_text(mapping: Any) -> str:
    """A scene as YAML, which is read back to the bit.

    Args:
        mapping: The scene as a mapping.
    """
    return yaml.safe_dump(mapping, sort_keys=False, allow_unicode=True, width=100)


def names_of(simulation: Simulation) -> dict[str, list[str]]:
    """Names of the rows of quantities.

    Args:
        simulation: The simulation.
    """
    return {
        ACTUATORS: list(map(str, simulation.actuator_names)),
        EFFECTORS: list(map(str, simulation.effector_names)),
        MARKERS: [str(marker) for marker in simulation.marker_ids],
        TOUCHES: list(map(str, simulation.touch_names)),
        **{one.objects: list(map(str, names)) for one in (*registered(), FIGURES)
           if (names := one.names(simulation))},
    }


def units_of(simulation: Simulation) -> dict[str, list[str]]:
    """Units of the setpoints and efforts of the actuators.

    Args:
        simulation: The simulation.
    """
    kinds = simulation.actuators.kinds
    return {
        "setpoint": [kind.setpoint.unit for kind in kinds],
        "effort": [kind.effort.unit for kind in kinds],
    }


def recorded_files(scene: Scene) -> Iterator[RecordedFile]:
    """The files that a scene names, each once.

    Args:
        scene: The scene.
    """
    for name in dict.fromkeys(files_named(scene)):
        path = scene.file_path(name).resolve()
        yield RecordedFile(str(name), str(path), digest_of(path))


def files_named(entry: object) -> Iterator[Path]:
    """All paths in an entry of a scene, in its order; not that of the scene itself.

    Args:
        entry: A scene, an entry of it, or a list or dict of these.
    """
    if isinstance(entry, Path):
        yield entry
    elif isinstance(entry, BaseModel):
        for name in type(entry).model_fields:
            if not (isinstance(entry, Scene) and name == "path"):
                yield from files_named(getattr(entry, name))
    elif isinstance(entry, dict | list | tuple):
        for one in entry.values() if isinstance(entry, dict) else entry:
            yield from files_named(one)


def digest_of(path: Path) -> str:
    """SHA-256 of a file's content.

    Args:
        path: The file.

    Raises:
        OSError: It cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def machine() -> dict[str, str]:
    """What decides the rounding of this process."""
    found = {"python": platform.python_version()}
    for library in _LIBRARIES:
        with suppress(PackageNotFoundError):
            found[library] = version(library)
    found["machine"] = platform.machine()
    found["processor"] = binding.get_host_cpu_name()
    found["system"] = sys.platform
    if "CS_GNU_LIBC_VERSION" in os.confstr_names:
        found["libc"] = os.confstr("CS_GNU_LIBC_VERSION") or ""
    for variable in _VARIABLES:
        if variable in os.environ:
            found[variable] = os.environ[variable]
    return found
