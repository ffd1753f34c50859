"""Beams of a scene: their nodes at rest, the frames that these move with, and their elements.

A node of a beam has a frame of its own unless it is joined: then it moves with the frame of the
rigid body, or shares one frame with the nodes of other beams in the same place. So a joint is no
constraint and adds no unknown. A node on a hinge or a ball joint has a frame that its parent carries
(`mechanics/hinged_frames.py`), with one unknown.

Frames of nodes have no mass: it is that of the elements between them
(`mechanics/beam_masses.py`).

The surface of a beam is its cross-section, swept along its axis, with flat ends. Beams are shown by
it, and touch with it what has no simpler shape.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.mechanics.barycentric import NO_LEVER, BarycentricMapping
from softrobot_twin.mechanics.beam_masses import BeamMasses, element_masses, hermite
from softrobot_twin.mechanics.beam_sections import BeamSection, rectangle, tube
from softrobot_twin.mechanics.beams import BeamElements, element_stiffness, write_deformations
from softrobot_twin.mechanics.hinged_frames import WORLD as WORLD_FRAME
from softrobot_twin.mechanics.hinged_frames import Hinges
from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import Beam, BeamArc, BeamJoint, CrossSection
from softrobot_twin.scene.references import is_pattern, matching

# Nodes of beams that are joined lie in the same place, within this share of the beam's length.
SAME_PLACE = 1.0e-4
# The thickness direction must differ from the axis by at least this angle's sine.
LEAST_SINE = 1.0e-3
# What fixed ends are joined to.
WORLD = "world"
# Places at which a smooth curve is measured, for each element.
SUBDIVISION = 16
# At a corner of the axis the outline is moved to the plane between both sides, along the axis by
# no more than this many radii.
MOST_MITRE = 3.0


@dataclass(frozen=True)
class FramePart:
    """What moves with one frame, as a rigid body.

    Attributes:
        name: Its name, after that of its body, such as ``fetch.top``.
        is_free: False where it is fixed.
        origin: Origin of its frame at rest, the centre of its mass [m], shape (3,).
        rotation: From its frame to the world at rest, shape (3, 3).
        mass: Mass, including that of the attached nodes [kg].
        inertia: About the origin, in its frame [kg m²], shape (3, 3).
        radius: Distance of its furthest point from the origin [m].
        damping: α: drag by mass and inertia [1/s].
        attached: Nodes of soft bodies attached to it among all nodes, shape (attached_count,).
        local: Their positions in its frame [m], shape (attached_count, 3).
    """

    name: str
    is_free: bool
    origin: np.ndarray
    rotation: np.ndarray
    mass: float
    inertia: np.ndarray
    radius: float
    damping: float
    attached: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    local: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))


class Carriers(NamedTuple):
    """What the nodes of a beam move with.

    Attributes:
        frame_nodes: Origin node of the frame of each node, shape (node_count,).
        local_places: Place of each node in its frame [m], shape (node_count, 3).
        local_axes: Rotation from the axes of each node to its frame, shape (node_count, 3, 3).
        hinges: Index of the hinge whose frame it is, -1 for another frame, shape (node_count,).
    """

    frame_nodes: np.ndarray
    local_places: np.ndarray
    local_axes: np.ndarray
    hinges: np.ndarray


class Pivot(NamedTuple):
    """A node of a beam on a hinge or a ball joint.

    Attributes:
        beam: The beam.
        node: Its node.
        key: Key of the joint in the scene.
        joint: The joint's entry.
        other: Node of another beam that carries it, among the nodes of all beams; -1 where a rigid
            body or the world does.
    """

    beam: BeamBody
    node: int
    key: str
    joint: BeamJoint
    other: int

    @property
    def place(self) -> np.ndarray:
        """Where it turns, at rest [m], shape (3,)."""
        through = self.joint.through
        return self.beam.places[self.node] if through is None else np.array(through)


class Carrier(NamedTuple):
    """What a node of a beam moves with.

    Attributes:
        kind: ``body``, ``frame`` or ``hinge``.
        which: Name of a rigid body, or `WORLD`; index of a frame of beams, or of a pivot.
    """

    kind: str
    which: str | int


@dataclass(frozen=True)
class BeamBody:
    """A beam of a scene.

    Attributes:
        entry: Its entry in the scene.
        index: Its index among the beams.
        section: Its cross-section at the start.
        places: Its nodes at rest [m], shape (node_count, 3).
        axes: Axes of the cross-section at each node at rest, as columns: tangent, y, z, shape
            (node_count, 3, 3).
        element_axes: Those at both ends of each element, which differ at corners, shape
            (element_count, 2, 3, 3).
        lengths: Length of each element at rest, along its curve [m], shape (element_count,).
        point_nodes: Node at each point of the entry, shape (point_count,); beyond the first and the last
            may lie those of an arc.
        carriers: What its nodes move with; None until the frames are numbered.
    """

    entry: Beam
    index: int
    section: BeamSection
    places: np.ndarray
    axes: np.ndarray
    element_axes: np.ndarray
    lengths: np.ndarray
    point_nodes: np.ndarray
    carriers: Carriers | None = None

    @property
    def name(self) -> str:
        """The beam's name."""
        return self.entry.name

    @property
    def key(self) -> str:
        """Key of its entry in the scene."""
        return f"beams[{self.index}]"

    @property
    def node_count(self) -> int:
        """Number of its nodes."""
        return len(self.places)

    @property
    def mass(self) -> float:
        """Its mass [kg]."""
        a, b = self.scales.T
        areas = self.section.area * (a * a + a * b + b * b) / 3.0
        return float(self.entry.material.density * (areas * self.lengths).sum())

    @property
    def scales(self) -> np.ndarray:
        """Size of the section at both ends of each element, by that at the start, shape
        (element_count, 2).
        """
        along = np.concatenate([[0.0], np.cumsum(self.lengths)]) / self.lengths.sum()
        sizes = 1.0 + along * (self.entry.section.end_scale - 1.0)
        return np.column_stack([sizes[:-1], sizes[1:]])

    @property
    def radius(self) -> float:
        """Distance of the furthest point of its sections from the axis [m]."""
        return self.section.radius * max(1.0, self.entry.section.end_scale)

    @property
    def node_lengths(self) -> np.ndarray:
        """Half of the length of the elements at each node [m], shape (node_count,)."""
        shares = np.zeros(self.node_count)
        shares[:-1] += 0.5 * self.lengths
        shares[1:] += 0.5 * self.lengths
        return shares

    def node_at(self, at: str | int) -> int:
        """The node at ``start``, ``end``, or at a point of the entry.

        Args:
            at: ``start``, ``end``, or the number of a point of the entry.
        """
        ends = {"start": 0, "end": self.node_count - 1}
        return ends[at] if isinstance(at, str) else int(self.point_nodes[at])

    @property
    def is_round(self) -> bool:
        """Whether it touches as a round body, of the radius of its section."""
        section = self.entry.section
        return not section.rectangle and section.end_scale == 1.0

    def axis_in_frames(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The axis at both ends of each element, in the frames that these move with.

        Returns:
            Origin nodes of the frames, shape (element_count, 2), places of the ends [m], and
            tangents there times the element's length [m], both of shape (element_count, 2, 3).
        """
        first = np.arange(len(self.lengths))
        ends = np.column_stack([first, first + 1])
        c, tangents = self.carriers, self.element_axes[:, :, :, 0]
        own = np.einsum("enji,enj->eni", self.axes[ends], tangents)
        local = np.einsum("enij,enj->eni", c.local_axes[ends], own) * self.lengths[:, None, None]
        return c.frame_nodes[ends], c.local_places[ends], local

    def nodes_mapping(self) -> BarycentricMapping:
        """Its nodes as points."""
        return _on_frames(self.carriers.frame_nodes, self.carriers.local_places)

    def carried(self, points) -> BarycentricMapping:
        """Map points that move with it; each is carried by the nearest element.

        Args:
            points: In the world, at rest [m], shape (point_count, 3).

        Returns:
            Their mapping onto frame nodes; see `carried_by`.
        """
        points = np.asarray(points, float).reshape(-1, 3)
        element, share, _ = self.nearest(points)
        return self.carried_by(element, share, points)

    def axis_at(self, elements, shares) -> np.ndarray:
        """Places on the axis at rest, Hermite's cubic between the ends of elements.

        Args:
            elements: Element of each place, shape (count,).
            shares: Where along it, 0 to 1, shape (count,).

        Returns:
            Places in the world [m], shape (count, 3).
        """
        length = self.lengths[elements]
        return sum(
            place[:, None] * self.places[elements + end]
            + (along * length)[:, None] * self.element_axes[elements, end, :, 0]
            for end, place, along, _ in hermite(np.asarray(shares, float))
        )

    def carried_by(self, elements, shares, points) -> BarycentricMapping:
        """Map points onto the frames of both ends of given elements.

        The axis between the ends is Hermite's cubic through both, so that a load on it acts at
        the ends as it does on Euler's beam. What lies off the axis turns with the ends, in shares
        that change linearly along the element. A point at a node moves with that node's frame.

        Args:
            elements: Element of each point, shape (point_count,).
            shares: Where along it, 0 to 1, shape (point_count,).
            points: In the world, at rest [m], shape (point_count, 3).

        Returns:
            Their mapping, onto at most eight frame nodes each.
        """
        axis, ends = self.axis_at(elements, shares), hermite(np.asarray(shares, float))
        length = self.lengths[elements]
        nodes, weights = [], []
        for end, place, along, turn in ends:
            node = elements + end
            off = (along * length)[:, None] * self.element_axes[elements, end, :, 0]
            off = off + turn[:, None] * (points - axis)
            own = np.einsum("nji,nj->ni", self.axes[node], off)
            local = place[:, None] * self.carriers.local_places[node]
            local += np.einsum("nij,nj->ni", self.carriers.local_axes[node], own)
            nodes.append(self.carriers.frame_nodes[node][:, None] + np.arange(4))
            weights.append(np.column_stack([place - local.sum(axis=1), local]))
        return BarycentricMapping(np.hstack(nodes), np.hstack(weights)).reduced(NO_LEVER)

    def distances(self, points) -> np.ndarray:
        """Distances of points at rest from it, zero inside [m]; points (count, 3).

        It counts as a round bar that contains its cross-section.

        Args:
            points: Places in the world [m], shape (count, 3).
        """
        points = np.asarray(points, float).reshape(-1, 3)
        return np.maximum(self.nearest(points)[2] - self.section.radius, 0.0)

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Element that is nearest to each point, share along it, and distance from its chord [m].

        Args:
            points: In the world, at rest [m], shape (point_count, 3).

        Returns:
            Each of shape (point_count,).
        """
        starts, chords = self.places[:-1], np.diff(self.places, axis=0)
        offsets = points[:, None, :] - starts
        shares = np.einsum("pei,ei->pe", offsets, chords) / np.sum(chords**2, axis=1)
        shares = np.clip(shares, 0.0, 1.0)
        distances = np.linalg.norm(offsets - shares[:, :, None] * chords, axis=2)
        element = np.argmin(distances, axis=1)
        own = np.arange(len(points))
        return element, shares[own, element], distances[own, element]

    def elements(self, rest_positions: np.ndarray, frames: RigidFrames) -> BeamElements:
        """Its elements; their rest shape is that of the beam at rest.

        Args:
            rest_positions: Node positions of the scene at rest [m], shape (node_count, 3).
            frames: The frames of the scene.
        """
        ends = np.column_stack([np.arange(len(self.lengths)), np.arange(1, self.node_count)])
        c = self.carriers
        # From the axes of an end to those of its node, to the frame.
        own = np.einsum("ekji,ekjl->ekil", self.axes[ends], self.element_axes)
        end_axes = np.einsum("ekij,ekjl->ekil", c.local_axes[ends], own)
        origins = c.frame_nodes[ends]
        rest = np.empty((len(ends), 6))
        write_deformations(np.array(rest_positions), origins, c.local_places[ends], end_axes, rest)
        material = self.entry.material
        return BeamElements(
            origins, frames.unknowns_of(origins.ravel()).reshape(-1, 2), c.local_places[ends],
            end_axes, rest,
            element_stiffness(
                self.lengths, self.section.tapered(self.scales), material.young_modulus, material.poisson_ratio
            ),
            np.full(len(ends), self.entry.damping.stiffness),
        )  # fmt: skip


def _on_frames(frame_nodes: np.ndarray, local: np.ndarray) -> BarycentricMapping:
    """Points that are constant in frames, on the frame nodes."""
    weights = np.column_stack([1.0 - local.sum(axis=1), local])
    return BarycentricMapping(frame_nodes[:, None] + np.arange(4), weights)


def all_elements(
    beams: tuple[BeamBody, ...], rest_positions: np.ndarray, frames: RigidFrames
) -> tuple[BeamElements, BeamMasses]:
    """The elements of all beams of a scene, see `BeamBody.elements`, and their mass."""
    elements = [beam.elements(rest_positions, frames) for beam in beams]
    masses = [
        element_masses(
            own, beam.lengths, beam.section, beam.entry.material.density, beam.entry.damping.mass,
            beam.scales,
        )
        for beam, own in zip(beams, elements, strict=True)
    ]
    return tuple(
        kind(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        for kind, parts in ((BeamElements, elements), (BeamMasses, masses))
    )


# --- the shape at rest ----------------------------------------------------------------------------


def build_section(entry: CrossSection, poisson_ratio: float) -> BeamSection:
    """Constants of the cross-section that an entry describes.

    Args:
        entry: The entry.
        poisson_ratio: ν of the material [-].
    """
    if entry.rectangle:
        given, own = entry.rectangle, rectangle(
            entry.rectangle.thickness, entry.rectangle.width, poisson_ratio)
        shear = own.shear_area_y if given.shear_factor is None else given.shear_factor * own.area
        return own._replace(torsion=given.torsion or own.torsion, shear_area_y=shear, shear_area_z=shear)
    if entry.circle:
        return tube(entry.circle.radius, 0.0, poisson_ratio)
    if entry.tube:
        return tube(entry.tube.radius, entry.tube.radius - entry.tube.wall, poisson_ratio)
    given = entry.constants
    drawn = tube(given.radius or float(np.sqrt(given.area / np.pi)), 0.0, poisson_ratio)
    shear_y, shear_z = (
        5.0 / 6.0 * given.area if value is None else value
        for value in (given.shear_area_y, given.shear_area_z)
    )
    return BeamSection(
        given.area, given.inertia_y, given.inertia_z, given.torsion, shear_y, shear_z,
        drawn.outline,
    )  # fmt: skip


def build_beam(entry: Beam, index: int, scene: Scene) -> BeamBody:
    """Place the nodes of a beam along its path.

    Args:
        entry: Its entry in the scene.
        index: Its index among the beams.
        scene: The scene.

    Raises:
        SceneError: The thickness direction lies along the axis.
    """
    points = np.array(entry.points, float)
    counts = _elements_of_spans(np.linalg.norm(np.diff(points, axis=0), axis=1), entry.elements)
    point_nodes = np.concatenate([[0], np.cumsum(counts)])
    if entry.curve == "smooth" and len(points) > 2:
        places, tangents, lengths = _smooth_path(points, counts)
        axes = _section_axes(places, tangents, entry, index, scene)
        element_axes = np.stack([axes[:-1], axes[1:]], axis=1)
    else:
        places = np.concatenate([
            points[:1],
            *(a + np.arange(1, n + 1)[:, None] / n * (b - a)
              for a, b, n in zip(points, points[1:], counts, strict=False)),
        ])  # fmt: skip
        chords = np.diff(places, axis=0)
        lengths = np.linalg.norm(chords, axis=1)
        tangents = chords / lengths[:, None]
        of_elements = _section_axes(places[:-1], tangents, entry, index, scene)
        element_axes = np.repeat(of_elements[:, None], 2, axis=1)
        axes = np.concatenate([of_elements, of_elements[-1:]])
    section = build_section(entry.section, entry.material.poisson_ratio)
    body = BeamBody(entry, index, section, places, axes, element_axes, lengths, point_nodes.astype(np.int64))
    for k, arc in enumerate(entry.arcs):
        body = _with_arc(body, arc, scene, f"{body.key}.arcs[{k}].towards")
    return body


def _with_arc(beam: BeamBody, arc: BeamArc, scene: Scene, key: str) -> BeamBody:
    """A beam with an arc at one of its ends.

    Raises:
        SceneError: The centre lies along the axis.
    """
    is_end = arc.at == "end"
    place, axes = (beam.places[-1], beam.axes[-1]) if is_end else (beam.places[0], beam.axes[0])
    outwards = axes[:, 0] if is_end else -axes[:, 0]
    towards = np.array(arc.towards) / np.linalg.norm(arc.towards)
    across = towards - (towards @ outwards) * outwards
    if np.linalg.norm(across) < LEAST_SINE:
        raise scene.error(key, list(arc.towards), f"lies along the axis of {beam.name}: it must point across")
    across /= np.linalg.norm(across)
    turns = Rotation.from_rotvec(np.outer(
        np.arange(arc.elements + 1) / arc.elements * arc.angle, np.cross(outwards, across))).as_matrix()
    from_centre = turns @ (-arc.radius * across)
    places, nodes = place + arc.radius * across + from_centre, turns @ axes
    lengths = np.full(arc.elements, arc.radius * arc.angle / arc.elements)
    of_elements = np.stack([nodes[:-1], nodes[1:]], axis=1)
    if is_end:
        return replace(beam, places=np.concatenate([beam.places, places[1:]]),
                       axes=np.concatenate([beam.axes, nodes[1:]]),
                       element_axes=np.concatenate([beam.element_axes, of_elements]),
                       lengths=np.concatenate([beam.lengths, lengths]))  # fmt: skip
    return replace(beam, places=np.concatenate([places[:0:-1], beam.places]),
                   axes=np.concatenate([nodes[:0:-1], beam.axes]),
                   element_axes=np.concatenate([of_elements[::-1, ::-1], beam.element_axes]),
                   lengths=np.concatenate([lengths, beam.lengths]),
                   point_nodes=beam.point_nodes + arc.elements)  # fmt: skip


def _elements_of_spans(lengths: np.ndarray, count: int) -> np.ndarray:
    """Elements between two points each, at least one, in proportion to the length."""
    counts = np.ones(len(lengths), np.int64)
    for _ in range(count - len(lengths)):
        counts[np.argmax(lengths / counts)] += 1
    return counts


def _smooth_path(points, counts) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, unit tangents and lengths of elements along a cubic spline through points."""
    from scipy.interpolate import CubicSpline  # it loads slowly

    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    curve = CubicSpline(knots, points)
    parameters, lengths = [knots[:1]], []
    for start, end, count in zip(knots, knots[1:], counts, strict=False):
        fine = np.linspace(start, end, SUBDIVISION * int(count) + 1)
        along = _arc_lengths(curve, fine)
        wanted = along[-1] * np.arange(1, count + 1) / count
        parameters.append(np.interp(wanted, along, fine))
        lengths.append(np.full(int(count), along[-1] / count))
    parameters = np.concatenate(parameters)
    tangents = curve(parameters, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    return curve(parameters), tangents, np.concatenate(lengths)


def _arc_lengths(curve, parameters: np.ndarray) -> np.ndarray:
    """Length of a curve from the first parameter to each, by Gauss's rule of three points."""
    half = 0.5 * np.diff(parameters)
    middle = parameters[:-1] + half
    total = np.zeros(len(half))
    for place, weight in ((-np.sqrt(0.6), 5.0 / 9.0), (0.0, 8.0 / 9.0), (np.sqrt(0.6), 5.0 / 9.0)):
        total += weight * half * np.linalg.norm(curve(middle + place * half, 1), axis=1)
    return np.concatenate([[0.0], np.cumsum(total)])


def _section_axes(places, tangents, entry: Beam, index: int, scene: Scene) -> np.ndarray:
    """Tangent, y and z at each place, as columns, shape (count, 3, 3)."""
    if not entry.thickness_direction:
        across = _transported(tangents)
    else:
        wanted = np.array(entry.thickness_direction) / np.linalg.norm(entry.thickness_direction)
        across = wanted - (tangents @ wanted)[:, None] * tangents
        sines = np.linalg.norm(across, axis=1)
        if sines.min() < LEAST_SINE:
            place = places[int(np.argmin(sines))]
            raise scene.error(f"beams[{index}].thickness_direction",
                              list(entry.thickness_direction),
                              f"lies along the axis of {entry.name} at "
                              f"{np.round(place, 6).tolist()} m: it must point across")
        across = across / sines[:, None]
    return np.stack([tangents, across, np.cross(tangents, across)], axis=2)


def _transported(tangents: np.ndarray) -> np.ndarray:
    """Directions across a path that turn about it as little as possible, shape (count, 3)."""
    across = np.empty_like(tangents)
    start = np.eye(3)[int(np.argmin(np.abs(tangents[0])))]
    for k, tangent in enumerate(tangents):
        own = (start if k == 0 else across[k - 1])
        own = own - (own @ tangent) * tangent
        if np.linalg.norm(own) < LEAST_SINE:  # a corner of 90 degrees
            own = np.cross(tangent, np.eye(3)[int(np.argmin(np.abs(tangent)))])
        across[k] = own / np.linalg.norm(own)
    return across


# --- joints ---------------------------------------------------------------------------------------


class BeamNet:
    """The beams of a scene, and which of their nodes share a frame.

    Attributes:
        beams: The beams.
        carriers: What each node of all beams moves with.
        pivots: Nodes on hinges and ball joints; nodes that are joined rigidly share one.
        is_fixed: Whether each frame is fixed, shape (frame_count,).
        representatives: Beam and node whose place and axes each frame has.
    """

    def __init__(self, scene: Scene):
        """Place all beams, and follow their joints.

        Args:
            scene: The scene.

        Raises:
            SceneError: A joint does not fit.
        """
        self._scene = scene
        self.beams = tuple(build_beam(b, k, scene) for k, b in enumerate(scene.beams))
        self._firsts = np.concatenate([[0], np.cumsum([b.node_count for b in self.beams])])
        count = int(self._firsts[-1])
        self._joined_to: list[str | None] = [None] * count
        self._pivots: dict[int, Pivot] = {}
        pairs = np.array(list(self._joints()), np.int64).reshape(-1, 2)
        self._group = connected_pieces(*pairs.T, count)
        self._number_frames()
        self._check_elements()

    def _joints(self) -> Iterator[tuple[int, int]]:
        """Pairs of nodes that are joined; nodes on rigid bodies are noted."""
        named = {beam.name: beam for beam in self.beams}
        for beam in self.beams:
            for index, joint in enumerate(beam.entry.joined):
                node, key = beam.node_at(joint.at), f"{beam.key}.joined[{index}]"
                joint = self._with_nearest(joint, beam, beam.places[node])
                place, other = self._number(beam, node), -1
                if joint.to in named and joint.to_at is not None:
                    other = self._number(named[joint.to], self._node_named(named[joint.to], joint, key))
                elif joint.to in named:
                    other = self._node_in_place(beam, node, named[joint.to], key)
                elif joint.to_at is not None:
                    raise self._scene.error(f"{key}.to_at", joint.to_at,
                                            f"is a point of a beam, and {joint.to} is none")
                if joint.by != "rigid":
                    if place in self._pivots:
                        raise self._two_carriers(self._pivots[place], key)
                    self._pivots[place] = Pivot(beam, node, key, joint, other)
                elif other >= 0:
                    yield place, other
                else:
                    if self._joined_to[place] not in (None, joint.to):
                        raise self._two_bodies(beam, key, self._joined_to[place], joint.to)
                    self._joined_to[place] = joint.to

    def _with_nearest(self, joint: BeamJoint, beam: BeamBody, place: np.ndarray) -> BeamJoint:
        """A joint with the nearest body in place of a pattern."""
        if not is_pattern(joint.to):
            return joint
        near = {
            other.name: float(np.linalg.norm(other.places - place, axis=1).min())
            for other in self.beams if other is not beam
        }  # fmt: skip
        for rigid in self._scene.rigid_bodies:
            near[rigid.name] = float(np.linalg.norm(np.asarray(rigid.position) - place))
        nearest = min(matching(joint.to, list(near)), key=near.__getitem__)
        return joint.model_copy(update={"to": nearest})

    def _number(self, beam: BeamBody, node: int) -> int:
        return int(self._firsts[beam.index]) + node

    def _node_named(self, other: BeamBody, joint: BeamJoint, key: str) -> int:
        """The node of another beam that a joint names."""
        points = len(other.entry.points)
        if isinstance(joint.to_at, int) and joint.to_at >= points:
            raise self._scene.error(f"{key}.to_at", joint.to_at,
                                    f"{other.name} has the points 0 to {points - 1}")
        return other.node_at(joint.to_at)

    def _node_in_place(self, beam: BeamBody, node: int, other: BeamBody, key: str) -> int:
        place = beam.places[node]
        distances = np.linalg.norm(other.places - place, axis=1)
        nearest = int(np.argmin(distances))
        if distances[nearest] > SAME_PLACE * max(beam.lengths.sum(), other.lengths.sum()):
            raise self._scene.error(f"{key}.to", other.name,
                                    f"has no node at {np.round(place, 6).tolist()}: its nearest "
                                    f"one is {distances[nearest]:.4g} m away; beams are joined at "
                                    "nodes in the same place", unit="m")
        return self._number(other, nearest)

    def _two_bodies(self, beam: BeamBody, key: str, first: str, second: str) -> SceneError:
        return self._scene.error(key, f"{first}, {second}",
                                 f"a node of {beam.name} is joined to both: it can move with one "
                                 "of them only")

    def _two_carriers(self, pivot: Pivot, key: str) -> SceneError:
        return self._scene.error(key, pivot.beam.name,
                                 f"a node of {pivot.beam.name} is on a {_noun(pivot)} "
                                 f"({pivot.key}), which alone carries it: it cannot be fixed or "
                                 "joined to another carrier too")

    def _number_frames(self) -> None:
        """One frame for each group of nodes that is not on a rigid body."""
        scene, nodes = self._scene, [(b, k) for b in self.beams for k in range(b.node_count)]
        fixed = np.zeros(len(nodes), bool)
        for beam in self.beams:
            for end in beam.entry.fixed:
                fixed[self._number(beam, beam.node_at(end))] = True
        self.carriers = [Carrier("frame", -1)] * len(nodes)
        fixed_frames, self.representatives, pivots = [], [], []
        _, first, members = np.unique(self._group, return_index=True, return_inverse=True)
        order = np.argsort(first)
        by_group = np.split(np.argsort(members, kind="stable"), np.cumsum(np.bincount(members)))
        for group in order:
            own = by_group[group]
            bodies = sorted({self._joined_to[n] for n in own} - {None})
            beam, node = nodes[own[0]]
            if len(bodies) > 1:
                raise self._two_bodies(beam, f"{beam.key}.joined", *bodies[:2])
            hinged = [self._pivots[n] for n in own if n in self._pivots]
            if hinged:
                if bodies or fixed[own].any() or len(hinged) > 1:
                    raise self._two_carriers(hinged[0], hinged[-1].key)
                carrier = Carrier("hinge", len(pivots))
                pivots.append(hinged[0])
            elif bodies:
                if fixed[own].any():
                    raise scene.error(f"{beam.key}.fixed", bodies[0],
                                      f"an end of {beam.name} that is joined to {bodies[0]} cannot "
                                      "be fixed too")
                carrier = Carrier("body", bodies[0])
            else:
                carrier = Carrier("frame", len(fixed_frames))
                fixed_frames.append(bool(fixed[own].any()))
                self.representatives.append((beam, node))
            for n in own:
                self.carriers[n] = carrier
        self.is_fixed = np.array(fixed_frames, bool)
        self.pivots = tuple(pivots)
        self._parents = [self._parent(pivot) for pivot in pivots]

    def _parent(self, pivot: Pivot) -> Carrier:
        """What carries a hinge: a rigid body, the world, or a frame of a beam."""
        if pivot.other < 0:
            return Carrier("body", pivot.joint.to)
        carrier = self.carriers[pivot.other]
        if carrier.kind == "hinge":
            there = self.pivots[carrier.which]
            raise self._scene.error(f"{pivot.key}.to", pivot.joint.to,
                                    f"is on a {_noun(there)} itself there ({there.key}): join both "
                                    f"beams to what carries it, {there.joint.to}")
        return carrier

    def _carriers_of(self, beam: BeamBody) -> list[Carrier]:
        """What each node of a beam moves with."""
        return self.carriers[self._firsts[beam.index] : self._firsts[beam.index + 1]]

    def _check_elements(self) -> None:
        """Refuse elements both of whose ends move with one frame."""
        for beam in self.beams:
            for a, b in pairwise(self._carriers_of(beam)):
                if a == b:
                    raise self._scene.error(f"{beam.key}.elements", beam.entry.elements,
                                            f"both ends of an element of {beam.name} move with the "
                                            "same frame; more elements are needed between two "
                                            "joints")

    def frame_parts(self) -> tuple[FramePart, ...]:
        """The frames of nodes, by their order; their mass is that of the elements."""
        radius = np.zeros(len(self.is_fixed))
        for beam in self.beams:
            reaches = beam.node_lengths + beam.radius
            for k, ((kind, which), reach) in enumerate(zip(self._carriers_of(beam), reaches, strict=True)):
                if kind == "frame":
                    base, node = self.representatives[which]
                    arm = np.linalg.norm(_apart(beam, k, base.places[node]))
                    radius[which] = max(radius[which], arm + reach)
        return tuple(
            FramePart(
                f"{beam.name}.{node}", not self.is_fixed[f], beam.places[node], beam.axes[node],
                0.0, np.zeros((3, 3)), float(radius[f]), 0.0,
            )
            for f, (beam, node) in enumerate(self.representatives)
        )

    def placed(self, rigid: tuple, first_frame_node: int) -> tuple[BeamBody, ...]:
        """The beams with their carriers.

        Args:
            rigid: The rigid bodies.
            first_frame_node: First frame node of the frames of beams.
        """
        bodies = {part.name: part for part in rigid}
        return tuple(replace(beam, carriers=self._placed(beam, bodies, first_frame_node))
                     for beam in self.beams)  # fmt: skip

    def _placed(self, beam: BeamBody, bodies: dict, first_frame_node: int) -> Carriers:
        """Where the nodes of a beam are on what carries them; see `placed`."""
        own = self._carriers_of(beam)
        nodes, places = np.empty(len(own), np.int64), np.zeros((len(own), 3))
        axes = np.empty((len(own), 3, 3))
        for k, (kind, which) in enumerate(own):
            if kind == "body":
                part = bodies[which]
                nodes[k], rotation = part.first_node, part.rotation
                places[k] = rotation.T @ (beam.places[k] - part.origin)
            else:
                is_hinge = kind == "hinge"
                base, node = self.pivots[which][:2] if is_hinge else self.representatives[which]
                nodes[k] = first_frame_node + 4 * (which + is_hinge * len(self.is_fixed))
                rotation = base.axes[node]
                centre = self.pivots[which].place if is_hinge else base.places[node]
                places[k] = rotation.T @ _apart(beam, k, centre)
            axes[k] = rotation.T @ beam.axes[k]
            if kind == "frame" and base is beam and node == k:
                axes[k] = np.eye(3)
        hinges = np.array([which if kind == "hinge" else -1 for kind, which in own], np.int64)
        return Carriers(nodes, places, axes, hinges)

    def hinges(self, framed: tuple, first_beam_frame: int, first_frame_node: int) -> Hinges:
        """The joints of hinged frames with their parents.

        Args:
            framed: All parts with a frame; see `Layout.framed`.
            first_beam_frame: Place of the first frame of a beam among them.
            first_frame_node: Origin node of the first of them.
        """
        places = {part.name: k for k, part in enumerate(framed[:first_beam_frame])}
        free = np.cumsum([part.is_free for part in framed]) - 1
        count = len(self.pivots)
        parents, free_parents = np.full((2, count), WORLD_FRAME, np.int64)
        points, axes = np.empty((count, 3)), np.zeros((count, 3))
        rotations, radii = np.empty((count, 3, 3)), np.empty(count)
        for h, (pivot, parent) in enumerate(zip(self.pivots, self._parents, strict=True)):
            origin, rotation = np.zeros(3), np.eye(3)
            if parent.which != WORLD:
                is_body = parent.kind == "body"
                k = places[parent.which] if is_body else first_beam_frame + parent.which
                origin, rotation = framed[k].origin, framed[k].rotation
                parents[h] = first_frame_node + 4 * k
                free_parents[h] = free[k] if framed[k].is_free else -1
            beam, node = pivot.beam, pivot.node
            points[h] = rotation.T @ (pivot.place - origin)
            rotations[h] = rotation.T @ beam.axes[node]
            arm = float(np.linalg.norm(beam.places[node] - pivot.place))
            radii[h] = arm + beam.node_lengths[node] + beam.radius
            if pivot.joint.axis:
                axis = np.array(pivot.joint.axis) / np.linalg.norm(pivot.joint.axis)
                axes[h] = beam.axes[node].T @ axis
        return Hinges(parents, free_parents, points, rotations, axes, radii)

    def reached(self, held: set[str]) -> set[str]:
        """What is held by beams, from the world or from rigid bodies on, and these bodies.

        Args:
            held: Names of rigid bodies that are held otherwise.
        """
        reached, near = set(held), {beam.name: self._neighbours(beam) for beam in self.beams}
        before = -1
        while len(reached) > before:
            before = len(reached)
            for beam in self.beams:
                if near[beam.name] & (reached | {WORLD}):
                    reached |= {beam.name} | near[beam.name]
        return reached

    def all_held(self, held: set[str]) -> set[str]:
        """Rigid bodies that are held, those held by beams included; refuses beams that float.

        Args:
            held: Names of rigid bodies that are guided, or attached to soft bodies that are held.

        Raises:
            SceneError: A beam is joined to nothing that is held.
        """
        reached = self.reached(held)
        for beam in self.beams:
            if beam.name not in reached:
                raise self._scene.error(beam.key, beam.name,
                                        "floats: in quasi_static integration one of its ends must "
                                        "be fixed, or joined to a body that is held")
        return reached

    def _neighbours(self, beam: BeamBody) -> set[str]:
        """Names of bodies and beams joined to a beam, and `WORLD` where it is fixed or hinged to it.
        """
        own = self._held_by(beam)
        near = {name for kind, name in own if kind == "body"}
        for other in self.beams:
            if other is not beam and own & self._held_by(other):
                near.add(other.name)
        if any(kind == "frame" and self.is_fixed[frame] for kind, frame in own):
            near.add(WORLD)
        return near

    def _held_by(self, beam: BeamBody) -> set[Carrier]:
        """Bodies, frames and hinges that the nodes of a beam move with, and parents of the hinges.
        """
        own = self._carriers_of(beam)
        return {*own, *(self._parents[which] for kind, which in own if kind == "hinge")}


def _apart(beam: BeamBody, node: int, centre: np.ndarray) -> np.ndarray:
    """From the origin of its frame to a node [m]; zero where both are one place but for rounding."""
    apart = beam.places[node] - centre
    return apart if np.linalg.norm(apart) > SAME_PLACE * beam.lengths.sum() else np.zeros(3)


def _noun(pivot: Pivot) -> str:
    """What a pivot is called in messages."""
    return "hinge" if pivot.joint.by == "hinge" else "ball joint"


def swept_surface(beam: BeamBody, pieces: int = 1) -> tuple[BarycentricMapping, np.ndarray]:
    """Sweep the outline of a beam's section along it.

    Args:
        beam: The beam.
        pieces: Pieces that each element is divided into.

    Returns:
        Points of a closed surface on the frames of the beam's nodes, an outline at each end of a
        piece and a point in the middle of both ends; and triangles, indices of points, outward,
        shape (triangle_count, 3).
    """
    elements = np.repeat(np.arange(len(beam.lengths)), pieces)
    shares = np.tile(np.arange(pieces) / pieces, len(beam.lengths))
    elements, shares = np.append(elements, elements[-1]), np.append(shares, 1.0)
    count, size = len(elements), len(beam.section.outline)
    centres = beam.axis_at(elements, shares)
    rings = centres[:, None, :] + _outlines(beam, elements, shares)
    points = np.concatenate([rings.reshape(-1, 3), centres[[0, -1]]])
    station = np.concatenate([np.repeat(np.arange(count), size), [0, count - 1]])
    mapping = beam.carried_by(elements[station], shares[station], points)
    return mapping, _tube(count, size)


def _outlines(beam: BeamBody, elements: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """The outline at each station, from the axis [m], shape (count, point_count, 3)."""
    weights = np.column_stack([1.0 - shares, shares])
    axes = np.einsum("ne,neij->nij", weights, beam.element_axes[elements])
    tangents = axes[:, :, 0] / np.linalg.norm(axes[:, :, 0], axis=1, keepdims=True)
    y = axes[:, :, 1] - np.sum(axes[:, :, 1] * tangents, axis=1)[:, None] * tangents
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    across = np.stack([y, np.cross(tangents, y)], axis=1)
    sizes = np.sum(weights * beam.scales[elements], axis=1)
    outlines = np.einsum("n,pk,nki->npi", sizes, beam.section.outline, across)
    corners = np.flatnonzero((shares == 0.0) & (elements > 0))
    before = beam.element_axes[elements[corners] - 1, 1, :, 0]
    own = tangents[corners]
    between = before + own
    # Zero where the axis turns back; there the outline stays as it is.
    along = np.sum(between * own, axis=1)
    off = -np.einsum("npi,ni->np", outlines[corners], between)
    off /= np.where(along > 1.0e-9, along, np.inf)[:, None]
    most = MOST_MITRE * beam.radius
    outlines[corners] += np.clip(off, -most, most)[:, :, None] * own[:, None, :]
    return outlines


def _tube(ring_count: int, size: int) -> np.ndarray:
    """Triangles between rings of points, and of both ends, whose middles come last."""
    ring = size * np.arange(ring_count - 1)[:, None]
    here, there = np.arange(size), np.roll(np.arange(size), -1)
    lower = np.stack([ring + here, ring + there, ring + size + there], axis=2)
    upper = np.stack([ring + here, ring + size + there, ring + size + here], axis=2)
    last, middle = size * (ring_count - 1), size * ring_count
    start = np.column_stack([np.full(size, middle), there, here])
    end = np.column_stack([np.full(size, middle + 1), last + here, last + there])
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3), start, end])
