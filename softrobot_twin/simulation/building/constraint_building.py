"""Effectors, markers and contacts of a scene.

Each pair of bodies that may touch gets the detector for their kinds.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.beam_contact import (
    BeamAndShape,
    RoundBeam,
    TwoRoundBeams,
    neighbours,
    never_touching,
)
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.constraints.contact_curvature import ContactCurvature, RoundPair
from softrobot_twin.constraints.contact_pairs import (
    BallAndShape,
    CarriedSurface,
    DeformableSurface,
    RigidSurface,
    RoundAndPlane,
    StandingSurface,
    SurfaceAndShape,
    TwoBoxes,
    TwoSurfaces,
)
from softrobot_twin.constraints.effector import AXES, EffectorPoints, Effectors
from softrobot_twin.constraints.effector_orientation import (
    PatchOrientation,
    PosedEffectors,
    frame_arms,
    patch_arms,
    spans_a_plane,
)
from softrobot_twin.geometry.box_pairs import BoxPairDetector
from softrobot_twin.geometry.point_location import closest_on_triangles
from softrobot_twin.geometry.self_proximity import FixedPairs, SelfDetector
from softrobot_twin.geometry.shapes import Box, Capsule, Cylinder, Plane, Shape, Sphere
from softrobot_twin.geometry.solid_shape import SolidShapeDetector
from softrobot_twin.geometry.surface_pairs import SurfacePairDetector
from softrobot_twin.geometry.surface_reading import read_solid_surface
from softrobot_twin.geometry.surface_shape import SurfaceShapeDetector
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.building.beam_bodies import BeamBody, swept_surface
from softrobot_twin.simulation.building.deformable_body import ON_BODY, SNAP_SHARE, Body
from softrobot_twin.simulation.building.mapped_surfaces import surface_on_mesh
from softrobot_twin.simulation.building.scene_layout import Layout, build_shape, triangulated

# Pieces of an element in the surface with which a beam that is not round touches.
CONTACT_PIECES = 2


def effector_term(layout: Layout, notes: list[str]):
    """The constraint term of the effectors of a scene.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.

    Raises:
        SceneError: A point does not lie on its body, or the points of an orientation lie on a line.
    """
    effectors, orientations = [], []
    for index, (key, effector) in enumerate(layout.scene.keyed("effectors")):
        points = layout.carried(
            effector.body, effector.points, f"{key}.points", notes,
            remedy="; several points count by their mean: for a place in a hollow part, give points "
            "on the material around it",
        )  # fmt: skip
        carriers = points.nodes[points.barycentric_weights != 0.0]
        if not layout.scene.slides and (layout.nodes.free_index[carriers] < 0).all():
            notes.append(f"{key} ({effector.name}) lies wholly in what is fixed or guided: "
                         "no actuator moves it.")  # fmt: skip
        directions = tuple(AXES[direction] for direction in effector.directions)
        effectors.append(EffectorPoints(effector.name, points, directions, effector.weight))
        if effector.orientation is not None:
            orientations.append(_orientation(layout, index, points, notes))
    free_index, size = layout.nodes.free_index, layout.nodes.size
    if orientations:
        return PosedEffectors(tuple(effectors), tuple(orientations), free_index, size)
    return Effectors(tuple(effectors), free_index, size)


def _orientation(
    layout: Layout, index: int, points: BarycentricMapping, notes: list[str]
) -> PatchOrientation:
    """The orientation of one effector, on the frame or the patch that carries its points."""
    effector = layout.scene.effectors[index]
    entry, rest = effector.orientation, layout.nodes.rest_positions
    key = f"effectors[{index}].points"
    if entry.points:
        key = f"effectors[{index}].orientation.points"
        points = layout.carried(effector.body, entry.points, key, notes)
    frame = frame_of(layout, points)
    if frame is not None:
        nodes, arms = frame_arms(frame, rest)
    else:
        if not spans_a_plane(points.positions(rest)):
            raise layout.scene.error(
                key, [list(point) for point in entry.points or effector.points],
                f"{effector.name} asks for an orientation: on a deformable body three or more "
                "points that do not lie on one line are needed", unit="m")
        nodes, arms = patch_arms(points, rest)
    axis = None
    if entry.pointing is not None:
        axis = np.array(entry.pointing, float) / np.linalg.norm(entry.pointing)
    length = entry.length_per_radian or layout.nodes.size
    return PatchOrientation(index, nodes, arms, frame is not None, axis, entry.weight, length)


def frame_of(layout: Layout, points: BarycentricMapping) -> int | None:
    """First node of the one frame that carries all points; None where there is none.

    Args:
        layout: The bodies.
        points: The points.
    """
    if not layout.framed:
        return None
    carriers = points.nodes[points.barycentric_weights != 0.0] - layout.frames.first_node
    bodies = np.unique(carriers // 4)
    if len(bodies) != 1 or not 0 <= bodies[0] < layout.frames.body_count:
        return None
    return int(layout.frames.first_node + 4 * bodies[0])


def marker_mapping(layout: Layout, notes: list[str]):
    """The markers of a scene.

    Args:
        layout: The scene with its bodies placed.
        notes: List to which warnings are appended.

    Returns:
        Their mapping, their ids, and for each effector the indices of the markers that measure it.
    """
    scene = layout.scene
    markers = BarycentricMapping(np.empty((0, 4), np.int64), np.empty((0, 4)))
    order: list[int] = []
    names = dict.fromkeys(marker.body for marker in scene.markers)
    for name in names:
        own = [index for index, marker in enumerate(scene.markers) if marker.body == name]
        points = [scene.markers[index].point for index in own]
        key = "markers" if len(names) == 1 else f"markers on {name}"
        markers = markers.followed_by(layout.carried(name, points, key, notes))
        order += own
    place = np.argsort(np.array(order, np.int64))
    markers = BarycentricMapping(markers.nodes[place], markers.barycentric_weights[place])
    ids = [marker.id for marker in scene.markers]
    moving_with = tuple(
        np.array([ids.index(marker) for marker in effector.measured_by], np.int64)
        for effector in scene.effectors
    )
    return markers, np.array(ids, np.uint32), moving_with


class Side:
    """A side of contact pairs.

    Attributes:
        name: Name of the body, beam or obstacle.
        shape: Shape of a rigid body or obstacle, in its frame; None of others.
        surface: Its points and triangles, and what carries them.
    """

    def __init__(self, name: str, surface, shape=None):
        """Take what is known of it; see the attributes."""
        self.name, self.surface, self.shape = name, surface, shape


class BeamSide(Side):
    """A side that is a beam: round about its axis, or a swept surface."""

    def __init__(self, beam: BeamBody):
        """Take the beam.

        Args:
            beam: The beam.
        """
        self.name, self.shape, self.beam = beam.name, None, beam
        self.round = RoundBeam(*beam.axis_in_frames(), beam.section.radius) if beam.is_round else None

    @cached_property
    def surface(self) -> CarriedSurface:
        """Its surface; made where it is asked for."""
        return CarriedSurface(*swept_surface(self.beam, CONTACT_PIECES))


def contact_term(layout: Layout, notes: list[str]) -> Contacts:
    """The contact term of a scene.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.

    Returns:
        The constraint term.

    Raises:
        SceneError: A pair cannot touch.
        MeshError: A surface cannot be used.
    """
    entry = layout.scene.contact
    sides = _sides(layout, notes)
    pairs = []
    for index, touching in enumerate(entry.between):
        friction = entry.friction if touching.friction is None else touching.friction
        first, second = (sides[name] for name in touching.pair)
        pairs.append(_pair(first, second, friction, f"contact.between[{index}]", layout))
    pairs += _known_ahead(layout, sides, notes)
    contacts = Contacts(
        tuple(pairs), layout.nodes.free_index, layout.nodes.write_largest, entry.alarm_distance,
        entry.contact_distance, entry.push_out_speed,
    )  # fmt: skip
    contacts.curvature = _curvature(pairs, layout)
    return contacts


def _curvature(pairs: list, layout: Layout):
    """Stiffness of facets that press on round shapes; None where there is no such pair."""
    found = []
    for index, pair in enumerate(pairs):
        shape, axis = getattr(pair, "shape", None), None
        is_round = isinstance(shape, Sphere | Capsule | Cylinder)
        if not is_round or not isinstance(pair.first, DeformableSurface):
            continue
        if not isinstance(shape, Sphere):
            axis = (shape.ends[1] - shape.ends[0]) / np.linalg.norm(shape.ends[1] - shape.ends[0])
        triangles, has_caps = pair.first.point_nodes[pair.first.triangles], isinstance(shape, Capsule)
        found.append(RoundPair(index, triangles, pair.second, shape.radius, axis, has_caps))
    nodes = layout.nodes
    return ContactCurvature(tuple(found), nodes.free_index, nodes.carried) if found else None


def _sides(layout: Layout, notes: list[str]) -> dict[str, Side]:
    """All bodies and obstacles that the contact section names."""
    scene, sides = layout.scene, {}
    named = {name for touching in scene.contact.between for name in touching.pair}
    named |= {layout.body_named(point.on).name for point in scene.contact.points}
    for body in layout.bodies:
        if body.name in named:
            sides[body.name] = Side(body.name, _surface_of(body, scene, notes))
    for beam in layout.beams:
        if beam.name in named:
            sides[beam.name] = BeamSide(beam)
    for part in layout.rigid:
        if part.name in named:
            surface = RigidSurface(part.first_node, *_facets(part.shape))
            sides[part.name] = Side(part.name, surface, part.shape)
    for entry in scene.obstacles:
        if entry.name in named:
            shape = build_shape(entry.shape, scene, notes)
            turn = Rotation.from_euler("xyz", entry.rotation).as_matrix()
            surface = StandingSurface(entry.position, turn, *_facets(shape))
            sides[entry.name] = Side(entry.name, surface, shape)
    return sides


def _facets(shape) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a shape; none of a plane, which has no end."""
    if isinstance(shape, Plane):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    return triangulated(shape)


def _surface_of(body: Body, scene: Scene, notes: list[str]):
    """The contact surface of a deformable body: that of its mesh, or one that it carries."""
    entry, mesh = body.entry.contact_surface, body.entry.mesh
    if entry is not None:
        solid = read_solid_surface(
            scene.file_path(entry.file), scale=entry.scale,
            rotation=mesh.rotation, translation=mesh.translation, notes=notes,
        )  # fmt: skip
        key = f"{body.key}.contact_surface"
        on_mesh, triangles = surface_on_mesh(
            body, solid.points, solid.triangles, entry, key, scene, notes
        )
        return CarriedSurface(body.carried_by(on_mesh), triangles)
    nodes, triangles = np.unique(body.mesh.surface_triangles, return_inverse=True)
    carried, triangles = body.node_mapping(nodes), triangles.reshape(-1, 3)
    if body.vertebrae is not None:
        return CarriedSurface(carried, triangles)
    return DeformableSurface(carried.nodes[:, 0][triangles])


def _pair(first: Side, second: Side, friction: float, key: str, layout: Layout):
    """The pair in order: deformable before rigid, moving before fixed."""
    if isinstance(first, BeamSide) or isinstance(second, BeamSide):
        return _beam_pair(first, second, friction, key, layout)
    if first is second:
        return _with_itself(first, friction, key, layout)
    if first.shape is not None and second.shape is None:
        first, second = second, first
    if first.shape is None:
        return _soft_pair(first, second, friction)
    if not {part.name for part in layout.rigid if part.is_free} & {first.name, second.name}:
        raise layout.scene.error(key, f"{first.name} and {second.name}",
                                 "neither of them moves by itself")
    return _solid_pair(first, second, friction)


def _beam_pair(first: Side, second: Side, friction: float, key: str, layout: Layout):
    """A beam and something else, another beam or itself: round ones by their axes."""
    if not isinstance(first, BeamSide):
        first, second = second, first
    names, rest, own = (first.name, second.name), layout.nodes.rest_positions, first.beam
    is_joined = _are_joined(own, second.name, layout)
    if first.round and isinstance(second.shape, Shape):
        return BeamAndShape(
            first.round, second.surface, second.shape, friction, names, rest,
            _held_against(own, second.surface, layout),
        )  # fmt: skip
    if isinstance(second, BeamSide) and first.round and second.round:
        excluded = np.zeros((first.round.element_count, second.round.element_count), bool)
        if is_joined or first is second:
            excluded = never_touching(first.round, second.round, rest)
        if first is second:
            excluded |= neighbours(own.lengths, first.round.radius)
        return TwoRoundBeams(first.round, second.round, excluded, friction, names)
    if is_joined:
        raise layout.scene.error(key, " and ".join(names),
                                 f"{own.name} is joined to {second.name}; contact of what is "
                                 "joined is built for beams of round section, with each other and "
                                 "with simple shapes")
    if first is second:
        return _with_itself(first, friction, key, layout)
    return _soft_pair(first, second, friction)


def _held_against(beam: BeamBody, surface, layout: Layout) -> list[int]:
    """Nodes of a beam that move with the carrier of a shape, or stand still as it does."""
    frames = beam.carriers.frame_nodes
    held = np.isin(frames, surface.nodes)
    if not len(surface.nodes):
        held = layout.frames.unknowns_of(frames) < 0
    return np.flatnonzero(held).tolist()


def _are_joined(beam: BeamBody, name: str, layout: Layout) -> bool:
    """Whether a beam moves with a frame of a rigid body, or of another beam."""
    other = next((part for part in (*layout.rigid, *layout.beams) if part.name == name), None)
    if other is None or other is beam:
        return False
    frames = other.carriers.frame_nodes if isinstance(other, BeamBody) else [other.first_node]
    return bool(np.isin(beam.carriers.frame_nodes, frames).any())


def _with_itself(side: Side, friction: float, key: str, layout: Layout):
    """The pair of a surface and itself."""
    if side.shape is not None:
        raise layout.scene.error(key, side.name, "a rigid body cannot touch itself")
    rest = side.surface.points(layout.nodes.rest_positions)
    detector = SelfDetector(side.surface.triangles, rest, layout.scene.contact.alarm_distance)
    return TwoSurfaces(side.surface, side.surface, detector, friction, (side.name, side.name))


def _soft_pair(first: Side, second: Side, friction: float):
    """The pair of a surface that deforms and something else."""
    if not isinstance(second.shape, Shape):
        return _two_surfaces(first, second, friction)
    detector = SurfaceShapeDetector(
        first.surface.triangles, first.surface.point_count, second.shape, deforms=True
    )
    return _surface_and_shape(first, second, detector, friction)


def _solid_pair(first: Side, second: Side, friction: float):
    """The pair of two rigid sides."""
    if isinstance(first.shape, Plane) or isinstance(second.shape, Sphere):
        first, second = second, first
    names = (first.name, second.name)
    if isinstance(first.shape, Sphere) and isinstance(second.shape, Shape):
        ball = first.shape
        return BallAndShape(
            first.surface, ball.radius, ball.centre, second.surface, second.shape, friction, names
        )
    if isinstance(first.shape, Capsule | Cylinder) and isinstance(second.shape, Plane):
        return RoundAndPlane(
            first.surface, first.shape, second.surface, second.shape, friction, names
        )
    if not isinstance(second.shape, Shape):
        first, second = second, first
    if not isinstance(first.shape, Shape) and not isinstance(second.shape, Plane):
        return _pair_with_file(first, second, friction)
    detector = SurfaceShapeDetector(
        first.surface.triangles, first.surface.point_count, second.shape
    )
    pair = _surface_and_shape(first, second, detector, friction)
    if isinstance(first.shape, Box) and isinstance(second.shape, Box):
        return TwoBoxes(BoxPairDetector(first.shape, second.shape), pair)
    return pair


def _pair_with_file(first: Side, second: Side, friction: float):
    """A rigid surface from a file, and a solid: flat ones by their facets, round ones exactly."""
    if isinstance(second.shape, Box) or not isinstance(second.shape, Shape):
        if isinstance(first.surface, StandingSurface):
            first, second = second, first
        return _two_surfaces(first, second, friction)
    detector = SolidShapeDetector(first.surface.triangles, first.surface.rigid_points, second.shape)
    return _surface_and_shape(first, second, detector, friction)


def _surface_and_shape(first: Side, second: Side, detector, friction: float) -> SurfaceAndShape:
    names = (first.name, second.name)
    return SurfaceAndShape(first.surface, second.surface, detector, friction, names)


def _two_surfaces(first: Side, second: Side, friction: float) -> TwoSurfaces:
    one, other = first.surface, second.surface
    detector = SurfacePairDetector(
        one.triangles, one.point_count, other.triangles, other.point_count,
        rigid_points=(one.rigid_points, other.rigid_points),
    )  # fmt: skip
    return TwoSurfaces(one, other, detector, friction, (first.name, second.name))


def _known_ahead(layout: Layout, sides: dict[str, Side], notes: list[str]) -> list[TwoSurfaces]:
    """Points and triangles that the scene names, body by body."""
    entry = layout.scene.contact
    bodies = {layout.body_named(point.on).name: layout.body_named(point.on)
              for point in entry.points}  # fmt: skip
    pairs = []
    for name, body in bodies.items():
        own = [p for p in entry.points if layout.body_named(p.on) is body]
        surface = sides[name].surface
        points = surface.points(layout.nodes.rest_positions)
        index = [_nearest(points, p.point) for p in own]
        triangles = [_nearest_triangle(points, surface.triangles, p.against) for p in own]
        for p, found in zip(own, index, strict=True):
            away = float(np.linalg.norm(points[found] - p.point))
            if away > SNAP_SHARE * body.size:
                notes.append(f"contact.points[{entry.points.index(p)}].point lies {1e3 * away:.3g} mm "
                             f"from the nearest point of the surface of {name}, which touches in its "
                             "place")
        _check_apart(layout, body, index, triangles)
        detector = FixedPairs(np.array(index), np.array(triangles))
        pairs.append(TwoSurfaces(surface, surface, detector, entry.friction, (name, name)))
    return pairs


def _nearest(points: np.ndarray, point) -> int:
    return int(np.argmin(np.linalg.norm(points - np.asarray(point), axis=1)))


def _nearest_triangle(points: np.ndarray, triangles: np.ndarray, place) -> np.ndarray:
    """The triangle nearest to a place; of several that meet there, that with the nearest centre."""
    corners, place = points[triangles], np.asarray(place, float)
    weights = closest_on_triangles(np.broadcast_to(place, (len(corners), 3)), corners)
    away = np.linalg.norm(np.einsum("tc,tci->ti", weights, corners) - place, axis=1)
    size = np.linalg.norm(np.ptp(points, axis=0))
    near = triangles[away <= away.min() + ON_BODY * size]
    return near[_nearest(points[near].mean(axis=1), place)]


def _check_apart(layout: Layout, body: Body, index: list[int], triangles: list) -> None:
    for place, (point, triangle) in enumerate(zip(index, triangles, strict=True)):
        if point in triangle:
            raise layout.scene.error(f"contact.points[{place}]", body.name,
                                     "its point is a corner of its triangle: they cannot come "
                                     "together")
