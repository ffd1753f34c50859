"""Rules of frames: rigid bodies, rigid parts of deformable bodies, beams."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.actuator_rules import add_actuator
from softrobot_twin.conversion.body_rules import MASSLESS, damping_of, mass_of, parts_of
from softrobot_twin.conversion.computed_values import (
    array_of,
    frames_of,
    is_rigid,
    is_true,
    mapped_from,
    mapping_of,
    mesh_of,
    number_of,
    rigid_indices,
    topology_of,
    value_of,
    whole_of,
)
from softrobot_twin.conversion.mesh_entries import shape_entry, surface_of
from softrobot_twin.conversion.rules import (
    FIXING,
    PARTS,
    BodyRecord,
    Conversion,
    rounded,
    rule,
    source_of,
)
from softrobot_twin.conversion.scene_tree import (
    KINDS,
    NotConverted,
    SceneComponent,
    components_below,
    first,
    nearest,
)

LEAST_MASS = 1e-6
"""Mass of a rigid body for which the file gives none [kg]."""
ARM = {"young_modulus": 2.0e9, "poisson_ratio": 0.3}
"""Material of arms that stand for rigid links: stiff, not so stiff that a step suffers."""
ARM_RADIUS = 0.1
"""Radius of these arms by their length."""


# --- rigid bodies ---------------------------------------------------------------------------------


@rule(PARTS, "MechanicalObject")
def frames(conversion: Conversion, state: SceneComponent) -> str | None:
    """Rigid bodies at the frames of a state that moves by itself.

    Args:
        conversion: The conversion.
        state: A state.
    """
    if not is_rigid(state) or id(state) in conversion.frames:
        return None
    if first(state.node, KINDS["beams"]) or mapped_from(state) or not nearest(state.node, KINDS["movers"]):
        return None
    places, carried = frames_of(state), _rigid_parts(conversion, state)
    mass, total = mass_of(state, len(places))
    if mass is None and not carried:
        return None
    surfaces = [surface_of(one) for one in components_below(conversion.root, KINDS["states"])
                if one is not state and not is_rigid(one) and state in mapped_from(one)]  # fmt: skip
    mesh = next(filter(None, surfaces), None)
    names = [conversion.name(state.node.name if len(places) == 1 else f"{state.node.name}_{index + 1}")
             for index in range(len(places))]  # fmt: skip
    conversion.frames[id(state)] = names
    share = rounded((total or 0.0) * conversion.units.kilogram / len(places))
    for index, (name, frame) in enumerate(zip(names, places, strict=True)):
        nodes = [record.mesh.points[chosen[index]] for record, chosen in carried if len(chosen[index])]
        shape = (shape_entry(conversion, mesh, name) if mesh is not None and len(places) == 1
                 else {"sphere": {"radius": _radius(conversion, frame, nodes)}})  # fmt: skip
        entry: dict[str, Any] = {"name": name, "mass": share or LEAST_MASS,
                                 "position": conversion.length(frame[:3]), **shape}  # fmt: skip
        turn = Rotation.from_quat(frame[3:])
        if turn.magnitude() > 1e-12:
            entry["rotation"] = rounded(turn.as_euler("xyz"))
        conversion.add("rigid_bodies", state, entry, *(() if share else ("the file gives it no mass",)))
        for record, chosen in carried:
            if len(chosen[index]):
                record.entry.setdefault("attached", []).append({"to": name, "nodes": chosen[index].tolist()})
    return f"rigid bod{'y' if len(names) == 1 else 'ies'} {', '.join(names)}: {1e3 * (share or LEAST_MASS):.4g} g"


def _radius(conversion: Conversion, frame: np.ndarray, nodes: list[np.ndarray]) -> float:
    """Radius of the sphere that stands for a part without a surface [m]."""
    far = [np.linalg.norm(one - frame[:3], axis=1).max() for one in nodes]
    return rounded(max(far, default=1.0) * conversion.units.metre)


def _rigid_parts(conversion: Conversion, state: SceneComponent) -> list[tuple[BodyRecord, list[np.ndarray]]]:
    """The bodies with points on a state's frames, and these points for each frame."""
    found = []
    for record in conversion.bodies.values():
        mapping = mapping_of(record.state)
        carried = np.full(len(record.mesh.points), -1)
        if mapping and mapping.kind == "RigidMapping" and state in mapped_from(record.state, mapping):
            carried = rigid_indices(mapping, len(carried))
        carriers = {one: own for one in mapped_from(record.state, mapping)
                    if (own := first(one.node, ("RigidMapping",))) and state in mapped_from(one, own)}  # fmt: skip
        for source, nodes, points in parts_of(record, carriers):
            carried[nodes] = rigid_indices(carriers[source], points.max(initial=-1) + 1)[points]
        if (carried >= 0).any():
            found.append((record, [np.flatnonzero(carried == index) for index in range(len(frames_of(state)))]))
    return found


# --- beams ----------------------------------------------------------------------------------------


@rule(PARTS, *KINDS["beams"])
def beam(conversion: Conversion, component: SceneComponent) -> str | None:
    """A beam along the frames of a state.

    Args:
        conversion: The conversion.
        component: Its force field.
    """
    state = conversion.state(component)
    if not is_rigid(state):
        raise NotConverted("its points are no frames")
    is_alone = component.kind == "BeamFEMForceField"
    section = component if is_alone else nearest(component.node, ("BeamInterpolation",))
    if section is None:
        raise NotConverted("its node has no BeamInterpolation")
    topology, places = topology_of(component.node), frames_of(state)
    edges = np.empty((0, 2)) if topology is None else mesh_of(topology).edges
    chain = np.stack([np.arange(len(places) - 1), np.arange(1, len(places))], axis=1)
    if len(edges) and not np.array_equal(np.sort(edges, axis=1), chain):
        raise NotConverted("its edges are no chain from the first frame to the last")
    if len(places) < 2:
        raise NotConverted("it has fewer than two frames")
    name = conversion.name(state.node.name)
    conversion.frames[id(state)] = [name] * len(places)
    shape, area = _section(conversion, section)
    young = number_of(section, "youngModulus", "defaultYoungModulus", otherwise=1e5) * conversion.units.pressure
    material = {
        "young_modulus": rounded(young),
        "poisson_ratio": number_of(section, "poissonRatio", "defaultPoissonRatio", otherwise=0.4),
        "density": _beam_density(conversion, component, places, area)}  # fmt: skip
    entry: dict[str, Any] = {
        "name": name, "points": conversion.length(places[:, :3]), "elements": len(places) - 1,
        "section": shape, "material": material, **damping_of(component.node)}  # fmt: skip
    if "rectangle" in shape:
        entry["thickness_direction"] = rounded(Rotation.from_quat(places[0, 3:]).apply([0.0, 1.0, 0.0]))
    conversion.add("beams", component, entry)
    return f"beam {name}: {len(places)} points, E {1e-6 * young:.4g} MPa"


def _section(conversion: Conversion, component: SceneComponent) -> tuple[dict[str, Any], float]:
    """The cross-section, and its area in the unit of the file."""
    shape, length = str(value_of(component, "crossSectionShape") or "circular"), conversion.length
    if shape == "circular":
        radius = number_of(component, "radius", otherwise=1.0)
        inner = number_of(component, "innerRadius", "radiusInner", otherwise=0.0)
        made = {"tube": {"radius": length(radius), "wall": length(radius - inner)}} if inner else {
            "circle": {"radius": length(radius)}}  # fmt: skip
        return made, np.pi * (radius**2 - inner**2)
    if shape == "rectangular":
        thickness, width = (number_of(component, word, otherwise=1.0) for word in ("lengthY", "lengthZ"))
        return {"rectangle": {"thickness": length(thickness), "width": length(width)}}, thickness * width
    raise NotConverted(f"its cross-section {shape} is not built here")


def _beam_density(conversion: Conversion, component: SceneComponent, places: np.ndarray, area: float) -> float:
    """Density [kg/m³]: of the force field, or of a mass in its node."""
    mass, total = mass_of(conversion.state(component), len(places))
    if component.kind == "AdaptiveBeamForceFieldAndMass" and is_true(component, "computeMass", True):
        density = number_of(component, "massDensity", otherwise=1.0)
    elif total is not None:
        density = total / (area * np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1).sum())
    elif mass is not None:
        density = number_of(mass, "massDensity", otherwise=1.0)
    else:
        conversion.notes.append(f"the beam of {component.where} has no mass: it takes {MASSLESS:g} kg/m³")
        return MASSLESS
    return rounded(density * conversion.units.density)


@rule(PARTS, "BeamInterpolation")
def beam_interpolation(conversion: Conversion, component: SceneComponent) -> str | None:
    """Nothing: the beam of its node reads it.

    Args:
        conversion: The conversion.
        component: The interpolation.

    Raises:
        NotConverted: No beam does.
    """
    users = components_below(component.node, KINDS["beams"])
    if not users:
        raise NotConverted("no force field of a beam uses it")
    return f"section of {source_of(users[0])}"


# --- hinges ---------------------------------------------------------------------------------------


@rule(PARTS, "JointActuator", "JointConstraint")
def joint(conversion: Conversion, component: SceneComponent) -> str | None:
    """A hinge of an articulated system with its motor: a stiff beam from the hinge to the frame that it moves.

    Args:
        conversion: The conversion.
        component: The actuator of the hinge.
    """
    angles, index = conversion.state(component), whole_of(component, "index")
    mapping = next((one for one in conversion.components if one.kind == "ArticulatedSystemMapping"
                    and angles in mapped_from(first(one.node, KINDS["states"]) or angles, one)), None)
    links = [(one, centre) for one in components_below(angles.node, ("Articulation",))
             if whole_of(one, "articulationIndex") == index
             and (centre := nearest(one.node, ("ArticulationCenter",)))]  # fmt: skip
    if mapping is None or len(links) != 1 or not is_true(links[0][0], "rotation", False):
        raise NotConverted("it turns no single hinge of an articulated system")
    (link, centre), state = links[0], conversion.state(mapping)
    parent, child = whole_of(centre, "parentIndex"), whole_of(centre, "childIndex")
    places, turn = frames_of(state), Rotation.from_quat(frames_of(state)[parent, 3:])
    centre.read.add("posOnChild")
    pivot = places[parent, :3] + turn.apply(array_of(centre, 3, "posOnParent", otherwise=np.zeros((1, 3)))[0])
    length = float(np.linalg.norm(places[child, :3] - pivot))
    if length < 1e-9:
        raise NotConverted("its moved frame lies in the hinge: no arm is between them")
    names = conversion.frames.setdefault(id(state), [""] * len(places))
    name = conversion.name(component.node.name if component.name == component.kind else component.name)
    axis = turn.apply(array_of(link, 3, "rotationAxis", otherwise=[[1.0, 0.0, 0.0]])[0])
    to = {"to": names[parent], "to_at": "end"} if names[parent] else {"to": "world"}
    radius = ARM_RADIUS * length
    mass = (mass_of(state, len(places))[1] or 0.0) * conversion.units.kilogram or LEAST_MASS
    density = mass / (np.pi * radius**2 * length * conversion.units.volume)
    motor = {"name": conversion.name(f"{name}_motor"), "beam": name, "at": "start"}
    told = add_actuator(conversion, component, "hinge_motors", motor)
    conversion.add("beams", component, {
        "name": name, "points": conversion.length([pivot, places[child, :3]]), "elements": 1,
        "section": {"circle": {"radius": conversion.length(radius)}},
        "material": {**ARM, "density": rounded(density)},
        "joined": [{"at": "start", **to, "by": "hinge", "axis": rounded(axis)}],
    }, "a stiff arm stands for the frame that it moves")  # fmt: skip
    names[child] = name
    return f"hinge motor {motor['name']}{told}"


@rule(FIXING, "Articulation", "ArticulationCenter")
def articulation(conversion: Conversion, component: SceneComponent) -> str | None:
    """Nothing: the actuator of the hinge has read it.

    Args:
        conversion: The conversion.
        component: The hinge, or its place.

    Raises:
        NotConverted: No actuator did.
    """
    if not component.read:
        raise NotConverted("a hinge without a JointActuator")
    return None
