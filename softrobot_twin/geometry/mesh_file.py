"""Mesh files as they are: nodes and cells of any format we read, before any repair."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import NamedTuple

import meshio
import meshio.abaqus
import meshio.gmsh
import meshio.vtk
import meshio.vtu
import numpy as np

from softrobot_twin.errors import MeshError

_SUFFIXES = (".msh", ".vtk", ".vtu", ".inp")
# Kinds of cells that are read, and how many nodes each has.
_NODES_OF = {"tetra": 4, "tetra10": 10}
_READERS = {
    "Gmsh": meshio.gmsh.read,
    "legacy VTK": meshio.vtk.read,
    "VTK XML": meshio.vtu.read,
    "Abaqus": meshio.abaqus.read,
}
_FORMAT_OF_SUFFIX = {
    ".msh": "Gmsh",
    ".vtk": "legacy VTK",
    ".vtu": "VTK XML",
    ".inp": "Abaqus",
}


class MeshFile(NamedTuple):
    """What a mesh file holds that matters to us.

    Attributes:
        node_positions: Node positions in the file's unit, float64, shape (node_count, 3).
        tets: Corner nodes of the tetrahedra, int64, shape (tet_count, 4).
        mid_nodes: Nodes on their edges, in the order of the file, −1 for a tetrahedron of four
            nodes, int64, shape (tet_count, 6); None where no tetrahedron has ten.
        dropped_cells: Number of cells of each lower-dimensional kind, such as triangles.
        format_name: Format of the content.
        expected_format: Format that the file's name promises.
    """

    node_positions: np.ndarray
    tets: np.ndarray
    mid_nodes: np.ndarray | None
    dropped_cells: dict[str, int]
    format_name: str
    expected_format: str


def read_mesh_file(path: Path) -> MeshFile:
    """Reads a mesh file, going by its content where its name says otherwise.

    Args:
        path: File to read: .msh, .vtk, .vtu or .inp.

    Returns:
        Nodes and tetrahedra as they stand in the file.

    Raises:
        MeshError: The file is missing, of another format, damaged, or not made of tetrahedra of
            four or ten nodes.
    """
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise MeshError(path, f"mesh files end in {', '.join(_SUFFIXES)}, not in '{suffix}'")
    if not path.is_file():
        found = "is a folder, not a file" if path.is_dir() else "there is no such file"
        raise MeshError(path, found)
    format_name = _format_of_content(path)
    # The reader reports on the terminal; what matters of it ends up in the error.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            content = _READERS[format_name](str(path))
        except Exception as error:  # a damaged file raises nearly anything there
            detail = " ".join(str(error).split()) or "no reason given"
            raise MeshError(
                path, f"cannot be read as {format_name} ({type(error).__name__}: {detail})"
            ) from error
    return _tets(path, content, format_name, _FORMAT_OF_SUFFIX[suffix])


def _format_of_content(path: Path) -> str:
    with open(path, "rb") as file:
        start = file.read(512).removeprefix(b"\xef\xbb\xbf").lstrip()
    if start.startswith(b"$"):
        return "Gmsh"
    if start.lower().startswith(b"# vtk"):
        return "legacy VTK"
    if start.startswith(b"<"):
        return "VTK XML"
    if start.startswith(b"*"):
        return "Abaqus"
    shown = start[:20].decode("ascii", errors="replace")
    raise MeshError(path, f"starts with {shown!r}, which no mesh format we read does")


def _tets(path: Path, content: meshio.Mesh, format_name: str, expected_format: str) -> MeshFile:
    tets, mids, dropped, solids = [], [], {}, {}
    for block in content.cells:
        if block.type in _NODES_OF:
            nodes = np.asarray(block.data, dtype=np.int64).reshape(-1, _NODES_OF[block.type])
            tets.append(nodes[:, :4])
            mids.append(nodes[:, 4:] if nodes.shape[1] == 10 else np.full((len(nodes), 6), -1))
        elif len(block.data) == 0:
            continue
        else:
            kinds = solids if block.dim == 3 else dropped
            kinds[block.type] = kinds.get(block.type, 0) + len(block.data)
    if solids:
        held = ", ".join(f"{count} {kind}" for kind, count in sorted(solids.items()))
        raise MeshError(path, "has solid cells other than tetrahedra of 4 or 10 nodes "
                        f"({held}), which are not simulated")  # fmt: skip
    if sum(len(block) for block in tets) == 0:
        held = ", ".join(f"{count} {kind}" for kind, count in sorted(dropped.items()))
        raise MeshError(path, f"has no tetrahedra, only {held or 'no cells at all'}")
    positions = np.asarray(content.points, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise MeshError(path, f"has nodes of shape {positions.shape}, not (n, 3)")
    mid_nodes = np.concatenate(mids)
    return MeshFile(
        positions, np.concatenate(tets), mid_nodes if (mid_nodes >= 0).any() else None, dropped,
        format_name, expected_format,
    )  # fmt: skip
