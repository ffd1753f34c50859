"""Force terms of a scene: elasticity, weight, springs, inertia and damping.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.constants import g as STANDARD_GRAVITY

from softrobot_twin.geometry.connected_pieces import connected_pieces
from softrobot_twin.geometry.helix import helix_points
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.beam_masses import BeamDamping, BeamInertia, BeamMasses, BeamWeight
from softrobot_twin.mechanics.beams import BeamElements, Beams
from softrobot_twin.mechanics.compression_watch import CompressionWatch
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.grips import Grips
from softrobot_twin.mechanics.hinged_frames import HingeBlocks, HingedTwists
from softrobot_twin.mechanics.inertia import LumpedInertia
from softrobot_twin.mechanics.kinematics import on_unknowns, size_of_points
from softrobot_twin.mechanics.liquid_filling import LiquidFilling
from softrobot_twin.mechanics.patch_volumes import PatchVolumes
from softrobot_twin.mechanics.rigid_bodies import RigidDamping, RigidInertia
from softrobot_twin.mechanics.sealed_gas import SealedGas
from softrobot_twin.mechanics.springs import Joints, Springs, segments
from softrobot_twin.mechanics.strain_watch import StrainWatch
from softrobot_twin.mechanics.observed_loads import ObservedLoads, ObservedPlace
from softrobot_twin.mechanics.touch_loads import TouchLoads
from softrobot_twin.scene.body_entries import Fibre, Helix
from softrobot_twin.simulation.building.beam_bodies import all_elements
from softrobot_twin.simulation.building.cavity_walls import cavity_surface
from softrobot_twin.simulation.building.deformable_body import Body, of_kind, part_named, single_nodes
from softrobot_twin.simulation.building.mapped_surfaces import path_on_elements
from softrobot_twin.simulation.building.reduced_body import ReducedBody
from softrobot_twin.simulation.building.scene_layout import Layout

# The end of a spring on a mass-spring body must be this near to one of its points, as a share of
# the body's size: files have six or seven digits.
AT_POINT = 1.0e-5
# A point that a touch holds is held by this multiple of E L, the stiffness of a block of its body's
# material and size: far above that of any body, and below what the arithmetic of a step notices.
HELD_STIFFNESS = 10.0
# In statics, turns of a joined rigid body that nothing resists are held by this multiple of its weight
# times its radius, before `HingeBlocks` takes its share: Newton's method then takes a body from any
# turn to where it hangs.
TURNS_HELD = 1.0e3


def force_terms(layout: Layout, notes: list[str]) -> Iterator[ForceTerm]:
    """All force terms of a scene, on nodes and carried points.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.

    Yields:
        The terms, elastic ones first.

    Raises:
        SceneError: An entry does not fit.
    """
    yield from static_terms(layout, notes)
    if layout.scene.integration != "quasi_static":
        _check_resisted(layout)
        yield from _motion_terms(layout)


def static_terms(layout: Layout, notes: list[str]) -> Iterator[ForceTerm]:
    """The force terms without inertia and damping of masses; see `force_terms`."""
    scene = layout.scene
    for body in layout.bodies:
        yield from _elastic_terms(layout, body)
    yield from layout.superelements.values()
    if scene.beams:
        yield from _beam_terms(layout)
    if any(scene.gravity) or scene.moving_base:
        yield Gravity(_borne_masses(layout), np.array(scene.gravity), _reduced_weights(layout))
    if scene.mass_springs and scene.integration == "quasi_static":
        check_masses_held(layout)
    if (scene.springs or scene.tubes or scene.fibres or any(body.springs for body in scene.mass_springs)):
        yield spring_term(layout, notes)
    if any(body.joined for body in scene.rigid_bodies):
        yield from _joint_terms(layout)
    if scene.touches:
        yield _touch_loads(layout, notes)
    if scene.grips:
        yield _grips(layout, notes)
    if scene.observer:
        places = tuple(_observed_places(layout, notes))
        yield ObservedLoads(places, layout.nodes.free_node_count)
    if scene.sealed_cavities:
        yield _sealed_gas(layout, notes)
    if any(scene.gravity) and any(cavity.liquid_density for cavity in scene.cavities):
        yield _liquid_filling(layout)


def _touch_loads(layout: Layout, notes: list[str]) -> TouchLoads:
    """All touches of a scene in one term."""
    scene, mappings, stiffness = layout.scene, [], []
    for key, touch in scene.keyed("touches"):
        body = layout.body_named(touch.body)
        if body.vertebrae:
            raise scene.error(f"{key}.body", body.name,
                              "is reduced to vertebrae: touches on such bodies are not built")
        mappings.append(_mean(layout.carried(touch.body, touch.points, f"{key}.points", notes)))
        stiffness.append(_holding_stiffness(body))
    axes = [[axis in touch.directions for axis in "xyz"] for touch in scene.touches]
    points = reduce(BarycentricMapping.followed_by, mappings)
    return TouchLoads(points, np.array(axes), np.array(stiffness), layout.nodes.free_index)


def _holding_stiffness(body: Body) -> float:
    """Of the spring that holds a body at a point [N/m]; see `HELD_STIFFNESS`."""
    stiffest = max(part.young_modulus for part in body.materials)
    return HELD_STIFFNESS * stiffest * size_of_points(body.mesh.node_positions)


def _grips(layout: Layout, notes: list[str]) -> Grips:
    """All grips of a scene in one term; none holds."""
    scene, mappings, counts, frames, stiffness = layout.scene, [], [], [], []
    rigid = {part.name: part.first_node for part in layout.rigid}
    for key, grip in scene.keyed("grips"):
        body = layout.unreduced(grip.body, key, "grips on such bodies are not built")
        if not (grip.stiffness or isinstance(body, Body)):
            raise scene.error(f"{key}.stiffness", "(nothing)",
                              f"{body.name} is no deformable body: a stiffness is needed", "N/m")
        mappings.append(layout.carried(grip.body, grip.points, f"{key}.points", notes))
        counts.append(len(grip.points))
        frames.append(rigid.get(grip.holds, -1))
        stiffness.append((grip.stiffness or _holding_stiffness(body)) / len(grip.points))
    points = reduce(BarycentricMapping.followed_by, mappings)
    grips = np.repeat(np.arange(len(counts)), counts)
    return Grips(points, grips, np.array(frames), np.array(stiffness)[grips], layout.nodes.free_index)


def _observed_places(layout: Layout, notes: list[str]) -> Iterator[ObservedPlace]:
    """Where an observer looks for forces."""
    for index, force in enumerate(layout.scene.observed_forces):
        key, body = f"observer.forces[{index}]", layout.body_named(force.body)
        if force.points and isinstance(body, Body) and body.vertebrae:
            raise layout.scene.error(f"{key}.body", body.name, "is reduced to vertebrae: forces on "
                                     "such bodies are not observed")
        if force.points:
            points = layout.carried(force.body, force.points, f"{key}.points", notes)
            yield ObservedPlace(force.name, points)
        elif isinstance(body, Body):
            yield _found_place(layout, body, force.name, key)
        else:
            points = body.origin + np.vstack([np.zeros(3), layout.nodes.size * np.eye(3)])
            yield ObservedPlace(force.name, body.carried(points), is_wrench=True)


def _found_place(layout: Layout, body: Body, name: str, key: str) -> ObservedPlace:
    """The middles of the triangles of a body's surface that are not held."""
    layout.unreduced(body.name, key, "an unknown place on it is not built; give points")
    mesh, free = body.mesh, layout.nodes.free_index
    corners = mesh.node_positions[mesh.surface_triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    thirds = BarycentricMapping(mesh.surface_triangles, np.full((len(corners), 3), 1.0 / 3.0))
    points = body.carried_by(thirds)
    index = free[points.nodes]
    if (index >= layout.nodes.free_node_count).any():
        raise layout.scene.error(f"{key}.body", body.name, "is held by rigid bodies: an unknown "
                                 "place on it is not built; give points")
    moves = (index >= 0).all(axis=1)
    if not moves.any():
        raise layout.scene.error(f"{key}.body", body.name, "has no surface that can move")
    points = BarycentricMapping(points.nodes[moves], points.barycentric_weights[moves])
    return ObservedPlace(name, points, is_found=True, normals=normals[moves])


def _mean(points: BarycentricMapping) -> BarycentricMapping:
    """The mean of points as one point, each of its nodes once."""
    nodes, place = np.unique(points.nodes, return_inverse=True)
    shares = points.barycentric_weights.ravel() / points.point_count
    return BarycentricMapping(nodes[None], np.bincount(place.ravel(), shares, len(nodes))[None])


def _beam_terms(layout: Layout) -> Iterator[ForceTerm]:
    """One term for all beams; a second one for elements at hinges, and what keeps hinges definite.

    Then weight and damping of their mass.
    """
    elements, masses = _beam_elements(layout)
    if layout.hinged is None:
        yield Beams(elements)
    else:
        yield from _hinged_terms(layout, elements)
    scene = layout.scene
    if any(scene.gravity):
        yield _on_frames(BeamWeight(masses, np.array(scene.gravity)), layout)
    if scene.integration == "dynamic" and masses.damping.any():
        yield _on_frames(BeamDamping(masses), layout)


def _beam_elements(layout: Layout) -> tuple[BeamElements, BeamMasses]:
    return all_elements(layout.beams, layout.drawn_positions, layout.frames)


def _on_frames(term: ForceTerm, layout: Layout) -> ForceTerm:
    """A term of forces and moments on frames, those of hinged ones on their unknowns."""
    return term if layout.hinged is None else on_unknowns(term, HingedTwists(layout.hinged))


def _hinged_terms(layout: Layout, elements: BeamElements) -> Iterator[ForceTerm]:
    """The elements of beams, those at hinges in a term of their own, and the hinges."""
    frames = layout.hinged
    at_hinge = (elements.unknowns >= layout.nodes.free_node_count).any(axis=1)
    others, own = (BeamElements(*(field[is_own] for field in elements)) for is_own in (~at_hinge, at_hinge))
    if len(others.origins):
        yield Beams(others)
    yield on_unknowns(Beams(own), HingedTwists(frames))
    hinge = own.unknowns - layout.nodes.free_node_count
    stiffness = np.zeros(frames.hinge_count)
    for end in (0, 1):
        is_own = hinge[:, end] >= 0
        bending = own.stiffness[is_own, 3:].max(axis=1)
        np.maximum.at(stiffness, hinge[is_own, end] // 2, bending)
    yield HingeBlocks(frames.own, frames.is_ball, stiffness)


def _sealed_gas(layout: Layout, notes: list[str]) -> SealedGas:
    scene, nodes = layout.scene, layout.nodes
    entries, surfaces = scene.sealed_cavities, []
    for key, cavity in scene.keyed("sealed_cavities"):
        surfaces.append(cavity_surface(layout, cavity.name, cavity.walls, key, notes))
        carriers = nodes.free_index[surfaces[-1].vertices.nodes]
        if (carriers >= nodes.free_node_count).any():
            raise scene.error(f"{key}.walls", cavity.name,
                              "are attached to a free rigid body: gas sealed there is not built")
    ambient = np.array([cavity.ambient_pressure for cavity in entries])
    return SealedGas(
        tuple(surfaces), nodes.free_index, layout.drawn_positions,
        ambient + [cavity.pressure for cavity in entries], ambient,
    )  # fmt: skip


def _liquid_filling(layout: Layout) -> LiquidFilling:
    scene, nodes = layout.scene, layout.nodes
    # Warnings of these walls are those of the actuators.
    surfaces = [
        (cavity_surface(layout, cavity.name, cavity.walls, key, []), cavity.liquid_density)
        for key, cavity in scene.keyed("cavities") if cavity.liquid_density
    ]  # fmt: skip
    return LiquidFilling(
        tuple(surface for surface, _ in surfaces), nodes.free_index, layout.drawn_positions,
        np.array([density for _, density in surfaces]), np.array(scene.gravity),
    )  # fmt: skip


def _elastic_terms(layout: Layout, body: Body) -> Iterator[ForceTerm]:
    """What bears the strain of a body, watched."""
    for part, term in body.strained_terms(layout):
        if part.strain_range and not isinstance(term, PatchVolumes):
            term.strain_watch = StrainWatch(term, part.key, body.name, part.strain_range)
        if not isinstance(term, PatchVolumes) and term.has_varied_strain:
            term.compression_watch = CompressionWatch(term, body.name, part.lame_parameters)
        yield term


def _borne_masses(layout: Layout) -> np.ndarray:
    """Mass whose weight acts at each unknown [kg], shape (free_node_count,)."""
    bodies = [body.borne_masses(layout) for body in layout.bodies]
    points = [np.broadcast_to(entry.masses, len(entry.points)) for entry in layout.scene.mass_springs]
    masses = np.concatenate([np.empty(0), *bodies, *points])[layout.nodes.free_nodes]
    own = np.append(masses, [(part.mass, 0.0) for part in layout.framed if part.is_free])
    return np.pad(own, (0, layout.nodes.free_node_count - len(own)))


def _reduced_weights(layout: Layout) -> np.ndarray | None:
    """Weight of reduced bodies on their coordinates [N]; None without any."""
    reduced = of_kind(layout.bodies, ReducedBody)
    if not reduced:
        return None
    weights = np.zeros((layout.nodes.free_node_count, 3))
    for body in reduced:
        own = layout.nodes.free_index[body.coordinate_nodes]
        weights[own] = body.weights(np.array(layout.scene.gravity))
    return weights


def _check_resisted(layout: Layout) -> None:
    """Refuse first-order motion of a body without drag, which would be infinitely fast."""
    scene = layout.scene
    if scene.integration != "first_order":
        return
    for body in layout.bodies:
        damping = body.entry.damping
        if damping.mass == 0.0 and (damping.stiffness == 0.0 or not body.is_held):
            raise scene.error(f"{body.key}.damping.mass", damping.mass,
                              "first_order motion needs a drag: without inertia nothing else "
                              "limits its speed", unit="1/s")
    if any(part.is_free for part in layout.framed) or scene.mass_springs:
        raise scene.error("integration", "first_order",
                          "free rigid bodies, vertebrae, beams and point masses have no drag; use "
                          "dynamic")


def _motion_terms(layout: Layout) -> Iterator[ForceTerm]:
    """Inertia in dynamic scenes, and damping."""
    yield from body_motion_terms(layout)
    free = [part for part in (*layout.rigid, *layout.vertebrae) if part.is_free]
    inertia = None
    if free:
        masses, inertias, rates = (
            np.array([getattr(part, field) for part in free])
            for field in ("mass", "inertia", "damping")
        )
        inertia = RigidInertia(layout.frames, masses, inertias)
        yield inertia
        if rates.any():
            yield RigidDamping(layout.frames, masses, inertias, rates)
    if layout.beams:
        yield _on_frames(BeamInertia(_beam_elements(layout)[1], layout.frames, inertia), layout)


def body_motion_terms(layout: Layout) -> Iterator[ForceTerm]:
    """Inertia and damping of deformable bodies and point masses.

    Args:
        layout: The bodies.
    """
    # The mass of attached nodes is added to their free rigid body.
    index = layout.nodes.free_index
    free_index = np.where(index < layout.nodes.free_node_count, index, -1)
    for body in layout.bodies:
        yield from body.motion_terms(layout, free_index)
    for entry in layout.scene.mass_springs:
        nodes = layout.mass_nodes[entry.name]
        moving = free_index[nodes] >= 0
        masses = np.broadcast_to(entry.masses, len(nodes))[moving]
        yield LumpedInertia(nodes[moving], free_index[nodes[moving]], masses)


def check_masses_held(layout: Layout) -> None:
    """Refuse point masses that no chain of springs connects to a held point.

    Args:
        layout: The bodies; in statics all others are held or have been refused.

    Raises:
        SceneError: A point mass floats.
    """
    world = len(layout.drawn_positions)
    pairs = []
    for spring in layout.scene.springs:
        ends = (_point_mass(layout, end) for end in spring.ends)
        pairs.append(tuple(world if node is None else node for node in ends))
    for entry in layout.scene.mass_springs:
        nodes = layout.mass_nodes[entry.name]
        pairs += [(int(nodes[a]), int(nodes[b])) for a, b in entry.springs]
        pairs += [(int(nodes[k]), world) for k in entry.fixed]
    piece = connected_pieces(*np.array(pairs, np.int64).reshape(-1, 2).T, world + 1)
    for key, entry in layout.scene.keyed("mass_springs"):
        loose = np.flatnonzero(piece[layout.mass_nodes[entry.name]] != piece[world])
        if len(loose):
            raise layout.scene.error(key, f"point {loose[0]}",
                                     f"of {entry.name} floats: in quasi_static integration a chain "
                                     "of springs must join it to a fixed point or to a body that "
                                     "is held")


def _point_mass(layout: Layout, end) -> int | None:
    """Node of the point mass at a spring's end; None for another kind of end."""
    if end.on not in layout.mass_nodes:
        return None
    own = layout.mass_nodes[end.on]
    rest = layout.drawn_positions[own]
    return int(own[np.argmin(np.linalg.norm(rest - end.point, axis=1))])


class _Part(NamedTuple):
    """Some springs of one kind; see `Springs` for the fields. One number is that of all."""

    first: BarycentricMapping
    second: BarycentricMapping
    stiffness: float | np.ndarray
    rest_lengths: float | np.ndarray
    damping: float = 0.0
    offsets: tuple[float, ...] | np.ndarray = (0.0, 0.0, 0.0)
    is_thread: bool = False

    def of_each(self, field: str) -> np.ndarray:
        """A field of each spring, shape (spring_count, ...)."""
        value = np.asarray(getattr(self, field))
        shape = (3,) if field == "offsets" else ()
        return np.broadcast_to(value, (self.first.point_count, *shape))


def spring_term(layout: Layout, notes: list[str]) -> Springs:
    """All springs of a scene in one term: a term for each tube would be slower.

    Args:
        layout: The bodies.
        notes: List to which a warning for each snapped point is appended.

    Returns:
        The force term.

    Raises:
        SceneError: A point does not lie on its body.
    """
    scene = layout.scene
    parts = [_between(layout, s, key, notes) for key, s in scene.keyed("springs")]
    for key, tube in scene.keyed("tubes"):
        points = path_on_elements(layout.body_named(tube.on), tube.points, f"{key}.points", notes)
        path = layout.carried(tube.on, points, f"{key}.points", notes)
        parts.append(_along(segments(path, layout.drawn_positions), tube.axial_stiffness))
    for key, fibre in scene.keyed("fibres"):
        parts += _fibre_parts(layout, fibre, key, notes)
    parts += [_in_mass_spring_body(layout, entry) for entry in scene.mass_springs if entry.springs]
    return _made_of(parts, Springs, layout)


def _made_of(parts: list[_Part], term: type[Springs], layout: Layout) -> Springs:
    first, second = (reduce(BarycentricMapping.followed_by, (part[end] for part in parts)) for end in (0, 1))
    stiffness, lengths, damping, offsets, threads = (
        np.concatenate([part.of_each(field) for part in parts]) for field in _Part._fields[2:]
    )
    free = layout.nodes.free_index
    return term(first, second, stiffness, lengths, damping, free, offsets, threads)


def _joint_terms(layout: Layout) -> Iterator[ForceTerm]:
    """The bearings of rigid bodies, and in statics what keeps their free turns definite."""
    parts, bodies = [], {part.name: part for part in layout.rigid}
    joined = [part for part in layout.rigid if part.entry.joined]
    for part in joined:
        for joint in part.entry.joined:
            points = np.array([joint.through], float)
            if joint.axis:
                axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
                points = points + np.outer((-part.radius, part.radius), axis)
            share, own = joint.stiffness / len(points), part.carried(points)
            if joint.to == "world":
                parts.append(_Part(own, _nowhere(len(points)), share, 0.0, offsets=points))
            else:
                parts.append(_Part(own, bodies[joint.to].carried(points), share, 0.0))
    yield _made_of(parts, Joints, layout)
    if layout.scene.integration == "quasi_static":
        turns = layout.frames.unknowns_of(np.array([part.first_node for part in joined])) + 1
        weights = [TURNS_HELD * STANDARD_GRAVITY * part.mass * part.radius for part in joined]
        yield HingeBlocks(turns, np.ones(len(turns), bool), weights)


def _nowhere(count: int) -> BarycentricMapping:
    """Second ends of springs to the world: their places are offsets."""
    return BarycentricMapping(np.zeros((count, 1), np.int64), np.zeros((count, 1)))


def _along(
    course: tuple[BarycentricMapping, BarycentricMapping, np.ndarray], axial_stiffness: float,
    is_thread: bool = False,
) -> _Part:  # fmt: skip
    """Springs of one axial stiffness EA [N], between two ends each of a length at rest."""
    first, second, lengths = course
    return _Part(first, second, axial_stiffness / lengths, lengths, is_thread=is_thread)


def _fibre_parts(layout: Layout, fibre: Fibre, key: str, notes: list[str]) -> list[_Part]:
    """Each thread of an entry, or all edges of a set in one part."""
    rest = layout.drawn_positions
    if fibre.edges is not None:
        body = layout.body_named(fibre.on)
        ends = part_named(body, "edge_set", fibre.edges, f"{key}.edges", layout.scene)
        first, second = map(single_nodes, ends.T + body.first_node)
        lengths = np.linalg.norm(first.positions(rest) - second.positions(rest), axis=1)
        return [_along((first, second, lengths), fibre.stiffness, fibre.tension_only)]
    if fibre.helix:
        paths, place = list(_helices(fibre.helix)), f"{key}.helix"
    else:
        place = f"{key}.points"
        paths = [path_on_elements(layout.body_named(fibre.on), fibre.points, place, notes)]
    # One mapping for all threads gives one note on all points that are snapped.
    points = layout.carried(fibre.on, np.concatenate(paths), place, notes)
    places = np.split(np.arange(points.point_count), np.cumsum([len(path) for path in paths])[:-1])
    return [
        _along(
            segments(BarycentricMapping(points.nodes[p], points.barycentric_weights[p]), rest),
            fibre.stiffness, fibre.tension_only,
        )
        for p in places
    ]  # fmt: skip


def _helices(helix: Helix) -> Iterator[np.ndarray]:
    """Points of each thread [m], shape (point_count, 3)."""
    turns = {"right": (1,), "left": (-1,), "both": (1, -1)}[helix.handedness]
    for turn in turns:
        for index in range(helix.count):
            phase = helix.phase + 2.0 * np.pi * index / helix.count
            yield helix_points(
                helix.point, helix.direction, helix.radius, helix.pitch, helix.reach, phase, turn,
                helix.segments_per_turn,
            )


def _between(layout: Layout, spring, key: str, notes: list[str]) -> _Part:
    ends = spring.ends if spring.ends[0].on != "world" else spring.ends[::-1]
    if ends[0].on == "world":
        raise layout.scene.error(f"{key}.ends", "world", "both ends stand in the world")
    first = spring_end(layout, ends[0], f"{key}.ends", notes)
    length = length_at_rest(spring)
    if ends[1].on == "world":
        return _Part(first, _nowhere(1), spring.stiffness, length, spring.damping, ends[1].point)
    second = spring_end(layout, ends[1], f"{key}.ends", notes)
    return _Part(first, second, spring.stiffness, length, spring.damping)


def length_at_rest(spring) -> float:
    """L₀ of a spring [m].

    Args:
        spring: Its entry.
    """
    first, second = (end.point for end in spring.ends)
    return np.linalg.norm(np.subtract(second, first)) if spring.rest_length is None else spring.rest_length


def spring_end(layout: Layout, end, key: str, notes: list[str]) -> BarycentricMapping:
    """An end of a spring that is not in the world.

    Args:
        layout: The bodies.
        end: Its entry.
        key: Key of both ends, for errors.
        notes: List to which a warning is appended where the point is snapped to its body.

    Raises:
        SceneError: The point is too far from its body.
    """
    if end.on not in layout.mass_nodes:
        return layout.carried(end.on, [end.point], key, notes)
    own = layout.mass_nodes[end.on]
    points = layout.drawn_positions[own]
    distances = np.linalg.norm(points - end.point, axis=1)
    # A single point has no size: its coordinates are the scale.
    size = size_of_points(points) or np.linalg.norm(points)
    if distances.min() > AT_POINT * size:
        raise layout.scene.error(key, list(end.point),
                                 f"is not a point of {end.on}; the nearest is "
                                 f"{distances.min():.3g} m away", unit="m")
    return single_nodes(own[[distances.argmin()]])


def _in_mass_spring_body(layout: Layout, entry) -> _Part:
    rest = layout.drawn_positions
    pairs = layout.mass_nodes[entry.name][np.array(entry.springs, np.int64)]
    first, second = map(single_nodes, pairs.T)
    lengths = np.linalg.norm(rest[pairs[:, 1]] - rest[pairs[:, 0]], axis=1)
    return _Part(first, second, entry.stiffness, lengths, entry.damping)
