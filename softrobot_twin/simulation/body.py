"""A body built from its scene entry: mesh, what holds it, its place among all nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.mesh_reading import CUT, MeshReading, read_tet_mesh
from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.regions import nodes_in_box, nodes_in_sphere
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import Body as BodyEntry
from softrobot_twin.scene.body_entries import Region

# Nodes this near outside a box, relative to the body's size, are told: they may be meant.
BESIDE = 1.0e-5
# A soft robot is not larger than this [m].
LARGEST_SIZE = 5.0


@dataclass(frozen=True)
class Body:
    """A deformable body, placed and held.

    Attributes:
        entry: What the scene says of it.
        key: Where the scene says it, such as ``bodies[2]``.
        mesh: The body at rest, its nodes numbered from 0; where the scene asks for quadratic
            elements, a `QuadraticMesh`, which reads like a `TetMesh`.
        first_node: Its first node among all nodes of the scene.
        fixed: Nodes that do not move by themselves, shape (node_count,) of bool.
        riding: Its nodes attached to each rigid body, by that body's name.
        is_held: Every piece of it has three fixed or guided nodes that are not on one line.
    """

    entry: BodyEntry
    key: str
    mesh: TetMesh
    first_node: int
    fixed: np.ndarray
    riding: dict[str, np.ndarray]
    is_held: bool

    @property
    def name(self) -> str:
        """The body's name."""
        return self.entry.name

    @property
    def size(self) -> float:
        """Diagonal of its bounding box [m]."""
        low, high = self.mesh.bounding_box
        return float(np.linalg.norm(high - low))

    @property
    def mass(self) -> float:
        """Its mass [kg]."""
        material = self.entry.material
        if material.total_mass is not None:
            return material.total_mass
        return material.density * float(self.mesh.volume)

    @property
    def density(self) -> float:
        """Its mass per volume [kg/m³]."""
        density = self.entry.material.density
        return self.mass / float(self.mesh.volume) if density is None else density

    def mapping(self, tets: np.ndarray, barycentric_weights: np.ndarray) -> BarycentricMapping:
        """Carry points inside its tetrahedra; see `TetMesh.carriers`."""
        nodes, weights = self.mesh.carriers(tets, barycentric_weights)
        return BarycentricMapping(nodes + self.first_node, weights)


def build_body(entry: BodyEntry, key: str, first_node: int, scene: Scene, notes: list) -> Body:
    """Read the mesh and fix its nodes.

    Args:
        entry: The body's entry.
        key: Where it stands in the scene.
        first_node: Nodes of the scene that come before its own.
        scene: The scene.
        notes: Takes what the reader mended.

    Returns:
        The body.

    Raises:
        MeshError: The mesh cannot be used.
        SceneError: A region holds no node, or nothing holds a body that must be held.
    """
    mesh = entry.mesh
    reading = read_tet_mesh(
        scene.file_path(mesh.file), scale=mesh.scale,
        translation=mesh.translation, rotation=mesh.rotation,
        merge_tolerance=mesh.merge_distance,
    )  # fmt: skip
    notes.extend(f"{key}.mesh ({mesh.file.name}): {note}" for note in reading.notes)
    if reading.mid_edge_nodes is not None:
        entry = _with_element_of_file(entry, key, notes)
    mesh = _with_nodes_of(entry.element, reading.mesh)
    asked = _Asked(entry, mesh, reading, scene, notes)
    fixed = np.zeros(mesh.node_count, dtype=bool)
    for index, region in enumerate(entry.fixed):
        fixed[_nodes_in(region, asked, f"{key}.fixed[{index}]")] = True
    riding = {}
    for index, region in enumerate(entry.attached):
        nodes = _nodes_in(region, asked, f"{key}.attached[{index}]")
        riding[region.to] = np.union1d(riding.get(region.to, nodes), nodes)
        fixed[nodes] = True
    # An edge that is attached or held at both ends is so in the middle too.
    for name, nodes in riding.items():
        between = np.isin(mesh.mid_edge_ends, nodes).all(axis=1)
        riding[name] = np.union1d(nodes, reading.mesh.node_count + np.flatnonzero(between))
    fixed[reading.mesh.node_count :] |= fixed[mesh.mid_edge_ends].all(axis=1)
    if fixed.all():
        notes.append(
            f"{key} ({entry.name}): all its {len(fixed)} nodes are fixed or attached; nothing of "
            "it can bend."
        )
    cut = next((note for note in reading.notes if CUT in note), "")
    # A rigid body that moves by itself holds nothing still.
    free = {rigid.name for rigid in scene.rigid_bodies if rigid.motion == "free"}
    held = fixed.copy()
    for name in free & set(riding):
        held[riding[name]] = False
    is_held = _is_held(mesh, held, f"{key}.fixed", scene, cut)
    return Body(entry, key, mesh, first_node, fixed, riding, is_held)


def _with_element_of_file(entry: BodyEntry, key: str, notes: list[str]) -> BodyEntry:
    """Ten-node tetrahedra are quadratic, unless the scene says otherwise."""
    if "element" not in entry.model_fields_set:
        return entry.model_copy(update={"element": "quadratic"})
    if entry.element == "linear":
        notes.append(f"{key}.element = linear: of the file's ten-node tetrahedra only the corners "
                     "are used.")  # fmt: skip
    return entry


def _nodes_of_file(mesh, reading: MeshReading) -> np.ndarray:
    """Node of the mesh for each node of the file, −1 where it has none, shape (file_nodes,)."""
    numbers = reading.mesh_node_indices
    ends = mesh.mid_edge_ends
    if reading.mid_edge_nodes is None or len(ends) == 0:
        return numbers
    corners = reading.mesh.node_count
    keys = ends[:, 0] * corners + ends[:, 1]  # rising, as the edges are numbered
    asked = np.sort(reading.mid_edge_nodes.ends, axis=1)
    numbers = numbers.copy()
    numbers[reading.mid_edge_nodes.file_nodes] = corners + np.searchsorted(
        keys, asked[:, 0] * corners + asked[:, 1]
    )
    return numbers


def _with_nodes_of(element: str, mesh: TetMesh):
    """The mesh with the nodes that an element needs beyond its corners."""
    if element == "linear":
        return mesh
    return add_mid_edge_nodes(mesh)


def placed_in_world(entry: BodyEntry, points) -> np.ndarray:
    """Points of the unplaced mesh where its placement puts them [m], shape (count, 3)."""
    turn = Rotation.from_euler("xyz", entry.mesh.rotation)
    return turn.apply(np.asarray(points, float).reshape(-1, 3)) + entry.mesh.translation


class _Asked(NamedTuple):
    """What a region's nodes are sought in, and who is told what looks wrong."""

    entry: BodyEntry
    mesh: TetMesh
    reading: MeshReading
    scene: Scene
    notes: list[str]


def _nodes_in(region: Region, asked_of: _Asked, key: str) -> np.ndarray:
    entry, mesh, reading, scene, notes = asked_of
    positions = mesh.node_positions
    if region.frame == "mesh":
        turn = Rotation.from_euler("xyz", entry.mesh.rotation)
        positions = turn.inv().apply(positions - np.asarray(entry.mesh.translation))
    if region.box is not None:
        low, high = np.array(region.box.minimum), np.array(region.box.maximum)
        nodes = nodes_in_box(positions, low, high)
        beside = BESIDE * _size(positions)
        around = len(nodes_in_box(positions, low - beside, high + beside)) - len(nodes)
        if around:
            notes.append(
                f"{key}: {around} nodes lie outside the box by less than {1e3 * beside:.2g} mm and "
                "are not in it; give a face that lies between layers of nodes."
            )
        value, unit = f"{list(region.box.minimum)}..{list(region.box.maximum)}", "m"
    elif region.sphere is not None:
        nodes = nodes_in_sphere(positions, region.sphere.centre, region.sphere.radius)
        value, unit = f"{list(region.sphere.centre)}, radius {region.sphere.radius}", "m"
    else:
        asked = np.asarray(region.nodes, dtype=np.int64)
        value, unit = f"{len(asked)} nodes", ""
        beyond = asked[asked >= len(reading.mesh_node_indices)]
        if len(beyond):
            raise SceneError(
                scene.path, f"{key}.nodes", int(beyond[0]), "",
                f"the mesh file has nodes 0 to {len(reading.mesh_node_indices) - 1}",
            )  # fmt: skip
        nodes = _nodes_of_file(mesh, reading)[asked]
        nodes = nodes[nodes >= 0]
    if len(nodes) == 0:
        low, high = positions.min(axis=0), positions.max(axis=0)
        raise SceneError(
            scene.path, key, value, unit,
            f"holds no node of the body, which reaches from {low.tolist()} to {high.tolist()} m"
            + size_hint(_size(positions)),
        )  # fmt: skip
    return nodes


def _size(positions: np.ndarray) -> float:
    """Diagonal of the bounding box [m]."""
    return float(np.linalg.norm(np.ptp(positions, axis=0)))


def size_hint(size: float) -> str:
    """Asks for the unit of a mesh that is larger than a soft robot [m]; else empty."""
    if size <= LARGEST_SIZE:
        return ""
    return f"; it is {size:.4g} m large: is its mesh in millimetres? then give mesh.scale: 0.001"


def holds_still(points: np.ndarray) -> bool:
    """True where points [m], shape (count, 3), are three or more that are not on one line."""
    if len(points) < 3:
        return False
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] > 1.0e-9 * max(spread[0], 1.0e-300))


def _is_held(mesh, fixed: np.ndarray, key: str, scene: Scene, cut: str) -> bool:
    """Every piece needs three fixed nodes that are not on one line, or it would float or swing."""
    first, others = mesh.cells[:, :1], mesh.cells[:, 1:]
    graph = coo_array(
        (np.ones(others.size), (np.broadcast_to(first, others.shape).ravel(), others.ravel())),
        shape=(mesh.node_count, mesh.node_count),
    )
    piece_count, piece = connected_components(graph, directed=False)
    for index in range(piece_count):
        held = mesh.node_positions[fixed & (piece == index)]
        if holds_still(held):
            continue
        if scene.integration != "quasi_static":
            return False
        which = "the body" if piece_count == 1 else f"piece {index} of {piece_count}"
        raise SceneError(
            scene.path, key, f"{len(held)} nodes", "",
            f"{which} is not held: in quasi_static integration at least three nodes that are "
            "not on one line must be fixed, or the body floats away"
            + (f"; {cut[:1].lower()}{cut[1:]}" if cut else size_hint(_size(mesh.node_positions))),
        )  # fmt: skip
    return True
