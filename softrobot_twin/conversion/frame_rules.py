"""Rules of frames: rigid bodies, rigid parts of deformable bodies, beams."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.actuator_rules import obj_text
from softrobot_twin.conversion.body_rules import EULER_IMPLICIT, MASSES, OTHER_MOTION, STATIC
from softrobot_twin.conversion.computed_values import (
    STATES,
    LoadedMesh,
    array_of,
    frames_of,
    indices_of,
    is_rigid,
    is_true,
    mapped_from,
    mesh_of,
    number_of,
    rigid_indices,
    state_mesh,
    state_of,
    topology_of,
    value_of,
)
from softrobot_twin.conversion.rules import (
    FIXING,
    PARTS,
    BodyRecord,
    Conversion,
    is_below_node,
    rounded,
    rule,
    source_of,
)
from softrobot_twin.conversion.scene_tree import NotConverted, SceneComponent, first, nearest
from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.surface_reading import SUFFIXES

BEAMS = ("AdaptiveBeamForceFieldAndMass", "BeamFEMForceField")
LEAST_MASS = 1e-6
"""Mass of a rigid body for which the file gives none [kg]."""
ARM = {"young_modulus": 2.0e9, "poisson_ratio": 0.3}
"""Material of arms that stand for rigid links: stiff, not so stiff that a step suffers."""
ARM_RADIUS = 0.1
"""Radius of these arms by their length."""
MOVERS = (*EULER_IMPLICIT, *STATIC, *OTHER_MOTION)


# --- surfaces -------------------------------------------------------------------------------------


def surface_of(state: SceneComponent) -> LoadedMesh | None:
    """The triangles of a state's topology at its points before mappings; None without triangles.

    Args:
        state: A state of points.
    """
    topology = topology_of(state.node)
    mesh = state_mesh(state)
    if topology is None or topology.node is not state.node:
        return None
    triangles = mesh_of(topology).triangles
    quads = array_of(topology, 4, "quads")
    if quads is not None and len(quads):
        halves = quads.astype(np.int64)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        triangles = np.concatenate([triangles, halves])
    return mesh._replace(triangles=triangles) if len(triangles) else None


def shape_entry(conversion: Conversion, mesh: LoadedMesh, name: str) -> dict[str, Any]:
    """The shape of a surface: a plane if it is flat, itself if it is closed, else its hull.

    Args:
        conversion: The conversion.
        mesh: The surface, in the frame of its carrier and the unit of the file.
        name: Name of the carrier, for a file that is written.
    """
    used = mesh.points[np.unique(mesh.triangles)]
    middle = used.mean(axis=0)
    spread = np.linalg.svd(used - middle, compute_uv=False)
    if spread[2] <= 1e-6 * spread[0]:
        sides = mesh.points[mesh.triangles[:, 1:]] - mesh.points[mesh.triangles[:, :1]]
        normal = np.cross(sides[:, 0], sides[:, 1]).sum(axis=0)
        return {"plane": {"point": conversion.length(middle), "normal": rounded(normal / np.linalg.norm(normal))}}
    _, _, _, counts = half_edges(_merged(mesh))
    hull = {} if (counts == 2).all() else {"hull": True}
    placement, metre = mesh.placement, conversion.units.metre
    if mesh.file is not None and placement.is_uniform and mesh.file.suffix.lower() in SUFFIXES:
        file = Path(os.path.relpath(mesh.file, conversion.output.resolve().parent)).as_posix()
        entry: dict[str, Any] = {"file": file, "scale": rounded(metre * placement.scale[0])}
        if placement.rotation.magnitude() > 1e-12:
            entry["rotation"] = rounded(placement.rotation.as_euler("xyz"))
        if np.abs(placement.translation).max() > 0.0:
            entry["translation"] = conversion.length(placement.translation)
        return {"surface": entry | hull}
    written = f"{conversion.output.stem}_{name}.obj"
    points = mesh.points * metre
    conversion.files[written] = lambda path: path.write_text(obj_text(points, mesh.triangles))
    return {"surface": {"file": written} | hull}


def _merged(mesh: LoadedMesh) -> np.ndarray:
    """Triangles whose coincident points are one."""
    _, place = np.unique(np.round(mesh.points, 9), axis=0, return_inverse=True)
    return np.ravel(place)[mesh.triangles]


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
    if first(state.node, BEAMS) is not None or mapped_from(state):
        return None
    if nearest(state.node, MOVERS) is None:
        return None
    masses = [one for one in conversion.components if one.kind in MASSES and state_of(one.node) is state]
    carried = _rigid_parts(conversion, state)
    surfaces = [one for one in conversion.components if one.kind in STATES and one is not state
                and not is_rigid(one) and state in mapped_from(one) and surface_of(one) is not None]  # fmt: skip
    if not masses and not carried:
        return None
    places = frames_of(state)
    names = [conversion.name(state.node.name if len(places) == 1 else f"{state.node.name}_{index + 1}")
             for index in range(len(places))]  # fmt: skip
    conversion.frames[id(state)] = names
    total = _rigid_mass(masses) * conversion.units.kilogram / len(places)
    for index, (name, frame) in enumerate(zip(names, places, strict=True)):
        mesh = next((surface_of(one) for one in surfaces), None)
        nodes = [record.mesh.points[chosen[index]] for record, chosen in carried if len(chosen[index])]
        shape = (shape_entry(conversion, mesh, name) if mesh is not None and len(places) == 1
                 else {"sphere": {"radius": _radius(conversion, frame, nodes)}})  # fmt: skip
        entry: dict[str, Any] = {"name": name, "mass": rounded(total or LEAST_MASS),
                                 "position": conversion.length(frame[:3]), **shape}  # fmt: skip
        angles = Rotation.from_quat(frame[3:]).as_euler("xyz")
        if np.abs(angles).max() > 1e-12:
            entry["rotation"] = rounded(angles)
        conversion.add("rigid_bodies", state, entry, *(() if total else ("the file gives it no mass",)))
        for record, chosen in carried:
            if len(chosen[index]):
                record.entry.setdefault("attached", []).append({"to": name, "nodes": chosen[index].tolist()})
    return f"rigid bod{'y' if len(names) == 1 else 'ies'} {', '.join(names)}: {1e3 * (total or LEAST_MASS):.4g} g"


def _rigid_mass(masses: list[SceneComponent]) -> float:
    if not masses:
        return 0.0
    total = number_of(masses[0], "totalMass")
    vertex = number_of(masses[0], "vertexMass", "mass")
    if total is None and vertex is None:
        return 0.0 if "vertexMass" in masses[0].fields else 1.0
    return vertex if total is None else total


def _radius(conversion: Conversion, frame: np.ndarray, nodes: list[np.ndarray]) -> float:
    """Radius of the sphere that stands for a part without a surface [m]."""
    far = [np.linalg.norm(one - frame[:3], axis=1).max() for one in nodes]
    return rounded(max(far, default=1.0) * conversion.units.metre)


def _rigid_parts(conversion: Conversion, state: SceneComponent) -> list[tuple[BodyRecord, list[np.ndarray]]]:
    """The bodies with points on a state's frames, and these points for each frame."""
    found, count = [], len(frames_of(state))
    for record in conversion.bodies.values():
        mapping = first(record.state.node, ("SubsetMultiMapping", "RigidMapping"))
        if mapping is None:
            continue
        sources = mapped_from(record.state, mapping)
        if mapping.kind == "RigidMapping":
            which = rigid_indices(mapping, len(record.mesh.points))
            if state in sources:
                found.append((record, [np.flatnonzero(which == index) for index in range(count)]))
            continue
        pairs = indices_of(mapping, "indexPairs")
        if pairs is None or len(pairs) != 2 * len(record.mesh.points):
            continue
        pairs = pairs.reshape(-1, 2)
        for number, source in enumerate(sources):
            own = first(source.node, ("RigidMapping",))
            if own is None or state not in mapped_from(source, own):
                continue
            which = rigid_indices(own, int(pairs[pairs[:, 0] == number, 1].max(initial=-1)) + 1)
            carried = np.full(len(pairs), -1)
            carried[pairs[:, 0] == number] = which[pairs[pairs[:, 0] == number, 1]]
            found.append((record, [np.flatnonzero(carried == index) for index in range(count)]))
    return found


# --- beams ----------------------------------------------------------------------------------------


@rule(PARTS, *BEAMS)
def beam(conversion: Conversion, component: SceneComponent) -> str | None:
    """A beam along the frames of a state.

    Args:
        conversion: The conversion.
        component: Its force field.
    """
    state = conversion.state(component)
    if not is_rigid(state):
        raise NotConverted("its points are no frames")
    section = component if component.kind == "BeamFEMForceField" else nearest(component.node, ("BeamInterpolation",))
    if section is None:
        raise NotConverted("its node has no BeamInterpolation")
    topology = topology_of(component.node)
    places = frames_of(state)
    edges = np.empty((0, 2)) if topology is None else mesh_of(topology).edges
    chain = np.stack([np.arange(len(places) - 1), np.arange(1, len(places))], axis=1)
    if len(edges) and not np.array_equal(np.sort(edges, axis=1), chain):
        raise NotConverted("its edges are no chain from the first frame to the last")
    if len(places) < 2:
        raise NotConverted("it has fewer than two frames")
    name = conversion.name(state.node.name)
    conversion.frames[id(state)] = [name] * len(places)
    material = {
        "young_modulus": number_of(section, "youngModulus", "defaultYoungModulus", otherwise=1e5),
        "poisson_ratio": number_of(section, "poissonRatio", "defaultPoissonRatio", otherwise=0.4)}  # fmt: skip
    material["young_modulus"] = rounded(material["young_modulus"] * conversion.units.pressure)
    shape, area = _section(conversion, section)
    material["density"] = _beam_density(conversion, component, places, area)
    entry: dict[str, Any] = {"name": name, "points": conversion.length(places[:, :3]), "elements": len(places) - 1,
                             "section": shape, "material": material}  # fmt: skip
    if "rectangle" in shape:
        entry["thickness_direction"] = rounded(Rotation.from_quat(places[0, 3:]).apply([0.0, 1.0, 0.0]))
    solver = nearest(component.node, EULER_IMPLICIT)
    damping = {} if solver is None else {
        key: value for key, word in (("mass", "rayleighMass"), ("stiffness", "rayleighStiffness"))
        if (value := number_of(solver, word, otherwise=0.0))}  # fmt: skip
    conversion.add("beams", component, entry | ({"damping": damping} if damping else {}))
    return f"beam {name}: {len(places)} points, E {1e-6 * material['young_modulus']:.4g} MPa"


def _section(conversion: Conversion, component: SceneComponent) -> tuple[dict[str, Any], float]:
    """The cross-section, and its area in the unit of the file."""
    shape = str(value_of(component, "crossSectionShape") or "circular")
    if shape == "circular":
        radius = number_of(component, "radius", otherwise=1.0) or 1.0
        inner = number_of(component, "innerRadius", "radiusInner", otherwise=0.0) or 0.0
        area = np.pi * (radius**2 - inner**2)
        if inner:
            return {"tube": {"radius": conversion.length(radius), "wall": conversion.length(radius - inner)}}, area
        return {"circle": {"radius": conversion.length(radius)}}, area
    if shape == "rectangular":
        sides = [number_of(component, word, otherwise=1.0) or 1.0 for word in ("lengthY", "lengthZ")]
        return {"rectangle": {"thickness": conversion.length(sides[0]), "width": conversion.length(sides[1])}}, sides[0] * sides[1]
    raise NotConverted(f"its cross-section {shape} is not built here")


def _beam_density(conversion: Conversion, component: SceneComponent, places: np.ndarray, area: float) -> float:
    """Density [kg/m³]: of the force field, or of a mass in its node."""
    density = number_of(component, "massDensity")
    if component.kind == "AdaptiveBeamForceFieldAndMass" and is_true(component, "computeMass", True):
        return rounded((1.0 if density is None else density) * conversion.units.density)
    mass = first(component.node, MASSES)
    length = float(np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1).sum())
    if mass is None:
        return 1.0
    total = number_of(mass, "totalMass")
    total = (number_of(mass, "vertexMass", otherwise=1.0) or 1.0) * len(places) if total is None else total
    return rounded(total / (area * length) * conversion.units.density)


@rule(PARTS, "BeamInterpolation")
def beam_interpolation(conversion: Conversion, component: SceneComponent) -> str | None:
    """Nothing: the beam of its node reads it.

    Args:
        conversion: The conversion.
        component: The interpolation.

    Raises:
        NotConverted: No beam does.
    """
    users = [one for one in conversion.components if one.kind in BEAMS and is_below_node(one.node, component.node)]
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
    angles = conversion.state(component)
    index = int(number_of(component, "index", otherwise=0.0) or 0)
    mapping = next((one for one in conversion.components if one.kind == "ArticulatedSystemMapping"
                    and angles in mapped_from(first(one.node, STATES) or angles, one)), None)
    links = [(one, centre) for one in conversion.components if one.kind == "Articulation"
             and int(number_of(one, "articulationIndex", otherwise=0.0) or 0) == index
             and (centre := nearest(one.node, ("ArticulationCenter",))) is not None and is_below_node(one.node, angles.node)]
    if mapping is None or len(links) != 1 or not is_true(links[0][0], "rotation", False):
        raise NotConverted("it turns no single hinge of an articulated system")
    (link, centre), state = links[0], conversion.state(mapping)
    parent, child = (int(number_of(centre, word, otherwise=0.0) or 0) for word in ("parentIndex", "childIndex"))
    places, below = frames_of(state), array_of(centre, 3, "posOnParent")
    turn = Rotation.from_quat(places[parent, 3:])
    pivot = places[parent, :3] + turn.apply(np.zeros(3) if below is None else below[0])
    array_of(centre, 3, "posOnChild")
    length = float(np.linalg.norm(places[child, :3] - pivot))
    if length < 1e-9:
        raise NotConverted("its moved frame lies in the hinge: no arm is between them")
    limits = [number_of(component, word) for word in ("minAngle", "maxAngle")]
    if None in limits:
        raise NotConverted("a motor of a hinge needs minAngle and maxAngle")
    names = conversion.frames.setdefault(id(state), [""] * len(places))
    name, moved = conversion.name(component.node.name if component.name == component.kind else component.name), conversion.length([pivot, places[child, :3]])
    axis = array_of(link, 3, "rotationAxis")
    to = {"to": names[parent], "to_at": "end"} if names[parent] else {"to": "world"}
    radius, metre = ARM_RADIUS * length, conversion.units.metre
    mass = _rigid_mass([one for one in conversion.components if one.kind in MASSES and state_of(one.node) is state])
    density = (mass * conversion.units.kilogram or LEAST_MASS) / (np.pi * radius**2 * length * metre**3)
    conversion.add("beams", component, {
        "name": name, "points": moved, "elements": 1, "section": {"circle": {"radius": conversion.length(radius)}},
        "material": {**ARM, "density": rounded(density)}, "joined": [{"at": "start", **to, "by": "hinge", "axis": rounded(
            turn.apply([1.0, 0.0, 0.0] if axis is None else axis[0]))}]}, "a stiff arm stands for the frame that it moves")
    names[child] = name
    motor = {"name": conversion.name(f"{name}_motor"), "beam": name, "at": "start", "angle": rounded(limits)}
    rate = number_of(component, "maxAngleVariation")
    if rate is not None:
        motor["rate"] = rounded(rate / conversion.time_step)
    conversion.add("hinge_motors", component, motor)
    return f"hinge motor {motor['name']}: {limits[0]:g} to {limits[1]:g} rad"


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
