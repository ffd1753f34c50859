"""Rules of actuators, effectors and sensors: cables, pressures, forces, slides, moduli, points that follow goals."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.computed_values import (
    LoadedMesh,
    array_of,
    frames_of,
    indices_of,
    is_rigid,
    is_true,
    number_of,
    state_mesh,
    value_of,
    whole_of,
)
from softrobot_twin.conversion.mesh_entries import normal_of, surface_file, surface_of, with_quads
from softrobot_twin.conversion.rules import ACTUATORS, BodyRecord, Conversion, rounded, rule
from softrobot_twin.conversion.scene_tree import (
    KINDS,
    TABLE,
    NotConverted,
    SceneComponent,
    follow,
    is_link,
    nearest,
    numbers,
)

MOST_POINTS = 5000
"""An effector at the mean of more points is not written."""
_TABLE: dict[str, dict[str, Any]] = TABLE["actuators"]


def _name_of(conversion: Conversion, component: SceneComponent) -> str:
    """Name of an entry: the component's own, or that of its node where another one has the same."""
    same = {id(one.node) for one in conversion.components if (one.kind, one.name) == (component.kind, component.name)}
    is_usual = component.name == component.kind or len(same) > 1
    return conversion.name(component.node.name if is_usual else component.name, component.node.name)


def _held_points(conversion: Conversion, component: SceneComponent) -> tuple[str, np.ndarray]:
    """The points [m] that an actuator acts on, shape (count, 3), and what carries them."""
    state = conversion.state(component)
    return conversion.needed_carrier(state), conversion.points(state)[indices_of(component, "indices", otherwise=[0])]


# --- cables and cavities --------------------------------------------------------------------------


@rule(ACTUATORS, "CableConstraint", "CableActuator")
def cable(conversion: Conversion, component: SceneComponent) -> str | None:
    """A cable through points of a body.

    Args:
        conversion: The conversion.
        component: The constraint or actuator.
    """
    method = str(value_of(component, "method") or "point")
    if method != "point":
        raise NotConverted(f"its method {method}, which pulls at patches, is not built here")
    carrier, path, start = _path(conversion, component)
    if not start:
        start, path = {"pull_point": rounded(path[0]), "pull_point_on": "body"}, path[1:]
    entry = {"name": _name_of(conversion, component), "body": carrier, **start, "points": rounded(path)}
    limits = add_actuator(conversion, component, "cables", entry)
    if number_of(component, "minForce", otherwise=-1.0) < 0.0:
        conversion.notes.append(f"cable {entry['name']} could push in the file; here no cable does")
    return f"cable {entry['name']} on {carrier}: {len(path)} point{'s'[:len(path) > 1]}{limits}"


def _path(conversion: Conversion, component: SceneComponent) -> tuple[str, np.ndarray, dict[str, Any]]:
    """The carrier and the points [m] of a cable, and its pull point in the world, if it has one."""
    carrier, path = _held_points(conversion, component)
    if is_true(component, "hasPullPoint", True):
        pull = array_of(component, 3, "pullPoint", otherwise=np.zeros((1, 3)))
        return carrier, path, {"pull_point": conversion.length(pull[0])}
    if len(path) < 2:
        raise NotConverted("a cable without a pull point needs two points")
    return carrier, path, {}


@rule(ACTUATORS, "CableEffector", "CableSensor")
def cable_length(conversion: Conversion, component: SceneComponent) -> str | None:
    """The length of a cable that pulls nothing: a string, which may be wanted.

    Args:
        conversion: The conversion.
        component: The effector or sensor.
    """
    name, (carrier, path, start) = _name_of(conversion, component), _path(conversion, component)
    return _sensor(conversion, component, {"name": name, "on": carrier, **start, "string": rounded(path)},
                   "desiredLength", "metre", "length_m") + f" on {carrier}: {len(path)} points"  # fmt: skip


def _sensor(conversion: Conversion, component: SceneComponent, entry: dict, wanted: str, unit: str, column: str) -> str:
    """Adds a sensor; that of an effector has a weight, and a target from its field `wanted`."""
    if component.kind.endswith("Effector"):
        entry["weight"] = 1.0
        target = number_of(component, wanted)
        if target is not None:
            conversion.targets[f"{entry['name']}_{column}"] = rounded(target * getattr(conversion.units, unit))
    conversion.add("sensors", component, entry)
    return f"sensor {entry['name']}"


@rule(ACTUATORS, "SurfacePressureConstraint", "SurfacePressureActuator", "SurfacePressureModel")
def cavity(conversion: Conversion, component: SceneComponent) -> str | None:
    """A surface with a pressure inside.

    Args:
        conversion: The conversion.
        component: The constraint or actuator.
    """
    name, wall, words = _closed_surface(conversion, component)
    limits = add_actuator(conversion, component, "cavities", {"name": name, "walls": [wall]})
    return f"cavity {name} {words}{limits}"


@rule(ACTUATORS, "VolumeEffector", "SurfacePressureSensor")
def volume(conversion: Conversion, component: SceneComponent) -> str | None:
    """The volume in a surface, which may be wanted.

    Args:
        conversion: The conversion.
        component: The effector or sensor.
    """
    name, wall, words = _closed_surface(conversion, component)
    return _sensor(conversion, component, {"name": name, "walls": [wall]}, "desiredVolume", "volume",
                   "volume_m3") + f" {words}"  # fmt: skip


def _surface(conversion: Conversion, component: SceneComponent) -> tuple[BodyRecord, LoadedMesh]:
    """The surface that a component is about, in the unit of the file, and the body that carries it."""
    state = conversion.state(component)
    record = conversion.record_of(conversion.carrier(state))
    if record is None:
        raise NotConverted("its surface is on no deformable body that is converted")
    mesh = surface_of(state) or state_mesh(state)
    own = array_of(component, 3, "triangles")
    if own is not None and len(own):
        is_whole = len(own) == len(mesh.triangles)
        mesh = mesh._replace(triangles=own.astype(np.int64), file=mesh.file if is_whole else None)
    mesh = with_quads(mesh, component)
    if not len(mesh.triangles):
        raise NotConverted("its surface has no triangles")
    return record, mesh


def _closed_surface(conversion: Conversion, component: SceneComponent) -> tuple[str, dict[str, Any], str]:
    """Name and wall of the chamber that a component is about, and in words where it is."""
    record, mesh = _surface(conversion, component)
    name = _name_of(conversion, component)
    wall = {"body": record.name, **surface_file(conversion, record, mesh, name)}
    return name, wall, f"on {record.name}: {len(mesh.triangles)} triangles"


@rule(ACTUATORS, "ForcePointActuator")
def force(conversion: Conversion, component: SceneComponent) -> str | None:
    """A force that each of some points of a body bears; here they share the sum.

    Args:
        conversion: The conversion.
        component: The actuator.
    """
    carrier, points = _held_points(conversion, component)
    direction = array_of(component, 3, "direction", otherwise=np.zeros((1, 3)))[0]
    if not direction.any() and number_of(component, "initForce"):
        raise NotConverted("a force that has no direction begins at zero here")
    entry = {"name": _name_of(conversion, component), "body": carrier, "points": rounded(points)}
    entry |= {"direction": rounded(direction)} if direction.any() else {}
    limits = add_actuator(conversion, component, "forces", entry, len(points))
    return f"force {entry['name']} on {carrier}: {len(points)} point{'s'[:len(points) > 1]}{limits}"


@rule(ACTUATORS, "ForceSurfaceActuator")
def surface_forces(conversion: Conversion, component: SceneComponent) -> str | None:
    """Forces on the points of a surface in spheres; a point bears less of one the farther it is from its centre.

    Args:
        conversion: The conversion.
        component: The actuator.
    """
    record, mesh = _surface(conversion, component)
    centres = array_of(component, 3, "centers", otherwise=np.empty((0, 3)))
    radii = array_of(component, 1, "radii", otherwise=[1.0])
    radii = radii if len(radii) == len(centres) else radii[:1]
    shares = 1.0 - np.linalg.norm(mesh.points - centres[:, None], axis=2) / radii[:, None]
    if not len(shares) or shares.max(axis=1).min() <= 0.0:
        raise NotConverted("no point of its surface is in one of its spheres")
    given = array_of(component, 3, "directions", otherwise=np.empty((0, 3)))
    base, follows = _name_of(conversion, component), is_true(component, "updateNormals", False)
    told = []
    for index, own in enumerate(shares):
        inside = np.flatnonzero(own > 0.0)
        name = base if len(centres) == 1 else conversion.name(f"{base}_{index + 1}")
        entry = {"name": name, "body": record.name, "points": conversion.length(mesh.points[inside]),
                 "shares": rounded(own[inside])}  # fmt: skip
        if len(given) == len(centres):
            entry["direction"] = rounded(given[index])
        else:
            normal = normal_of(mesh, np.isin(mesh.triangles, inside).any(axis=1))
            entry |= {"direction": rounded(normal)} | ({"turns_with_body": True} if follows else {})
        limits = add_actuator(conversion, component, "forces", entry, own[inside].sum())
        told.append(f"force {name} on {record.name}: {len(inside)} point{'s'[:len(inside) > 1]}{limits}")
    return "; ".join(told)


@rule(ACTUATORS, "SlidingActuator")
def slide(conversion: Conversion, component: SceneComponent) -> str | None:
    """What moves points, or a frame, along a direction: a force by displacement, or a slide.

    Args:
        conversion: The conversion.
        component: The actuator.
    """
    state, name = conversion.state(component), _name_of(conversion, component)
    direction = array_of(component, 1, "direction", otherwise=[1.0, 0.0, 0.0])
    if not is_rigid(state):
        carrier, points = conversion.needed_carrier(state), conversion.points(state)
        points = points[indices_of(component, "indices", otherwise=np.arange(len(points)))]
        entry = {"name": name, "body": carrier, "points": rounded(points), "direction": rounded(direction)}
        limits = add_actuator(conversion, component, "moved_points", entry)
        return f"force {name} on {carrier}, by displacement: {len(points)} point{'s'[:len(points) > 1]}{limits}"
    if direction[3:].any():
        raise NotConverted("turns a frame: a hinge motor turns a beam about a hinge")
    if not conversion.is_static:
        raise NotConverted("moves a frame in motion in time: slides are built with a StaticSolver")
    body = conversion.needed_carrier(state, whole_of(component, "indices"))
    rigid_bodies = conversion.scene.get("rigid_bodies", ())
    if not any(one["name"] == body and one.get("motion") == "guided" for one in rigid_bodies):
        raise NotConverted("moves a frame that nothing holds along the other axes, or that of a beam")
    limits = add_actuator(conversion, component, "slides", {"name": name, "body": body, "axis": rounded(direction[:3])})
    return f"slide {name} of {body}{limits}"


@rule(ACTUATORS, "YoungModulusActuator")
def modulus(conversion: Conversion, component: SceneComponent) -> str | None:
    """Young's modulus of what a force field acts on; that of other fields on the same cells is added.

    Args:
        conversion: The conversion.
        component: The actuator.
    """
    linked = value_of(component, "forceField")
    fem = linked if isinstance(linked, SceneComponent) else nearest(component.node, KINDS["linear"])
    record = None if fem is None else conversion.bodies.get(id(conversion.state(fem)))
    if fem is None or record is None:
        raise NotConverted("finds no force field of a body that is converted")
    own = np.flatnonzero(record.acting[id(fem)])
    part = next((index for index, (_, cells) in enumerate(record.materials)
                 if np.array_equal(np.sort(cells), own)), None)  # fmt: skip
    if part is None:
        raise NotConverted("its force field has several moduli with the others: a stiffener changes one")
    material, units = record.materials[part][0], conversion.units
    ratio, usual = material.get("poisson_ratio"), number_of(fem, "poissonRatio", otherwise=0.45)
    if ratio is None or abs(ratio - usual) > 1e-9:
        raise NotConverted("Poisson's ratio of its cells would change with the modulus")
    young = number_of(fem, "youngModulus", otherwise=5000.0) * units.pressure
    limits = [number_of(component, key, otherwise=value) * units.pressure + material["young_modulus"] - young
              for key, value in (("minYoung", 10.0), ("maxYoung", 1e5))]  # fmt: skip
    entry = {"name": _name_of(conversion, component), "body": record.name, "young_modulus": rounded(limits)}
    if len(record.materials) > 1:
        entry["region"] = f"part_{part}" if part else "body"
    share = number_of(component, "maxYoungVariationRatio")
    if share is not None:
        entry["rate"] = rounded(share * young / conversion.time_step)
    conversion.add("stiffeners", component, entry)
    return f"stiffener {entry['name']} of {record.name}, E {1e-3 * limits[0]:.4g} to {1e-3 * limits[1]:.4g} kPa"


def add_actuator(conversion: Conversion, component: SceneComponent, kind: str, entry: dict, count: float = 1.0) -> str:
    """Adds an entry with limits by the table of its kind, and the value to the commands.

    Args:
        conversion: The conversion.
        component: The actuator.
        kind: Name of the table: the section of the entry, where the table names no other one.
        entry: The entry.
        count: By how much the effort here is that of the file.

    Returns:
        The limits in words.
    """
    table, told = _TABLE[kind], ""
    for key, row in table["limits"].items():
        low, high = (number_of(component, *row[end], may_be_infinite=True) for end in ("low", "high"))
        factor = count * _in_si(conversion, row["unit"], bool(low or high))
        least = -np.inf if low is None else row.get("sign", 1.0) * low * factor
        most = np.inf if high is None else high * factor
        # No actuator here has limits without rest, but for cables that stay taut.
        if row.get("is_bounded") and not np.isfinite([least, most]).all():
            raise NotConverted(f"needs both limits of its {key}")
        limits = [max(least, 0.0), most] if row.get("pulls") else [min(least, 0.0), max(most, 0.0)]
        if limits != row.get("open"):
            entry[key] = list(map(rounded, limits))
            told += ", {} {:.4g} to {:.4g} {}".format(key, *row["show"] * np.array(limits), row["show_unit"])
    usual, other = [*table["values"], ""][:2]
    chosen = other if other and str(value_of(component, "valueType")).lower() in (other.lower(), "1") else usual
    row = table["values"][chosen]
    if "control" in row:
        entry["control"] = row["control"]
    rate = number_of(component, row["rate"], may_be_infinite=True) if "rate" in row else None
    if rate is not None:
        entry["rate"] = rounded(count * rate * _in_si(conversion, row["unit"]) / conversion.time_step)
    conversion.add(table.get("section", kind), component, entry)
    if component.kind.endswith("Actuator"):
        given = {key: number_of(component, one["initial"], otherwise=0.0)
                 for key, one in table["values"].items() if "initial" in one}  # fmt: skip
        given = {key: value for key, value in given.items() if value}
    else:
        values, index = array_of(component, 1, "value", otherwise=[0.0]), whole_of(component, "valueIndex")
        given = {chosen: values[index] if index < len(values) else 0.0}
    for key, value in given.items():
        column, unit = (table["values"][key][word] for word in ("column", "unit"))
        value_in_si = count * value * _in_si(conversion, unit, bool(value))
        conversion.commands[f"{entry['name']}_{column}"] = rounded(value_in_si)
    return told


def _in_si(conversion: Conversion, unit: str, is_used: bool = True) -> float:
    """The factor of a unit; in motion in time SOFA's efforts are impulses, effort times step."""
    factor = getattr(conversion.units, unit)
    if unit not in ("force", "pressure", "torque") or conversion.is_static:
        return factor
    note = ("efforts (forces of cables, pressures) are divided by the step, "
            f"{conversion.time_step:g} s: in motion in time SOFA's are impulses")  # fmt: skip
    if is_used and note not in conversion.notes:
        conversion.notes.append(note)
    return factor / conversion.time_step


# --- effectors ------------------------------------------------------------------------------------


def _goals(conversion: Conversion, component: SceneComponent, width: int) -> np.ndarray:
    """Places that are wanted, in the unit of the file, shape (count, width)."""
    names = ("effectorGoal", "effectorGoalPosition")
    value = value_of(component, *names)
    for link in filter(is_link, map(component.fields.get, names)):
        owner, _ = follow(link, component.node)
        conversion.goals.add(id(owner))
        if isinstance(owner, SceneComponent) and owner.kind in KINDS["states"]:
            value = frames_of(owner)[:, :width] if is_rigid(owner) else value_of(owner, "position")
    return np.empty((0, width)) if value is None else numbers(value, width).reshape(-1, width)


@rule(ACTUATORS, "PositionEffector")
def position_effector(conversion: Conversion, component: SceneComponent) -> str | None:
    """Points, or frames, that follow goals.

    Args:
        conversion: The conversion.
        component: The effector.
    """
    state = conversion.state(component)
    chosen, is_frame = indices_of(component, "indices", otherwise=[0]), is_rigid(state)
    turned = array_of(component, 3, "directions")
    if turned is not None and len(turned) >= 3 and not np.allclose(turned[:3], np.eye(3)):
        raise NotConverted("its directions are not the axes of the world")
    axes = array_of(component, 1, "useDirections", otherwise=np.ones(6))
    points, goals = conversion.points(state), _goals(conversion, component, 7 if is_frame else 3)
    base, made = _name_of(conversion, component), []
    for place, index in enumerate(chosen):
        name = base if len(chosen) == 1 else conversion.name(f"{base}_{place + 1}")
        carrier = conversion.needed_carrier(state, index if is_frame else 0)
        frame = frames_of(state)[index] if is_frame and len(axes) > 3 and axes[3:].all() else None
        entry = {"name": name, "body": carrier, "points": rounded(points[[index]])}
        _add_effector(conversion, component, entry, axes, goals[place : place + 1], frame)
        made.append(name)
    return f"effector{'s' if len(made) > 1 else ''} {', '.join(made)} on {carrier}"


@rule(ACTUATORS, "BarycentricCenterEffector")
def centre_effector(conversion: Conversion, component: SceneComponent) -> str | None:
    """The mean of all points of a state, which follows a goal.

    Args:
        conversion: The conversion.
        component: The effector.
    """
    state = conversion.state(component)
    if is_rigid(state):
        raise NotConverted("the mean of frames is not built here: PositionEffector takes one frame")
    points, carrier = conversion.points(state), conversion.needed_carrier(state)
    if len(points) > MOST_POINTS:
        raise NotConverted(f"the mean of {len(points)} points; at most {MOST_POINTS} are written")
    axes = array_of(component, 1, "axis", "useDirections", otherwise=np.ones(3))
    entry = {"name": _name_of(conversion, component), "body": carrier, "points": rounded(points)}
    _add_effector(conversion, component, entry, axes, _goals(conversion, component, 3))
    return f"effector {entry['name']}: mean of {len(points)} points on {carrier}"


def _add_effector(
    conversion: Conversion, component: SceneComponent, entry: dict[str, Any], axes: np.ndarray, goals: np.ndarray,
    frame: np.ndarray | None = None,
) -> None:  # fmt: skip
    """Adds an effector along some axes, and its goal, if it has one, to the file of targets.

    Args:
        conversion: The conversion.
        component: Its source.
        entry: Its name, body and points.
        axes: Which axes it follows along.
        goals: Shape (count, width), in the unit of the file; the first one is its goal.
        frame: The frame that turns with its goal; None where none does.
    """
    if not axes[:3].all():
        entry["directions"] = [axis for axis, is_used in zip("xyz", axes, strict=False) if is_used]
    weight = number_of(component, "weight", otherwise=1.0)
    entry |= ({} if weight == 1.0 else {"weight": weight}) | ({} if frame is None else {"orientation": {}})
    conversion.add("effectors", component, entry)
    for goal in goals[:1]:
        wanted = dict(zip(("x_m", "y_m", "z_m"), goal[:3] * conversion.units.metre, strict=True))
        if frame is not None:
            turn_of_goal = Rotation.from_quat(goal[3:]) * Rotation.from_quat(frame[3:]).inv()
            wanted |= zip(("qx", "qy", "qz", "qw"), turn_of_goal.as_quat(), strict=True)
        conversion.targets |= {f"{entry['name']}_{key}": rounded(value) for key, value in wanted.items()}
