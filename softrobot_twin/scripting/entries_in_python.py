"""Entries of a scene that is written in Python: arrays for lists, and meshes in memory."""

from __future__ import annotations

import atexit
import itertools
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from softrobot_twin.errors import MeshError, SceneError
from softrobot_twin.tables.input_tables import real_array

IN_PYTHON = Path("<python>")
"""What errors name as the file of a scene that was built in Python."""
# Kind of the cells of an array, by the number of their nodes.
_CELLS = {4: "tetra", 10: "tetra10", 8: "hexahedron"}
_MESH_KEYS = ("mesh", "file", "visual", "contact_surface")
_numbers = itertools.count()


def plain_entries(entries: Any) -> Any:
    """The entries as a scene file would give them: sections, lists, numbers, words.

    A mesh in memory, a `meshio.Mesh` or a pair of points and cells, is written to a temporary file
    that is kept until the process ends.

    Args:
        entries: The entries.

    Raises:
        SceneError: A mesh in memory is none.
        MeshError: A mesh in memory cannot be written.
    """
    return _plain(entries, "")


def _plain(value: Any, key: str) -> Any:
    last = key.rpartition(".")[2]
    if isinstance(value, meshio.Mesh):
        return str(_written(value))
    if last in _MESH_KEYS and isinstance(value, tuple | list) and len(value) == 2:
        return str(_written(_mesh_of(value[0], value[1], key)))
    if isinstance(value, Mapping):
        return {str(name): _plain(one, f"{key}.{name}".lstrip(".")) for name, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return str(value) if np.ma.is_masked(value) or value.dtype.kind in "mM" else value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one, f"{key}[{index}]") for index, one in enumerate(value)]
    return str(value) if isinstance(value, Path) else value


def _mesh_of(points: Any, cells: Any, key: str) -> meshio.Mesh:
    """A mesh of arrays."""
    try:
        positions, nodes = real_array(points), np.asarray(cells)
    except (TypeError, ValueError, OverflowError):
        raise SceneError(IN_PYTHON, key, "(a pair)", "", _PAIR) from None
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise SceneError(IN_PYTHON, key, f"(points of shape {positions.shape})", "", _PAIR)
    if nodes.ndim != 2 or nodes.shape[1] not in _CELLS or nodes.dtype.kind not in "iu":
        stated = f"(cells of shape {nodes.shape}, {nodes.dtype})"
        raise SceneError(IN_PYTHON, key, stated, "", _PAIR)
    return meshio.Mesh(positions, [(_CELLS[nodes.shape[1]], nodes)])


_PAIR = ("a mesh is a file, a meshio.Mesh, or a pair of points, shape (n, 3), and cells of whole "
         "numbers, shape (m, 4), (m, 10) or (m, 8)")


def _written(mesh: meshio.Mesh) -> Path:
    """Writes a mesh in the format that keeps its named parts."""
    if "gmsh:physical" in mesh.cell_data:
        suffix, options = ".msh", {"file_format": "gmsh22", "binary": True}
    elif mesh.cell_sets:
        suffix, options = ".inp", {}
    else:
        suffix, options = ".vtu", {}
    path = _folder() / f"mesh_{next(_numbers)}{suffix}"
    try:
        meshio.write(path, mesh, **options)
    except Exception as error:  # A mesh may have anything in it.
        raise MeshError(None, f"a meshio.Mesh cannot be written as {suffix}: {error}") from error
    return path


@cache
def _folder() -> Path:
    """Folder of the meshes of this process, deleted at its end."""
    folder = tempfile.TemporaryDirectory(prefix="softrobot_twin-meshes-")
    atexit.register(folder.cleanup)
    return Path(folder.name)
