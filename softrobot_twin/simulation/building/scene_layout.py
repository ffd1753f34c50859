"""Bodies of a scene and their nodes: deformable bodies, point masses and rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.barycentric import NO_LEVER, BarycentricMapping
from softrobot_twin.mechanics.cavity_surfaces import CavitySurface
from softrobot_twin.mechanics.hinged_frames import HingedFrames, Hinges
from softrobot_twin.mechanics.kinematics import Nodes, size_of_body, size_of_points
from softrobot_twin.mechanics.rigid_bodies import AttachedNodes, RigidFrames
from softrobot_twin.mechanics.superelements import Superelements
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import RigidBody
from softrobot_twin.scene.entry import values_below
from softrobot_twin.scene.references import matching
from softrobot_twin.simulation.building.beam_bodies import BeamBody, BeamNet, FramePart
from softrobot_twin.simulation.building.cavity_walls import cavity_wall, check_walls_of_reduced
from softrobot_twin.simulation.building.deformable_body import (
    Body,
    build_body,
    carry,
    holds_still,
    of_kind,
    placed_in_world,
)
from softrobot_twin.simulation.building.reduced_body import ReducedBody, reduced_body
from softrobot_twin.simulation.building.vertebrae import VertebraBody, vertebra_body

# Length of the facets of a triangulated round shape, as a share of its radius.
FACETS = 0.4


def triangulated(shape, facets: float = FACETS) -> tuple[np.ndarray, np.ndarray]:
    """Surface of a shape: points in its frame [m], (n, 3), and triangles, (triangle_count, 3).

    Args:
        shape: The shape.
        facets: Length of the facets of a round shape, as a share of its radius.
    """
    return shape.surface(facets * shape.curvature_radius)


@dataclass(frozen=True, kw_only=True)
class RigidPart(FramePart):
    """A rigid body of a scene: free, or guided or fixed and then without mass and attached nodes.

    Attributes:
        entry: Its entry in the scene.
        index: Its index among all rigid bodies.
        first_node: Its first frame node.
        centre_of_mass: The frame's origin in the coordinates of the scene entry [m], shape (3,).
        shape: Its shape, in its frame.
    """

    entry: RigidBody
    index: int
    first_node: int
    centre_of_mass: np.ndarray
    shape: object

    @property
    def is_guided(self) -> bool:
        """Whether it follows commanded poses."""
        return self.entry.motion == "guided"

    def carried(self, points) -> BarycentricMapping:
        """Map points that move with it.

        Args:
            points: In the world, at rest [m], shape (point_count, 3).

        Returns:
            Their mapping onto its frame nodes.
        """
        local = (np.asarray(points, float).reshape(-1, 3) - self.origin) @ self.rotation
        nodes = np.tile(self.first_node + np.arange(4), (len(local), 1))
        return BarycentricMapping(nodes, np.column_stack([1.0 - local.sum(axis=1), local]))

    def distances(self, points) -> np.ndarray:
        """Distances of points at rest from it, zero inside [m]; points (count, 3).

        Args:
            points: Places in the world [m], shape (count, 3).
        """
        points = np.asarray(points, float).reshape(-1, 3)
        return self.shape.distances((points - self.origin) @ self.rotation)

    def entry_pose(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origin [m] and rotation of the entry's coordinates at a state, (3,) and (3, 3).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        frame = positions[self.first_node : self.first_node + 4]
        rotation = (frame[1:] - frame[0]).T
        return frame[0] - rotation @ self.centre_of_mass, rotation


def build_rigid_parts(
    scene: Scene, bodies: list[Body], net: BeamNet, first_node: int, notes: list[str]
) -> tuple[RigidPart, ...]:
    """Build all rigid bodies.

    Args:
        scene: The scene.
        bodies: Its deformable bodies, whose nodes may be attached.
        net: Its beams, whose nodes may be joined.
        first_node: Number of nodes of the scene before their frames.
        notes: List to which repairs are appended.

    Returns:
        The rigid bodies.

    Raises:
        SceneError: A free body floats in statics, or a node is attached to it and to another.
        MeshError: A surface cannot be used.
    """
    held = {
        entry.name for entry in scene.rigid_bodies
        if entry.motion != "free" or any(
            body.is_held and holds_still(body.mesh.node_positions[body.riding[entry.name]])
            for body in bodies if entry.name in body.riding
        )
    }  # fmt: skip
    held = held_bodies(scene, net, held)
    if scene.integration == "quasi_static":
        held = net.all_held(held)
    parts = []
    for index, (key, entry) in enumerate(scene.keyed("rigid_bodies")):
        if entry.name not in held and scene.integration == "quasi_static":
            raise scene.error(f"{key}.motion", "free",
                              f"{entry.name} floats: in quasi_static integration nothing gives it "
                              "an equilibrium; make the scene dynamic, the body guided, or attach "
                              "it to a soft body or join it to a beam or body that is held")
        node = first_node + 4 * index
        parts.append(_build_part(entry, index, node, bodies, scene, notes))
    _check_attached_once(parts, bodies, scene)
    return tuple(parts)


def held_bodies(scene: Scene, net: BeamNet, held: set[str]) -> set[str]:
    """What is held, by beams and by joints of rigid bodies too: names of rigid bodies and beams.

    Args:
        scene: The scene.
        net: Its beams.
        held: Names of rigid bodies that are held otherwise.
    """
    pairs = [{body.name, joint.to} for body in scene.rigid_bodies for joint in body.joined]
    before = -1
    while len(held) > before:
        before = len(held)
        held = net.reached(held).union(*(pair - {"world"} for pair in pairs if pair & (held | {"world"})))
    return held


def _build_part(entry, index: int, first_node: int, bodies, scene, notes) -> RigidPart:
    rotation = Rotation.from_euler("xyz", entry.rotation).as_matrix()
    shape = entry.shape.solid(scene.file_path, notes)
    centre, mass, inertia = np.zeros(3), 0.0, np.zeros((3, 3))
    attached, points = np.empty(0, np.int64), np.empty((0, 3))
    if entry.motion == "free":
        volume, centre, unit_inertia = shape.mass_properties()
        mass = entry.mass or entry.density * volume
        inertia = unit_inertia * (mass / volume)
        attached, points, masses = _attached_to(entry.name, bodies)
        points = (points - np.asarray(entry.position, float)) @ rotation
        mass, centre, inertia = _with_point_masses(mass, centre, inertia, masses, points)
        shape = entry.shape.moved(-centre).solid(scene.file_path, notes)
    corners, _ = triangulated(shape)
    local = points - centre
    radius = float(np.linalg.norm(np.vstack([corners, local]), axis=1).max())
    origin = np.asarray(entry.position, float) + rotation @ centre
    return RigidPart(
        entry.name, entry.motion == "free", origin, rotation, mass, inertia, radius,
        entry.damping, attached, local, entry=entry, index=index, first_node=first_node,
        centre_of_mass=centre, shape=shape,
    )  # fmt: skip


def _attached_to(name: str, bodies: list[Body]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes attached to a rigid body: indices, rest positions [m] and masses [kg]."""
    found = [(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0))]
    for body in bodies:
        if name in body.riding:
            nodes = body.riding[name]
            # Elements at attached nodes have lumped masses in every mass model; see `coupled_to`.
            masses = body.node_masses()[nodes]
            found.append((nodes + body.first_node, body.mesh.node_positions[nodes], masses))
    nodes, points, masses = (np.concatenate(column) for column in zip(*found, strict=True))
    return nodes, points, masses


def _with_point_masses(mass: float, centre, inertia, masses, points):
    """Mass [kg], centre [m] and inertia about it [kg m²] of a body and of points fixed to it."""
    if not len(masses):
        return mass, centre, inertia
    total = mass + masses.sum()
    common = (mass * centre + masses @ points) / total
    for own, arm in [(mass, centre - common), *zip(masses, points - common, strict=True)]:
        inertia = inertia + own * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return total, common, inertia


def _check_attached_once(parts: list[RigidPart], bodies: list[Body], scene: Scene) -> None:
    """Refuse nodes that are attached to a free rigid body and to another one."""
    free = {part.name for part in parts if part.is_free}
    for body in bodies:
        for name in free & set(body.riding):
            others = [nodes for other, nodes in body.riding.items() if other != name]
            shared = np.intersect1d(body.riding[name], np.concatenate([np.empty(0, int), *others]))
            if len(shared):
                raise scene.error(f"{body.key}.attached", f"{len(shared)} nodes",
                                  f"are attached to {name}, which moves by itself, and to another "
                                  "rigid body")


def frame_nodes(
    positions: np.ndarray, free_nodes: np.ndarray, free_index: np.ndarray,
    sizes: list[float], parts: tuple[RigidPart, ...], hinges: Hinges | None = None,
) -> Nodes:  # fmt: skip
    """Add the frame nodes of rigid bodies to all other nodes.

    Args:
        positions: The other nodes at rest [m], shape (n, 3).
        free_nodes: Those that move, shape (free,).
        free_index: Their unknowns, shape (n,).
        sizes: Sizes of the other bodies [m].
        parts: The rigid bodies.
        hinges: Joints of the hinged frames behind them; None without any.

    Returns:
        All nodes.
    """
    free = np.array([part.is_free for part in parts], bool)
    unknowns = len(free_nodes) + 2 * int(free.sum())
    radii = np.array([part.radius for part in parts])
    moving = [part for part in parts if part.is_free]
    attached = AttachedNodes(
        np.concatenate([np.empty(0, np.int64), *(part.attached for part in moving)]),
        np.repeat(np.arange(len(moving)), [len(part.attached) for part in moving]),
        np.concatenate([np.empty((0, 3)), *(part.local for part in moving)]),
    )
    rest = np.vstack([positions, RigidFrames.rest_nodes([(p.origin, p.rotation) for p in parts])])
    placed = len(positions), free, len(free_nodes)
    if hinges is None:
        frames = RigidFrames(*placed, unknowns, radii[free], attached)
    else:
        unknowns += len(hinges.parents)
        frames = HingedFrames(*placed, unknowns, hinges, radii[free], attached)
        rest = np.vstack([rest, frames.rest_nodes(frames.rest_poses(rest))])
    free_index[attached.nodes] = frames.attached_index()
    rest.setflags(write=False)
    return Nodes(
        rest, free_nodes, np.concatenate([free_index, frames.free_index()]), unknowns,
        max([*sizes, *(2.0 * radii)]), (frames,),
    )  # fmt: skip


class Layout(NamedTuple):
    """The bodies of a scene and their nodes.

    Attributes:
        scene: The scene.
        bodies: Its deformable bodies.
        rigid: Its rigid bodies, shape (rigid_body_count,).
        mass_nodes: Nodes of each mass-spring body, by its name.
        nodes: All nodes.
        vertebrae: Vertebrae of reduced bodies; their frames come after those of rigid bodies.
        superelements: Those of each reduced body, by its name.
        beams: Its beams.
        beam_frames: Frames of their nodes; they come after those of vertebrae.
        drawn: Positions of the nodes before mounting [m], shape (node_count, 3); None where the
            scene mounts nothing.
        is_held: Whether all deformable bodies are fixed somewhere, and a chain of beams leads from
            each beam to a frame that does not move by itself, or to a rigid body that deformable
            ones hold; a hinge or a ball joint holds a beam as well.
    """

    scene: Scene
    bodies: tuple[Body, ...]
    rigid: tuple
    mass_nodes: dict[str, np.ndarray]
    nodes: Nodes
    vertebrae: tuple[FramePart, ...] = ()
    superelements: dict[str, Superelements] = {}
    beams: tuple[BeamBody, ...] = ()
    beam_frames: tuple[FramePart, ...] = ()
    is_held: bool = True
    drawn: np.ndarray | None = None

    @property
    def drawn_positions(self) -> np.ndarray:
        """Positions of the nodes as drawn, where nothing is strained [m], shape (node_count, 3)."""
        return self.nodes.rest_positions if self.drawn is None else self.drawn

    @property
    def asked(self) -> dict[str, ReducedBody]:
        """The reduced bodies by name, for `lay_out`; empty where no term asks for points still."""
        return {body.name: body for body in of_kind(self.bodies, ReducedBody) if body.points is None}

    @property
    def framed(self) -> tuple:
        """All parts that have a frame: rigid bodies, vertebrae, then nodes of beams."""
        return (*self.rigid, *self.vertebrae, *self.beam_frames)

    @property
    def frames(self) -> RigidFrames:
        """Frames of the rigid bodies of a scene that has any."""
        return self.nodes.kinds[0]

    @property
    def hinged(self) -> HingedFrames | None:
        """The same frames where some are hinged to others; None without hinges."""
        frames = self.nodes.kinds[0] if self.nodes.kinds else None
        return frames if isinstance(frames, HingedFrames) else None

    def body_named(self, name: str | None):
        """The body of a name, of any kind; without a name the only deformable one.

        Args:
            name: Name of the body; None for the only deformable one.
        """
        if name is None:
            return self.bodies[0]
        return next(b for b in (*self.bodies, *self.rigid, *self.beams) if b.name == name)

    def carried(
        self, name: str | None, points, key: str, notes: list[str], spread_radius: float = 0.0,
        remedy: str = "",
    ) -> BarycentricMapping:
        """Map points onto a body.

        Args:
            name: The body; None for the only deformable one.
            points: Points at rest [m], shape (point_count, 3).
            key: Scene entry of the points, for errors.
            notes: List to which a warning for each snapped point is appended.
            spread_radius: See `carry`.
            remedy: See `carry`.

        Returns:
            The mapping.

        Raises:
            SceneError: A point is too far from a deformable body.
        """
        body = self.body_named(name)
        if isinstance(body, Body):
            return carry(body, points, key, self.scene, notes, spread_radius, remedy=remedy)
        return body.carried(points)

    def bodies_of(self, entry) -> list:
        """The body of an entry that may be `also_on` others, and then these, each once.

        Args:
            entry: An entry with keys `body` and `also_on`.
        """
        every = [b.name for b in (*self.bodies, *self.rigid, *self.beams)]
        names = [self.body_named(entry.body).name]
        for pattern in entry.also_on:
            names += matching(pattern, every)
        return [self.body_named(name) for name in dict.fromkeys(names)]

    def unreduced(self, name: str | None, key: str, remedy: str):
        """The body of a name, which is not reduced.

        Args:
            name: See `body_named`.
            key: Key of the entry that names it.
            remedy: What is not built on reduced bodies, for the error.

        Raises:
            SceneError: The body is reduced.
        """
        body = self.body_named(name)
        if isinstance(body, Body) and body.is_reduced:
            raise self.scene.error(f"{key}.body", body.name, f"is reduced: {remedy}")
        return body

    def carried_along(
        self, entry, points, key: str, notes: list[str], spread_radius: float = 0.0
    ) -> BarycentricMapping:
        """Map points onto the body of an entry, or onto the nearest where it is `also_on` others.

        Args:
            entry: See `bodies_of`.
            points: Points at rest [m], shape (point_count, 3).
            key: Scene entry of the points, for errors.
            notes: List to which a warning for each snapped point is appended.
            spread_radius: See `carry`.

        Raises:
            SceneError: A point is too far from a deformable body.
        """
        bodies = self.bodies_of(entry)
        if len(bodies) == 1:
            return self.carried(entry.body, points, key, notes, spread_radius)
        return self.carried_by_nearest(bodies, points, key, notes, spread_radius)

    def carried_by_nearest(
        self, bodies: list, points, key: str, notes: list[str], spread_radius: float = 0.0
    ) -> BarycentricMapping:
        """Map each point onto the nearest of several bodies, the first of those equally near.

        Args:
            bodies: The bodies, see `bodies_of`.
            points: Points at rest [m], shape (point_count, 3).
            key: Scene entry of the points, for errors.
            notes: List to which a warning for each snapped point is appended.
            spread_radius: See `carry`.

        Returns:
            The mapping.

        Raises:
            SceneError: A point is too far from a deformable body.
        """
        points = np.asarray(points, float).reshape(-1, 3)
        nearest = np.argmin([body.distances(points) for body in bodies], axis=0)
        mappings, places = [], []
        for index, body in enumerate(bodies):
            own = np.flatnonzero(nearest == index)
            if len(own):
                mappings.append(
                    carry(body, points[own], key, self.scene, notes, spread_radius, own).reduced()
                    if isinstance(body, Body) else body.carried(points[own]).reduced(NO_LEVER)
                )  # fmt: skip
                places.append(own)
        joined = reduce(BarycentricMapping.followed_by, mappings)
        order = np.argsort(np.concatenate(places))
        return BarycentricMapping(joined.nodes[order], joined.barycentric_weights[order])

    def in_world(self, name: str | None, frame: str, points) -> np.ndarray:
        """Points of an entry with its own frame, in the world [m], shape (count, 3).

        Args:
            name: Name of the body; None for the only deformable one.
            frame: ``world``, or ``mesh`` for coordinates of the body's mesh.
            points: The points [m], shape (count, 3).
        """
        if frame == "world":
            return np.asarray(points, float).reshape(-1, 3)
        return placed_in_world(self.body_named(name).entry, points)

    def mesh_among_nodes(self, body: Body):
        """A body's mesh, with nodes numbered among all nodes.

        Args:
            body: A body of this layout.
        """
        positions = self.drawn_positions
        if len(positions) == body.mesh.node_count:
            return body.mesh
        return body.mesh.renumbered(positions, body.first_node)


def lay_out(
    scene: Scene, notes: list[str], asked: dict[str, ReducedBody] = {},
    mounted: np.ndarray | None = None,
) -> Layout:  # fmt: skip
    """Read all bodies of a scene and number their nodes.

    Args:
        scene: The scene.
        notes: List to which repairs are appended.
        asked: The reduced bodies, by name, after their terms have asked for points; empty before,
            when all nodes of their meshes are points.
        mounted: Positions of all nodes of the mounted robot [m], shape (node_count, 3); None where
            the scene mounts nothing.

    Returns:
        The layout.

    Raises:
        MeshError: A mesh cannot be used.
        SceneError: An entry does not fit.
    """
    check_files(scene)
    check_walls_of_reduced(scene)
    net = BeamNet(scene)
    guided = {entry.name for entry in scene.rigid_bodies if entry.motion != "free"}
    held = held_bodies(scene, net, guided)
    bodies: list[Body] = []
    first_node = 0
    for key, entry in scene.keyed("deformables"):
        body = build_body(entry, key, first_node, scene, notes, held)
        if entry.name in asked:
            body = asked[entry.name].with_asked_points(first_node)
        elif entry.reduced:
            body = reduced_body(body, scene)
        bodies.append(body)
        if not entry.vertebrae:
            first_node += body.scene_node_count
    bodies = _with_vertebrae(bodies, scene, notes)
    positions = [body.rest_nodes() for body in bodies]
    held_nodes = [body.held_nodes() for body in bodies]
    fixed = [held.all(axis=1) for held in held_nodes]
    sizes = [size_of_body(body.mesh.node_positions, body.mesh.corner_mesh.as_tets)
             for body in bodies]  # fmt: skip
    mass_nodes = {}
    for entry in scene.mass_springs:
        mass_nodes[entry.name] = first_node + np.arange(len(entry.points))
        positions.append(np.asarray(entry.points, float))
        sizes.append(size_of_points(positions[-1]))
        fixed.append(np.isin(np.arange(len(entry.points)), entry.fixed))
        first_node += len(entry.points)
    rigid = build_rigid_parts(scene, bodies, net, first_node, notes)
    _note_unused_contact_surfaces(bodies, scene, notes)
    first_node += 4 * len(rigid)
    for index, body in enumerate(bodies):
        bodies[index] = body.placed(rigid, first_node)
        first_node += 4 * len(body.vertebrae)
    vertebrae = tuple(part for body in bodies for part in body.vertebrae)
    riders = {name for body in bodies for name in body.riding}
    is_held = all(body.is_held for body in bodies) and (
        {beam.name for beam in net.beams} <= held_bodies(scene, net, guided | riders))
    beams, beam_frames = net.placed(rigid, first_node), net.frame_parts()
    sizes += [size_of_points(beam.places) for beam in beams]
    framed, before = (*rigid, *vertebrae, *beam_frames), len(rigid) + len(vertebrae)
    hinges = net.hinges(framed, before, first_node - 4 * before) if net.pivots else None
    reduced = of_kind(bodies, ReducedBody)
    nodes = _with_held_axes(_number(positions, fixed, sizes, framed, hinges, reduced), held_nodes)
    if nodes.free_node_count == 0 and (scene.deformables or scene.mass_springs or beams):
        raise _nothing_moves(scene)
    drawn = nodes.rest_positions if scene.mounting else None
    if scene.mounting:
        nodes = _mounted(nodes, mounted, scene)
    superelements = {body.name: body.superelements(nodes, scene) for body in of_kind(bodies, VertebraBody)}
    return Layout(
        scene, tuple(bodies), rigid, mass_nodes, nodes, vertebrae, superelements, beams,
        beam_frames, is_held, drawn,
    )  # fmt: skip


def _mounted(nodes: Nodes, mounted: np.ndarray | None, scene: Scene) -> Nodes:
    """The nodes, at rest where they are mounted; angles of hinges count from there."""
    if mounted is None:
        raise scene.error("mounting", f"{len(scene.mounting)} stages",
                          "this is built for robots that rest as they are drawn only")
    mounted.setflags(write=False)
    kinds = tuple(kind.resting_at(mounted) if isinstance(kind, HingedFrames) else kind
                  for kind in nodes.kinds)  # fmt: skip
    return replace(nodes, rest_positions=mounted, kinds=kinds)


def check_files(scene: Scene) -> None:
    """Refuse missing files, including those of bodies without contact.

    Args:
        scene: The scene.

    Raises:
        SceneError: A file is missing; the error names its key and the searched place.
    """
    for key, name, file in values_below(scene):
        if name != "file" or file is None:
            continue
        path = file
        try:
            path = scene.file_path(file)
            if path.is_file():
                continue
            reason = "is a folder, not a file" if path.is_dir() else "there is no such file"
        except (OSError, ValueError) as error:  # a name too long, or with a null character
            reason = getattr(error, "strerror", None) or str(error)
        raise scene.error(key, str(file), f"{reason} ({path})")


def whole_layout(scene: Scene, bodies: list[Body]) -> Layout:
    """Deformable bodies before their nodes are numbered, to which points can be mapped.

    Args:
        scene: The scene.
        bodies: Its deformable bodies.
    """
    return Layout(scene, tuple(bodies), (), {}, None)


def walls_on(body: Body, whole: Layout, notes: list[str]) -> tuple[CavitySurface, ...]:
    """Walls of cavities on a body, on its own nodes.

    Args:
        body: The body, not reduced.
        whole: All bodies; see `whole_layout`.
        notes: List to which repairs and warnings are appended.
    """
    return tuple(
        cavity_wall(whole, cavity.name, wall, f"{key}.walls[{place}]", notes)
        for key, cavity in whole.scene.keyed("cavities") for place, wall in enumerate(cavity.walls)
        if whole.body_named(wall.body).name == body.name
    )  # fmt: skip


def _with_vertebrae(bodies: list[Body], scene: Scene, notes: list[str]) -> list[Body]:
    """The bodies, those with an entry of vertebrae carried by these."""
    own = [replace(body, first_node=0) for body in bodies]
    whole = whole_layout(scene, own)
    return [
        vertebra_body(alone, walls_on(alone, whole, notes), scene) if body.entry.vertebrae else body
        for body, alone in zip(bodies, own, strict=True)
    ]  # fmt: skip


def _note_unused_contact_surfaces(bodies: list[Body], scene: Scene, notes: list[str]) -> None:
    named = {name for touching in scene.touching for name in touching.pair}
    # A predefined point may omit its body if there is only one.
    points = scene.contact and scene.contact.points
    for body in bodies:
        if body.entry.contact_surface and body.name not in named and not points:
            notes.append(
                f"{body.key}.contact_surface is not used: contact.between names no pair with "
                f"{body.name}"
            )


def _nothing_moves(scene: Scene) -> SceneError:
    """The error of a scene whose bodies have no unknown."""
    key, what = "mass_springs", "all points are fixed"
    if scene.beams:
        key, what = "beams", "all nodes are fixed or joined to guided bodies"
    elif scene.deformables:
        key = "body.fixed" if scene.body else "bodies"
        what = "all nodes are fixed or attached"
    return scene.error(key, what, "nothing in the scene can move by itself")


def _number(
    positions: list[np.ndarray], fixed: list[np.ndarray], sizes: list[float], rigid: tuple,
    hinges: Hinges | None, reduced: tuple[ReducedBody, ...],
) -> Nodes:  # fmt: skip
    """Number the unknowns: the free nodes, in order."""
    held = np.concatenate([np.empty(0, bool), *fixed])
    free_nodes = np.flatnonzero(~held)
    free_index = np.full(len(held), -1, dtype=np.int64)
    free_index[free_nodes] = np.arange(len(free_nodes))
    rest = np.concatenate([np.empty((0, 3)), *positions])
    if rigid or hinges is not None:
        nodes = frame_nodes(rest, free_nodes, free_index, sizes, rigid, hinges)
    else:
        rest.setflags(write=False)
        # A single point has no size that could limit its displacement.
        size = max(sizes) or np.inf
        nodes = Nodes(rest, free_nodes, free_index, len(free_nodes), size)
    return _with_reduced_points(nodes, reduced) if reduced else nodes


def _with_held_axes(nodes: Nodes, held_nodes: list[np.ndarray]) -> Nodes:
    """The nodes, some of which are held along some axes: free nodes of bodies are the first unknowns."""
    free_axes = np.ones((nodes.free_node_count, 3))
    held = np.concatenate([np.empty((0, 3), bool), *held_nodes])
    own = ~held[~held.all(axis=1)]
    free_axes[: len(own)] = own
    return nodes if free_axes.all() else replace(nodes, free_axes=free_axes)


def _with_reduced_points(nodes: Nodes, reduced: tuple[ReducedBody, ...]) -> Nodes:
    """The nodes, the points of reduced bodies numbered after all other carried points."""
    index = nodes.free_index.copy()
    first = nodes.free_node_count + sum(len(kind.carried_unknowns) for kind in nodes.kinds)
    kinds = tuple(body.kind(index) for body in reduced)
    for body, kind in zip(reduced, kinds, strict=True):
        count = len(kind.carried_unknowns)
        index[body.first_point : body.first_point + count] = first + np.arange(count)
        first += count
    return replace(nodes, free_index=index, kinds=(*nodes.kinds, *kinds))
