"""Rules of contact: which surfaces may touch, at which distance, with which friction."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.conversion.computed_values import (
    array_of,
    indices_of,
    is_rigid,
    is_true,
    mapped_from,
    number_of,
    value_of,
)
from softrobot_twin.conversion.mesh_entries import shape_entry, surface_file, surface_of
from softrobot_twin.conversion.rules import (
    CONTACTS,
    PLANES,
    BodyRecord,
    Conversion,
    rounded,
    rule,
    source_of,
)
from softrobot_twin.conversion.scene_text import SOURCE
from softrobot_twin.conversion.scene_tree import (
    KINDS,
    NotConverted,
    SceneComponent,
    components_below,
    first,
    nearest,
)


class _Touching(NamedTuple):
    """Something with a collision model.

    Attributes:
        name: Name of its body or obstacle.
        groups: Groups of each of its surfaces; a common one forbids contact.
        can_move: Whether it is no obstacle.
        touches_itself: Whether a surface of it may touch itself.
    """

    name: str
    groups: frozenset[frozenset[int]]
    can_move: bool
    touches_itself: bool

    def may_touch(self, other: _Touching) -> bool:
        """Whether surfaces of both may touch.

        Args:
            other: The other; itself for two surfaces of it.
        """
        return any(not one & two for one in self.groups for two in other.groups if other is not self or one != two)


@rule(CONTACTS, *KINDS["intersections"])
def contact(conversion: Conversion, component: SceneComponent) -> str | None:
    """All that may touch, from the collision models of the scene.

    Args:
        conversion: The conversion.
        component: The component with the distances.
    """
    touching: dict[str, _Touching] = {}
    for model in components_below(conversion.root, KINDS["collision_models"]):
        try:
            found = _touching(conversion, model)
        except NotConverted as error:
            conversion.missing.append((model, str(error)))
            continue
        if found is not None:
            before = touching.get(found.name, found)
            itself = found.touches_itself or before.touches_itself
            touching[found.name] = found._replace(groups=found.groups | before.groups, touches_itself=itself)
    every = list(touching.values())
    pairs = [[one.name, one.name] for one in every if one.can_move and (one.touches_itself or one.may_touch(one))]
    pairs += [[one.name, other.name] for index, one in enumerate(every) for other in every[index + 1 :]
              if (one.can_move or other.can_move) and one.may_touch(other)]  # fmt: skip
    _drop_lonely_obstacles(conversion, {name for pair in pairs for name in pair})
    alarm = number_of(component, "alarmDistance", otherwise=1.0)
    least = number_of(component, "contactDistance", otherwise=0.5)
    if not pairs:
        return "nothing that may touch"
    friction = _friction(conversion)
    conversion.scene["contact"] = {
        **({"friction": friction} if friction else {}), "alarm_distance": conversion.length(alarm),
        "contact_distance": conversion.length(least), "between": [{"pair": pair} for pair in pairs]}  # fmt: skip
    return f"contact of {len(pairs)} pair{'s'[:len(pairs) > 1]}, friction {friction:g}"


def _touching(conversion: Conversion, model: SceneComponent) -> _Touching | None:
    """What a collision model belongs to; its surface becomes that of contact."""
    state = conversion.state(model)
    if id(state) in conversion.goals or not is_true(model, "active", True):
        return None
    groups = array_of(model, 1, "group", otherwise=[])
    itself, chosen = is_true(model, "selfCollision", False), frozenset((frozenset(groups.tolist()),))
    carrier = conversion.carrier(state)
    if carrier is None:
        is_free = (is_true(model, "moving", True) and is_true(model, "simulated", True)
                   and nearest(state.node, KINDS["movers"]) is not None and not mapped_from(state))  # fmt: skip
        if is_free and first(state.node, KINDS["masses"]) is None:
            return None  # a goal that the mouse moves
        return _Touching(_obstacle(conversion, model, state), chosen, False, False)
    _add_contact_surface(conversion, conversion.record_of(carrier), state)
    fixed = {one["name"] for one in conversion.scene.get("rigid_bodies", ()) if one.get("motion") == "fixed"}
    return _Touching(carrier, chosen, carrier not in fixed, itself)


def _add_contact_surface(conversion: Conversion, record: BodyRecord | None, state: SceneComponent) -> None:
    """A body's surface for contact, in place of that of its mesh."""
    if record is None or state is record.state:
        return
    mesh = surface_of(state)
    if mesh is None:
        triangles = [kind for kind in KINDS["collision_models"] if "Triangle" in kind]
        if first(state.node, triangles) is None:
            raise NotConverted("points or lines alone: the surface of the body is taken")
        return
    if conversion.surfaces.setdefault(record.name, state) is not state:
        raise NotConverted(f"a second surface for contact of {record.name}")
    record.entry["contact_surface"] = surface_file(conversion, record, mesh, f"{record.name}_contact")


def _obstacle(conversion: Conversion, model: SceneComponent, state: SceneComponent) -> str:
    """The obstacle of a state that nothing moves."""
    known = next((name for name, one in conversion.surfaces.items() if one is state), None)
    if known is not None:
        return known
    mesh, name = None if is_rigid(state) else surface_of(state), conversion.name(state.node.name)
    if mesh is not None:
        shape = shape_entry(conversion, mesh, name)
    elif model.kind.startswith("Sphere"):
        points = conversion.points(state)
        if len(points) > 1:
            raise NotConverted("several balls of one state that nothing moves")
        radius = number_of(model, "radius", "listRadius", otherwise=1.0)
        shape = {"sphere": {"centre": points[0].tolist(), "radius": conversion.length(radius)}}
    else:
        raise NotConverted("what it touches with has no surface")
    conversion.add("obstacles", model, {"name": name, **shape})
    conversion.surfaces[name] = state
    return name


def _drop_lonely_obstacles(conversion: Conversion, used: set[str]) -> None:
    """Obstacles, and surfaces for contact, that nothing may touch are left out."""
    obstacles = conversion.scene.get("obstacles", [])
    conversion.scene["obstacles"] = [one for one in obstacles if one["name"] in used]
    for record in conversion.bodies.values():
        if record.name not in used:
            record.entry.pop("contact_surface", None)


def _friction(conversion: Conversion) -> float:
    """The coefficient of friction of a scene."""
    for component in components_below(conversion.root, KINDS["responses"])[:1]:
        if "rules" in component.fields:
            reason = "its rules for single pairs: give friction of a pair in contact.between"
            conversion.missing.append((component, reason))
        found = re.search(r"mu=([\d.eE+-]+)", str(value_of(component, "responseParams") or ""))
        return float(found[1]) if found else 0.0
    return 0.0


# --- planes ---------------------------------------------------------------------------------------


def _touch(conversion: Conversion, key: str, entry: dict[str, Any]) -> None:
    """Adds to a list of the section of contact, which other rules may have filled."""
    conversion.scene.setdefault("contact", {}).setdefault(key, []).append(entry)


@rule(PLANES, "PlaneForceField")
def plane(conversion: Conversion, component: SceneComponent) -> str | None:
    """A plane that pushes a surface back: an obstacle.

    Args:
        conversion: The conversion.
        component: The force field.
    """
    state = conversion.state(component)
    carrier = conversion.needed_carrier(state)
    if is_rigid(state):
        raise NotConverted("holds origins of frames: an obstacle touches surfaces")
    if is_true(component, "bilateral", False):
        raise NotConverted("holds from both sides: an obstacle does not pull")
    if surface_of(state) is not None:
        _add_contact_surface(conversion, conversion.record_of(carrier), state)
    contact = conversion.scene.get("contact", {})
    normal = array_of(component, 3, "normal", otherwise=[[0.0, 1.0, 0.0]])[0]
    size = np.linalg.norm(normal)
    away = number_of(component, "d", otherwise=0.0) / size * conversion.units.metre
    away -= contact.get("contact_distance", 0.0)
    name = conversion.name(f"{component.node.name}_plane" if component.name == component.kind else component.name)
    conversion.add("obstacles", component, {
        "name": name, "plane": {"point": rounded(away * normal / size), "normal": rounded(normal / size)}})  # fmt: skip
    _touch(conversion, "between", {"pair": [carrier, name]} | ({"friction": 0.0} if "friction" in contact else {}))
    component.read |= {"stiffness", "damping"}
    conversion.notes.append(f"plane {name} yields to what presses on it in the file; here it is rigid")
    return f"obstacle {name} below {carrier}"


@rule(PLANES, "UnilateralPlaneConstraint")
def point_before_triangle(conversion: Conversion, component: SceneComponent) -> str | None:
    """A point that stays on the outer side of three others of the same body.

    Args:
        conversion: The conversion.
        component: The constraint.
    """
    state = conversion.state(component)
    record = conversion.record_of(conversion.carrier(state))
    if record is None or len(mapped_from(state)) > 1:
        raise NotConverted("its points are not all on one deformable body that is converted")
    places = conversion.points(state)[indices_of(component, "indices", otherwise=[])[:4]]
    if len(places) < 4:
        raise NotConverted("needs four points")
    point, *corners = places
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    if normal @ (point - corners[0]) * (-1.0 if is_true(component, "flipNormal", False) else 1.0) <= 0.0:
        raise NotConverted("its point is not before the plane of the others")
    _touch(conversion, "points", {
        SOURCE: [source_of(component)], "on": record.name, "point": rounded(point),
        "against": rounded(np.mean(corners, axis=0))})  # fmt: skip
    return f"contact of a point with a triangle of {record.name}, those of its surface that are nearest"
