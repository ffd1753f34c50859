"""Rules of actuators and effectors: cables, pressures, points that follow goals."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.computed_values import (
    STATES,
    UNMOVED,
    LoadedMesh,
    array_of,
    frames_of,
    indices_of,
    is_rigid,
    is_true,
    mesh_of,
    number_of,
    state_mesh,
    topology_of,
    value_of,
)
from softrobot_twin.conversion.rules import ACTUATORS, BodyRecord, Conversion, rounded, rule
from softrobot_twin.conversion.scene_tree import (
    NotConverted,
    SceneComponent,
    follow,
    is_link,
    numbers,
)
from softrobot_twin.geometry.surface_reading import SUFFIXES

MOST_POINTS = 5000
"""An effector at the mean of more points is not written."""


def _impulse(conversion: Conversion) -> float:
    """What divides efforts: in motion in time SOFA's are impulses, effort times step [s]."""
    return 1.0 if conversion.scene.get("integration") == "quasi_static" else conversion.time_step


def _note_impulse(conversion: Conversion) -> None:
    note = (f"efforts (forces of cables, pressures) are divided by the step, {conversion.time_step:g} s: in motion in "
            "time SOFA's are impulses")  # fmt: skip
    if _impulse(conversion) != 1.0 and note not in conversion.notes:
        conversion.notes.append(note)


def _name_of(conversion: Conversion, component: SceneComponent) -> str:
    """Name of an entry: the component's own, or that of its node where another one has the same."""
    same = [one for one in conversion.components if (one.kind, one.name) == (component.kind, component.name)]
    nodes = {id(one.node) for one in same}
    return component.node.name if component.name == component.kind or len(nodes) > 1 else component.name


def _limits(component: SceneComponent, low: str, high: str, factor: float, sign: float = 1.0) -> list | None:
    """Limits by two fields, open where one is missing; None where both are."""
    given = [number_of(component, name) for name in (low, high)]
    if given == [None, None]:
        return None
    least = -np.inf if given[0] is None else sign * given[0] * factor
    most = np.inf if given[1] is None else given[1] * factor
    return [rounded(min(least, 0.0)) if np.isfinite(least) else least,
            rounded(max(most, 0.0)) if np.isfinite(most) else most]  # fmt: skip


# --- cables ---------------------------------------------------------------------------------------


@rule(ACTUATORS, "CableConstraint", "CableActuator")
def cable(conversion: Conversion, component: SceneComponent) -> str | None:
    """A cable through points of a body.

    Args:
        conversion: The conversion.
        component: The constraint or actuator.
    """
    state = conversion.state(component)
    method = str(value_of(component, "method") or "point")
    if method != "point":
        raise NotConverted(f"its method {method}, which pulls at patches, is not built here")
    carrier = conversion.carrier(state)
    if carrier is None:
        raise NotConverted("its points are on no body that is converted")
    points = conversion.points(state)
    chosen = indices_of(component, "indices")
    path = points[chosen if chosen is not None and len(chosen) else [0]]
    entry: dict[str, Any] = {"name": conversion.name(_name_of(conversion, component), component.node.name), "body": carrier}
    if is_true(component, "hasPullPoint", True):
        pull = array_of(component, 3, "pullPoint")
        entry["pull_point"] = conversion.length(np.zeros(3) if pull is None else pull[0])
    else:
        if len(path) < 2:
            raise NotConverted("a cable without a pull point needs two points")
        entry |= {"pull_point": rounded(path[0]), "pull_point_on": "body"}
        path = path[1:]
    entry["points"] = rounded(path)
    entry = conversion.add("cables", component, entry)
    _cable_limits(conversion, component, entry)
    return f"cable {entry['name']} on {carrier}: {len(path)} point{'s'[:len(path) > 1]}{_in_words(entry)}"


def _cable_limits(conversion: Conversion, component: SceneComponent, entry: dict[str, Any]) -> None:
    metre, force = conversion.units.metre, conversion.units.force / _impulse(conversion)
    name = entry["name"]
    shortening = _limits(component, "maxNegativeDisp", "maxPositiveDisp", metre, -1.0)
    if component.fields.get("maxNegativeDisplacement") or component.fields.get("maxPositiveDisplacement"):
        shortening = _limits(component, "maxNegativeDisplacement", "maxPositiveDisplacement", metre, -1.0)
    if shortening is not None:
        entry["shortening"] = shortening
    variation = number_of(component, "maxDispVariation")
    if variation is not None:
        entry["rate"] = rounded(variation * metre / conversion.time_step)
    most = number_of(component, "maxForce")
    least = number_of(component, "minForce")
    if most is not None or (least or 0.0) > 0.0:
        entry["tension"] = [rounded(max(least or 0.0, 0.0) * force), np.inf if most is None else rounded(most * force)]
        _note_impulse(conversion)
    if least is None or least < 0.0:
        conversion.notes.append(f"cable {name} could push in the file; here no cable does")
    if component.kind == "CableActuator":
        for word in ("initForce", "initDisplacement"):
            number_of(component, word)
        return
    values, which = array_of(component, 1, "value"), int(number_of(component, "valueIndex", otherwise=0.0) or 0)
    value = 0.0 if values is None or which >= len(values) else float(values[which])
    by_force = str(value_of(component, "valueType") or "displacement").lower() in ("force", "1")
    conversion.commands[f"{name}_tension_N" if by_force else f"{name}_shortening_m"] = rounded(
        value * (force if by_force else metre))  # fmt: skip
    if by_force:
        _note_impulse(conversion)


# --- cavities -------------------------------------------------------------------------------------


@rule(ACTUATORS, "SurfacePressureConstraint", "SurfacePressureActuator", "SurfacePressureModel")
def cavity(conversion: Conversion, component: SceneComponent) -> str | None:
    """A surface with a pressure inside.

    Args:
        conversion: The conversion.
        component: The constraint or actuator.
    """
    state = conversion.state(component)
    carrier = conversion.carrier(state)
    record = next((one for one in conversion.bodies.values() if one.name == carrier), None)
    if record is None:
        raise NotConverted("its surface is on no deformable body that is converted")
    topology = topology_of(component.node)
    mesh = state_mesh(state)._replace(triangles=np.empty((0, 3), np.int64))
    if topology is not None:
        mesh = mesh._replace(triangles=mesh_of(topology).triangles)
    own = array_of(component, 3, "triangles")
    if own is not None and len(own):
        whole = len(own) == len(mesh.triangles)
        mesh = mesh._replace(triangles=own.astype(np.int64), file=mesh.file if whole else None)
    quads = array_of(component, 4, "quads")
    if quads is not None and len(quads):
        halves = quads.astype(np.int64)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
        mesh = mesh._replace(triangles=np.concatenate([mesh.triangles, halves]), file=None)
    if not len(mesh.triangles):
        raise NotConverted("its surface has no triangles")
    name = conversion.name(_name_of(conversion, component), component.node.name)
    wall = {"body": carrier, **surface_file(conversion, record, mesh, name)}
    entry: dict[str, Any] = {"name": name, "walls": [wall]}
    entry = conversion.add("cavities", component, entry)
    _cavity_limits(conversion, component, entry)
    return f"cavity {name} on {carrier}: {len(mesh.triangles)} triangles{_in_words(entry)}"


def _in_words(entry: dict[str, Any]) -> str:
    """Limits of an actuator in units that are read easily."""
    told = [f", {key} {factor * entry[key][0]:.4g} to {factor * entry[key][1]:.4g} {unit}"
            for key, factor, unit in (("shortening", 1e3, "mm"), ("tension", 1.0, "N"), ("pressure", 1e-3, "kPa"),
                                      ("growth", 1e6, "cm³")) if key in entry]  # fmt: skip
    return "".join(told)


def surface_file(conversion: Conversion, record: BodyRecord, mesh: LoadedMesh, name: str) -> dict[str, Any]:
    """The file of a surface: the scene's own where it is placed like the body, else one that is written.

    Args:
        conversion: The conversion.
        record: The body that carries the surface.
        mesh: The surface, in the unit of the file.
        name: Name of the cavity, or of what else it is, for a file that is written.

    Returns:
        Keys `file` and `scale` of an entry.
    """
    body = record.mesh.placement if record.entry["mesh"].get("scale") is not None else UNMOVED
    metre = conversion.units.metre
    same_place = (np.allclose(mesh.placement.translation, body.translation)
                  and (mesh.placement.rotation * body.rotation.inv()).magnitude() < 1e-9)  # fmt: skip
    if mesh.file is not None and mesh.placement.is_uniform and same_place and mesh.file.suffix.lower() in SUFFIXES:
        file = Path(os.path.relpath(mesh.file, conversion.output.resolve().parent)).as_posix()
        return {"file": file, "scale": rounded(metre * mesh.placement.scale[0])}
    # Where the surface is before the placement of the body's mesh [m].
    points = body.rotation.inv().apply((mesh.points - body.translation) * metre)
    written = f"{conversion.output.stem}_{name}.obj"
    conversion.files[written] = lambda path: path.write_text(obj_text(points, mesh.triangles))
    return {"file": written}


def obj_text(points: np.ndarray, triangles: np.ndarray) -> str:
    """A surface as a Wavefront file.

    Args:
        points: Shape (point_count, 3).
        triangles: Shape (triangle_count, 3).
    """
    lines = [f"v {x:.10g} {y:.10g} {z:.10g}" for x, y, z in points]
    lines += [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    return "\n".join(lines) + "\n"


def _cavity_limits(conversion: Conversion, component: SceneComponent, entry: dict[str, Any]) -> None:
    units = conversion.units
    pressure, volume = units.pressure / _impulse(conversion), units.metre**3
    limits = _limits(component, "minPressure", "maxPressure", pressure)
    if limits is not None:
        entry["pressure"] = limits
        _note_impulse(conversion)
    else:
        entry["pressure"] = [-np.inf, np.inf]
    growth = _limits(component, "minVolumeGrowth", "maxVolumeGrowth", volume)
    if growth is not None:
        entry["growth"] = growth
    by_volume = str(value_of(component, "valueType") or "pressure").lower() in ("volumegrowth", "1")
    names = ("maxVolumeGrowthVariation", "maxPressureVariation")
    variation = {name: number_of(component, name) for name in names}
    if by_volume:
        entry["control"] = "volume"
    rate = variation[names[0]] if by_volume else variation[names[1]]
    if rate is not None:
        entry["rate"] = rounded(rate * (volume if by_volume else pressure) / conversion.time_step)
    if component.kind == "SurfacePressureActuator":
        for word in ("initPressure", "initVolumeGrowth"):
            number_of(component, word)
        return
    values, which = array_of(component, 1, "value"), int(number_of(component, "valueIndex", otherwise=0.0) or 0)
    value = 0.0 if values is None or which >= len(values) else float(values[which])
    column = "growth_m3" if by_volume else "pressure_Pa"
    conversion.commands[f"{entry['name']}_{column}"] = rounded(value * (volume if by_volume else pressure))
    if value and not by_volume:
        _note_impulse(conversion)


# --- effectors ------------------------------------------------------------------------------------


def _goal(conversion: Conversion, component: SceneComponent, width: int) -> np.ndarray | None:
    """Places that are wanted, in the unit of the file, shape (count, width); None for none."""
    value = value_of(component, "effectorGoal", "effectorGoalPosition")
    if value is None:
        return None
    if isinstance(value, SceneComponent):
        value = value_of(value, "position")
    link = component.fields.get("effectorGoal") or component.fields.get("effectorGoalPosition")
    if is_link(link):
        owner = follow(link, component.node)[0]
        conversion.goals.add(id(owner))
    found = numbers(value)
    if is_link(link) and isinstance(owner, SceneComponent) and owner.kind in STATES and is_rigid(owner):
        found = numbers(found, 7)[:, :width].ravel()
    return found.reshape(-1, width) if len(found) and not len(found) % width else None


@rule(ACTUATORS, "PositionEffector")
def position_effector(conversion: Conversion, component: SceneComponent) -> str | None:
    """Points, or frames, that follow goals.

    Args:
        conversion: The conversion.
        component: The effector.
    """
    state = conversion.state(component)
    chosen = indices_of(component, "indices")
    chosen = np.array([0]) if chosen is None or not len(chosen) else chosen
    rigid = is_rigid(state)
    axes = array_of(component, 1, "useDirections")
    axes = np.ones(6) if axes is None or not len(axes) else np.resize(axes, 6) if len(axes) > 3 else np.append(axes, [0] * 3)
    for name in ("directions",):
        turned = array_of(component, 3, name)
        if turned is not None and len(turned) >= 3 and not np.allclose(turned[:3], np.eye(3)):
            raise NotConverted("its directions are not the axes of the world")
    points, goals = conversion.points(state), _goal(conversion, component, 7 if rigid else 3)
    weight = number_of(component, "weight", otherwise=1.0) or 1.0
    base = conversion.name(_name_of(conversion, component))
    made = []
    for place, index in enumerate(chosen):
        name = base if len(chosen) == 1 else conversion.name(f"{base}_{place + 1}")
        carrier = conversion.frames[id(state)][index] if rigid and id(state) in conversion.frames else conversion.carrier(state)
        if carrier is None:
            raise NotConverted("its points are on no body that is converted")
        entry: dict[str, Any] = {"name": name, "body": carrier, "points": [rounded(points[index])]}
        letters = [axis for axis, used in zip("xyz", axes[:3], strict=True) if used]
        if letters != ["x", "y", "z"]:
            entry["directions"] = letters
        if weight != 1.0:
            entry["weight"] = weight
        if rigid and axes[3:].all():
            entry["orientation"] = {}
        entry = conversion.add("effectors", component, entry)
        if goals is not None and place < len(goals):
            _want(conversion, name, goals[place], entry, frames_of(state)[index] if rigid else None)
        made.append(name)
    return f"effector{'s' if len(made) > 1 else ''} {', '.join(made)} on {carrier}"


def _want(conversion: Conversion, name: str, goal: np.ndarray, entry: dict[str, Any], frame: np.ndarray | None) -> None:
    """The target of an effector, for the file of targets."""
    for axis, value in zip("xyz", goal[:3] * conversion.units.metre, strict=True):
        conversion.targets[f"{name}_{axis}_m"] = rounded(value)
    if "orientation" in entry and frame is not None:
        from_rest = Rotation.from_quat(goal[3:]) * Rotation.from_quat(frame[3:]).inv()
        for word, value in zip(("qx", "qy", "qz", "qw"), from_rest.as_quat(), strict=True):
            conversion.targets[f"{name}_{word}"] = rounded(value)


@rule(ACTUATORS, "BarycentricCenterEffector")
def centre_effector(conversion: Conversion, component: SceneComponent) -> str | None:
    """The mean of all points of a state, which follows a goal.

    Args:
        conversion: The conversion.
        component: The effector.
    """
    state = conversion.state(component)
    points, carrier = conversion.points(state), conversion.carrier(state)
    if is_rigid(state):
        raise NotConverted("the mean of frames is not built here: PositionEffector takes one frame")
    if carrier is None:
        raise NotConverted("its points are on no body that is converted")
    if len(points) > MOST_POINTS:
        raise NotConverted(f"the mean of {len(points)} points; at most {MOST_POINTS} are written")
    name = conversion.name(_name_of(conversion, component))
    entry: dict[str, Any] = {"name": name, "body": carrier, "points": rounded(points)}
    axes = array_of(component, 1, "axis", "useDirections")
    if axes is not None and len(axes) == 3 and not axes.all():
        entry["directions"] = [axis for axis, used in zip("xyz", axes, strict=True) if used]
    conversion.add("effectors", component, entry)
    goal = _goal(conversion, component, 3)
    if goal is not None:
        _want(conversion, name, goal[0], entry, None)
    return f"effector {name}: mean of {len(points)} points on {carrier}"
