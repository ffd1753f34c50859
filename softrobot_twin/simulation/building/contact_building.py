"""Contacts of a scene.

Each pair of bodies that may touch gets the search for their kinds: the first of `SEARCHES` that fits
both, in either order.
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
    ContactPair,
    DeformableSurface,
    NoShape,
    RigidSurface,
    RollingAndPlane,
    Side,
    SolidAndRound,
    StandingSurface,
    SurfaceAndShape,
    TwoBoxes,
    TwoSurfaces,
)
from softrobot_twin.geometry.point_location import closest_on_triangles
from softrobot_twin.geometry.self_proximity import FixedPairs, SelfDetector
from softrobot_twin.geometry.shapes.shape import RollingShape, Shape
from softrobot_twin.geometry.surface_reading import SolidSurface, read_solid_surface
from softrobot_twin.scene import Scene
from softrobot_twin.scene.shapes import AxialShape, Box, Plane, Sphere
from softrobot_twin.simulation.building.beam_bodies import BeamBody, swept_surface
from softrobot_twin.simulation.building.deformable_body import ON_BODY, SNAP_SHARE, Body
from softrobot_twin.simulation.building.mapped_surfaces import surface_on_mesh
from softrobot_twin.simulation.building.scene_layout import Layout, triangulated

# Pieces of an element in the surface with which a beam that is not round touches.
CONTACT_PIECES = 2


def _two_solids(first: Side, second: Side, friction: float) -> TwoSurfaces:
    """Two rigid surfaces by their facets, what moves before what stands."""
    if isinstance(first.surface, StandingSurface):
        first, second = second, first
    return TwoSurfaces(first, second, friction)


SEARCHES = (
    (NoShape, Shape, SurfaceAndShape),
    (NoShape, object, TwoSurfaces),
    (Sphere, Sphere, lambda first, second, friction: BallAndShape(second, first, friction)),
    (Sphere, Shape, BallAndShape),
    (RollingShape, Plane, RollingAndPlane),
    (Box, Box, TwoBoxes),
    (SolidSurface, Plane, SurfaceAndShape),
    (SolidSurface, Sphere | AxialShape, SolidAndRound),
    (SolidSurface, SolidSurface, lambda first, second, friction: _two_solids(second, first, friction)),
    (SolidSurface, object, _two_solids),
    (Shape, Plane, SurfaceAndShape),
    (Shape, Shape, SurfaceAndShape),
)
"""Kinds of the shapes of both sides, and what makes their pair."""


class BeamSide(Side):
    """A side that is a beam, as a swept surface.

    Attributes:
        beam: The beam.
        by_axis: The side by its axis, where it is round; else no side.
    """

    def __init__(self, beam: BeamBody):
        """Take the beam.

        Args:
            beam: The beam.
        """
        self.name, self.beam = beam.name, beam
        axis = [RoundBeam(*beam.axis_in_frames(), beam.section.radius)] if beam.is_round else []
        self.by_axis = [Side(beam.name, one) for one in axis]

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
        friction = entry.friction_of(touching)
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
    found = [
        RoundPair(index, pair.first.node_triangles, pair.second,
                  pair.shape.curvature_radius, pair.shape.axis, pair.shape.has_round_ends)
        for index, pair in enumerate(pairs)
        if isinstance(pair.first, DeformableSurface) and isinstance(pair, SurfaceAndShape)
        and pair.shape.is_round
    ]  # fmt: skip
    return ContactCurvature(tuple(found), layout.nodes.free_index, layout.nodes.carried) if found else None


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
            surface = RigidSurface(part.first_node, *triangulated(part.shape))
            sides[part.name] = Side(part.name, surface, part.shape)
    for entry in scene.obstacles:
        if entry.name in named:
            shape = entry.shape.solid(scene.file_path, notes)
            turn = Rotation.from_euler("xyz", entry.rotation).as_matrix()
            surface = StandingSurface(entry.position, turn, *triangulated(shape))
            sides[entry.name] = Side(entry.name, surface, shape)
    return sides


def _surface_of(body: Body, scene: Scene, notes: list[str]):
    """The contact surface of a deformable body: that of its mesh, or one that it carries."""
    entry, mesh = body.entry.contact_surface, body.entry.mesh
    if entry:
        solid = read_solid_surface(
            scene.file_path(entry.file), scale=entry.scale,
            rotation=mesh.rotation, translation=mesh.translation, notes=notes,
        )  # fmt: skip
        key = f"{body.key}.contact_surface"
        on_mesh, triangles = surface_on_mesh(body, solid.points, solid.triangles, entry, key, scene, notes)
        return CarriedSurface(body.carried_by(on_mesh), triangles)
    nodes, triangles = np.unique(body.mesh.surface_triangles, return_inverse=True)
    carried, triangles = body.node_mapping(nodes), triangles.reshape(-1, 3)
    if body.vertebrae:
        return CarriedSurface(carried, triangles)
    return DeformableSurface(carried.nodes[:, 0][triangles])


def _pair(first: Side, second: Side, friction: float, key: str, layout: Layout) -> ContactPair:
    """The pair of two sides, by the first of `SEARCHES` that fits."""
    if isinstance(first, BeamSide) or isinstance(second, BeamSide):
        return _beam_pair(first, second, friction, key, layout)
    if first is second:
        return _with_itself(first, friction, key, layout)
    moving = {part.name for part in layout.rigid if part.is_free}
    deforms = isinstance(first.shape, NoShape) or isinstance(second.shape, NoShape)
    if not deforms and not moving & {first.name, second.name}:
        raise layout.scene.error(key, f"{first.name} and {second.name}", "neither of them moves by itself")
    return _searched(first, second, friction)


def _searched(first: Side, second: Side, friction: float) -> ContactPair:
    return next(
        make(one, other, friction) for kind, other_kind, make in SEARCHES
        for one, other in ((first, second), (second, first))
        if isinstance(one.shape, kind) and isinstance(other.shape, other_kind)
    )  # fmt: skip


def _beam_pair(first: Side, second: Side, friction: float, key: str, layout: Layout) -> ContactPair:
    """A beam and something else, another beam or itself: round ones by their axes."""
    if not isinstance(first, BeamSide):
        first, second = second, first
    names, rest, own = (first.name, second.name), layout.nodes.rest_positions, first.beam
    is_joined = _are_joined(own, second.name, layout)
    if first.by_axis and isinstance(second.shape, Shape):
        held = _held_against(own, second.surface, layout)
        return BeamAndShape(*first.by_axis, second, friction, rest, held)
    if isinstance(second, BeamSide) and first.by_axis and second.by_axis:
        (one,), (other,) = first.by_axis, second.by_axis
        excluded = np.zeros((one.surface.element_count, other.surface.element_count), bool)
        if is_joined or first is second:
            excluded = never_touching(one.surface, other.surface, rest)
        if first is second:
            excluded |= neighbours(own.lengths, one.surface.radius)
        return TwoRoundBeams(one, other, friction, excluded)
    if is_joined:
        raise layout.scene.error(key, " and ".join(names),
                                 f"{own.name} is joined to {second.name}; contact of what is "
                                 "joined is built for beams of round section, with each other and "
                                 "with simple shapes")
    if first is second:
        return _with_itself(first, friction, key, layout)
    return _searched(first, second, friction)


def _held_against(beam: BeamBody, surface, layout: Layout) -> list[int]:
    """Nodes of a beam that move with the carrier of a shape, or stand still as it does."""
    frames = beam.carriers.frame_nodes
    moves = len(surface.nodes)
    held = np.isin(frames, surface.nodes) if moves else layout.frames.unknowns_of(frames) < 0
    return np.flatnonzero(held).tolist()


def _are_joined(beam: BeamBody, name: str, layout: Layout) -> bool:
    """Whether a beam moves with a frame of a rigid body, or of another beam."""
    other = next((part for part in (*layout.rigid, *layout.beams) if part.name == name), None)
    if other is None or other is beam:
        return False
    frames = other.carriers.frame_nodes if isinstance(other, BeamBody) else [other.first_node]
    return bool(np.isin(beam.carriers.frame_nodes, frames).any())


def _with_itself(side: Side, friction: float, key: str, layout: Layout) -> TwoSurfaces:
    """The pair of a surface and itself."""
    if not isinstance(side.shape, NoShape):
        raise layout.scene.error(key, side.name, "a rigid body cannot touch itself")
    rest = side.surface.points(layout.nodes.rest_positions)
    detector = SelfDetector(side.surface.triangles, rest, layout.scene.contact.alarm_distance)
    return TwoSurfaces(side, side, friction, detector)


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
        for p, found, triangle in zip(own, index, triangles, strict=True):
            if found in triangle:
                raise layout.scene.error(f"contact.points[{entry.points.index(p)}]", name, "its point is a "
                                         "corner of its triangle: they cannot come together")
            away = float(np.linalg.norm(points[found] - p.point))
            if away > SNAP_SHARE * body.size:
                notes.append(f"contact.points[{entry.points.index(p)}].point lies {1e3 * away:.3g} mm "
                             f"from the nearest point of the surface of {name}, which touches in its "
                             "place")
        detector = FixedPairs(np.array(index), np.array(triangles))
        pairs.append(TwoSurfaces(sides[name], sides[name], entry.friction, detector))
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
