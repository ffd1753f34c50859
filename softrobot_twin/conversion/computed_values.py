"""What components of a SOFA scene compute: meshes of loaders, positions of states, regions of interest.

Lengths are in the unit of the scene. A value that the file gives goes before one that is computed.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.scene_tree import (
    NotConverted,
    SceneComponent,
    SceneNode,
    UNKNOWN,
    first,
    follow,
    is_link,
    nearest,
    numbers,
    root_of,
)
from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.hexahedral_mesh import INTO_TETS
from softrobot_twin.geometry.mesh_reading import read_mesh_file
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.surface_reading import read_surface

STATES = ("MechanicalObject",)
"""Kinds of components that hold positions."""
LOADERS = ("MeshVTKLoader", "MeshGmshLoader", "MeshSTLLoader", "MeshOBJLoader", "MeshObjLoader",
           "MeshOffLoader", "GIDMeshLoader", "VTKLoader")  # fmt: skip
"""Kinds of components that read mesh files."""
TOPOLOGIES = (
    "MeshTopology", "Mesh", "TetrahedronSetTopologyContainer", "HexahedronSetTopologyContainer",
    "TriangleSetTopologyContainer", "QuadSetTopologyContainer", "EdgeSetTopologyContainer",
    "PointSetTopologyContainer", "RegularGridTopology", "RegularGrid")  # fmt: skip
"""Kinds of components that connect positions to cells."""
RIGID_TEMPLATES = ("rigid", "rigid3", "rigid3d", "rigid3f")


@dataclass(frozen=True, eq=False)
class Placement:
    """x ↦ translation + rotation · (scale · x).

    Attributes:
        translation: Shape (3,).
        rotation: A rotation.
        scale: Factor along each axis, shape (3,).
    """

    translation: np.ndarray
    rotation: Rotation
    scale: np.ndarray

    def place(self, points: np.ndarray) -> np.ndarray:
        """Points where they are placed, shape (count, 3).

        Args:
            points: Shape (count, 3).
        """
        return self.rotation.apply(points * self.scale) + self.translation if len(points) else points

    @property
    def is_uniform(self) -> bool:
        """Whether it is a similarity that keeps the orientation."""
        return bool(np.ptp(self.scale) == 0.0 and self.scale[0] > 0.0)

    def after(self, first: Placement) -> Placement:
        """Another placement, and then this one, whose scale is the same along all axes.

        Args:
            first: The other one.
        """
        return Placement(self.place(first.translation[None])[0], self.rotation * first.rotation,
                         self.scale * first.scale)  # fmt: skip


UNMOVED = Placement(np.zeros(3), Rotation.identity(), np.ones(3))


class LoadedMesh(NamedTuple):
    """Points and cells.

    Attributes:
        points: Shape (point_count, 3).
        tets: Shape (tet_count, 4).
        hexahedra: Shape (hexahedron_count, 8).
        triangles: Shape (triangle_count, 3).
        edges: Shape (edge_count, 2).
        file: The mesh file; None for cells that the scene gives.
        placement: How its points were placed.
    """

    points: np.ndarray
    tets: np.ndarray
    hexahedra: np.ndarray
    triangles: np.ndarray
    edges: np.ndarray
    file: Path | None = None
    placement: Placement = UNMOVED


def _cells(width: int) -> np.ndarray:
    return np.empty((0, width), np.int64)


# --- values and links -----------------------------------------------------------------------------


def value_of(component: SceneComponent, *names: str) -> Any:
    """The value of a field; that of its source, or a computed one, where the file gives none.

    Args:
        component: The component.
        *names: Names of the field; the first is the usual one, others mean the same.

    Returns:
        The value; None where there is none.

    Raises:
        NotConverted: A link leads nowhere, or the value cannot be computed.
    """
    component.read.update(names)
    for name in names:
        given = component.fields.get(name)
        if given is not None:
            return linked(given, component.node, name)
    source = component.fields.get("src")
    if is_link(source):
        owner, _ = follow(source, component.node)
        if isinstance(owner, SceneComponent):
            found = value_of(owner, *names)
            if found is not None:
                return found
    compute = _COMPUTED.get(component.kind)
    return None if compute is None else compute(component, names[0])


def linked(value: Any, node: SceneNode, name: str = "") -> Any:
    """A value, or what its link leads to.

    Args:
        value: Value of a field.
        node: The node that a link begins in.
        name: Name of the field, for a link to a component.
    """
    if value == UNKNOWN or isinstance(value, list) and UNKNOWN in value:
        raise NotConverted(f"its field {name} is not known: it is {UNKNOWN.strip('()')}")
    if not is_link(value):
        if isinstance(value, list) and any(map(is_link, value)):
            return [linked(part, node, name) for part in value]
        return value
    owner, field = follow(value, node)
    if isinstance(owner, SceneNode):
        return owner.fields.get(field or "", owner)
    return owner if field is None else value_of(owner, field)


def array_of(component: SceneComponent, width: int, *names: str) -> np.ndarray | None:
    """The numbers of a field in rows, or None; see `value_of`.

    Args:
        component: The component.
        width: Numbers in a row.
        *names: Names of the field.
    """
    value = value_of(component, *names)
    return None if value is None else numbers(value, width)


def number_of(component: SceneComponent, *names: str, otherwise: float | None = None) -> float | None:
    """The first number of a field.

    Args:
        component: The component.
        *names: Names of the field.
        otherwise: What is returned where there is none.
    """
    found = array_of(component, 1, *names)
    return otherwise if found is None or not len(found) else float(found[0])


def indices_of(component: SceneComponent, *names: str) -> np.ndarray | None:
    """The whole numbers of a field, int64; or None.

    Args:
        component: The component.
        *names: Names of the field.
    """
    found = array_of(component, 1, *names)
    return None if found is None else found.astype(np.int64)


def is_true(component: SceneComponent, name: str, otherwise: bool) -> bool:
    """The truth value of a field.

    Args:
        component: The component.
        name: Name of the field.
        otherwise: What it is where the file gives none.
    """
    value = value_of(component, name)
    if value is None:
        return otherwise
    return str(value).strip().lower() in ("1", "true", "1.0")


def placement_of(component: SceneComponent) -> Placement:
    """How a loader or a state places its points; angles are in degrees.

    Args:
        component: The component.

    Raises:
        NotConverted: It has a matrix.
    """
    if component.fields.get("transformation") is not None:
        raise NotConverted("a matrix transformation is not read: give translation, rotation, scale3d")

    def vector(name: str, letter: str, usual: float) -> np.ndarray:
        found = array_of(component, 3, name)
        made = np.full(3, usual) if found is None or not len(found) else found[0].copy()
        for axis, word in enumerate("xyz"):
            made[axis] = number_of(component, letter + word, otherwise=made[axis])
        return made

    scale = vector("scale3d", "s", 1.0) * (number_of(component, "scale", otherwise=1.0) or 1.0)
    return Placement(vector("translation", "d", 0.0),
                     Rotation.from_euler("xyz", vector("rotation", "r", 0.0), degrees=True), scale)  # fmt: skip


# --- loaders and topologies -----------------------------------------------------------------------


def find_file(component: SceneComponent, name: str) -> Path:
    """The file that a component names: beside the scene, beside the script, or in SOFA's data.

    Args:
        component: The component.
        name: The name.

    Raises:
        NotConverted: There is none.
    """
    folders = [Path(component.place[0]).parent, Path.cwd()]
    home = root_of(component.node).fields.get("folder")
    if home is not None:
        folders.insert(0, Path(home))
    for root in filter(None, (os.environ.get("SOFA_ROOT"),)):
        folders += [Path(root, "share/sofa"), Path(root, "share"), Path(root, "share/sofa/examples")]
    for folder in folders:
        if (folder / name).is_file():
            return (folder / name).resolve()
    raise NotConverted(f"its file {name} is not found in {folders[0]}; $SOFA_ROOT is searched too")


def loaded_mesh(component: SceneComponent) -> LoadedMesh:
    """The placed mesh of a loader.

    Args:
        component: The loader.

    Raises:
        NotConverted: Its file is missing or cannot be read.
    """
    kept = component.__dict__.get("loaded")
    if kept is None:
        name = value_of(component, "filename")
        if not name:
            raise NotConverted("it names no file")
        file, placement = find_file(component, str(name)), placement_of(component)
        raw = _read_file(file)
        kept = raw._replace(points=placement.place(raw.points), file=file, placement=placement)
        component.__dict__["loaded"] = kept
    return kept


def _read_file(file: Path) -> LoadedMesh:
    try:
        if file.suffix.lower() == ".gidmsh":
            return _read_gid(file)
        if file.suffix.lower() in (".vtk", ".vtu", ".msh"):
            try:
                mesh = read_mesh_file(file)
                tets, hexahedra = mesh.tets, mesh.hexahedra
                every = np.concatenate([tets, hexahedra[:, INTO_TETS].reshape(-1, 4)])
                return LoadedMesh(mesh.node_positions, tets, hexahedra, boundary_triangles(every), _cells(2))
            except MeshError as error:
                if "has no tetrahedra or hexahedra" not in error.reason:
                    raise
        points, triangles = read_surface(file)
        return LoadedMesh(points, _cells(4), _cells(8), triangles, _cells(2))
    except (MeshError, OSError, ValueError) as error:
        raise NotConverted(f"its mesh cannot be read: {error}") from error


def _read_gid(file: Path) -> LoadedMesh:
    """A mesh of GiD: coordinates and tetrahedra between words, numbered from 1."""
    points: dict[int, list[float]] = {}
    tets, section = [], ""
    for line in file.read_text(errors="replace").splitlines():
        words = line.split()
        if not words:
            continue
        if words[0].lower() in ("coordinates", "elements", "end"):
            section = "" if words[0].lower() == "end" else words[0].lower()
        elif section == "coordinates":
            points[int(words[0])] = [float(word) for word in words[1:4]]
        elif section == "elements":
            tets.append([int(word) for word in words[1:5]])
    order = {number: index for index, number in enumerate(points)}
    cells = np.array([[order[number] for number in tet] for tet in tets], np.int64).reshape(-1, 4)
    return LoadedMesh(np.array(list(points.values())), cells, _cells(8), boundary_triangles(cells), _cells(2))


def mesh_of(component: SceneComponent) -> LoadedMesh:
    """Points and cells of a topology or a loader.

    Args:
        component: The component.

    Raises:
        NotConverted: They cannot be computed.
    """
    if component.kind in LOADERS:
        return loaded_mesh(component)
    if component.kind in ("RegularGridTopology", "RegularGrid"):
        return _grid(component)
    source = _source_of(component)
    given = source._asdict() if source is not None else LoadedMesh(
        np.empty((0, 3)), _cells(4), _cells(8), _cells(3), _cells(2))._asdict()  # fmt: skip
    for key, width, names in (
        ("points", 3, ("position", "points")), ("tets", 4, ("tetrahedra", "tetras")),
        ("hexahedra", 8, ("hexahedra", "hexas")), ("triangles", 3, ("triangles",)),
        ("edges", 2, ("edges", "lines")),
    ):  # fmt: skip
        component.read.update(names)
        own = next((component.fields[name] for name in names if component.fields.get(name) is not None), None)
        if own is not None:
            own = numbers(linked(own, component.node, names[0]), width)
            if key != "points":
                own = own.astype(np.int64)
            elif source is None or own.shape != source.points.shape or not np.allclose(own, source.points):
                given |= {"file": None, "placement": UNMOVED}
            given[key] = own
    mesh = LoadedMesh(**given)
    if not len(mesh.tets) and not len(mesh.hexahedra) and not len(mesh.triangles):
        mesh = _of_hexahedra(component, mesh)
    if not len(mesh.triangles) and (len(mesh.tets) or len(mesh.hexahedra)):
        every = np.concatenate([mesh.tets, mesh.hexahedra[:, INTO_TETS].reshape(-1, 4)])
        mesh = mesh._replace(triangles=boundary_triangles(every))
    return mesh


def _of_hexahedra(component: SceneComponent, mesh: LoadedMesh) -> LoadedMesh:
    """The tetrahedra that a mapping of topologies makes of hexahedra, for the topology that is its output."""
    mapping = first(component.node, ("Hexa2TetraTopologicalMapping",))
    source = None if mapping is None else value_of(mapping, "input")
    if isinstance(source, SceneNode):
        source = first(source, TOPOLOGIES)
    if source is None or source is component:
        return mesh
    found = mesh_of(source)
    points = mesh.points if len(mesh.points) else found.points
    return mesh._replace(points=points, tets=found.hexahedra[:, INTO_TETS].reshape(-1, 4))


def _source_of(component: SceneComponent) -> LoadedMesh | None:
    """The mesh that ``src``, or a link of ``position``, leads to."""
    for name in ("src", "position", "tetrahedra", "hexahedra", "points"):
        link = component.fields.get(name)
        if is_link(link):
            component.read.add(name)
            owner, _ = follow(link, component.node)
            if isinstance(owner, SceneComponent) and owner.kind in (*LOADERS, *TOPOLOGIES):
                found = mesh_of(owner)
                # Only of a source are the cells taken too.
                return found if name == "src" else found._replace(
                    tets=_cells(4), hexahedra=_cells(8), triangles=_cells(3), edges=_cells(2))
    return None


def _grid(component: SceneComponent) -> LoadedMesh:
    """A box of hexahedra."""
    counts = array_of(component, 3, "n")
    count = ([int(number_of(component, word, otherwise=2.0) or 2) for word in ("nx", "ny", "nz")]
             if counts is None else counts[0].astype(int))  # fmt: skip
    low, high = (array_of(component, 3, name) for name in ("min", "max"))
    ends = [np.array([number_of(component, axis + word, otherwise=usual) for axis in "xyz"])
            if found is None else found[0]
            for word, usual, found in (("min", 0.0, low), ("max", 1.0, high))]  # fmt: skip
    axes = [np.linspace(ends[0][axis], ends[1][axis], count[axis]) for axis in range(3)]
    # x runs fastest.
    points = np.stack(np.meshgrid(*axes[::-1], indexing="ij"), axis=-1).reshape(-1, 3)[:, ::-1]
    node = np.arange(len(points)).reshape(count[2], count[1], count[0])
    corners = [node[dz : count[2] - 1 + dz, dy : count[1] - 1 + dy, dx : count[0] - 1 + dx].ravel()
               for dx, dy, dz in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0),
                                  (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))]  # fmt: skip
    hexahedra = np.stack(corners, axis=1) if min(count) > 1 else _cells(8)
    placement, offset = placement_of(component), array_of(component, 3, "p0")
    points = points if offset is None else points + offset[0]
    edges = np.stack([np.arange(len(points) - 1), np.arange(1, len(points))], axis=1)
    return LoadedMesh(placement.place(points), _cells(4), hexahedra, _cells(3),
                      edges if sorted(count)[1] == 1 else _cells(2))  # fmt: skip


def topology_of(node: SceneNode) -> SceneComponent | None:
    """The topology that components of a node use: of it or of the nearest node above.

    Args:
        node: The node.
    """
    return nearest(node, TOPOLOGIES)


# --- states ---------------------------------------------------------------------------------------


def is_rigid(state: SceneComponent) -> bool:
    """Whether a state holds frames, seven numbers each, and not points.

    Args:
        state: A state.
    """
    state.read.add("template")
    return str(state.fields.get("template", "")).lower() in RIGID_TEMPLATES


def state_of(node: SceneNode) -> SceneComponent | None:
    """The state that components of a node act on.

    Args:
        node: The node.
    """
    return nearest(node, STATES)


def state_mesh(state: SceneComponent) -> LoadedMesh:
    """Points of a state in the world at rest, before its mappings, and how they were placed.

    Args:
        state: A state of points.

    Raises:
        NotConverted: They cannot be computed.
    """
    placement = placement_of(state)
    mesh = _source_of(state)
    given = array_of(state, 3, "rest_position", "position") if _has(state, "position") or _has(
        state, "rest_position") else None  # fmt: skip
    if given is not None:
        if mesh is None or mesh.points.shape != given.shape or not np.allclose(mesh.points, given):
            mesh = LoadedMesh(given, _cells(4), _cells(8), _cells(3), _cells(2))
    elif mesh is None:
        topology = first(state.node, (*TOPOLOGIES, *LOADERS))
        mesh = None if topology is None else mesh_of(topology)
    if mesh is None or not len(mesh.points):
        return LoadedMesh(placement.place(np.zeros((1, 3))), _cells(4), _cells(8), _cells(3), _cells(2))
    # A rotation after unequal factors has no counterpart in a scene: the file is not named then.
    can_join = placement.is_uniform and mesh.file is not None
    joined = placement.after(mesh.placement) if can_join else UNMOVED
    return mesh._replace(points=placement.place(mesh.points), placement=joined,
                         file=mesh.file if can_join else None)  # fmt: skip


def _has(component: SceneComponent, name: str) -> bool:
    return component.fields.get(name) is not None


def frames_of(state: SceneComponent) -> np.ndarray:
    """Frames of a rigid state: places and quaternions (x, y, z, w), shape (count, 7).

    Args:
        state: A rigid state.
    """
    given = array_of(state, 1, "rest_position", "position")
    topology = first(state.node, TOPOLOGIES)
    if (given is None or not len(given)) and topology is not None:
        given = mesh_of(topology).points.ravel()
    frames = np.array([[0.0, 0, 0, 0, 0, 0, 1]])
    if given is not None and len(given):
        # Places alone stand for frames that are not turned.
        width = 7 if len(given) % 7 == 0 and not (len(given) % 3 == 0 and topology is not None and len(
            mesh_of(topology).points) * 3 == len(given)) else 3  # fmt: skip
        rows = numbers(given, width)
        frames = np.tile(frames, (len(rows), 1))
        frames[:, :width] = rows
    placement = placement_of(state)
    frames[:, :3] = placement.place(frames[:, :3])
    turned = placement.rotation * Rotation.from_quat(frames[:, 3:])
    frames[:, 3:] = turned.as_quat()
    return frames


def points_of(state: SceneComponent) -> np.ndarray:
    """Points of a state in the world at rest, shape (count, 3); of a rigid state its places.

    Args:
        state: A state.

    Raises:
        NotConverted: They cannot be computed.
    """
    if is_rigid(state):
        return frames_of(state)[:, :3]
    mapping = first(state.node, ("RigidMapping", "IdentityMapping", "SubsetMapping", "SubsetMultiMapping"))
    if mapping is not None and mapping.kind == "IdentityMapping" and not _has(state, "position"):
        return points_of(mapped_from(state, mapping)[0])
    if mapping is not None and mapping.kind == "SubsetMapping":
        own = indices_of(mapping, "indices")
        every = points_of(mapped_from(state, mapping)[0])
        return every if own is None else every[own]
    points = state_mesh(state).points
    if mapping is not None and mapping.kind == "RigidMapping":
        source = mapped_from(state, mapping)[0]
        if is_rigid(source) and not is_true(mapping, "globalToLocalCoords", False):
            frames = frames_of(source)
            which = rigid_indices(mapping, len(points))
            turned = Rotation.from_quat(frames[which, 3:]).apply(points)
            return turned + frames[which, :3]
    return points


def rigid_indices(mapping: SceneComponent, count: int) -> np.ndarray:
    """The frame that carries each point of a rigid mapping, int64, shape (count,).

    Args:
        mapping: A rigid mapping.
        count: Number of points.
    """
    which = indices_of(mapping, "rigidIndexPerPoint")
    if which is not None and len(which) == count:
        return which
    return np.full(count, int(number_of(mapping, "index", otherwise=0.0) or 0), np.int64)


MAPPINGS = ("BarycentricMapping", "IdentityMapping", "RigidMapping", "SubsetMapping",
            "SubsetMultiMapping", "AdaptiveBeamMapping", "BeamLinearMapping", "SkinningMapping",
            "ArticulatedSystemMapping", "TubularMapping", "CenterPointMechanicalMapping",
            "RigidRigidMapping")  # fmt: skip
"""Kinds of components that let a state follow another one."""


def mapped_from(state: SceneComponent, mapping: SceneComponent | None = None) -> list[SceneComponent]:
    """The states that a state follows; empty where it moves by itself.

    Args:
        state: A state.
        mapping: Its mapping, where it is known.
    """
    mapping = mapping or first(state.node, MAPPINGS)
    if mapping is None:
        return []
    sources = []
    for name in ("input", "input1", "input2", "object1"):
        given = value_of(mapping, name)
        sources += [one for one in (given if isinstance(given, list) else [given]) if one is not None]
    found = []
    for source in sources:
        if isinstance(source, SceneNode):
            source = first(source, STATES)
        if isinstance(source, SceneComponent):
            found.append(source)
    if not found and state.node.parents:
        above = state_of(state.node.parents[0])
        found = [] if above is None else [above]
    return found


# --- regions of interest --------------------------------------------------------------------------


def _roi_points(roi: SceneComponent) -> np.ndarray:
    given = array_of(roi, 3, "position") if _has(roi, "position") else None
    state = state_of(roi.node)
    if given is None and state is None:
        raise NotConverted("it stands in a node without positions")
    return points_of(state) if given is None else given  # type: ignore[arg-type]


def _in_boxes(roi: SceneComponent, points: np.ndarray) -> np.ndarray:
    """Whether points are in one of the boxes of a region, shape (count,)."""
    inside = np.zeros(len(points), bool)
    for low, high in boxes_of(roi):
        inside |= ((points >= low) & (points <= high)).all(axis=1)
    oriented = array_of(roi, 10, "orientedBox")
    for corners in oriented if oriented is not None else ():
        p0, p1, p2 = corners[:9].reshape(3, 3)
        along, across = p1 - p0, p2 - p1
        normal = np.cross(along, p2 - p0)
        normal = normal / np.linalg.norm(normal)
        local = points - p0
        inside |= ((0.0 <= local @ along) & (local @ along <= along @ along)
                   & (0.0 <= local @ across) & (local @ across <= across @ across)
                   & (np.abs(local @ normal) <= 0.5 * corners[9]))  # fmt: skip
    return inside


def boxes_of(roi: SceneComponent) -> np.ndarray:
    """Corners of the boxes along the axes of a region, shape (count, 2, 3).

    Args:
        roi: A BoxROI.
    """
    boxes = array_of(roi, 6, "box")
    if boxes is None:
        oriented = roi.fields.get("orientedBox") is not None
        boxes = np.empty((0, 6)) if oriented else np.array([[0.0, 0, 0, 1, 1, 1]])
    corners = boxes.reshape(-1, 2, 3)
    return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)


def spheres_of(roi: SceneComponent) -> tuple[np.ndarray, np.ndarray]:
    """Centres, shape (count, 3), and radii, shape (count,), of a SphereROI.

    Args:
        roi: The region.
    """
    centres, radii = array_of(roi, 3, "centers"), array_of(roi, 1, "radii")
    if centres is None or radii is None or not len(radii):
        raise NotConverted("it needs centers and radii")
    return centres, np.resize(radii, len(centres))


def _in_spheres(roi: SceneComponent, points: np.ndarray) -> np.ndarray:
    inside = np.zeros(len(points), bool)
    for centre, radius in zip(*spheres_of(roi), strict=True):
        inside |= np.linalg.norm(points - centre, axis=1) <= radius
    return inside


def _complement(roi: SceneComponent, points: np.ndarray) -> np.ndarray:
    """Whether points are in none of the sets of a ComplementaryROI."""
    outside = np.ones(len(points), bool)
    for number in range(1, int(number_of(roi, "nbSet", otherwise=1.0) or 1) + 1):
        chosen = indices_of(roi, f"setIndices{number}")
        outside[[] if chosen is None else chosen] = False
    return outside


REGIONS: dict[str, Callable[[SceneComponent, np.ndarray], np.ndarray]] = {
    "BoxROI": _in_boxes, "BoxRoi": _in_boxes, "SphereROI": _in_spheres, "SubsetTopology": _in_boxes,
    "ComplementaryROI": _complement,
}  # fmt: skip
"""Kinds of regions of interest: which points are inside."""


def _roi_value(roi: SceneComponent, name: str) -> Any:
    """An output of a region of interest."""
    inside = REGIONS[roi.kind]
    if name in ("indices", "pointsInROI"):
        points = _roi_points(roi)
        chosen = np.flatnonzero(inside(roi, points))
        return points[chosen] if name == "pointsInROI" else chosen
    cells = {"tetra": "tets", "hexa": "hexahedra", "triang": "triangles", "edge": "edges"}
    kind = next((key for word, key in cells.items() if name.startswith(word)), None)
    topology = topology_of(roi.node)
    if kind is None or topology is None:
        return None
    every, points = getattr(mesh_of(topology), kind), _roi_points(roi)
    if is_true(roi, "strict", True):
        chosen = inside(roi, points)[every].all(axis=1)
    else:
        chosen = inside(roi, points[every].mean(axis=1))
    if name.endswith("OutROI"):
        chosen = ~chosen
    return np.flatnonzero(chosen) if "ndices" in name or name.endswith("Index") else every[chosen]


def _mesh_value(component: SceneComponent, name: str) -> Any:
    """An output of a loader or topology."""
    key = {"position": "points", "points": "points", "rest_position": "points", "tetrahedra": "tets",
           "tetras": "tets", "hexahedra": "hexahedra", "hexas": "hexahedra",
           "triangles": "triangles", "edges": "edges", "lines": "edges"}.get(name)  # fmt: skip
    return None if key is None else getattr(mesh_of(component), key)


def _state_value(state: SceneComponent, name: str) -> Any:
    """An output of a state."""
    if name in ("position", "rest_position"):
        if is_rigid(state):
            return state.fields.get("position") and frames_of(state)
        return None if _has(state, name) else points_of(state)
    return None


def _mapped_values(mapper: SceneComponent, name: str) -> Any:
    """The values of an IndexValueMapper: one value at some indices, others as they come in."""
    if name != "outputValues":
        return None
    before, chosen = array_of(mapper, 1, "inputValues"), indices_of(mapper, "indices")
    value = number_of(mapper, "value", otherwise=0.0)
    chosen = np.empty(0, np.int64) if chosen is None else chosen
    values = np.full(max(int(chosen.max(initial=-1)) + 1, 0 if before is None else len(before)),
                     number_of(mapper, "defaultValue", otherwise=0.0))
    values[: 0 if before is None else len(before)] = () if before is None else before
    values[chosen] = value
    return values


_COMPUTED: dict[str, Callable[[SceneComponent, str], Any]] = {
    **dict.fromkeys((*LOADERS, *TOPOLOGIES), _mesh_value), **dict.fromkeys(REGIONS, _roi_value),
    **dict.fromkeys(STATES, _state_value), "IndexValueMapper": _mapped_values,
}  # fmt: skip
