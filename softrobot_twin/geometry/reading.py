"""Reading of a user's mesh: placed, mended, and every repair told."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.mesh_file import MeshFile, read_mesh_file
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.repair import (
    coincident_pairs,
    drop_degenerate_tets,
    drop_unused_nodes,
    first_of_duplicates,
    first_of_repeated_tets,
    first_of_touching_pieces,
    hinged_part_count,
    orient_tets,
    piece_labels,
)
from softrobot_twin.geometry.tet_mesh import TetMesh

# Radius ratio under which a tetrahedron is told as a sliver.
SLIVER_RATIO = 0.05
# Nodes this close, relative to the body's size, lie at one place.
_COINCIDENT = 1e-9
CUT = "the body is cut there"
"""What a note says of nodes that lie at one place and are not joined."""
# Indices named in a note before it only counts.
_NAMED_INDICES = 5


class MidEdgeNodes(NamedTuple):
    """Nodes that a file puts on edges.

    Attributes:
        file_nodes: Their places in the file, int64, shape (mid_count,).
        ends: The two nodes of the mesh that each lies between, int64, shape (mid_count, 2).
    """

    file_nodes: np.ndarray
    ends: np.ndarray


class MeshReading(NamedTuple):
    """A mesh as read, and what was done to it.

    Attributes:
        mesh: The mesh, in metres.
        notes: One sentence for each repair and each oddity. Tetrahedra and nodes are named by
            their place in the file, from 0.
        file_node_indices: Place in the file of each node of the mesh, int64, shape
            (node_count,).
        mesh_node_indices: Node of the mesh for each node of the file, −1 where it was dropped or
            stands on an edge, int64, shape (file_node_count,).
        mid_edge_nodes: Where the nodes stand that the file puts on edges; None where it holds
            tetrahedra of four nodes only.
    """

    mesh: TetMesh
    notes: tuple[str, ...]
    file_node_indices: np.ndarray
    mesh_node_indices: np.ndarray
    mid_edge_nodes: MidEdgeNodes | None = None


def read_tet_mesh(
    path: str | Path,
    *,
    scale: float = 1.0,
    translation: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0),
    merge_tolerance: float | None = None,
) -> MeshReading:
    """Reads a mesh of tetrahedra and places it: x = translation + Rz Ry Rx (scale · x_file).

    Args:
        path: File to read: .msh, .vtk, .vtu or .inp; its content decides the format.
        scale: Metres in one unit of the file, 0.001 for millimetres.
        translation: Shift after scale and rotation [m], shape (3,).
        rotation: Angles about the fixed x, then y, then z axis [rad], shape (3,).
        merge_tolerance: Distance within which nodes become one [m], 0 merges none; None merges
            only nodes of separate pieces that lie at one place.

    Returns:
        The mesh, the notes, and the node indices' translation.

    Raises:
        MeshError: The file cannot be read, does not hold tetrahedra of four or ten nodes, or
            cannot be mended; or the placement makes no sense.
    """
    path = Path(path)
    _check_placement(path, scale, translation, rotation, merge_tolerance)
    file = read_mesh_file(path)
    _check_nodes(path, file)
    notes = _content_notes(path, file)
    notes += _rotation_notes(rotation)

    turn = Rotation.from_euler("xyz", np.asarray(rotation, dtype=float))
    positions = turn.apply(scale * file.node_positions) + np.asarray(translation, dtype=float)
    standing_in = np.arange(len(positions))
    if merge_tolerance is None:
        standing_in = first_of_touching_pieces(positions, file.tets)
        notes += _joined_notes(standing_in)
    elif merge_tolerance > 0.0:
        standing_in = first_of_duplicates(positions, merge_tolerance)
        notes += _merge_notes(standing_in)

    kept = drop_degenerate_tets(positions, standing_in[file.tets])
    if len(kept.degenerate):
        notes.append(f"Dropped {_counted(kept.degenerate, 'tetrahedron')} without volume.")
    if len(kept.tets) == 0:
        raise MeshError(path, "has only tetrahedra without volume")
    once = first_of_repeated_tets(kept.tets)
    repeated = np.delete(kept.kept, once)
    if len(repeated):
        notes.append(
            f"Dropped {_counted(repeated, 'tetrahedron')} that the file holds more than once."
        )
    file_tets = kept.kept[once]
    oriented = orient_tets(positions, kept.tets[once])
    if len(oriented.inverted):
        inverted = _counted(file_tets[oriented.inverted], "inverted tetrahedron")
        notes.append(f"Turned {inverted} the right way round.")
    nodes = drop_unused_nodes(positions, oriented.tets)
    mesh_node_indices = nodes.new_indices[standing_in]
    mids = None
    if file.mid_nodes is not None:
        mids = _mid_edge_nodes(positions, file, standing_in, mesh_node_indices, file_tets, notes)
    used = mesh_node_indices >= 0
    used[file.mid_nodes[file.mid_nodes >= 0] if mids else []] = True
    unused = np.flatnonzero(~used)
    if len(unused):
        notes.append(f"Dropped {_counted(unused, 'node')} that no tetrahedron uses.")

    mesh = TetMesh(nodes.node_positions, nodes.tets)
    notes += _oddity_notes(mesh, nodes.old_indices, file_tets)
    return MeshReading(mesh, tuple(notes), nodes.old_indices, mesh_node_indices, mids)


def _mid_edge_nodes(
    positions: np.ndarray, file: MeshFile, standing_in: np.ndarray, mesh_node_indices: np.ndarray,
    file_tets: np.ndarray, notes: list[str],
) -> MidEdgeNodes:  # fmt: skip
    """Where the nodes on edges stand, and what is told of them."""
    module = import_module("softrobot_twin.geometry.quadratic_mesh")
    found = module.place_mid_edge_nodes(
        positions, standing_in[file.tets[file_tets]], file.mid_nodes[file_tets]
    )
    if len(found.curved):
        notes.append(
            f"Straightened {len(found.curved)} curved edges (the node furthest off, "
            f"{found.furthest}, by {1e3 * found.offset:.3g} mm): edges are straight at rest."
        )
    return MidEdgeNodes(found.nodes, mesh_node_indices[found.ends])


def _check_placement(
    path: Path,
    scale: float,
    translation: Sequence[float],
    rotation: Sequence[float],
    merge_tolerance: float | None,
) -> None:
    if not (math.isfinite(scale) and scale > 0.0):
        raise MeshError(path, f"scale is {scale}, not a positive number")
    for name, unit, values in (("translation", "m", translation), ("rotation", "rad", rotation)):
        if np.shape(values) != (3,) or not np.isfinite(np.asarray(values, dtype=float)).all():
            raise MeshError(path, f"{name} is {values} {unit}, not three finite numbers")
    if merge_tolerance is not None and not 0.0 <= merge_tolerance < math.inf:
        raise MeshError(path, f"merge_tolerance is {merge_tolerance} m, not a length")


def _check_nodes(path: Path, file: MeshFile) -> None:
    node_count = len(file.node_positions)
    outside = np.flatnonzero(((file.tets < 0) | (file.tets >= node_count)).any(axis=1))
    if len(outside):
        raise MeshError(
            path,
            f"tetrahedron {outside[0]} has the nodes {file.tets[outside[0]].tolist()}, "
            f"but there are only {node_count}",
        )
    if file.mid_nodes is not None and file.mid_nodes.max() >= node_count:
        tet = int(np.argmax((file.mid_nodes >= node_count).any(axis=1)))
        raise MeshError(
            path, f"tetrahedron {tet} has the nodes {file.mid_nodes[tet].tolist()} on its edges, "
            f"but there are only {node_count}",
        )  # fmt: skip
    wrong = np.flatnonzero(~np.isfinite(file.node_positions).all(axis=1))
    if len(wrong):
        raise MeshError(
            path, f"node {wrong[0]} is at {file.node_positions[wrong[0]].tolist()}, not finite"
        )


def _content_notes(path: Path, file: MeshFile) -> list[str]:
    notes = []
    if file.format_name != file.expected_format:
        notes.append(f"Read as {file.format_name} in spite of the name's '{path.suffix}'.")
    if file.dropped_cells:
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(file.dropped_cells.items()))
        notes.append(f"Dropped the cells that are not solid ({kinds}).")
    return notes


def _rotation_notes(rotation: Sequence[float]) -> list[str]:
    largest = max(abs(float(angle)) for angle in rotation)
    if largest <= 2.0 * math.pi:
        return []
    return [f"The rotation holds {largest:g} rad, more than a turn: are the angles in degrees?"]


def _joined_notes(standing_in: np.ndarray) -> list[str]:
    merged = np.flatnonzero(standing_in != np.arange(len(standing_in)))
    if len(merged) == 0:
        return []
    return [
        f"Merged {_counted(merged, 'node')} with others that lie there: they cut the mesh into "
        "separate pieces (merge_distance: 0 keeps the cut)."
    ]


def _merge_notes(standing_in: np.ndarray) -> list[str]:
    merged = np.flatnonzero(standing_in != np.arange(len(standing_in)))
    if len(merged) == 0:
        return []
    return [f"Merged {_counted(merged, 'node')} with others that lie there."]


def _oddity_notes(
    mesh: TetMesh, file_node_indices: np.ndarray, file_tet_indices: np.ndarray
) -> list[str]:
    """What is odd about a mesh but is left as it is."""
    notes = []
    sizes = np.bincount(piece_labels(mesh.cells, mesh.node_count))
    if len(sizes) > 1:
        largest = np.sort(sizes)[::-1][:_NAMED_INDICES].tolist()
        more = ", …" if len(sizes) > _NAMED_INDICES else ""
        shown = ", ".join(map(str, largest)) + more
        notes.append(f"The mesh is in {len(sizes)} separate pieces, of {shown} nodes.")
    size = float(np.linalg.norm(np.ptp(mesh.node_positions, axis=0)))
    pairs = coincident_pairs(mesh.node_positions, _COINCIDENT * size)
    if len(pairs):
        doubled = np.unique(file_node_indices[pairs[:, 1]])
        notes.append(
            f"Another node lies at the place of {_counted(doubled, 'node')}: {CUT}."
        )
    hinged = hinged_part_count(mesh.cells, mesh.node_count)
    if hinged:
        notes.append(
            f"Parts of the mesh hang together by edges or single nodes only, in {hinged} places "
            "or more: they can turn there."
        )
    ratios = radius_ratios(mesh)
    slivers = np.flatnonzero(ratios < SLIVER_RATIO)
    if len(slivers):
        worst = int(ratios.argmin())
        named = _counted(file_tet_indices[slivers], "tetrahedron")
        notes.append(
            f"Kept {named} with a radius ratio under {SLIVER_RATIO:g} (lowest {ratios[worst]:.2g}, "
            f"tetrahedron {file_tet_indices[worst]}): expect less accuracy there."
        )
    return notes


def _counted(indices: np.ndarray, noun: str) -> str:
    """Such as ``2 nodes (4, 7)``; beyond a few, the rest are only counted."""
    named = ", ".join(str(int(index)) for index in indices[:_NAMED_INDICES])
    more = ", …" if len(indices) > _NAMED_INDICES else ""
    if len(indices) > 1:
        noun = noun.removesuffix("on") + "a" if noun.endswith("tetrahedron") else noun + "s"
    return f"{len(indices)} {noun} ({named}{more})"
