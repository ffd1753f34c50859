"""Reading of volume mesh files: placed, repaired, and each repair reported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.cell_mesh import SomeCells
from softrobot_twin.geometry.hexahedral_mesh import (
    INTO_TETS,
    HexahedralMesh,
    corner_determinants,
    scaled_jacobians,
)
from softrobot_twin.geometry.mesh_file_checks import (
    check_file,
    check_positions,
    check_size,
    damage_told,
)
from softrobot_twin.geometry.mesh_parts import (
    NO_PARTS,
    MeshParts,
    cell_of_each,
    file_parts,
    placed_parts,
    read_abaqus,
    read_gmsh,
)
from softrobot_twin.geometry.mesh_repair import (
    coincident_pairs,
    component_labels,
    drop_unused_nodes,
    enclose_volume,
    first_of_duplicates,
    first_of_repeated_tets,
    first_of_touching_parts,
    hinged_part_count,
    orient_tets,
)
from softrobot_twin.geometry.quadratic_mesh import place_mid_edge_nodes
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.shape_functions import LINEAR_TETRAHEDRON
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.geometry.vtk_reading import read_legacy_vtk, read_vtk_xml

# Number of nodes of each kind of cell that is read.
_NODES_OF = {"tetra": 4, "tetra10": 10, "hexahedron": 8}
# Suffix, begin of the content, in small letters, and reader of each format.
_FORMATS = {
    "Gmsh": (".msh", b"$", read_gmsh),
    "legacy VTK": (".vtk", b"# vtk", read_legacy_vtk),
    "VTK XML": (".vtu", b"<", read_vtk_xml),
    "Abaqus": (".inp", b"*", read_abaqus),
}
_FORMAT_OF_SUFFIX = {suffix: name for name, (suffix, _, _) in _FORMATS.items()}


class MeshFile(NamedTuple):
    """Content of a mesh file, as far as it is used.

    Attributes:
        node_positions: Node positions in the unit of the file, float64, shape (node_count, 3).
        tets: Corner nodes of the tetrahedra, int64, shape (tet_count, 4).
        mid_nodes: Mid-edge nodes in the order of the file, −1 for a tetrahedron of four nodes,
            int64, shape (tet_count, 6); None if no tetrahedron has ten nodes.
        hexahedra: Corners of the hexahedra, int64, shape (hexahedron_count, 8).
        dropped_cells: Number of cells of each lower-dimensional kind, such as triangles, that
            belong to no named part.
        parts: Named parts.
        format_name: Format of the content.
        expected_format: Format according to the suffix of the file.
        notes: One sentence for each part that was left out.
    """

    node_positions: np.ndarray
    tets: np.ndarray
    mid_nodes: np.ndarray | None
    hexahedra: np.ndarray
    dropped_cells: dict[str, int]
    parts: MeshParts
    format_name: str
    expected_format: str
    notes: tuple[str, ...]


def read_mesh_file(path: Path) -> MeshFile:
    """Reads a mesh file in the format of its content, whatever its suffix.

    Args:
        path: File to read: .msh, .vtk, .vtu or .inp.

    Returns:
        Nodes and solid cells as in the file.

    Raises:
        MeshError: The file is missing, of another format, damaged, or contains solid cells other
            than tetrahedra of four or ten nodes and hexahedra of eight.
    """
    check_file(path, tuple(_FORMAT_OF_SUFFIX), "mesh")
    check_size(path)
    format_name = _format_of_content(path)
    with damage_told(path, f"cannot be read as {format_name}"):
        content = _FORMATS[format_name][2](str(path))
        parts, counts = file_parts(path, content, format_name)
    return _solids(path, content, parts, counts, format_name, _FORMAT_OF_SUFFIX[path.suffix.lower()])


def _format_of_content(path: Path) -> str:
    with open(path, "rb") as file:
        start = file.read(512).removeprefix(b"\xef\xbb\xbf").lstrip()
    for name, (_, begin, _) in _FORMATS.items():
        if start.lower().startswith(begin):
            return name
    shown = start[:20].decode("ascii", errors="replace")
    raise MeshError(path, f"starts with {shown!r}, which no mesh format we read does")


def _solids(
    path: Path, content: meshio.Mesh, parts: MeshParts, counts: dict[str, int], format_name: str,
    expected_format: str,
) -> MeshFile:
    tets, mids, hexahedra, dropped, solids = [], [], [], {}, {}
    for block in content.cells:
        if block.type in _NODES_OF:
            nodes = np.asarray(block.data, dtype=np.int64).reshape(-1, _NODES_OF[block.type])
            if nodes.shape[1] == 8:
                hexahedra.append(nodes)
                continue
            tets.append(nodes[:, :4])
            mids.append(nodes[:, 4:] if nodes.shape[1] == 10 else np.full((len(nodes), 6), -1))
        elif len(block.data) == 0:
            continue
        else:
            kinds = solids if block.dim == 3 else dropped
            kinds[block.type] = kinds.get(block.type, 0) + len(block.data)
    if solids:
        held = ", ".join(f"{count} {kind}" for kind, count in sorted(solids.items()))
        raise MeshError(path, "has solid cells other than tetrahedra of 4 or 10 nodes and hexahedra "
                        f"of 8 ({held}), which are not simulated")  # fmt: skip
    if sum(len(block) for block in [*tets, *hexahedra]) == 0:
        held = ", ".join(f"{count} {kind}" for kind, count in sorted(dropped.items()))
        raise MeshError(path, f"has no tetrahedra or hexahedra, only {held or 'no cells at all'}")
    positions = np.asarray(content.points, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise MeshError(path, f"has nodes of shape {positions.shape}, not (n, 3)")
    tets = np.concatenate([np.empty((0, 4), np.int64), *tets])
    mid_nodes = np.concatenate([np.empty((0, 6), np.int64), *mids])
    hexahedra = np.concatenate([np.empty((0, 8), np.int64), *hexahedra])
    if len(hexahedra) and (mid_nodes >= 0).any():
        raise MeshError(path, "has tetrahedra of 10 nodes beside hexahedra of 8: only tetrahedra of "
                        "4 nodes fit on their faces")  # fmt: skip
    unnamed = {kind: count - counts.get(kind, 0) for kind, count in dropped.items()}
    return MeshFile(
        positions, tets, mid_nodes if (mid_nodes >= 0).any() else None, hexahedra,
        {kind: count for kind, count in unnamed.items() if count}, parts, format_name,
        expected_format, tuple(content.info or ()),
    )  # fmt: skip


# Radius ratio below which a tetrahedron is reported as a sliver.
SLIVER_RATIO = 0.05
# Least corner determinant of a hexahedron, that of unit edges, below which it is reported.
SKEWED_JACOBIAN = 0.1
# The same relative to the cube of the cell's size, below which a corner is flat.
_FLAT_CORNER = 1e-9
# Distance, relative to the size of the body, below which nodes coincide.
_COINCIDENT = 1e-9
CUT = "the body is cut there"
"""Text of a note on nodes that coincide and are not merged."""
_REPEATED = "Dropped {} that the file contains more than once."
# Number of indices listed in a note.
_NAMED_INDICES = 5


class MidEdgeNodes(NamedTuple):
    """Mid-edge nodes of a file.

    Attributes:
        file_nodes: Their indices in the file, int64, shape (mid_count,).
        ends: Nodes of the mesh at the ends of the edge of each, int64, shape (mid_count, 2).
    """

    file_nodes: np.ndarray
    ends: np.ndarray


NO_MID_EDGE_NODES = MidEdgeNodes(np.empty(0, np.int64), np.empty((0, 2), np.int64))


class MeshReading(NamedTuple):
    """A mesh that was read, and how it differs from the file.

    Attributes:
        mesh: The mesh, in metres.
        notes: One sentence for each repair and each warning. Cells of a kind and nodes are numbered
            as in the file, from 0.
        file_node_indices: Index in the file of each node of the mesh, int64, shape (node_count,).
        mesh_node_indices: Node of the mesh for each node of the file, −1 if it was dropped or is a
            mid-edge node, int64, shape (file_node_count,).
        mid_edge_nodes: Mid-edge nodes of the file; none if it contains only tetrahedra of four
            nodes.
        parts: Named regions, surfaces and sets of edges.
    """

    mesh: TetMesh | HexahedralMesh
    notes: tuple[str, ...]
    file_node_indices: np.ndarray
    mesh_node_indices: np.ndarray
    mid_edge_nodes: MidEdgeNodes = NO_MID_EDGE_NODES
    parts: MeshParts = NO_PARTS


def read_solid_mesh(
    path: str | Path,
    *,
    scale: float = 1.0,
    translation: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    merge_tolerance: float | None = None,
) -> MeshReading:
    """Reads a mesh of tetrahedra and hexahedra, places and repairs it.

    It is placed at x = translation + Rz Ry Rx (scale · x_file).

    Args:
        path: File to read: .msh, .vtk, .vtu or .inp; its content decides the format.
        scale: Metres in one unit of the file, 0.001 for millimetres.
        translation: Shift after scale and rotation [m], shape (3,).
        rotation: Angles about the fixed x, then y, then z axis [rad], shape (3,).
        merge_tolerance: Distance within which nodes become one [m], 0 merges none; None merges
            only coincident nodes of separate parts.

    Returns:
        The mesh: a `HexahedralMesh` if there are hexahedra, else a `TetMesh`.

    Raises:
        MeshError: The file cannot be read, does not contain tetrahedra of four or ten nodes or
            hexahedra of eight, or cannot be repaired.
    """
    path = Path(path)
    file = read_mesh_file(path)
    _check_nodes(path, file, scale)
    notes = _content_notes(path, file, rotation)
    turn = Rotation.from_euler("xyz", np.asarray(rotation, dtype=float))
    positions = turn.apply(scale * file.node_positions) + np.asarray(translation, dtype=float)
    representatives, why = np.arange(len(positions)), ""
    if merge_tolerance is None:
        every = np.concatenate([file.tets, file.hexahedra[:, INTO_TETS].reshape(-1, 4)])
        representatives = first_of_touching_parts(positions, every)
        why = ": they cut the mesh into separate parts (merge_distance: 0 keeps the cut)"
    elif merge_tolerance > 0.0:
        representatives = first_of_duplicates(positions, merge_tolerance)
    merged = np.flatnonzero(representatives != np.arange(len(positions)))
    _note(notes, merged, "node", f"Merged {{}} with coincident ones{why}.")

    tets = representatives[file.tets]
    enclosing = enclose_volume(positions, tets)
    _note(notes, np.flatnonzero(~enclosing), "tetrahedron", "Dropped {} without volume.")
    if not enclosing.any() and len(file.hexahedra) == 0:
        raise MeshError(path, "has only tetrahedra without volume")
    kept = np.flatnonzero(enclosing)
    once = first_of_repeated_tets(tets[kept])
    _note(notes, np.delete(kept, once), "tetrahedron", _REPEATED)
    file_tets = kept[once]
    oriented, inverted = orient_tets(positions, tets[file_tets])
    _note(notes, file_tets[inverted], "inverted tetrahedron", "Reoriented {}.")
    hexahedra = _upright_hexahedra(path, positions, representatives[file.hexahedra], notes)
    nodes = drop_unused_nodes(positions, oriented, hexahedra)
    mesh_node_indices = nodes.new_indices[representatives]
    used, mids = mesh_node_indices >= 0, NO_MID_EDGE_NODES
    if file.mid_nodes is not None:
        mids = _mid_edge_nodes(positions, file, representatives, mesh_node_indices, file_tets, notes)
        used[file.mid_nodes[file.mid_nodes >= 0]] = True
    cell = "cell" if len(hexahedra) else "tetrahedron"
    _note(notes, np.flatnonzero(~used), "node", f"Dropped {{}} that no {cell} uses.")

    mesh = _made_mesh(path, nodes, nodes.new_indices[hexahedra])
    notes += _oddity_notes(mesh, nodes.old_indices, file_tets)
    parts = file.parts
    if not file.parts.is_empty:
        cells = cell_of_each(tets, tets[file_tets])
        of_hexahedra = cell_of_each(representatives[file.hexahedra], hexahedra)
        cells = np.concatenate([cells, of_hexahedra + len(once)])
        parts = placed_parts(file.parts, cells, mesh_node_indices)
    return MeshReading(mesh, tuple(notes), nodes.old_indices, mesh_node_indices, mids, parts)


def _upright_hexahedra(
    path: Path, positions: np.ndarray, hexahedra: np.ndarray, notes: list[str]
) -> np.ndarray:
    """The hexahedra, each once and none inside out; what can be mended is noted.

    Raises:
        MeshError: One has a node twice, as wedges and pyramids written as hexahedra have, or is flat
            or inside out in a corner.
    """
    in_order = np.sort(hexahedra, axis=1)
    doubled = np.flatnonzero((in_order[:, 1:] == in_order[:, :-1]).any(axis=1))
    if len(doubled):
        raise MeshError(
            path, f"hexahedron {doubled[0]} has a node twice: a wedge or pyramid written as a "
            "hexahedron is not simulated",
        )  # fmt: skip
    once = first_of_repeated_tets(hexahedra) if len(hexahedra) else np.empty(0, np.int64)
    _note(notes, np.delete(np.arange(len(hexahedra)), once), "hexahedron", _REPEATED)
    kept = hexahedra[once]
    mirrored = np.flatnonzero((corner_determinants(positions[kept]) < 0.0).all(axis=1))
    kept[mirrored] = kept[mirrored][:, [4, 5, 6, 7, 0, 1, 2, 3]]
    _note(notes, once[mirrored], "inverted hexahedron", "Reoriented {}.")
    corners = positions[kept]
    sizes = np.linalg.norm(np.ptp(corners, axis=1), axis=1, keepdims=True)
    upright = (corner_determinants(corners) > _FLAT_CORNER * sizes**3).all(axis=1)
    if not upright.all():
        raise MeshError(
            path, f"hexahedron {once[np.argmin(upright)]} is flat or inside out in a corner: are its "
            "nodes in the order of the format, around one face and then around the other?",
        )  # fmt: skip
    return kept


def _made_mesh(path: Path, nodes, hexahedra: np.ndarray) -> TetMesh | HexahedralMesh:
    if len(hexahedra) == 0:
        return TetMesh(nodes.node_positions, nodes.tets)
    try:
        return HexahedralMesh(nodes.node_positions, nodes.tets, hexahedra)
    except MeshError as error:
        raise MeshError(path, error.reason) from None


def _mid_edge_nodes(
    positions: np.ndarray, file: MeshFile, representatives: np.ndarray,
    mesh_node_indices: np.ndarray, file_tets: np.ndarray, notes: list[str],
) -> MidEdgeNodes:  # fmt: skip
    """Finds the edges of the mid-edge nodes, and adds a note on curved edges."""
    found = place_mid_edge_nodes(positions, representatives[file.tets[file_tets]], file.mid_nodes[file_tets])
    if len(found.curved):
        notes.append(
            f"Straightened {len(found.curved)} curved edges (the node furthest off, "
            f"{found.furthest}, by {1e3 * found.offset:.3g} mm): edges are straight at rest."
        )
    return MidEdgeNodes(found.nodes, mesh_node_indices[found.ends])


def _check_nodes(path: Path, file: MeshFile, scale: float) -> None:
    node_count = len(file.node_positions)
    mid_nodes = np.empty((0, 6)) if file.mid_nodes is None else file.mid_nodes
    for cell, nodes, least, where in (
        ("tetrahedron", file.tets, 0, ""), ("hexahedron", file.hexahedra, 0, ""),
        ("tetrahedron", mid_nodes, -1, " on its edges"),
    ):  # fmt: skip
        wrong = np.flatnonzero(((nodes < least) | (nodes >= node_count)).any(axis=1))
        if len(wrong):
            raise MeshError(
                path, f"{cell} {wrong[0]} has the nodes {nodes[wrong[0]].tolist()}{where}, "
                f"but there are only {node_count}",
            )  # fmt: skip
    check_positions(path, file.node_positions, scale, "node")


def _content_notes(path: Path, file: MeshFile, rotation: Sequence[float]) -> list[str]:
    """Warnings on how the file is read and placed."""
    notes = list(file.notes)
    if file.format_name != file.expected_format:
        notes.append(f"Read as {file.format_name} in spite of the suffix '{path.suffix}'.")
    if file.dropped_cells:
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(file.dropped_cells.items()))
        notes.append(f"Dropped the cells that are not solid ({kinds}).")
    largest = max(abs(float(angle)) for angle in rotation)
    if largest > 2.0 * math.pi:
        notes.append(f"The rotation contains {largest:g} rad, more than a turn: are the angles in "
                     "degrees?")  # fmt: skip
    return notes


def _oddity_notes(
    mesh: TetMesh | HexahedralMesh, file_node_indices: np.ndarray, file_tet_indices: np.ndarray
) -> list[str]:
    """Warnings on properties of the mesh that are not repaired."""
    notes = []
    sizes = np.bincount(component_labels(mesh.as_tets, mesh.node_count))
    if len(sizes) > 1:
        largest = np.sort(sizes)[::-1][:_NAMED_INDICES].tolist()
        more = ", …" if len(sizes) > _NAMED_INDICES else ""
        shown = ", ".join(map(str, largest)) + more
        notes.append(f"The mesh consists of {len(sizes)} separate parts, of {shown} nodes.")
    size = float(np.linalg.norm(np.ptp(mesh.node_positions, axis=0)))
    pairs = coincident_pairs(mesh.node_positions, _COINCIDENT * size)
    doubled = np.unique(file_node_indices[pairs[:, 1]])
    _note(notes, doubled, "node", f"Another node coincides with {{}}: {CUT}.")
    tets, hexahedra = mesh.cells, np.empty((0, 8), np.int64)
    if isinstance(mesh, HexahedralMesh):
        tets, hexahedra = mesh.tets, mesh.hexahedra
    hinged = hinged_part_count(tets, hexahedra, mesh.node_count)
    if hinged:
        notes.append(
            f"Parts of the mesh are connected by edges or single nodes only, in at least {hinged} "
            "places: they can rotate there."
        )
    scaled = scaled_jacobians(mesh.node_positions[hexahedra])
    skewed = np.flatnonzero(scaled < SKEWED_JACOBIAN)
    _note(notes, skewed, "hexahedron", f"Kept {{}} with a scaled Jacobian below {SKEWED_JACOBIAN:g} "
          f"(lowest {scaled.min(initial=1.0):.2g}): expect less accuracy there.")
    ratios = radius_ratios(SomeCells(mesh.node_positions, tets, LINEAR_TETRAHEDRON))
    slivers = np.flatnonzero(ratios < SLIVER_RATIO)
    if len(slivers):
        worst = int(ratios.argmin())
        _note(notes, file_tet_indices[slivers], "tetrahedron",
              f"Kept {{}} with a radius ratio below {SLIVER_RATIO:g} (lowest {ratios[worst]:.2g}, "
              f"tetrahedron {file_tet_indices[worst]}): expect less accuracy there.")
    return notes


def _note(notes: list[str], indices: np.ndarray, noun: str, sentence: str) -> None:
    """Adds a sentence on indices, if there are any.

    Args:
        notes: Where it is added.
        indices: In the file.
        noun: What they number.
        sentence: Its braces become text such as ``2 nodes (4, 7)``; only the first few are listed.
    """
    if not len(indices):
        return
    named = ", ".join(str(int(index)) for index in indices[:_NAMED_INDICES])
    more = ", …" if len(indices) > _NAMED_INDICES else ""
    if len(indices) > 1:
        noun = noun.removesuffix("on") + "a" if noun.endswith("hedron") else noun + "s"
    notes.append(sentence.format(f"{len(indices)} {noun} ({named}{more})"))
