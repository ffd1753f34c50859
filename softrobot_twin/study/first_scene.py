"""``python -m softrobot_twin init``: a commented scene for a mesh, with guesses that are told.

Nothing is asked: fixed region, effector, scale and material are guessed, and each guess stands in a
comment beside its value, to be changed. The scene is built before it is written.
"""

from __future__ import annotations

import os
import re
import shlex
from itertools import combinations
from pathlib import Path
from string import Template
from textwrap import wrap
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softrobot_twin.errors import MeshError, NamedError
from softrobot_twin.geometry.cad_meshing import CAD_SUFFIXES, TRIANGLE_SUFFIXES, kept_mesh, part_size
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.mesh_reading import MeshReading, read_solid_mesh
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.harness.output_file import OutputError, output_file
from softrobot_twin.harness.terminal import console, table, terminal_status, warn
from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry import check_name
from softrobot_twin.scene.loading import read_yaml, scene_from_mapping
from softrobot_twin.scene.material_presets import MATERIAL_PRESETS
from softrobot_twin.simulation import Simulation

PRESET = "dragon_skin_30"
"""Material of a first scene."""
PRESSURE = 20.0e3
"""Greatest gauge pressure of a cavity in a first scene [Pa]."""
LARGEST_IN_METRES = 2.0
"""A mesh file with a larger extent is taken as one in millimetres."""
# A CAD file without a wanted size is meshed with about this number of tetrahedra.
_TETS = 2000.0
# Nodes this near to an end of the body, relative to its length, lie in the face there.
_IN_FACE = 1.0e-5
# A flat end face of less than this share of the box around the section is a rim, not an end.
_LEAST_END = 0.1
# A body stands on what is lowest if that surrounds this share of its outline from above; on flat
# feet if they surround that share: three at the rim of a disc surround two fifths of it.
_LEAST_FLOOR, _LEAST_FEET = 0.5, 0.2
# Without a flat face this share of the length is fixed.
_SLAB = 0.05
# Where the points of the examples of cables lie along the body.
_STATIONS = (0.15, 0.35, 0.55, 0.75, 0.95)
# How far from the middle of the body there, as a share of half its thickness there.
_OFFSET = 0.7


class SceneExistsError(NamedError):
    """The scene file is there already."""


class MeshSource(NamedTuple):
    """What a scene says of its mesh.

    Attributes:
        file: The mesh file or the CAD file.
        scale: Metres in one unit of the file.
        size: Wanted edge of the tetrahedra of a CAD file [m]; None for a mesh file.
        reason: Why this scale.
    """

    file: Path
    scale: float
    size: float | None
    reason: str

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a comment says of scale and size."""
        of_size = () if self.size is None else ("size: edge of the tetrahedra, in m",)
        return (f"scale: {self.reason}", *of_size)


class Guess(NamedTuple):
    """What is guessed from the shape of a body.

    Attributes:
        axis: Its longest axis, 0 to 2.
        fixed: Minimum and maximum of a box around the nodes that are fixed [m], shape (2, 3).
        fixed_nodes: Their number.
        end: Where it is fixed, in words.
        tip: The farthest point of the body [m], shape (3,).
        cavities: Names of its closed surfaces.
        left_out: Names of surfaces that are not closed.
        cables: Points of two cables inside it, pull point first [m], each of shape (n, 3).
        hold_radius: Radius for their points [m].
        of_hexahedra: Whether its cells are hexahedra.
        regions: Names of parts of the body, such as the solids of a STEP file.
    """

    axis: int
    fixed: np.ndarray
    fixed_nodes: int
    end: str
    tip: np.ndarray
    cavities: tuple[str, ...]
    left_out: tuple[str, ...]
    cables: tuple[np.ndarray, np.ndarray]
    hold_radius: float
    of_hexahedra: bool
    regions: tuple[str, ...]


def guess(reading: MeshReading) -> Guess:
    """Guesses where a body is fixed, what moves, and what could drive it.

    Args:
        reading: Its mesh [m].

    Returns:
        The guesses.
    """
    mesh = reading.mesh
    points, tets = mesh.node_positions, mesh.as_tets
    triangles = boundary_triangles(tets)
    low, high = points.min(axis=0), points.max(axis=0)
    extents = high - low
    # Of equal extents the last one: parts often stand upright.
    axis = 2 - int(np.argmax(np.round(extents[::-1] / extents.max(), 6)))
    areas = [_flat_area(points, triangles, axis, end[axis]) for end in (low, high)]
    section = float(np.prod(np.delete(extents, axis)))
    if axis == 2 or max(areas) < _LEAST_END * section:
        on_floor = _flat_area(points, triangles, 2, low[2])
        if _stands(points, on_floor > 0.0):
            axis, areas = 2, [on_floor, 0.0]
    at_high = areas[1] > 1.01 * areas[0]
    fixed, fixed_nodes, word = _fixed_box(points, axis, at_high, areas[int(at_high)] > 0.0)
    end = f"{word} at the {'highest' if at_high else 'lowest'} {'xyz'[axis]}"
    cavities, left_out = [], []
    for name, own in reading.parts.surfaces.items():
        try:
            closed_surface(own, len(points))
            check_name(name)
        except (MeshError, ValueError):
            left_out.append(name)
        else:
            cavities.append(name)
    cables = tuple(_cable(mesh, points, tets, axis, at_high, side) for side in (-1.0, 1.0))
    across = np.delete(extents, axis).min()
    return Guess(axis, fixed, fixed_nodes, end, _tip(mesh, points, axis, at_high),
                 tuple(cavities), tuple(left_out), cables, 0.15 * float(across),
                 isinstance(mesh, HexahedralMesh), tuple(reading.parts.regions))  # fmt: skip


def _stands(points: np.ndarray, on_flat_faces: bool) -> bool:
    """Whether a body stands on the floor: its lowest points surround enough of what is above."""
    heights = points[:, 2] - points[:, 2].min()
    reach, share = (_IN_FACE, _LEAST_FEET) if on_flat_faces else (_SLAB, _LEAST_FLOOR)
    try:
        floor = ConvexHull(points[heights <= reach * heights.max()][:, :2]).volume
    except (QhullError, ValueError):  # fewer than three points, or all on a line
        return False
    return floor >= share * ConvexHull(points[:, :2]).volume


def _flat_area(points, triangles, axis: int, end: float) -> float:
    """Area of the surface in a plane at an end of a body [m²]."""
    length = float(np.ptp(points[:, axis]))
    corners = points[triangles]
    inside = (np.abs(corners[:, :, axis] - end) <= _IN_FACE * length).all(axis=1)
    sides = corners[inside, 1:] - corners[inside, :1]
    return 0.5 * float(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum())


def _fixed_box(points: np.ndarray, axis: int, at_high: bool, is_flat: bool) -> tuple[np.ndarray, int, str]:
    """A box around the nodes at an end, their number, and what they are."""
    low, high = points.min(axis=0), points.max(axis=0)
    length = float(high[axis] - low[axis])
    depths = high[axis] - points[:, axis] if at_high else points[:, axis] - low[axis]
    reach, word = _SLAB * length, f"a slice of {100.0 * _SLAB:.0f} % of the length"
    if is_flat:
        inner = depths[depths > _IN_FACE * length]
        reach, word = min(0.01 * length, 0.25 * float(inner.min())), "the flat face"
    # Three nodes that are not on one line hold a body.
    while np.linalg.matrix_rank(_spread(points[depths <= reach]), tol=1e-6 * length) < 2:
        reach, word = 1.5 * max(reach, 0.01 * length), "the nodes"
    margin = 0.05 * float((high - low).max())
    box = np.stack([low - margin, high + margin])
    if at_high:
        box[0, axis] = high[axis] - reach
    else:
        box[1, axis] = low[axis] + reach
    return box, int(np.count_nonzero(depths <= reach)), word


def _spread(points: np.ndarray) -> np.ndarray:
    return points - points.mean(axis=0) if len(points) else np.zeros((1, 3))


def _tip(mesh, points: np.ndarray, axis: int, at_high: bool) -> np.ndarray:
    """Middle of the end that is not fixed, or the node nearest to it where the middle is hollow."""
    low, high = points[:, axis].min(), points[:, axis].max()
    depths = points[:, axis] - low if at_high else high - points[:, axis]
    at_end = points[depths <= 1e-3 * (high - low)]
    middle = 0.5 * (at_end.min(axis=0) + at_end.max(axis=0))
    if locate_points(mesh, middle[None]).distances[0] > 1e-6 * (high - low):
        middle = at_end[np.linalg.norm(at_end - middle, axis=1).argmin()]
    return np.round(middle, 6) + 0.0


def _section(points: np.ndarray, tets: np.ndarray, axis: int, place: float) -> np.ndarray:
    """Points of a body in a plane across an axis: where edges pass it [m], shape (count, 3)."""
    ends = points[tets[:, list(combinations(range(4), 2))].reshape(-1, 2)]
    heights = ends[:, :, axis] - place
    ends = ends[heights[:, 0] * heights[:, 1] <= 0.0]
    heights = ends[:, :, axis] - place
    rise = heights[:, 1] - heights[:, 0]
    share = np.where(rise != 0.0, -heights[:, 0] / np.where(rise != 0.0, rise, 1.0), 0.0)
    return ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])


def _cable(mesh, points, tets, axis: int, at_high: bool, side: float) -> np.ndarray:
    """Points of a cable along the body, on one side of its middle across its thinner direction.

    The middle and the thickness are those of the section there, so that a cable follows a taper.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    extents = high - low
    across = min((one for one in range(3) if one != axis), key=lambda one: extents[one])
    shares = 1.0 - np.array(_STATIONS) if at_high else np.array(_STATIONS)
    wanted = np.empty((len(_STATIONS), 3))
    for station, place in enumerate(low[axis] + shares * extents[axis]):
        section = _section(points, tets, axis, place)
        least, greatest = section.min(axis=0), section.max(axis=0)
        wanted[station] = 0.5 * (least + greatest)
        wanted[station, across] += 0.5 * side * _OFFSET * (greatest - least)[across]
    centres = points[tets].mean(axis=1)
    outside = np.flatnonzero(locate_points(mesh, wanted).distances > 0.0)
    for index in outside:  # a chamber, or a curved body
        wanted[index] = centres[np.linalg.norm(centres - wanted[index], axis=1).argmin()]
    pull = wanted[0].copy()
    pull[axis] = high[axis] if at_high else low[axis]
    return np.vstack([pull, wanted])


# --- the text of the scene ------------------------------------------------------------------------


# The texts of a scene, of one of its cavities, and of an example of a cable; comments say what is
# guessed.
_SCENE, _CAVITY, _CABLE = (
    Template(part) for part in
    (Path(__file__).with_suffix(".yaml")).read_text(encoding="utf-8").split("%%\n")
)  # fmt: skip
_ELEMENTS = {
    False: "quadratic                   # linear is faster, but far too stiff in bending",
    True: "hexahedral                  # as the cells of the file",
}


def scene_text(name: str, source: MeshSource, file: str, found: Guess) -> str:
    """The YAML text of a first scene, every value with its unit and every guess in a comment.

    Args:
        name: Name of the robot.
        source: How the mesh is read.
        file: Mesh file as the scene names it.
        found: What was guessed.
    """
    preset, others = MATERIAL_PRESETS[PRESET], [name for name in MATERIAL_PRESETS if name != PRESET]
    mesh = [f"file: {_quoted(file)}"]
    if source.size is not None:
        mesh.append(f"size: {_number(source.size)}")
    if source.scale != 1.0:
        mesh.append(f"scale: {_number(source.scale)}")
    regions = [f"  #   - {{region: {name}, preset: {others[0]}}}\n" for name in found.regions]
    if regions:
        regions.insert(0, f"{'  # materials:':39s}# of the regions that the mesh names\n")
    cavities = [_CAVITY.substitute(name=name, most=_number(PRESSURE)) for name in found.cavities]
    if cavities:
        cavities.insert(0, f"{'cavities:':39s}# closed surfaces that the mesh names\n")
        cavities.append("\n")
    return _SCENE.substitute(
        file=Path(file).name, name=name, mesh=", ".join(mesh), remarks=_remarks(*source.remarks),
        element=_ELEMENTS[found.of_hexahedra], preset=PRESET, law=preset.law,
        density=f"{preset.density:g}",
        others=_remarks("others: " + ", ".join(others),
                        "or law, young_modulus [Pa], poisson_ratio, density [kg/m³]"),
        regions="".join(regions), end=found.end, count=found.fixed_nodes,
        low=_vector(found.fixed[0]), high=_vector(found.fixed[1]), tip=_vector(found.tip),
        cavities="".join(cavities),
        cables="".join(_cable_text(word, points, found.hold_radius)
                       for word, points in zip(("first", "second"), found.cables, strict=True)),
    )  # fmt: skip


def _remarks(*remarks: str) -> str:
    """Comments on lines of their own, at the column of the others."""
    space = " " * 39
    return "".join(space + f"# {line}\n" for remark in remarks for line in wrap(remark, 58))


def _cable_text(name: str, points: np.ndarray, hold_radius: float) -> str:
    """A cable as a comment, at places inside this body."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    path = [_vector(point) for point in points[1:]]
    pairs = [", ".join(path[start : start + 2]) for start in range(0, len(path), 2)]
    return _CABLE.substitute(
        name=name, pull_point=_vector(points[0]), points=",\n#              ".join(pairs),
        hold_radius=_number(hold_radius), shortening=_number(0.2 * length))


def _number(value: float) -> str:
    """A number of four digits, with a point, so that YAML reads it as one."""
    return np.format_float_positional(value, precision=4, fractional=False, trim="0")


def _vector(values) -> str:
    """Three lengths, in steps of a micrometre."""
    return "[" + ", ".join(np.format_float_positional(value + 0.0, trim="0")
                           for value in np.round(values, 6)) + "]"


def _quoted(file: str) -> str:
    return file if re.fullmatch(r"[\w./-]+", file) else '"' + file.replace('"', '\\"') + '"'


# --- the command ----------------------------------------------------------------------------------


def source_of(path: Path, size: float | None, scale: float | None) -> tuple[MeshSource, MeshReading]:
    """How a scene reads a mesh or CAD file, and its mesh.

    Args:
        path: The file.
        size: Wanted edge of the tetrahedra of a CAD file [m]; None for a coarse mesh.
        scale: Metres in one unit of the file; None to guess it.

    Raises:
        MeshError: The file cannot be used.
    """
    suffix = path.suffix.lower()
    if suffix not in CAD_SUFFIXES:
        reading = read_solid_mesh(path, scale=scale or 1.0)
        largest = float(np.ptp(reading.mesh.node_positions, axis=0).max())
        reason = "metres in a unit of the file"
        if scale is None:
            in_millimetres = largest > LARGEST_IN_METRES
            scale = 1e-3 if in_millimetres else 1.0
            unit = "millimetres" if in_millimetres else "metres"
            reason = f"guessed: {unit}, for its largest extent is {largest:.4g}"
            reading = read_solid_mesh(path, scale=scale)
        return MeshSource(path, scale, None, reason), reading
    if suffix in TRIANGLE_SUFFIXES:
        word = "guessed: millimetres" if scale is None else "as given"
        reason = f"{suffix[1:].upper()} files have no unit: {word}"
        scale = 1e-3 if scale is None else scale
    else:
        if scale is not None:
            raise MeshError(path, "states its unit: leave --unit out")
        scale, reason = 1.0, "the file states its unit"
    if size is None:
        size = float(f"{part_size(path, scale).size_for(_TETS):.2g}")
        reason += ", size guessed"
    kept = kept_mesh(path, size, scale)
    return MeshSource(path, scale, size, reason), read_solid_mesh(kept.path)


def made_name(text: str, noun: str) -> str:
    """A name of letters, digits and underscores, as scenes have.

    Args:
        text: What it is made of.
        noun: With what it begins where it would not begin with a letter.
    """
    word = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    return word if re.match(r"[A-Za-z]", word) else f"{noun}_{word}".rstrip("_")


def check_new_scene(output: Path, replace: bool) -> None:
    """Refuses to write a scene to a file that is none, or that exists.

    Args:
        output: The file.
        replace: Whether one that exists is replaced.

    Raises:
        OutputError: It is no .yaml file.
        SceneExistsError: It exists.
    """
    if output.suffix.lower() not in (".yaml", ".yml"):
        raise OutputError(output, "a scene is a .yaml file")
    if output.exists() and not replace:
        raise SceneExistsError(output, "exists already; name another file by --output, or replace "
                               "it by --force")


def first_scene(
    path: Path, source: MeshSource, reading: MeshReading, folder: Path
) -> tuple[str, Scene, Guess]:  # fmt: skip
    """The text of a scene for a mesh, and the scene.

    Args:
        path: File that the scene will be, for errors and relative paths.
        source: Its mesh.
        reading: The mesh [m].
        folder: Folder that the mesh file is named relative to.

    Raises:
        SoftRobotTwinError: No scene can be made of the mesh.
    """
    found = guess(reading)
    file = Path(os.path.relpath(source.file.resolve(), folder.resolve())).as_posix()
    text = scene_text(made_name(source.file.stem, "robot"), source, file, found)
    return text, scene_from_mapping(read_yaml(text), path), found


def init(
    path: Path, output: Path | None = None, *, size: float | None = None,
    scale: float | None = None, replace: bool = False,
) -> int:  # fmt: skip
    """Writes a first scene for a mesh or CAD file and tells what was guessed.

    Args:
        path: The file.
        output: The scene; by default beside the mesh, with its name.
        size: Wanted edge of the tetrahedra of a CAD file [m].
        scale: Metres in one unit of the file; None to guess it.
        replace: Whether an existing scene is replaced.

    Returns:
        Exit code.

    Raises:
        SoftRobotTwinError: The file cannot be used, or the scene exists.
    """
    output = path.with_suffix(".yaml") if output is None else output
    check_new_scene(output, replace)
    if size is not None and path.suffix.lower() not in CAD_SUFFIXES:
        raise MeshError(path, f"has tetrahedra already: --size is for {', '.join(CAD_SUFFIXES)}")
    with terminal_status(f"reading {path.name}"):
        source, reading = source_of(path, size, scale)
    with terminal_status("building the scene"):
        text, scene, found = first_scene(output.resolve(), source, reading, output.resolve().parent)
        simulation = Simulation(scene)
    with output_file(output) as partial:
        partial.write_text(text, encoding="utf-8")
    for note in simulation.notes:
        warn(note)
    _print_guesses(output, source, reading, found)
    return 0


def _print_guesses(output: Path, source: MeshSource, reading: MeshReading, found: Guess) -> None:
    made = table(f"{output}: what was guessed", "entry", "guess")
    extents = 1e3 * np.ptp(reading.mesh.node_positions, axis=0)
    made.add_row("mesh", " × ".join(f"{extent:.4g}" for extent in extents)
                 + f" mm, {reading.mesh.node_count} nodes")
    made.add_row("scale", f"{source.scale:g} m per unit of the file ({source.reason})")
    if source.size is not None:
        made.add_row("size", f"{1e3 * source.size:.4g} mm")
    made.add_row("fixed", f"{found.end}, {found.fixed_nodes} nodes")
    tip = ", ".join(f"{1e3 * value:.4g}" for value in found.tip)
    made.add_row("effector", f"tip at {tip} mm")
    made.add_row("material", f"{PRESET}")
    made.add_row("cavities", ", ".join(found.cavities) or "none: the mesh names no closed surface")
    if found.regions:
        made.add_row("regions", f"{', '.join(found.regions)}: all of the same material")
    if found.left_out:
        made.add_row("left out", f"{', '.join(found.left_out)}: not closed, or no name for a topic")
    made.add_row("gravity", "along -z")
    console().print(made)
    scene = shlex.quote(str(output))
    console().print(f"\nLook at it: softrobot_twin explain {scene}\n"
                    f"Let it sag:  softrobot_twin simulate {scene} --steps 20 "
                    "--output first.csv --picture first.png",
                    soft_wrap=True)  # fmt: skip
