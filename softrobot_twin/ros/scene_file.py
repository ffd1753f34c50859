"""Finds scene and path files, independent of the folder in which the node was started."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from softrobot_twin.errors import ParameterError
from softrobot_twin.shared_files import ScenePath

_PACKAGE = "softrobot_twin"


def config_folders() -> list[Path]:
    """Folders that may contain the package's configuration, in order of search."""
    folders = []
    with suppress(LookupError, OSError):  # The package is not installed in a sourced ROS workspace.
        folders.append(Path(get_package_share_directory(_PACKAGE)) / "config")
    folders.append(Path(sys.prefix) / "share" / _PACKAGE / "config")
    folders.append(Path(__file__).resolve().parents[2] / "config")
    return folders


def parameter_folders(arguments: Sequence[str]) -> list[Path]:
    """Folders of the parameter files of a command line.

    Args:
        arguments: The command line of the process.
    """
    pairs = zip(arguments, arguments[1:], strict=False)
    return [Path(file).absolute().parent for word, file in pairs if word == "--params-file"]


def find_scene_file(name: str, parameter: str) -> Path:
    """Finds the file of a scene or of a path.

    Args:
        name: Absolute path, or path relative to the working directory, the folder of a parameter file of the
            process, or a configuration folder.
        parameter: Name of the parameter, for the error.

    Raises:
        ParameterError: There is no such file; the message lists the searched places.
    """
    if not name:
        raise ParameterError(parameter, name, "", "must name a file")
    if Path(name).is_absolute():
        candidates = [Path(name)]
    else:
        candidates = [folder / name for folder in (
            Path.cwd(), *parameter_folders(sys.argv), *config_folders())]  # fmt: skip
    for candidate in candidates:
        if candidate.is_file():
            return candidate.resolve()
    looked = ", ".join(str(candidate) for candidate in candidates)
    raise ParameterError(parameter, name, "", f"no such file; looked for {looked}")


def find_scene(values: Mapping[str, object], name: str = "scene") -> ScenePath:
    """Finds the file of a node's scene.

    Args:
        values: Values of the node's parameters.
        name: Begin of the names of its parameters ``..._file`` and ``..._changes``.

    Returns:
        The path, with other values of the scene's entries.

    Raises:
        ParameterError: There is no such file; the message lists the searched places.
    """
    path = find_scene_file(str(values[f"{name}_file"]), f"{name}_file")
    return ScenePath(path, filter(None, values[f"{name}_changes"]))
