"""Named parts of mesh files: regions of cells, surfaces of triangles, and edges.

Gmsh names physical groups, Abaqus names element sets. VTK files have cell data, but no names.
"""

from __future__ import annotations

import io
import shlex
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import meshio
import meshio.abaqus
import meshio.gmsh
import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.gmsh_process import run_gmsh

# Kinds of cells of each kind of part, and how many of their first nodes are corners.
_TETS, _HEXAHEDRA = ("tetra", "tetra10"), ("hexahedron",)
_CORNERS_OF = {"triangle": 3, "triangle6": 3, "quad": 4, "line": 2, "line3": 2}
# A quadrilateral as two triangles.
_HALVES = np.array([[0, 1, 2], [0, 2, 3]])
# Abaqus elements that meshio does not know, and known ones with the same nodes.
_SAME_NODES = {"C3D4H": "C3D4", "CPS6": "STRI65"}
# Names of the kinds of parts in messages.
_KINDS = {"regions": "volume region", "surfaces": "surface", "edges": "set of edges"}


class MeshParts(NamedTuple):
    """Named parts of a mesh file, with the indices of the file or of the mesh that was made of it.

    Attributes:
        path: The file.
        regions: Cells of each region, int64, shape (n,): of a mesh in rising order, of a file tetrahedra
            counted over all their blocks, then hexahedra over all of theirs.
        surfaces: Corner nodes of the triangles of each surface, a quadrilateral as two, oriented as in the
            file, int64, shape (n, 3).
        edges: End nodes of the line elements of each set, in the order of the file, int64,
            shape (n, 2).
        unusable: Reason for each part that cannot be used, by its name.
        unnamed: What the file has in place of names, for messages.
    """

    path: Path | None
    regions: dict[str, np.ndarray]
    surfaces: dict[str, np.ndarray]
    edges: dict[str, np.ndarray]
    unusable: dict[str, str]
    unnamed: str

    @property
    def is_empty(self) -> bool:
        """True for a file that names nothing."""
        return not (self.regions or self.surfaces or self.edges or self.unusable)

    def region(self, name: str) -> np.ndarray:
        """Cells of a region; raises `MeshError` where the file has no such region.

        Args:
            name: Its name in the file.
        """
        return self._part("regions", name)

    def surface(self, name: str) -> np.ndarray:
        """Triangles of a surface; raises `MeshError` where the file has no such surface.

        Args:
            name: Its name in the file.
        """
        return self._part("surfaces", name)

    def edge_set(self, name: str) -> np.ndarray:
        """Edges of a set; raises `MeshError` where the file has no such set.

        Args:
            name: Its name in the file.
        """
        return self._part("edges", name)

    def _part(self, kind: str, name: str) -> np.ndarray:
        parts = getattr(self, kind)
        if name in parts:
            return parts[name]
        if name in self.unusable:
            raise MeshError(self.path, f"{name} {self.unusable[name]}")
        known = ", ".join(sorted(parts)) or "none"
        also = f"; {self.unnamed}" if self.unnamed else ""
        raise MeshError(self.path, f"has no {_KINDS[kind]} named {name}; of this kind it names {known}{also}")


NO_PARTS = MeshParts(None, {}, {}, {}, {}, "")
"""Of a mesh without named parts."""


def read_abaqus(path: str) -> meshio.Mesh:
    """Reads an Abaqus file, its element sets as `cell_sets`.

    The sets are read here, because meshio mixes up sets that belong to several blocks of elements.
    So are parts and instances: meshio joins the nodes of parts, which have the same numbers.

    Args:
        path: File to read.

    Returns:
        The content; each set has one array of cell indices for each block of cells. Its `info` are
        notes on what was left out.

    Raises:
        Exception: The file is damaged, or has what is not read.
    """
    text = Path(path).read_text(errors="replace")
    elements, commands = io.StringIO(), []
    elements.name = path  # meshio finds included files by it
    for line in text.splitlines(keepends=True):
        if line.startswith("**"):
            continue
        if line.startswith("*"):
            commands.append((line, []))
        elif commands:
            commands[-1][1].append(line)
    commands, notes = _assembled(commands)
    # Of several blocks of nodes meshio keeps the last one.
    nodes = [row for command, rows in commands if _keyword(command) == "NODE" for row in rows]
    if nodes:
        elements.writelines(["*NODE\n", *nodes])
    for command, rows in commands:
        if _keyword(command) not in ("NODE", "ELSET", "NSET"):
            elements.write(_for_meshio(command))
            elements.writelines(rows)
    elements.seek(0)
    content = meshio.abaqus.read(elements)
    if not any(_keyword(command) == "INCLUDE" for command, _ in commands):
        content.cell_sets = _abaqus_sets(commands, content)
    content.info = notes
    return content


# Commands that make or move nodes and elements, and are not read.
_UNREAD = ("SYSTEM", "NGEN", "NFILL", "NMAP", "NCOPY", "ELGEN", "ELCOPY")


def _assembled(commands: list) -> tuple[list, list[str]]:
    """The commands with the nodes, elements and sets of each instance, numbered on and placed.

    A set of a part has its own name; where several instances have sets of one name, ``instance.set``.
    """
    parts, placed, instances, others, within = {}, set(), [], [], None
    for command, rows in commands:
        keyword, given = _keyword(command), _parameters(command)
        if keyword in _UNREAD or given.get("SYSTEM", "R").upper() != "R":
            raise ValueError(f"*{keyword.title()} is not read; let the program write each node and "
                             "element in Cartesian coordinates")  # fmt: skip
        if keyword == "PART":
            within = parts.setdefault(given["NAME"].casefold(), [])
        elif keyword == "INSTANCE":
            part = given.get("PART", "").casefold()
            within = list(parts[part]) if part else []
            placed.add(part)
            instances.append((given["NAME"], within, [row for row in rows if row.strip()]))
        elif keyword in ("END PART", "END INSTANCE"):
            within = None
        else:
            (others if within is None else within).append((command, rows))
    if not instances:
        if len(parts) > 1:
            raise ValueError(f"it has the parts {', '.join(parts)}, and no *Instance that places them")
        return commands, []
    sets = [{_parameters(command).get("ELSET", "").casefold() for command, _ in own}
            for _, own, _ in instances]  # fmt: skip
    set_names = [name for names in sets for name in names - {""}]
    made, first, starts = [], 0, {}
    for instance, own, placement in instances:
        starts[instance.casefold()] = first
        several = {name for name in set_names if set_names.count(name) > 1}
        prefix = f"{instance}."
        numbered = [_numbered(command, rows, first, prefix, several) for command, rows in own]
        place = _placement(placement)
        for (command, rows), at in zip(numbered, own, strict=True):
            made.append((command, place(rows) if _keyword(at[0]) == "NODE" else rows))
        numbers = [int(row.partition(",")[0]) for command, rows in numbered
                   if _keyword(command) in ("NODE", "ELEMENT") for row in rows
                   if row.partition(",")[0].strip().isdigit()]  # fmt: skip
        first = max(numbers, default=first)
    for command, rows in others:
        given = _parameters(command)
        start = starts[given["INSTANCE"].casefold()] if "INSTANCE" in given else first
        made.append(_numbered(command, rows, start, "", set()))
    return made, [f"Left out the part {name}, which no *Instance places." for name in parts
                  if name not in placed]  # fmt: skip


def _numbered(command: str, rows: list[str], first: int, prefix: str, several: set[str]) -> tuple:
    """A command with its numbers of nodes and elements higher by `first`, and sets renamed."""
    keyword, name = _keyword(command), _parameters(command).get("ELSET", "")
    if keyword not in ("NODE", "ELEMENT", "ELSET"):
        return command, rows
    if name.casefold() in several:
        words = command.strip().split(",")
        words = [f"ELSET={prefix}{name}" if word.strip().upper().startswith("ELSET=") else word
                 for word in words]  # fmt: skip
        command = ",".join(words) + "\n"
    # Only these numbers of a row are those of nodes and elements.
    count = {"NODE": 1, "ELSET": 2 if "GENERATE" in _parameters(command) else None}.get(keyword)
    moved = []
    for row in rows:
        words = [word.strip() for word in row.split(",")]
        for place, word in enumerate(words[:count]):
            if word.isdigit():
                words[place] = str(int(word) + first)
            elif word.strip('"').casefold() in several:
                words[place] = prefix + word.strip('"')
        moved.append(", ".join(words) + "\n")
    return command, moved


def _placement(rows: list[str]) -> Callable[[list[str]], list[str]]:
    """Moves rows of nodes as the data of an instance say: a translation, then a turn [degrees]
    about the axis through two points."""
    numbers = [[float(word) for word in row.split(",") if word.strip()] for row in rows]
    shift = np.array((numbers[0] if numbers else [0.0] * 3)[:3])
    turn, origin = Rotation.identity(), np.zeros(3)
    if len(numbers) > 1:
        origin, end, angle = np.array(numbers[1][:3]), np.array(numbers[1][3:6]), numbers[1][6]
        turn = Rotation.from_rotvec(np.radians(angle) * (end - origin) / np.linalg.norm(end - origin))

    def placed(own: list[str]) -> list[str]:
        words = [[word for word in row.split(",") if word.strip()] for row in own]
        points = np.array([row[1:4] for row in words if row], float).reshape(-1, 3)
        points = turn.apply(points + shift - origin) + origin
        return [f"{row[0].strip()}, {x!r}, {y!r}, {z!r}\n"
                for row, (x, y, z) in zip(filter(None, words), points.tolist(), strict=True)]

    return placed if numbers else lambda own: own


def _keyword(command: str) -> str:
    return command.partition(",")[0].strip().lstrip("*").strip().upper()


def _parameters(command: str) -> dict[str, str]:
    words = (word.partition("=") for word in command.strip().split(",")[1:])
    return {key.strip().upper(): value.strip().strip('"') for key, _, value in words}


def _for_meshio(command: str) -> str:
    """The line of a block of elements with its type only, as meshio knows it."""
    given = _parameters(command)
    if _keyword(command) != "ELEMENT" or "TYPE" not in given:
        return command
    kind = given["TYPE"].upper()
    return f"*ELEMENT, TYPE={_SAME_NODES.get(kind, kind)}\n"


def _abaqus_sets(commands: list, content: meshio.Mesh) -> dict[str, list[np.ndarray]]:
    """Cell indices of each element set in each block. Names differ by more than their case."""
    place, members, names = {}, {}, {}
    block = 0
    for command, rows in commands:
        keyword, given = _keyword(command), _parameters(command)
        if keyword == "ELEMENT":
            width = 1 + content.cells[block].data.shape[-1]
            numbers = [int(word) for row in rows for word in row.split(",") if word.strip()]
            ids = numbers[::width]
            place.update((number, (block, index)) for index, number in enumerate(ids))
            block += 1
        elif keyword == "ELSET":
            ids = _set_members(rows, "GENERATE" in given)
        if keyword in ("ELEMENT", "ELSET") and given.get("ELSET"):
            key = given["ELSET"].casefold()
            names.setdefault(key, given["ELSET"])
            members.setdefault(key, []).extend(ids)
    sets = {}
    for key, name in names.items():
        cells = [[] for _ in content.cells]
        for number in _element_numbers(members, key, ()):
            of_block, index = place[number]
            cells[of_block].append(index)
        sets[name] = [np.unique(np.array(indices, np.int64)) for indices in cells]
    return sets


def _set_members(rows: list[str], is_generated: bool) -> list:
    """Numbers of elements and names of other sets."""
    if not is_generated:
        words = (word.strip() for row in rows for word in row.split(","))
        return [int(word) if word.isdigit() else word.strip('"') for word in words if word]
    numbers = []
    for row in rows:
        if row.strip():
            first, last, *step = (int(word) for word in row.split(",") if word.strip())
            numbers += range(first, last + 1, *step)
    return numbers


def _element_numbers(members: dict, key: str, within: tuple) -> list[int]:
    """Elements of a set and of the sets that it names."""
    if key in within or key not in members:
        raise ValueError(f"element set {key} is not defined or contains itself")
    numbers = []
    for member in members[key]:
        if isinstance(member, int):
            numbers.append(member)
        else:
            numbers += _element_numbers(members, member.casefold(), (*within, key))
    return numbers


def read_gmsh(path: str) -> meshio.Mesh:
    """Reads a Gmsh file, its named physical groups as `cell_sets`.

    The groups are read here, because meshio takes a name of two dimensions for one, and leaves out
    entities whose group is negative: those that belong to it with the opposite orientation. A wall
    between two chambers is in the surface of one of them like this.

    Script lines after the last section, which gmsh appends, are left out. Nodes with parameters,
    which meshio refuses, are written anew by gmsh.

    Args:
        path: File to read.

    Returns:
        The content; each set has one array of cell indices for each block of cells. A cell whose
        orientation is opposite in the set has the index ~i.

    Raises:
        MeshError: gmsh is needed and missing.
    """
    raw = _sections(Path(path).read_bytes())
    content, groups = _gmsh_content(path, raw)
    content.cell_sets = {}
    names = _physical_names(_section(raw, b"PhysicalNames"))
    for index, block in enumerate(content.cells):
        tags = _group_tags(content, index, groups)
        for name, dimension, tag in names:
            sets = content.cell_sets.setdefault(
                name, [np.empty(0, np.int64) for _ in content.cells]
            )
            if dimension == block.dim:
                ahead = np.flatnonzero([tag in own for own in tags])
                turned = np.flatnonzero([-tag in own for own in tags])
                sets[index] = np.concatenate([ahead, ~turned])
    return content


def _gmsh_content(path: str, raw: bytes) -> tuple[meshio.Mesh, dict | None]:
    """Cells and nodes, and the physical groups of entities of files that have such."""
    version, is_binary, size = _section(raw, b"MeshFormat").split()[:3]
    entities = _section(raw, b"Entities")
    groups = _groups_of_entities(entities, is_binary == b"1", int(size)) if version == b"4.1" else None
    # meshio refuses files where only some entities have groups.
    some = bool(groups) and any(groups.values()) and not all(groups.values())
    start, end = raw.find(b"$Entities"), raw.find(b"$EndEntities")
    readable = raw[:start] + raw[end + len(b"$EndEntities") :].lstrip() if some else raw
    with tempfile.NamedTemporaryFile(suffix=".msh") as file:
        file.write(readable)
        file.flush()
        try:
            content = meshio.gmsh.read(file.name)
        except Exception as error:  # of a damaged file, any
            if "parametric" not in str(error) and b"$ParametricNodes" not in raw:
                raise
            rewritten = run_gmsh(Path(path), {"rewrite": str(Path(path).resolve())})
            return _gmsh_content(path, rewritten["content"].tobytes())
    if some:
        content.cell_data["gmsh:physical"] = [
            np.array([own[0] if own else 0 for own in _group_tags(content, index, groups)])
            for index in range(len(content.cells))
        ]
    return content, groups


def _sections(raw: bytes) -> bytes:
    """The file to the end of its last section."""
    last = raw.rfind(b"\n$End")
    end = raw.find(b"\n", last + 1)
    # A section that begins and does not end is damage, not script.
    return raw if last < 0 or end < 0 or b"\n$" in raw[end:] else raw[: end + 1]


def _section(raw: bytes, name: bytes) -> bytes:
    """The lines between $name and $Endname, without their line ends; empty where there is none."""
    start = raw.find(b"$" + name)
    end = raw.find(b"$End" + name, start)
    return raw[raw.find(b"\n", start) + 1 : end] if 0 <= start < end else b""


def _physical_names(section: bytes) -> list[tuple[str, int, int]]:
    """Name, dimension and number of each physical group."""
    rows = (shlex.split(line) for line in section.decode().splitlines()[1:])
    return [(row[2], int(row[0]), int(row[1])) for row in rows if row]


def _groups_of_entities(section: bytes, is_binary: bool, size: int) -> dict:
    """Numbers of the physical groups of each entity, by its dimension and number."""
    words, stream = iter(section.split()), io.BytesIO(section)

    def read(kind: str, count: int) -> list:
        if not is_binary:
            return [float(next(words)) if kind == "d" else int(next(words)) for _ in range(count)]
        dtype = np.dtype(kind)
        return np.frombuffer(stream.read(count * dtype.itemsize), dtype, count).tolist()

    groups = {}
    if not section:
        return groups
    for dimension, count in enumerate(read(f"u{size}", 4)):
        for _ in range(count):
            (entity,) = read("i4", 1)
            read("d", 3 if dimension == 0 else 6)
            groups[dimension, entity] = read("i4", read(f"u{size}", 1)[0])
            if dimension > 0:
                read("i4", read(f"u{size}", 1)[0])
    return groups


def _group_tags(content: meshio.Mesh, index: int, groups: dict | None) -> list:
    """Physical groups of each cell of a block."""
    if groups is None:
        tags = content.cell_data.get("gmsh:physical")
        return [] if tags is None else [(tag,) for tag in tags[index].tolist()]
    entities = content.cell_data["gmsh:geometrical"][index].tolist()
    return [groups.get((content.cells[index].dim, entity), ()) for entity in entities]


def file_parts(path: Path, content: meshio.Mesh, format_name: str) -> tuple[MeshParts, dict[str, int]]:
    """Sorts the named parts of a file by the kind of their cells.

    Args:
        path: The file.
        content: Its content; only tetrahedra and hexahedra are among its solid cells.
        format_name: Its format.

    Returns:
        The parts, with the indices of the file, and the number of flat cells and lines in them, by their
        kind. A name may be that of a region and of a surface.
    """
    named = content.cell_sets if format_name in ("Gmsh", "Abaqus") else {}
    parts = MeshParts(path, {}, {}, {}, {}, _in_place_of_names(content, format_name))
    first = _first_cells(content)
    # Without hexahedra no face of a cell is a quadrilateral.
    has_quads = any(block.type in _HEXAHEDRA for block in content.cells)
    for name, of_blocks in named.items():
        solids, triangles, lines, others = [], [], [], {}
        for block, start, cells in zip(content.cells, first, of_blocks, strict=True):
            cells, turned = np.maximum(cells, ~cells), cells < 0
            if block.type in _TETS + _HEXAHEDRA:
                solids.append(start + cells)
            elif block.type in _CORNERS_OF and (block.type != "quad" or has_quads):
                corners = _CORNERS_OF[block.type]
                rows = np.asarray(block.data, np.int64)[cells, :corners]
                rows[turned] = rows[turned][:, ::-1]
                if corners == 4:
                    rows = rows[:, _HALVES].reshape(-1, 3)
                (lines if corners == 2 else triangles).append(rows)
            elif len(cells) and block.dim == 2:
                others[block.type] = others.get(block.type, 0) + len(cells)
        if others:
            held = ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
            parts.unusable[name] = f"has cells other than triangles ({held})"
            continue
        for of_kind, found in zip(parts[1:4], (solids, triangles, lines), strict=True):
            if sum(map(len, found)):
                of_kind[name] = np.concatenate(found)
    return parts, _cell_counts(content, named)


def _first_cells(content: meshio.Mesh) -> list[int]:
    """Number of the first cell of each block of solid cells: see `MeshParts.regions`."""
    counts = {kinds: 0 for kinds in (_TETS, _HEXAHEDRA)}
    first = []
    for block in content.cells:
        kinds = _HEXAHEDRA if block.type in _HEXAHEDRA else _TETS
        first.append(counts[kinds])
        counts[kinds] += len(block.data) if block.type in kinds else 0
    return [start + (counts[_TETS] if block.type in _HEXAHEDRA else 0)
            for start, block in zip(first, content.cells, strict=True)]  # fmt: skip


def _cell_counts(content: meshio.Mesh, named: dict[str, list[np.ndarray]]) -> dict[str, int]:
    """Number of flat cells and lines in the parts, each counted once, by their kind."""
    counts = {}
    for index, block in enumerate(content.cells):
        if block.type in _CORNERS_OF and named:
            cells = np.concatenate([of_blocks[index] for of_blocks in named.values()])
            once = np.unique(np.maximum(cells, ~cells))
            counts[block.type] = counts.get(block.type, 0) + len(once)
    return counts


def _in_place_of_names(content: meshio.Mesh, format_name: str) -> str:
    if format_name == "Abaqus":
        return ""
    numbers = [name for name, blocks in content.cell_data.items()
               if all(np.issubdtype(np.asarray(data).dtype, np.integer) for data in blocks)]
    if format_name == "Gmsh":
        if content.field_data or "gmsh:physical" not in numbers:
            return ""
        return "its physical groups have numbers but no names"
    shown = f" (it has the numbers {', '.join(sorted(numbers))} of cells)" if numbers else ""
    return f"{format_name} files do not name parts{shown}; use a Gmsh or an Abaqus file"


def cell_of_each(of_file: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Finds the cell with the nodes of each cell of a file, in any order.

    A cell that a file contains once for each of its groups belongs to all of them.

    Args:
        of_file: Nodes of the tetrahedra or hexahedra of the file, merged ones replaced,
            shape (file_cell_count, nodes of a cell).
        cells: Those that are kept, each once, shape (cell_count, nodes of a cell).

    Returns:
        Index of the cell, −1 where there is none, shape (file_cell_count,).
    """
    if len(of_file) == 0:
        return np.empty(0, np.int64)
    all_rows = np.sort(np.concatenate([cells, of_file]), axis=1)
    _, group = np.unique(all_rows, axis=0, return_inverse=True)
    group = group.ravel()
    cell_of_group = np.full(group.max() + 1, -1, dtype=np.int64)
    cell_of_group[group[: len(cells)]] = np.arange(len(cells))
    return cell_of_group[group[len(cells) :]]


def placed_parts(parts: MeshParts, cell_of: np.ndarray, node_of: np.ndarray) -> MeshParts:
    """Renumbers the parts of a file after repair.

    Args:
        parts: The parts.
        cell_of: Cell of the mesh for each cell of the file, numbered as in `MeshParts.regions`,
            −1 where it was dropped, shape (file_cell_count,).
        node_of: Node of the mesh for each node of the file, −1 where it is not a corner of the
            mesh, shape (file_node_count,).

    Returns:
        The parts of the mesh. Triangles and edges whose corners were merged into one are dropped.
        A part that loses a node is unusable.
    """
    placed = MeshParts(parts.path, {}, {}, {}, dict(parts.unusable), parts.unnamed)
    for name, of_file in parts.regions.items():
        cells = np.unique(cell_of[of_file])
        cells = cells[cells >= 0]
        if len(cells):
            placed.regions[name] = cells
        else:
            placed.unusable[name] = "has only tetrahedra without volume"
    for kind in ("surfaces", "edges"):
        for name, rows in getattr(parts, kind).items():
            lost = _lost_node(rows, node_of)
            if lost is not None:
                placed.unusable[name] = (
                    f"is a {_KINDS[kind]} with node {lost}, which is not a corner of a "
                    "cell of the mesh: its nodes must be nodes of the body"
                )
                continue
            rows = node_of[rows]
            distinct = (rows != np.roll(rows, 1, axis=1)).all(axis=1)
            if distinct.any():
                getattr(placed, kind)[name] = rows[distinct]
            else:
                placed.unusable[name] = f"is a {_KINDS[kind]} whose nodes were all merged into one"
    return placed


def _lost_node(rows: np.ndarray, node_of: np.ndarray) -> int | None:
    """First node of the file that is not in the mesh; None without one."""
    nodes = rows.ravel()
    lost = ~np.isin(nodes, np.flatnonzero(node_of >= 0))
    return int(nodes[np.argmax(lost)]) if lost.any() else None
