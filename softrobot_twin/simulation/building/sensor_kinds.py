"""The kinds of sensors: each says what it measures, and builds the rows of its entries.

A new kind is a key of `Sensor` in `scene/sensor_entries.py`, and a `SensorKind` in `SENSOR_KINDS`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.cable import CablePath
from softrobot_twin.constraints.cavity import Cavities
from softrobot_twin.constraints.constraint_term import ConstraintTerm, rows_that_move_nothing
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.constraints.hinge_angle import HingeAngles
from softrobot_twin.constraints.sensors import Bends, GasPressures, PressingForces, SensedTerm, Sensors
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.scene.sensor_entries import Sensor
from softrobot_twin.simulation.building.actuator_kinds import Quantity
from softrobot_twin.simulation.building.cable_actuator import cable_path, cables_along
from softrobot_twin.simulation.building.cavity_walls import cavity_surface
from softrobot_twin.simulation.building.force_building import length_at_rest, spring_end
from softrobot_twin.simulation.building.hinge_motor_actuator import hinge_of
from softrobot_twin.simulation.building.scene_layout import Layout

LENGTH, ANGLE, VOLUME, PRESSURE, FORCE = (
    Quantity("length", "m"), Quantity("angle", "rad"), Quantity("volume", "m3"),
    Quantity("pressure", "Pa"), Quantity("force", "N"),
)  # fmt: skip
Keyed = list[tuple[str, Sensor]]


class SensorKind(NamedTuple):
    """A kind of sensors.

    Attributes:
        quantity: What it measures.
        build: Makes the rows of its entries, given with their keys; takes the contacts of the scene too,
            None without any.
    """

    quantity: Quantity
    build: Callable[[Layout, Keyed, list[str], Contacts | None], SensedTerm]


def _of_paths(layout: Layout, paths: list[CablePath]) -> SensedTerm:
    """Lengths of paths: a row of a cable is how much its path is shortened."""
    nodes = layout.nodes
    term = cables_along(tuple(paths), nodes.free_index, nodes.rest_positions, nodes.carried)
    return SensedTerm(term, term.rest_lengths, -1.0, np.ones(len(paths)), term.rest_lengths)


def _strings(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Lengths of strings through bodies."""
    return _of_paths(layout, [
        CablePath(one.name, layout.carried(one.on, one.string, f"{key}.string", notes),
                  np.array(one.pull_point) if one.pull_point else None)
        for key, one in entries])  # fmt: skip


def _cables(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Lengths of the paths of cables, of which the cables have told their notes."""
    known = {cable.name: (key, cable) for key, cable in layout.scene.keyed("cables")}
    return _of_paths(layout, [cable_path(layout, *known[one.cable], []) for _, one in entries])


def _of_angles(layout: Layout, term: ConstraintTerm) -> SensedTerm:
    count = term.row_count
    return SensedTerm(term, np.zeros(count), 1.0, np.full(count, layout.nodes.finite_size), np.ones(count))


def _bends(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Angles between the first and the last piece of a line."""
    lines = []
    for key, one in entries:
        points = [one.bend[place] for place in (0, 1, -2, -1)]
        lines.append(layout.carried(one.on, points, f"{key}.bend", notes))
    axes = np.array([one.axis for _, one in entries], float)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for (key, one), line, axis in zip(entries, lines, axes, strict=True):
        pieces = np.diff(line.positions(layout.drawn_positions).reshape(2, 2, 3), axis=1)[:, 0]
        across = np.linalg.norm(np.cross(pieces, axis), axis=1)
        if (across < 1e-6 * np.linalg.norm(pieces, axis=1)).any() or not pieces.any(axis=1).all():
            raise layout.scene.error(f"{key}.axis", list(one.axis), "is along an end of the line: "
                                     "a turn about it shows nothing")  # fmt: skip
    return _of_angles(layout, Bends(lines, axes, layout.nodes.free_index))


def _hinges(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Angles of hinges, within half a turn of rest."""
    hinges = [hinge_of(layout, one.hinge, one.at, one.name, key) for key, one in entries]
    limits, stiffness = np.zeros((len(hinges), 2)), np.ones(len(hinges))
    return _of_angles(layout, HingeAngles(layout.hinged, hinges, limits, stiffness))


def _cavities(layout: Layout, walls: list[tuple[str, str, tuple]], notes: list[str]) -> Cavities:
    """Volumes inside of walls, given with the key and the name of their cavity."""
    surfaces = tuple(cavity_surface(layout, name, own, key, notes) for key, name, own in walls)
    nodes = layout.nodes
    return Cavities(surfaces, nodes.free_index, layout.drawn_positions, nodes.carried)


def _volumes_of(term: Cavities) -> SensedTerm:
    return SensedTerm(term, term.rest_volumes, 1.0, 1.0 / term.rest_areas, term.rest_volumes)


def _walls_of(layout: Layout, name: str | None) -> tuple[str, str, tuple]:
    """Key, name and walls of a cavity, inflated or sealed."""
    keyed = (*layout.scene.keyed("cavities"), *layout.scene.keyed("sealed_cavities"))
    key, entry = next((key, entry) for key, entry in keyed if entry.name == name)
    return key, entry.name, entry.walls


def _volumes(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Volumes of cavities, which have told the notes of their walls."""
    return _volumes_of(_cavities(layout, [_walls_of(layout, one.volume) for _, one in entries], []))


def _chambers(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Volumes of chambers that are nothing else."""
    walls = [(key, one.name, one.walls) for key, one in entries]
    return _volumes_of(_cavities(layout, walls, notes))


def _pressures(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Gauge pressures of sealed gas."""
    volumes = _cavities(layout, [_walls_of(layout, one.pressure) for _, one in entries], [])
    sealed = {one.name: one for one in layout.scene.sealed_cavities}
    gas = [sealed[one.pressure] for _, one in entries]
    ambient = np.array([one.ambient_pressure for one in gas])
    absolute = ambient + [one.pressure for one in gas]
    term = GasPressures(volumes, volumes.rest_volumes, absolute, ambient)
    lengths = volumes.rest_volumes / (absolute * volumes.rest_areas)
    return SensedTerm(term, np.zeros(len(gas)), 1.0, lengths, absolute)


def _forces(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Forces of springs, positive where they pull, k (L - L₀); the springs have told their notes.

    A force counts in metres as it changes the length of its spring.
    """
    known, paths, rests = {one.name: (key, one) for key, one in layout.scene.keyed("springs")}, [], []
    for own, one in entries:
        key, spring = known[one.spring]
        if spring.damping:
            raise layout.scene.error(f"{own}.spring", spring.name, "has damping: its force is not one of a state")
        ends = sorted(spring.ends, key=lambda end: end.on != "world")
        points = [spring_end(layout, end, f"{key}.ends", []) for end in ends if end.on != "world"]
        start = np.array(ends[0].point, float) if len(points) < 2 else None
        paths.append(CablePath(one.name, reduce(BarycentricMapping.followed_by, points), start))
        rests.append(length_at_rest(spring))
    stiffness = np.array([known[one.spring][1].stiffness for _, one in entries])
    sensed, rest = _of_paths(layout, paths), np.array(rests)
    return SensedTerm(sensed.term, stiffness * (sensed.zeros - rest), -stiffness, 1.0 / stiffness,
                      stiffness * sensed.spans)  # fmt: skip


def _contacts(layout: Layout, entries: Keyed, notes: list[str], contacts: Contacts | None) -> SensedTerm:
    """Sums of normal forces of pairs."""
    known = contacts.pair_names if contacts else ()
    pairs = [next((pair for pair in known if set(pair) == set(one.contact)), None) for _, one in entries]
    for (key, one), pair in zip(entries, pairs, strict=True):
        if pair is None:
            raise layout.scene.error(f"{key}.contact", list(one.contact), "is no pair of contact.between, which has "
                                     f"{', '.join(map(' with '.join, known)) or 'none'}")  # fmt: skip
    spans = np.array([one.full_scale for _, one in entries])
    return SensedTerm(PressingForces(contacts, pairs), np.zeros(len(entries)), 1.0,
                      layout.nodes.finite_size / spans, spans)  # fmt: skip


SENSOR_KINDS: dict[str, SensorKind] = {
    "string": SensorKind(LENGTH, _strings), "cable": SensorKind(LENGTH, _cables),
    "bend": SensorKind(ANGLE, _bends), "hinge": SensorKind(ANGLE, _hinges),
    "volume": SensorKind(VOLUME, _volumes), "walls": SensorKind(VOLUME, _chambers),
    "pressure": SensorKind(PRESSURE, _pressures), "spring": SensorKind(FORCE, _forces),
    "contact": SensorKind(FORCE, _contacts),
}  # fmt: skip
"""The kinds, by the key of an entry that has them."""


def kind_of(entry: Sensor) -> str:
    """Key of the kind of an entry.

    Args:
        entry: The entry.
    """
    return next(key for key in SENSOR_KINDS if getattr(entry, key) is not None)


def in_order(scene: Scene) -> list[tuple[str, Sensor]]:
    """The sensors with their keys, those of a kind together: the order of all arrays of sensors.

    Args:
        scene: The scene.
    """
    order = list(SENSOR_KINDS)
    return sorted(scene.keyed("sensors"), key=lambda keyed: order.index(kind_of(keyed[1])))


def sensor_term(layout: Layout, notes: list[str], contacts: Contacts | None, wanted: bool = False) -> Sensors | None:
    """The rows of the sensors of a scene, or of those that may have targets.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.
        contacts: The contacts; None without any.
        wanted: Whether only sensors with a weight count.

    Returns:
        The term; None without such sensors.

    Raises:
        SceneError: An entry does not fit the bodies.
    """
    scene = layout.scene
    chosen = [keyed for keyed in in_order(scene) if keyed[1].weight or not wanted]
    if wanted and chosen:
        reason = "slides" if scene.slides else "control" if scene.control else ""
        key, entry = next((one for one in chosen if one[1].contact), chosen[0])
        if entry.contact and contacts and contacts.rubs:
            reason = "friction of contacts, which decides with the force"
        if reason:
            raise scene.error(f"{key}.weight", entry.weight, f"is not built beside {reason}")
    parts = []
    for key, kind in SENSOR_KINDS.items():
        own = [keyed for keyed in chosen if kind_of(keyed[1]) == key]
        if own:
            parts.append(kind.build(layout, own, notes, contacts))
    weights = [one.weight or 1.0 for _, one in chosen]
    term = Sensors(parts, np.array(weights)) if parts else None
    for index in rows_that_move_nothing(term, layout.nodes) if term and wanted else ():
        key, entry = chosen[index]
        raise scene.error(f"{key}.weight", entry.weight, "lies wholly in what is fixed: no target moves it")
    return term
