"""What components of a SOFA scene compute: meshes of loaders, positions of states, regions of interest.

Lengths are in the unit of the scene. A value that the file gives goes before one that is computed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import binary_fill_holes
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.scene_tree import (
    KINDS,
    TABLE,
    NotConverted,
    SceneComponent,
    SceneNode,
    UNKNOWN,
    components_below,
    first,
    follow,
    is_link,
    nearest,
    numbers,
    root_of,
)
from softrobot_twin.errors import MOST_COUNTED, MeshError
from softrobot_twin.geometry.hexahedral_mesh import INTO_TETS
from softrobot_twin.geometry.mesh_reading import read_mesh_file
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.surface_reading import read_surface

RIGID_TEMPLATES = ("rigid", "rigid3", "rigid3d", "rigid3f")


class Placement(NamedTuple):
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

    points: np.ndarray = np.empty((0, 3))
    tets: np.ndarray = np.empty((0, 4), np.int64)
    hexahedra: np.ndarray = np.empty((0, 8), np.int64)
    triangles: np.ndarray = np.empty((0, 3), np.int64)
    edges: np.ndarray = np.empty((0, 2), np.int64)
    file: Path | None = None
    placement: Placement = UNMOVED

    def with_boundary(self) -> LoadedMesh:
        """The mesh with the boundary of its cells as triangles."""
        every = np.concatenate([self.tets, self.hexahedra[:, INTO_TETS].reshape(-1, 4)])
        return self._replace(triangles=boundary_triangles(every))


# --- values and links -----------------------------------------------------------------------------

_OWN = {"translation", "rotation", "scale3d", "scale", *(f"{a}{b}" for a in "drs" for b in "xyz")}
"""Fields that ``src`` does not link: a loader has placed its points already."""


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
    if is_link(source) and names[0] not in _OWN:
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
    if isinstance(value, str) and value.startswith("@") and " @" in value:
        value = value.split()  # several links in a text
    if not is_link(value):
        if isinstance(value, list) and any(map(is_link, value)):
            return [linked(part, node, name) for part in value]
        return value
    owner, field = follow(value, node)
    if isinstance(owner, SceneNode):
        return owner.fields.get(field or "", owner)
    found = owner if field is None else value_of(owner, field)
    if found is None and owner.kind not in _COMPUTED:
        raise NotConverted(f"its field {name} comes from {owner.kind} ({owner.where}), which is not read")
    return found


def array_of(component: SceneComponent, width: int, *names: str, otherwise: Any = None) -> Any:
    """The numbers of a field in rows, or None; see `value_of`.

    Args:
        component: The component.
        width: Numbers in a row.
        *names: Names of the field.
        otherwise: What is returned as an array where there is none, or an empty list.
    """
    value = value_of(component, *names)
    found = None if value is None else numbers(value, width)
    return found if otherwise is None or found is not None and len(found) else np.asarray(otherwise)


def number_of(
    component: SceneComponent, *names: str, otherwise: Any = None, may_be_infinite: bool = False
) -> Any:  # fmt: skip
    """The first number of a field.

    Args:
        component: The component.
        *names: Names of the field.
        otherwise: What is returned where there is none.
        may_be_infinite: See `numbers`.
    """
    value = value_of(component, *names)
    found = [] if value is None else numbers(value, 1, may_be_infinite)
    return float(found[0]) if len(found) else otherwise


def whole_of(component: SceneComponent, name: str) -> int:
    """The first number of a field as a whole one; zero where there is none.

    Args:
        component: The component.
        name: Name of the field.
    """
    return int(number_of(component, name, otherwise=0))


def indices_of(component: SceneComponent, *names: str, otherwise: Any = None) -> Any:
    """The whole numbers of a field, int64; or None.

    Args:
        component: The component.
        *names: Names of the field.
        otherwise: What is returned where there is none, or an empty list.

    Raises:
        NotConverted: One is below 0, of which SOFA knows none.
    """
    found = array_of(component, 1, *names, otherwise=otherwise)
    if found is not None and not (found >= 0.0).all():
        raise NotConverted(f"its field {names[0]} has {found.min():g}, and indices begin with 0")
    return None if found is None else found.astype(np.int64)


def is_true(component: SceneComponent, name: str, otherwise: bool) -> bool:
    """The truth value of a field.

    Args:
        component: The component.
        name: Name of the field.
        otherwise: What it is where the file gives none.
    """
    value = value_of(component, name)
    return otherwise if value is None else str(value).strip().lower() in ("1", "true", "1.0")


def placement_of(component: SceneComponent) -> Placement:
    """How a loader or a state places its points; angles are in degrees.

    Args:
        component: The component.

    Raises:
        NotConverted: It has a matrix.
    """
    if component.fields.get("transformation") is not None:
        raise NotConverted("a matrix transformation is not read: give translation, rotation, scale3d")

    scale = _vector_of(component, "scale3d", "s{}", np.ones(3)) * number_of(component, "scale", otherwise=1.0)
    turn = Rotation.from_euler("xyz", _vector_of(component, "rotation", "r{}", np.zeros(3)), degrees=True)
    return Placement(_vector_of(component, "translation", "d{}", np.zeros(3)), turn, scale)


def _vector_of(component: SceneComponent, name: str, of_axis: str, usual: Any) -> np.ndarray:
    """Three numbers of a field, or of fields of single axes, which go before it."""
    every = array_of(component, 3, name, otherwise=[usual])[0]
    return np.array([number_of(component, of_axis.format(axis), otherwise=value)
                     for axis, value in zip("xyz", every, strict=True)])  # fmt: skip


# --- loaders and topologies -----------------------------------------------------------------------


def find_file(component: SceneComponent, name: str) -> Path:
    """The file that a component names: beside the scene, beside the script, or in SOFA's data.

    Args:
        component: The component.
        name: The name.

    Raises:
        NotConverted: There is none.
    """
    name = name.replace("\\", "/")
    folders = [Path(component.place[0]).parent, Path.cwd()]
    home, sofa = root_of(component.node).fields.get("folder"), os.environ.get("SOFA_ROOT")
    folders[:0] = [Path(home)] if home else []
    folders += [Path(sofa, below) for below in ("share/sofa", "share", "share/sofa/examples")] if sofa else []
    for folder in folders:
        if (folder / name).is_file():
            return (folder / name).resolve()
    raise NotConverted(f"its file {name} is not found in {folders[0]}; $SOFA_ROOT is searched too")


@cache
def loaded_mesh(component: SceneComponent) -> LoadedMesh:
    """The placed mesh of a loader.

    Args:
        component: The loader.

    Raises:
        NotConverted: Its file is missing or cannot be read.
    """
    name = value_of(component, "filename")
    if not name:
        raise NotConverted("it names no file")
    file, placement = find_file(component, str(name)), placement_of(component)
    raw = _read_file(file)
    return raw._replace(points=placement.place(raw.points), file=file, placement=placement)


def _read_file(file: Path) -> LoadedMesh:
    try:
        if file.suffix.lower() == ".gidmsh":
            return _read_gid(file)
        if file.suffix.lower() in (".vtk", ".vtu", ".msh"):
            try:
                mesh = read_mesh_file(file)
                return LoadedMesh(mesh.node_positions, mesh.tets, mesh.hexahedra).with_boundary()
            except MeshError as error:
                if "has no tetrahedra or hexahedra" not in error.reason:
                    raise
        points, triangles = read_surface(file)
        return LoadedMesh(points, triangles=triangles)
    except (MeshError, OSError, ValueError) as error:
        raise NotConverted(f"its mesh cannot be read: {error}") from error


def _read_gid(file: Path) -> LoadedMesh:
    """A mesh of GiD: coordinates and tetrahedra between words, numbered from 1."""
    text = file.read_text(errors="replace").lower()
    sections = dict(re.findall(r"(?ms)^\s*(coordinates|elements)\s*\n(.*?)^\s*end", text))
    nodes, cells = (np.loadtxt(sections.get(word, "").splitlines(), ndmin=2) for word in ("coordinates", "elements"))
    order = {number: index for index, number in enumerate(nodes[:, 0])}
    tets = np.array([[order[number] for number in cell[1:5]] for cell in cells], np.int64)
    return LoadedMesh(nodes[:, 1:4], tets).with_boundary()


def mesh_of(component: SceneComponent) -> LoadedMesh:
    """Points and cells of a topology or a loader.

    Args:
        component: The component.

    Raises:
        NotConverted: They cannot be computed.
    """
    if component.kind in KINDS["loaders"]:
        return loaded_mesh(component)
    build = next((make for kind, make in _BUILT.items() if component.kind.startswith(kind)), _source_of)
    source = build(component)
    given = (source or LoadedMesh())._asdict()
    for key, names in TABLE["mesh_fields"].items():
        width = given[key].shape[1]
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
    is_solid = len(mesh.tets) or len(mesh.hexahedra)
    if not is_solid and not len(mesh.triangles) and (filled := _made_of_hexahedra(component)) is not None:
        return filled if not len(mesh.points) else mesh._replace(tets=filled.tets).with_boundary()
    return mesh.with_boundary() if is_solid and not len(mesh.triangles) else mesh


_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
"""Corners of a hexahedron of a grid, in steps along each axis."""


def _grid_of(component: SceneComponent) -> LoadedMesh:
    """Points of a regular grid, those along x one after the other, and its hexahedra."""
    counts, (low, high) = _grid_counts(component), _grid_ends(component, np.zeros(3), np.ones(3))
    places = np.indices(counts[::-1]).reshape(3, -1)[::-1].T
    steps = (high - low) / np.maximum(counts - 1, 1)
    points = array_of(component, 1, "p0", otherwise=low).ravel() + places * steps
    corners = np.flatnonzero((places < counts - 1).all(axis=1))
    line = np.arange(len(points) * (np.sort(counts)[1] == 1))
    return LoadedMesh(points, hexahedra=corners[:, None] + _CORNERS @ [1, counts[0], counts[0] * counts[1]],
                      edges=np.stack([line[:-1], line[1:]], axis=1))  # fmt: skip


def _grid_counts(component: SceneComponent) -> np.ndarray:
    counts = _vector_of(component, "n", "n{}", np.full(3, 2)).astype(np.int64)
    if counts.min() < 1 or counts.prod(dtype=float) > MOST_COUNTED:
        raise NotConverted(f"it needs a point or more along each axis, and at most {MOST_COUNTED:,}")
    return counts


def _grid_ends(component: SceneComponent, *usual: np.ndarray) -> list[np.ndarray]:
    """Lower and upper corner of a grid."""
    return [_vector_of(component, end, "{}" + end, value) for end, value in zip(("min", "max"), usual, strict=True)]


def _sparse_grid_of(component: SceneComponent) -> LoadedMesh:
    """The cells of a grid around a surface that hold a part of it, or lie inside."""
    surface = _source_of(component) if component.fields.get("filename") is None else loaded_mesh(component)
    if surface is None or not len(surface.triangles):
        raise NotConverted("a sparse grid needs a surface of triangles")
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    # SOFA makes the box of the surface a hundredth larger at each side.
    low, high = _grid_ends(component, low - 0.01 * (high - low), high + 0.01 * (high - low))
    width = number_of(component, "cellWidth", otherwise=0.0)
    counts = np.ceil((high - low) / width).astype(int) + 1 if width > 0.0 else _grid_counts(component)
    cell = np.full(3, width) if width > 0.0 else (high - low) / (counts - 1)
    is_kept = np.zeros(counts - 1, bool)
    for triangle in (surface.points[surface.triangles] - low) / cell:
        ends = triangle.min(axis=0), triangle.max(axis=0)
        least, most = (np.clip(end.astype(int), 0, counts - 2) for end in ends)
        near = least + np.indices(most - least + 1).reshape(3, -1).T
        # No plane along an edge of both, or along the triangle, lies between it and the cell.
        sides = np.roll(triangle, -1, axis=0) - triangle
        axes = np.concatenate([np.cross(sides[:, None], np.eye(3)).reshape(-1, 3), [np.cross(sides[0], sides[1])]])
        reach, places = 0.5 * np.abs(axes).sum(axis=1), (triangle - (near[:, None] + 0.5)) @ axes.T
        is_cut = ((places.min(axis=1) <= reach) & (places.max(axis=1) >= -reach)).all(axis=1)
        is_kept[tuple(near[is_cut].T)] = True
    start = np.argwhere(binary_fill_holes(is_kept).transpose(2, 1, 0))[:, ::-1]
    used, places = np.unique((start[:, None] + _CORNERS) @ [1, counts[0], counts[0] * counts[1]], return_inverse=True)
    points = np.stack(np.unravel_index(used, counts[::-1])[::-1], axis=1)
    return LoadedMesh(low + points * cell, hexahedra=places.reshape(-1, 8).astype(np.int64))


_BUILT: dict[str, Callable[[SceneComponent], LoadedMesh | None]] = {
    "RegularGrid": _grid_of, "SparseGrid": _sparse_grid_of}  # fmt: skip
"""Topologies that make their points, by the beginning of their kind."""


def _made_of_hexahedra(component: SceneComponent) -> LoadedMesh | None:
    """The tetrahedra that a mapping puts into an empty topology; None where none does."""
    mapping = _naming(component, ("Hexa2TetraTopologicalMapping",))
    source = None if mapping is None else value_of(mapping, "input")
    if not isinstance(source, SceneComponent) or source is component:
        return None
    mesh = mesh_of(source)
    return mesh._replace(tets=mesh.hexahedra[:, INTO_TETS].reshape(-1, 4), hexahedra=mesh.hexahedra[:0], file=None)


def _naming(output: SceneComponent, kinds: tuple[str, ...]) -> SceneComponent | None:
    """The mapping of one of some kinds that names a component as its output."""
    every = components_below(root_of(output.node), kinds)
    return next((one for one in every if named_by(one, "output") is output), None)


def _source_of(component: SceneComponent) -> LoadedMesh | None:
    """The mesh that ``src``, or a link of ``position``, leads to."""
    for name in ("src", "position", "tetrahedra", "hexahedra", "points"):
        link = component.fields.get(name)
        if is_link(link):
            component.read.add(name)
            owner, _ = follow(link, component.node)
            if isinstance(owner, SceneComponent) and owner.kind in KINDS["meshes"]:
                found = mesh_of(owner)
                # Only of a source are the cells taken too.
                return found if name == "src" else LoadedMesh(found.points, file=found.file, placement=found.placement)
    return None


def used_topology(component: SceneComponent) -> SceneComponent | None:
    """The topology that a component names, or else that of its node.

    Args:
        component: The component.
    """
    owner = named_by(component, "topology")
    return owner if isinstance(owner, SceneComponent) else topology_of(component.node)


def topology_of(node: SceneNode) -> SceneComponent | None:
    """The topology that components of a node use: of it or of the nearest node above.

    Args:
        node: The node.
    """
    return nearest(node, KINDS["topologies"])


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
    return nearest(node, KINDS["states"])


def state_mesh(state: SceneComponent) -> LoadedMesh:
    """Points of a state in the world at rest, before its mappings, and how they were placed.

    Args:
        state: A state of points.

    Raises:
        NotConverted: They cannot be computed.
    """
    placement = placement_of(state)
    mesh = _source_of(state)
    if _has(state, "position", "rest_position"):
        given = array_of(state, 3, "rest_position", "position")
        if mesh is None or mesh.points.shape != given.shape or not np.allclose(mesh.points, given):
            mesh = LoadedMesh(given)
    elif mesh is None:
        source = first(state.node, KINDS["meshes"])
        mesh = None if source is None else mesh_of(source)
    if mesh is None or not len(mesh.points):
        return LoadedMesh(placement.place(np.zeros((1, 3))))
    # A rotation after unequal factors has no counterpart in a scene: the file is not named then.
    can_join = placement.is_uniform and mesh.file is not None
    joined = placement.after(mesh.placement) if can_join else UNMOVED
    return mesh._replace(points=placement.place(mesh.points), placement=joined, file=mesh.file if can_join else None)


def _has(component: SceneComponent, *names: str) -> bool:
    return any(component.fields.get(name) is not None for name in names)


def frames_of(state: SceneComponent) -> np.ndarray:
    """Frames of a rigid state: places and quaternions (x, y, z, w), shape (count, 7).

    Args:
        state: A rigid state.
    """
    topology, placement = first(state.node, KINDS["topologies"]), placement_of(state)
    places = np.zeros((1, 3)) if topology is None else mesh_of(topology).points
    given = array_of(state, 1, "rest_position", "position", otherwise=places.ravel())
    # Places alone stand for frames that are not turned.
    width = 3 if len(given) % 7 or len(given) == places.size else 7
    rows = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (len(given) // width, 1))
    rows[:, :width] = numbers(given, width)
    rows[~rows[:, 3:].any(axis=1), 6] = 1.0  # four zeros stand for no turn
    turned = placement.rotation * Rotation.from_quat(rows[:, 3:])
    return np.hstack([placement.place(rows[:, :3]), turned.as_quat()])


def points_of(state: SceneComponent) -> np.ndarray:
    """Points of a state in the world at rest, shape (count, 3); of a rigid state its places.

    Args:
        state: A state.

    Raises:
        NotConverted: They cannot be computed.
    """
    if is_rigid(state):
        return frames_of(state)[:, :3]
    mapping = mapping_of(state)
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
    which = indices_of(mapping, "rigidIndexPerPoint", otherwise=[])
    return which if len(which) == count else np.full(count, indices_of(mapping, "index", otherwise=[0])[0])


def mapping_of(state: SceneComponent) -> SceneComponent | None:
    """The mapping that moves a state: of its node, or another one that names it as output.

    Args:
        state: A state.
    """
    return first(state.node, KINDS["mappings"]) or _naming(state, KINDS["mappings"])


def named_by(component: SceneComponent, name: str) -> SceneNode | SceneComponent | None:
    """What the link of a field leads to; None where it leads nowhere, or is none.

    Args:
        component: The component.
        name: Name of the field.
    """
    link = component.fields.get(name)
    with suppress(NotConverted):
        return follow(link, component.node)[0] if is_link(link) else None
    return None


def mapped_from(state: SceneComponent, mapping: SceneComponent | None = None) -> list[SceneComponent]:
    """The states that a state follows; empty where it moves by itself.

    Args:
        state: A state.
        mapping: Its mapping, where it is known.
    """
    mapping = mapping or mapping_of(state)
    if mapping is None:
        return []
    given = [value_of(mapping, name) for name in ("input", "input1", "input2", "object1")]
    sources = [one for value in given for one in (value if isinstance(value, list) else [value])]
    sources = [first(one, KINDS["states"]) if isinstance(one, SceneNode) else one for one in sources]
    found = [one for one in sources if isinstance(one, SceneComponent)]
    above = state_of(state.node.parents[0]) if state.node.parents else None
    return found or ([] if above is None else [above])


# --- regions of interest --------------------------------------------------------------------------


def _roi_points(roi: SceneComponent) -> np.ndarray:
    given = array_of(roi, 3, "position") if _has(roi, "position") else None
    state = state_of(roi.node)
    if given is None and state is None:
        raise NotConverted("it stands in a node without positions")
    return points_of(state) if given is None else given  # type: ignore[arg-type]


def shapes_of(roi: SceneComponent) -> list[tuple[str, dict[str, np.ndarray]]]:
    """The shapes of a region: their kinds and lengths, as an entry `fixed` has them; turned boxes it has not.

    Args:
        roi: A region.
    """
    if roi.kind == "SphereROI":
        centres, radii = array_of(roi, 3, "centers", otherwise=[]), array_of(roi, 1, "radii", otherwise=[])
        if not len(centres) or not len(radii):
            raise NotConverted("it needs centers and radii")
        return [("sphere", {"centre": centre, "radius": radius})
                for centre, radius in zip(centres, np.resize(radii, len(centres)), strict=True)]  # fmt: skip
    turned = array_of(roi, 10, "orientedBox", otherwise=np.empty((0, 10)))
    usual = np.empty((0, 6)) if len(turned) else [[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]]
    boxes = array_of(roi, 6, "box", otherwise=usual).reshape(-1, 2, 3)
    return [("box", {"minimum": ends.min(axis=0), "maximum": ends.max(axis=0)}) for ends in boxes] + [
        ("turned", {"corners": one[:9].reshape(3, 3), "depth": one[9]}) for one in turned]  # fmt: skip


def is_inside(points: np.ndarray, kind: str, shape: dict[str, np.ndarray]) -> np.ndarray:
    """Whether points are in a shape, shape (count,).

    Args:
        points: Shape (count, 3).
        kind: Kind of the shape.
        shape: Its lengths; see `shapes_of`.
    """
    if kind == "sphere":
        return np.linalg.norm(points - shape["centre"], axis=1) <= shape["radius"]
    if kind == "box":
        return ((points >= shape["minimum"]) & (points <= shape["maximum"])).all(axis=1)
    start, corner, end = shape["corners"]
    normal = np.cross(corner - start, end - corner)
    edges = [corner - start, end - corner, shape["depth"] * normal / np.linalg.norm(normal)]
    return (np.abs((points - start) @ np.linalg.inv(edges) - [0.5, 0.5, 0.0]) <= 0.5).all(axis=1)


def _roi_value(roi: SceneComponent, name: str) -> Any:
    """An output of a region of interest."""
    cells = {"tetra": "tets", "hexa": "hexahedra", "triang": "triangles", "edge": "edges"}
    kind = next((key for word, key in cells.items() if name.startswith(word)), None)
    topology = topology_of(roi.node)
    outputs = ("indices", "indicesOut", "pointsInROI", "pointsOutROI")
    if name not in outputs and (kind is None or topology is None):
        return None
    points, shapes = _roi_points(roi), shapes_of(roi)

    def is_in(places: np.ndarray) -> np.ndarray:
        return np.any([is_inside(places, *shape) for shape in shapes], axis=0)

    if name in outputs:
        chosen = is_in(points) if name in ("indices", "pointsInROI") else ~is_in(points)
        return points[chosen] if name.startswith("points") else np.flatnonzero(chosen)
    every = getattr(mesh_of(topology), kind)
    is_strict = is_true(roi, "strict", True)
    chosen = is_in(points)[every].all(axis=1) if is_strict else is_in(points[every].mean(axis=1))
    chosen = ~chosen if name.endswith("OutROI") else chosen
    return np.flatnonzero(chosen) if "ndices" in name or name.endswith("Index") else every[chosen]


def _complement_value(roi: SceneComponent, name: str) -> Any:
    """An output of what is in none of some sets of points."""
    sets = [indices_of(roi, key, otherwise=[]) for key in roi.fields if key.startswith("setIndices")]
    points = _roi_points(roi)
    others = np.setdiff1d(np.arange(len(points)), np.concatenate([[], *sets]))
    return {"indices": others, "pointsInROI": points[others]}.get(name)


def _mesh_value(component: SceneComponent, name: str) -> Any:
    """An output of a loader or topology."""
    key = next((key for key, names in TABLE["mesh_fields"].items() if name in names), None)
    return None if key is None else getattr(mesh_of(component), key)


def _state_value(state: SceneComponent, name: str) -> Any:
    """An output of a state."""
    is_given = is_rigid(state) or _has(state, name)
    return None if is_given or name not in ("position", "rest_position") else points_of(state)


_COMPUTED: dict[str, Callable[[SceneComponent, str], Any]] = {
    **dict.fromkeys(KINDS["meshes"], _mesh_value), **dict.fromkeys(KINDS["regions"], _roi_value),
    **dict.fromkeys(KINDS["complements"], _complement_value),
    **dict.fromkeys(KINDS["states"], _state_value),
}  # fmt: skip
