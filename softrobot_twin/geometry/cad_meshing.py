"""Tetrahedra inside a part of a CAD program: STL files, which are triangles, and STEP files.

The surface of an STL file is checked here; gmsh meshes it in a process of its own, see
`gmsh_mesher`. Closed surfaces inside a solid become cavities: named surfaces of the mesh.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry import gmsh_mesher
from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.geometry.gmsh_mesher import Refused, refuse_size
from softrobot_twin.geometry.mesh_file_checks import check_file
from softrobot_twin.geometry.mesh_repair import drop_unused_nodes, orient_tets
from softrobot_twin.geometry.surface import boundary_triangles, half_edges
from softrobot_twin.geometry.surface_reading import SolidSurface, read_surface, repair_surface
from softrobot_twin.geometry.tet_mesh import TetMesh

CAD_SUFFIXES = (".stl", ".step", ".stp")
"""Suffixes of files that gmsh meshes."""
MOST_TETS = 1_000_000
"""A size that would make more tetrahedra than this is refused."""
MOST_BYTES, MOST_FACETS = 200_000_000, 1_000_000
"""Greatest CAD file, and greatest number of triangles of an STL file."""
VOLUME_TOLERANCE = 0.01
"""A mesh whose volume differs from the part's by a greater share is told."""
INSTALL = "pip install gmsh"
"""Installs gmsh."""
LIBRARIES = ("libglu1-mesa libgl1 libgomp1 libxrender1 libxcursor1 libxfixes3 libxext6 libxft2 "
             "libxinerama1 libfontconfig1")  # fmt: skip
"""Ubuntu's packages of the libraries that gmsh loads, though it opens no window here."""
# Part of the key of kept meshes: another way of meshing makes other meshes.
_WAY = "1"


class CadMesh(NamedTuple):
    """Tetrahedra of a CAD file.

    Attributes:
        mesh: The body [m].
        regions: Tetrahedra of each solid, where there are several, by its name.
        cavities: Triangles of each closed inner surface, normals out of the gas, by its name,
            shape (triangle_count, 3).
        notes: One sentence for each repair and each finding.
        version: Version of gmsh.
    """

    mesh: TetMesh
    regions: dict[str, np.ndarray]
    cavities: dict[str, np.ndarray]
    notes: tuple[str, ...]
    version: str

    def cavity_volume(self, name: str) -> float:
        """Volume enclosed by a cavity [m³].

        Args:
            name: Name of the cavity.
        """
        return enclosed_volume(self.mesh.node_positions, self.cavities[name])


def enclosed_volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside a closed surface, negative where its normals point inwards [m³].

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).
    """
    corners = points[triangles] - points[triangles[0, 0]]
    return float(np.linalg.det(corners).sum() / 6.0)


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


def mesh_cad(path: Path, size: float, scale: float = 1.0) -> CadMesh:
    """Fills the part of a CAD file with tetrahedra.

    Args:
        path: File to read: .stl, .step or .stp.
        size: Wanted edge of the tetrahedra [m].
        scale: Metres in one unit of an STL file; a STEP file states its unit.

    Returns:
        The mesh. The same file, size and version of gmsh give the same mesh.

    Raises:
        MeshError: The file cannot be read, its surface is open or intersects itself, it has no
            solid, the size does not suit it, or gmsh is not there or fails.
    """
    path = Path(path)
    _check_file(path)
    if path.suffix.lower() == ".stl":
        shells = read_shells(path, scale)
        return _mesh_shells(path, shells, size)
    job = {"file": str(path.resolve()), "size": 1e3 * size, "most_tets": MOST_TETS}
    return _made(path, _run_gmsh(path, job), [])


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


def part_size(path: Path, scale: float = 1.0) -> PartSize:
    """Reads how large the part of a CAD file is, without meshing it.

    Args:
        path: File to read: .stl, .step or .stp.
        scale: Metres in one unit of an STL file.

    Raises:
        MeshError: As `mesh_cad`.
    """
    path = Path(path)
    _check_file(path)
    if path.suffix.lower() == ".stl":
        shells = read_shells(path, scale)
        return PartSize(np.ptp(shells.points, axis=0), shells.volume)
    made = _run_gmsh(path, {"file": str(path.resolve()), "size": None})
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


def read_shells(path: Path, scale: float = 1.0) -> Shells:
    """Reads an STL file, repairs its orientation and finds which of its shells are cavities.

    Args:
        path: File, ASCII or binary.
        scale: Metres in one unit of the file.

    Returns:
        Its closed surfaces.

    Raises:
        MeshError: The file cannot be read, or a surface is open, touches itself along an edge, or
            intersects itself or another one.
    """
    _check_stl(path)
    points, triangles = read_surface(path, scale=scale)
    if len(triangles) > MOST_FACETS:
        raise MeshError(path, f"has {len(triangles)} triangles, more than {MOST_FACETS}; export it "
                        "with fewer facets")  # fmt: skip
    if len(triangles) < 4:
        raise MeshError(path, f"has only {len(triangles)} triangles, which enclose nothing")
    repaired = repair_surface(points, triangles)
    used, triangles = np.unique(repaired.triangles, return_inverse=True)
    points, triangles = points[used], triangles.reshape(-1, 3)
    _refuse_open(path, points, triangles)
    crossing = first_crossing(points, triangles)
    if crossing is not None:
        raise MeshError(path, f"its surface intersects itself at {_at(crossing)}; unite overlapping "
                        "or touching bodies in the CAD program")  # fmt: skip
    shell_of = _shells(triangles)
    for shell in range(shell_of.max() + 1):
        own = shell_of == shell
        if enclosed_volume(points, triangles[own]) < 0.0:
            triangles[own] = triangles[own][:, ::-1]
    solids = _nested(points, triangles, shell_of)
    volumes = [enclosed_volume(points, triangles[shell_of == shell])
               for shell in range(shell_of.max() + 1)]  # fmt: skip
    volume = sum(volumes[own[0]] - sum(volumes[shell] for shell in own[1:]) for own in solids)
    # That cavities point the other way is no fault.
    notes = [note for note in repaired.notes if "all" not in note]
    if len(solids) > 1:
        notes.append(f"it has {len(solids)} separate bodies, which nothing joins")
    return Shells(points, triangles, shell_of, solids, volume, notes)


def _check_stl(path: Path) -> None:
    """Refuses a binary file that has not as many bytes as its triangles need."""
    with open(path, "rb") as file:
        head = file.read(1024)
    if head.lstrip().startswith(b"solid") and (b"facet" in head or b"endsolid" in head):
        return
    facets = int.from_bytes(head[80:84], "little")
    expected, found = 84 + 50 * facets, path.stat().st_size
    if len(head) < 84 or found < expected:
        needed = f"{facets} triangles need {expected} bytes, " if len(head) >= 84 else ""
        reason = f"is no STL file, or only a part of one: {needed}it has {found} bytes"
        raise MeshError(path, reason)


def _at(place: np.ndarray) -> str:
    """A place in words."""
    return "(" + ", ".join(f"{1e3 * value + 0.0:.3f}" for value in place) + ") mm"


def _refuse_open(path: Path, points: np.ndarray, triangles: np.ndarray) -> None:
    """Refuse edges that do not belong to two triangles of opposite direction."""
    halves, edges, place, counts = half_edges(triangles)
    for wrong, what in (
        (counts == 1, "is open: {} of its edges belong to one triangle only"),
        (counts > 2, "meets itself: {} of its edges belong to more than two triangles"),
    ):
        if wrong.any():
            middle = points[edges[np.argmax(wrong)]].mean(axis=0)
            raise MeshError(path, f"its surface {what.format(int(wrong.sum()))}, the first at "
                            f"{_at(middle)}; repair it in the CAD program")  # fmt: skip
    balance = np.bincount(place, np.where(halves[:, 0] < halves[:, 1], 1, -1))
    if balance.any():
        middle = points[edges[np.argmax(balance != 0)]].mean(axis=0)
        raise MeshError(path, "its triangles cannot be oriented: the surface has one side only, as "
                        f"a Möbius strip, at {_at(middle)}")  # fmt: skip


def _shells(triangles: np.ndarray) -> np.ndarray:
    """Connected component of each triangle, shape (triangle_count,)."""
    count = int(triangles.max()) + 1
    pieces = connected_pieces(np.repeat(triangles[:, 0], 2), triangles[:, 1:].ravel(), count)
    return np.unique(pieces[triangles[:, 0]], return_inverse=True)[1]


def _nested(points: np.ndarray, triangles: np.ndarray, shell_of: np.ndarray) -> list[list[int]]:
    """Outer shell of each solid and those of its cavities: a shell inside one is a cavity, inside
    two a solid again."""
    shells = [SolidSurface(points, triangles[shell_of == shell])
              for shell in range(shell_of.max() + 1)]  # fmt: skip
    inside = [[other for other, around in enumerate(shells)
               if other != shell and around.distances(points[own.triangles[:1, 0]])[0] == 0.0]
              for shell, own in enumerate(shells)]  # fmt: skip
    solids = {shell: [shell] for shell, around in enumerate(inside) if len(around) % 2 == 0}
    for shell, around in enumerate(inside):
        if shell not in solids:
            innermost = max(around, key=lambda other: len(inside[other]))
            solids[innermost].append(shell)
    return list(solids.values())


# Triangles per leaf of the tree that finds pairs of near triangles.
_LEAF = 4
# Shares of an edge and of a triangle that count as its end: files store six or seven digits.
_TOUCH = 1.0e-6
# Least slope of an edge against a triangle that it runs through; flatter ones lie in it.
_LEAST_SLOPE = 1.0e-5


def first_crossing(points: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """A point where an edge of a surface runs through one of its triangles; None without any.

    Args:
        points: Points [m], shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).

    Returns:
        The point [m], shape (3,). Triangles that lie on each other do not cross.
    """
    for first, second in _near_pairs(points[triangles]):
        for edges, faces in ((first, second), (second, first)):
            for corner in range(3):
                ends = triangles[edges][:, [corner, (corner + 1) % 3]]
                apart = ~(ends[:, :, None] == triangles[faces][:, None, :]).any(axis=(1, 2))
                found = _crossings(points[ends[apart]], points[triangles[faces[apart]]])
                if len(found):
                    return found[0]
    return None


def _crossings(ends: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Points where segments run through the inside of triangles, shape (count, 3)."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    slope = np.einsum("ni,ni->n", along, normal)
    scale = np.linalg.norm(along, axis=1) * np.linalg.norm(normal, axis=1)
    ahead = np.abs(slope) > _LEAST_SLOPE * scale
    slope = np.where(ahead, slope, 1.0)
    share = np.einsum("ni,ni->n", corners[:, 0] - start, normal) / slope
    place = start + share[:, None] * along
    area = np.einsum("ni,ni->n", normal, normal)
    from_corner = place - corners[:, 0]
    u = np.einsum("ni,ni->n", np.cross(from_corner, other), normal) / area
    v = np.einsum("ni,ni->n", np.cross(one, from_corner), normal) / area
    # An end on a triangle touches it; an edge that meets its edge from the side runs through.
    within = (share > _TOUCH) & (share < 1.0 - _TOUCH)
    within &= (u > -_TOUCH) & (v > -_TOUCH) & (u + v < 1.0 + _TOUCH)
    return place[ahead & within]


def _near_pairs(corners: np.ndarray):
    """Yields pairs of triangles whose bounding boxes meet, as two arrays of their numbers.

    The triangles are sorted along a curve through space; boxes around 4, 8, 16... neighbours on it
    form a tree, whose levels are compared with themselves from the top.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = _along_a_curve(0.5 * (low + high))
    depth = max(0, int(np.ceil(np.log2(max(1.0, len(order) / _LEAF)))))
    count = _LEAF * 2**depth
    padded = np.full((2, count, 3), np.nan)
    padded[0, : len(order)], padded[1, : len(order)] = low[order], high[order]
    levels = [padded]
    while levels[-1].shape[1] > 1:
        lows, highs = levels[-1].reshape(2, -1, 2, 3)
        bounds = np.fmin(lows[:, 0], lows[:, 1]), np.fmax(highs[:, 0], highs[:, 1])
        levels.append(np.stack(bounds))
    stack = [(len(levels) - 1, np.zeros((1, 2), np.int64))]
    while stack:
        level, pairs = stack.pop()
        (low_a, high_a), (low_b, high_b) = (levels[level][:, pairs[:, side]] for side in (0, 1))
        pairs = pairs[((low_a <= high_b) & (low_b <= high_a)).all(axis=1)]
        if level == 0:
            pairs = order[pairs[pairs[:, 0] < pairs[:, 1]]]
            if len(pairs):
                yield pairs[:, 0], pairs[:, 1]
            continue
        halves = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        children = (2 * pairs[:, None, :] + halves).reshape(-1, 2)
        children = children[children[:, 0] <= children[:, 1]]
        # Many pairs at once are compared in portions, so that memory does not grow with the file.
        for first in range(0, len(children), 200_000):
            stack.append((level - 1, children[first : first + 200_000]))


def _along_a_curve(centres: np.ndarray) -> np.ndarray:
    """Order of points along Morton's curve, on which neighbours are near to each other."""
    span = np.ptp(centres, axis=0)
    steps = ((centres - centres.min(axis=0)) / np.where(span > 0.0, span, 1.0) * 1023.0)
    steps = steps.astype(np.int64)
    code = np.zeros(len(centres), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


# --- gmsh -----------------------------------------------------------------------------------------


def _mesh_shells(path: Path, shells: Shells, size: float) -> CadMesh:
    """Fills the solids between the shells of an STL file."""
    extents = np.ptp(shells.points, axis=0)
    try:
        refuse_size(1e3 * size, 1e3 * extents, 1e9 * shells.volume, MOST_TETS)
    except Refused as error:
        raise MeshError(path, str(error)) from None
    arrays = {"points": 1e3 * shells.points, "triangles": shells.triangles,
              "shells": shells.shell_of}  # fmt: skip
    job = {"size": 1e3 * size, "shells": True, "solids": shells.solids,
           "volume": 1e9 * shells.volume}  # fmt: skip
    found = _made(path, _run_gmsh(path, job, arrays), shells.notes)
    expected = sum(len(own) - 1 for own in shells.solids)
    if len(found.cavities) != expected:
        raise MeshError(path, f"has {expected} closed inner surfaces, but its mesh has "
                        f"{len(found.cavities)}; give a smaller size")  # fmt: skip
    return found


def _run_gmsh(path: Path, job: dict, arrays: dict[str, np.ndarray] | None = None) -> dict:
    """Runs `gmsh_mesher` and returns its arrays."""
    with tempfile.TemporaryDirectory(prefix="softrobot_twin_mesh_") as name:
        folder = Path(name)
        (folder / "job.json").write_text(json.dumps(job))
        if arrays is not None:
            np.savez(folder / "shells.npz", **arrays)
        # -P: the folder of the script has modules whose names are no business of gmsh.
        command = [sys.executable, "-P", gmsh_mesher.__file__, str(folder)]
        ended = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        if (folder / "error.json").is_file():
            raise MeshError(path, _in_words(json.loads((folder / "error.json").read_text())))
        if ended.returncode or not (folder / "mesh.npz").is_file():
            last = " ".join(ended.stderr.split())[-300:] or "without a message"
            raise MeshError(path, f"gmsh ended with code {ended.returncode} ({last})")
        with np.load(folder / "mesh.npz") as made:
            return dict(made)


def _in_words(error: dict) -> str:
    """The error of `gmsh_mesher` as a sentence."""
    kind, text = error["kind"], " ".join(error["text"].split())
    if kind == "not installed":
        return (f"is a CAD file, which gmsh meshes, and gmsh is not installed: {INSTALL} (there is "
                "no wheel for ARM: sudo apt install python3-gmsh)")
    if kind == "library":
        return (f"is a CAD file, which gmsh meshes, and gmsh cannot be loaded ({text}): sudo apt "
                f"install {LIBRARIES}")
    return text if kind == "refused" else f"gmsh cannot mesh it ({text})"


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
    names = made["names"].tolist()
    regions = {}
    if len(names) > 1:
        for index, name in enumerate(_distinct(names)):
            regions[name] = np.flatnonzero(made["solids"] == index)
    return CadMesh(mesh, regions, cavities_of(mesh), tuple(notes), str(made["version"]))


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
    shell_of = _shells(triangles)
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
