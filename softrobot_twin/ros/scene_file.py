"""Finds scene and path files, independent of the folder in which the node was started."""

from __future__ import annotations

import sys
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from softrobot_twin.errors import ParameterError

_PACKAGE = "softrobot_twin"


def config_folders() -> list[Path]:
    """Folders that may contain the package's configuration, in order of search."""
    folders = []
    try:
        folders.append(Path(get_package_share_directory(_PACKAGE)) / "config")
    except (LookupError, OSError):
        pass  # The package is not installed in a sourced ROS workspace.
    folders.append(Path(sys.prefix) / "share" / _PACKAGE / "config")
    folders.append(Path(__file__).resolve().parents[2] / "config")
    return folders


def find_scene_file(name: str, parameter: str) -> Path:
    """Finds the file of a scene or of a path.

    Args:
        name: Absolute path, or path relative to the working directory or a configuration folder.
        parameter: Name of the parameter, for the error.

    Raises:
        ParameterError: There is no such file; the message lists the searched places.
    """
    if not name:
        raise ParameterError(parameter, name, "", "must name a file")
    if Path(name).is_absolute():
        candidates = [Path(name)]
    else:
        candidates = [folder / name for folder in (Path.cwd(), *config_folders())]
    for candidate in candidates:
        if candidate.is_file():
            return candidate.resolve()
    looked = ", ".join(str(candidate) for candidate in candidates)
    raise ParameterError(parameter, name, "", f"no such file; looked for {looked}")
