"""Tetrahedra inside a part of a CAD program: STL files, which are triangles, and STEP files.

The surface of an STL file is checked here; gmsh meshes it in a process of its own, see
`gmsh_mesher`. Closed surfaces inside a solid become cavities: named surfaces of the mesh.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import meshio
import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry import gmsh_mesher
from softrobot_twin.geometry.gmsh_mesher import Refused, refuse_size
from softrobot_twin.geometry.gmsh_process import run_gmsh
from softrobot_twin.geometry.mesh_file_checks import check_file
from softrobot_twin.geometry.mesh_repair import drop_unused_nodes, orient_tets
from softrobot_twin.geometry.solid_repair import repair_solids
from softrobot_twin.geometry.solid_shells import (
    at,
    connected_shells,
    enclosed_volume,
    first_crossing,
    nested,
    outward_shells,
    refuse_open,
)
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.surface_reading import REPAIR, read_surface, repair_surface
from softrobot_twin.geometry.tet_mesh import TetMesh

TRIANGLE_SUFFIXES = (".stl", ".obj", ".ply", ".off")
"""Suffixes of files of triangles, which state no unit."""
CAD_SUFFIXES = (*TRIANGLE_SUFFIXES, ".step", ".stp")
"""Suffixes of files that gmsh meshes."""
MOST_TETS = 1_000_000
"""A size that would make more tetrahedra than this is refused."""
MOST_BYTES, MOST_FACETS = 200_000_000, 1_000_000
"""Greatest CAD file, and greatest number of triangles of an STL file."""
CAVITY_TOLERANCE = 0.03
"""A cavity of the mesh that lost a greater share of its volume is told."""
VOLUME_TOLERANCE = 0.01
"""A mesh whose volume differs from the part's by a greater share is told."""
# Part of the key of kept meshes: another way of meshing makes other meshes.
_WAY = "2"


class CadMesh(NamedTuple):
    """Tetrahedra of a CAD file.

    Attributes:
        mesh: The body [m].
        regions: Tetrahedra of each solid, where there are several, by its name.
        cavities: Triangles of each closed inner surface, normals out of the gas, by its name,
            shape (triangle_count, 3).
        notes: One sentence for each repair and each finding.
        version: Version of gmsh.
        lost: Share of the volume of each cavity of the part that its facets cut off, by its name.
    """

    mesh: TetMesh
    regions: dict[str, np.ndarray]
    cavities: dict[str, np.ndarray]
    notes: tuple[str, ...]
    version: str
    lost: Mapping[str, float] = MappingProxyType({})

    def cavity_volume(self, name: str) -> float:
        """Volume enclosed by a cavity [m³].

        Args:
            name: Name of the cavity.
        """
        return enclosed_volume(self.mesh.node_positions, self.cavities[name])


class Shells(NamedTuple):
    """The closed surfaces of an STL file.

    Attributes:
        points: [m], shape (point_count, 3).
        triangles: Normals outwards of the space that each shell encloses, shape (n, 3).
        shell_of: Shell of each triangle, shape (n,).
        solids: Outer shell of each solid, followed by those of its cavities.
        volume: Volume of the solids [m³].
        notes: One sentence for each repair.
    """

    points: np.ndarray
    triangles: np.ndarray
    shell_of: np.ndarray
    solids: list[list[int]]
    volume: float
    notes: list[str]


def mesh_cad(
    path: Path, size: float, scale: float = 1.0, repair: bool = False, turn: int | None = None
) -> CadMesh:
    """Fills the part of a CAD file with tetrahedra.

    Args:
        path: File to read: .stl, .step or .stp.
        size: Wanted edge of the tetrahedra [m].
        scale: Metres in one unit of a surface file; a STEP file states its unit.
        repair: Whether holes of a surface file are closed and its solids united; see
            `repair_solids`.
        turn: Elements in a full turn of all curved faces, 0 for the size alone. None refines the
            curved walls of cavities, as far as they lose more than 2.5 % of their volume.

    Returns:
        The mesh. The same file, size and version of gmsh give the same mesh.

    Raises:
        MeshError: The file cannot be read, its surface is open or intersects itself, it has no
            solid, the size does not suit it, or gmsh is not there or fails.
    """
    path = Path(path)
    _check_file(path)
    if path.suffix.lower() in TRIANGLE_SUFFIXES:
        shells = read_shells(path, scale, repair)
        return _mesh_shells(path, shells, size, turn)
    job = {"file": str(path.resolve()), "size": 1e3 * size, "most_tets": MOST_TETS, "turn": turn}
    return _made(path, run_gmsh(path, job), [])


class PartSize(NamedTuple):
    """How large a part is.

    Attributes:
        extents: Edges of its bounding box [m], shape (3,).
        volume: Volume of its solids [m³].
    """

    extents: np.ndarray
    volume: float

    def size_for(self, tet_count: float) -> float:
        """Edge of the tetrahedra that about so many of them have [m].

        Args:
            tet_count: Wanted number of tetrahedra.
        """
        size = (gmsh_mesher.TETS_PER_VOLUME * self.volume / tet_count) ** (1.0 / 3.0)
        return min(size, 0.5 * float(self.extents.max()))


def part_size(path: Path, scale: float = 1.0, repair: bool = False) -> PartSize:
    """Reads how large the part of a CAD file is, without meshing it.

    Args:
        path: File to read: .stl, .step or .stp.
        scale: Metres in one unit of a surface file.
        repair: See `mesh_cad`.

    Raises:
        MeshError: As `mesh_cad`.
    """
    path = Path(path)
    _check_file(path)
    if path.suffix.lower() in TRIANGLE_SUFFIXES:
        shells = read_shells(path, scale, repair)
        return PartSize(np.ptp(shells.points, axis=0), shells.volume)
    made = run_gmsh(path, {"file": str(path.resolve()), "size": None})
    return PartSize(1e-3 * made["extents"], 1e-9 * float(made["volume"]))


def _check_file(path: Path) -> None:
    check_file(path, CAD_SUFFIXES, "CAD")
    byte_count = path.stat().st_size
    if byte_count == 0:
        raise MeshError(path, "is empty")
    if byte_count > MOST_BYTES:
        raise MeshError(path, f"has {byte_count / 1e6:.0f} MB, more than {MOST_BYTES / 1e6:.0f} "
                        "MB; export it with fewer facets")  # fmt: skip


# --- the surface of an STL file -------------------------------------------------------------------


def read_shells(path: Path, scale: float = 1.0, repair: bool = False) -> Shells:
    """Reads an STL file, repairs its orientation and finds which of its shells are cavities.

    Args:
        path: File of triangles.
        scale: Metres in one unit of the file.
        repair: Whether holes are closed and solids that overlap are united.

    Returns:
        Its closed surfaces.

    Raises:
        MeshError: The file cannot be read, or a surface is open, touches itself along an edge, or
            intersects itself or another one.
    """
    points, triangles = read_surface(path, scale=scale)
    if len(triangles) > MOST_FACETS:
        raise MeshError(path, f"has {len(triangles)} triangles, more than {MOST_FACETS}; export it "
                        "with fewer facets")  # fmt: skip
    if len(triangles) < 4:
        raise MeshError(path, f"has only {len(triangles)} triangles, which enclose nothing")
    notes: list[str] = []
    if repair:
        points, triangles = repair_solids(path, points, triangles, notes)
    repaired = repair_surface(points, triangles)
    used, triangles = np.unique(repaired.triangles, return_inverse=True)
    points, triangles = points[used], triangles.reshape(-1, 3)
    remedy = "repair it in the CAD program" if repair else REPAIR.format(path.name, "")
    refuse_open(path, points, triangles, remedy)
    crossing = first_crossing(points, triangles)
    if crossing is not None:
        raise MeshError(path, f"its surface intersects itself at {at(crossing)}; {remedy}")
    shell_of = connected_shells(triangles)
    triangles = outward_shells(points, triangles, shell_of)
    solids = nested(points, triangles, shell_of)
    volumes = [enclosed_volume(points, triangles[shell_of == shell])
               for shell in range(shell_of.max() + 1)]  # fmt: skip
    volume = sum(volumes[own[0]] - sum(volumes[shell] for shell in own[1:]) for own in solids)
    # That cavities point the other way is no fault.
    notes += [note for note in repaired.notes if "all" not in note]
    if len(solids) > 1:
        notes.append(f"it has {len(solids)} separate bodies, which nothing joins")
    return Shells(points, triangles, shell_of, solids, volume, notes)


# --- gmsh -----------------------------------------------------------------------------------------


def _mesh_shells(path: Path, shells: Shells, size: float, turn: int | None) -> CadMesh:
    """Fills the solids between the shells of an STL file."""
    extents = np.ptp(shells.points, axis=0)
    try:
        refuse_size(1e3 * size, 1e3 * extents, 1e9 * shells.volume, MOST_TETS)
    except Refused as error:
        raise MeshError(path, str(error)) from None
    arrays = {"points": 1e3 * shells.points, "triangles": shells.triangles, "shells": shells.shell_of}
    chambers = [(shell, 1e9 * enclosed_volume(shells.points, shells.triangles[shells.shell_of == shell]))
                for own in shells.solids for shell in own[1:]]  # fmt: skip
    job = {"size": 1e3 * size, "shells": True, "solids": shells.solids, "turn": turn,
           "volume": 1e9 * shells.volume, "chambers": chambers}  # fmt: skip
    found = _made(path, run_gmsh(path, job, arrays), shells.notes)
    expected = sum(len(own) - 1 for own in shells.solids)
    if len(found.cavities) != expected:
        raise MeshError(path, f"has {expected} closed inner surfaces, but its mesh has "
                        f"{len(found.cavities)}; give a smaller size")  # fmt: skip
    return found


def _made(path: Path, made: dict, notes: list[str]) -> CadMesh:
    """The mesh that gmsh made, with its cavities and regions."""
    positions = 1e-3 * made["nodes"]
    oriented, _ = orient_tets(positions, made["tets"])
    nodes = drop_unused_nodes(positions, oriented)
    try:
        mesh = TetMesh(nodes.node_positions, nodes.tets)
    except MeshError as error:
        reason = f"its mesh cannot be used: {error.reason}; try another size"
        raise MeshError(path, reason) from None
    differs = 1e9 * mesh.volume / float(made["volume"]) - 1.0
    if abs(differs) > VOLUME_TOLERANCE:
        notes = [*notes, f"the volume of the mesh differs by {100.0 * differs:+.1f} % from the "
                 "part's: a smaller size follows its curved faces better"]  # fmt: skip
    cavities = cavities_of(mesh)
    lost = _lost_shares(mesh, cavities, made["chambers"])
    notes = [*notes, *(
        f"facets cut {100.0 * share:.1f} % off the volume of {name}, and about as much off the force "
        "of its pressure: a smaller size, or more elements in a full turn, follows its walls better"
        for name, share in lost.items() if share > CAVITY_TOLERANCE
    )]  # fmt: skip
    names = made["names"].tolist()
    regions = {}
    if len(names) > 1:
        for index, name in enumerate(_distinct(names)):
            regions[name] = np.flatnonzero(made["solids"] == index)
    return CadMesh(mesh, regions, cavities, tuple(notes), str(made["version"]), lost)


def _lost_shares(mesh: TetMesh, cavities: dict[str, np.ndarray], chambers: np.ndarray) -> dict[str, float]:
    """Share of volume that each cavity has lost against the chamber of the part at its place."""
    lost = {}
    for name, triangles in cavities.items():
        corners = 1e3 * mesh.node_positions[triangles].reshape(-1, 3)
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        if len(chambers):
            nearest = chambers[np.linalg.norm(chambers[:, :3] - middle, axis=1).argmin()]
            lost[name] = 1.0 - 1e9 * enclosed_volume(mesh.node_positions, triangles) / nearest[3]
    return lost


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of regions: words of letters and digits, each once."""
    found: list[str] = []
    for index, name in enumerate(names, start=1):
        word = re.sub(r"\W+", "_", name).strip("_")
        # A part without a name gets that of the program that wrote it.
        is_named = re.match(r"(?!Open_CASCADE)[A-Za-z]", word)
        word = word if is_named else f"solid_{index}"
        found.append(word if word not in found else f"{word}_{index}")
    return found


def cavities_of(mesh: TetMesh) -> dict[str, np.ndarray]:
    """The closed inner surfaces of a mesh: ``cavity_1``, ``cavity_2``, ..., the largest first.

    Args:
        mesh: The mesh.

    Returns:
        Triangles of each, normals out of the gas, shape (triangle_count, 3).
    """
    triangles = boundary_triangles(mesh.cells)
    shell_of = connected_shells(triangles)
    inner = []
    for shell in range(shell_of.max() + 1):
        own = triangles[shell_of == shell]
        # Normals of a mesh's surface point out of the material: into a cavity.
        volume = -enclosed_volume(mesh.node_positions, own)
        if volume > 0.0:
            inner.append((volume, own[:, ::-1]))
    inner.sort(key=lambda one: -one[0])
    return {f"cavity_{index}": own for index, (_, own) in enumerate(inner, start=1)}


def write_msh(path: Path, made: CadMesh) -> None:
    """Writes a mesh as Gmsh 2.2, in metres: solids as regions, cavities as named surfaces.

    Args:
        path: File to write.
        made: The mesh.
    """
    cells = made.mesh.cells
    blocks = [("tetra", cells[tets], name, 3) for name, tets in made.regions.items()]
    blocks = blocks or [("tetra", cells, "", 3)]
    blocks += [("triangle", triangles, name, 2) for name, triangles in made.cavities.items()]
    tags = [np.full(len(own), tag, np.int32) for tag, (_, own, _, _) in enumerate(blocks, start=1)]
    meshio.Mesh(
        made.mesh.node_positions, [(kind, own.astype(np.int32)) for kind, own, _, _ in blocks],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array([tag, dimension])
                    for tag, (_, _, name, dimension) in enumerate(blocks, start=1) if name},
    ).write(path, file_format="gmsh22", binary=True)  # fmt: skip


# --- meshes of scenes -----------------------------------------------------------------------------


class KeptMesh(NamedTuple):
    """The mesh of a CAD file that a scene names.

    Attributes:
        path: Its file, in metres.
        notes: What was found when it was made, and where it is.
    """

    path: Path
    notes: tuple[str, ...]


def mesh_cache() -> Path:
    """The folder in which meshes of CAD files are kept."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "softrobot_twin" / "meshes"


def kept_mesh(path: Path, size: float, scale: float = 1.0) -> KeptMesh:
    """The mesh of a CAD file, made once for each content, size and scale; see `mesh_cache`.

    Args:
        path: The file.
        size: Wanted edge of the tetrahedra [m].
        scale: Metres in one unit of an STL file.

    Raises:
        MeshError: As `mesh_cad`; or the mesh cannot be kept.
    """
    _check_file(path)
    key = hashlib.sha256(path.read_bytes())
    key.update(f" {size:.9g} {scale:.9g} {_WAY}".encode())
    kept = mesh_cache() / f"{path.stem}_{key.hexdigest()[:16]}.msh"
    found = kept.with_suffix(".notes")
    if kept.is_file() and found.is_file():
        before = found.read_text(encoding="utf-8").splitlines()
        return KeptMesh(kept, (*before, f"meshed before, kept in {kept}"))
    made = mesh_cad(path, size, scale)
    partial = kept.with_name(f".{kept.stem}.{os.getpid()}.msh")
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text("\n".join(made.notes), encoding="utf-8")
        os.replace(partial, found)
        write_msh(partial, made)
        os.replace(partial, kept)
    except OSError as error:
        raise MeshError(kept, f"cannot be written ({error.strerror or error}); another folder is "
                        "named by the environment variable XDG_CACHE_HOME") from None  # fmt: skip
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
    word = f"meshed by gmsh {made.version}, {made.mesh.node_count} nodes, kept in {kept}"
    return KeptMesh(kept, (*made.notes, word))
