"""Checks of names in a scene: each name is given once, and every named object exists."""

from __future__ import annotations

from collections.abc import Iterator
from fnmatch import fnmatchcase
from typing import Any

from softrobot_twin.scene.entry import FRAMED, OnBody, refusal
from softrobot_twin.scene.refusal_messages import nearest


def check_names(scene) -> None:
    """Refuses names that are given twice.

    Args:
        scene: The scene.

    Raises:
        PydanticCustomError: A name is given more than once.
    """
    if scene.body is not None and scene.bodies:
        raise refusal("bodies", "(and body)", "a single body is given as body, several as bodies, not both")
    if not (scene.deformables or scene.rigid_bodies or scene.mass_springs or scene.beams):
        raise refusal("body", "(nothing)",
                      "the scene has no body: give body, bodies, beams, rigid_bodies or "
                      "mass_springs")
    nouns = dict.fromkeys(e.noun for entries in scene.actuator_entries.values() for e in entries)
    words = [*nouns, "motor", *(["sensor"] if scene.sensors else [])]
    *others, last = words
    for kind, sections in (
        (f"{', '.join(others)} or {last}" if others else last, (*scene.actuator_entries, "motors", "sensors")),
        ("sealed cavity", ("sealed_cavities",)), ("effector", ("effectors",)),
        ("touch", ("touches",)), ("reaction", ("reactions",)),
        ("grip", ("grips",)), ("marker id", ("markers",)),
        ("body or obstacle", ("deformables", "rigid_bodies", "mass_springs", "beams", "obstacles")),
        ("spring", ("springs", "tubes", "fibres")),
    ):  # fmt: skip
        word, seen = "id" if kind == "marker id" else "name", dict[object, str]()
        for key, entry in (keyed for section in sections for keyed in scene.keyed(section)):
            key, name = f"{key}.{word}", getattr(entry, word)
            if name in seen:
                raise refusal(key, name, f"{kind} {name} is given more than once, also in ", seen[name])
            if name == "world":
                raise refusal(key, name, f"{kind} world: this name is reserved for the fixed world")
            seen[name] = key


_RIGID, _DEFORMABLE = ("rigid_bodies",), ("deformables",)
_BODIES = (*_DEFORMABLE, *FRAMED, "mass_springs")
_NAMES: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("cables.wraps", "cable {} wraps", ("obstacles",), ()),
    ("cables.pull_point_on", "cable {} is pulled from", FRAMED, ("world", "body")),
    ("cavities.walls.also_on", "{} is on", _DEFORMABLE, ()),
    ("sealed_cavities.walls.also_on", "{} is on", _DEFORMABLE, ()),
    ("slides.body", "slide {} moves", ("guided_bodies",), ()),
    ("hinge_motors.beam", "hinge motor {} turns", ("beams",), ()),
    ("rest_shapes.beam", "rest shape {} changes", ("beams",), ()),
    ("sensors.cable", "{} measures", ("cables",), ()),
    ("sensors.hinge", "{} measures", ("beams",), ()),
    ("sensors.pressure", "{} measures", ("sealed_cavities",), ()),
    ("sensors.spring", "{} measures", ("springs",), ()),
    ("sensors.volume", "{} measures", ("cavities", "sealed_cavities"), ()),
    ("sensors.walls.also_on", "{} is on", _DEFORMABLE, ()),
    ("grips.holds", "grip {} holds", _RIGID, ("world",)),
    ("reactions.of", "reaction {} is of", _BODIES, ()),
    ("reactions.attached_to", "reaction {} is at", _RIGID, ()),
    ("rigid_bodies.joined.to", "rigid body {} is joined to", _RIGID, ("world",)),
    ("deformables.attached.to", "body {} is attached to", _RIGID, ()),
    ("springs.ends.on", "spring {} is connected to", _BODIES, ("world",)),
    ("motors.cables", "motor {} drives", ("cables",), ()),
)
"""Names of other objects: where they are, what is said of their entry, and the sections and further names
that they may be of. No entry names itself."""
_PATTERNS = (("cables.also_on", "cable {} is also on"), ("muscles.also_on", "muscle {} is also on"))
"""Names of bodies, or patterns of them."""
_CARRIERS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("tubes.on", FRAMED), ("fibres.on", ()), ("markers.body", FRAMED), ("cavities.walls.body", ()),
    ("sealed_cavities.walls.body", ()), ("sensors.walls.body", ()),
)
"""Bodies of entries that are no `OnBody`, and the sections that they may be of, see there."""


def check_references(scene) -> None:
    """Refuses names of objects that the scene does not have.

    Args:
        scene: The scene.

    Raises:
        PydanticCustomError: A named object does not exist.
    """
    deformable, framed = names_in(scene, *_DEFORMABLE), names_in(scene, *FRAMED)
    for section in (*scene.actuator_entries, "effectors", "touches", "grips"):
        for key, entry in scene.keyed(section):
            if isinstance(entry, OnBody):
                check_carrier(f"{key}.body", entry.name, entry.body, deformable, names_in(scene, *entry.carriers))
            if section in scene.actuator_entries:
                entry.check_references(scene, key)
    for place, sections in _CARRIERS:
        for key, entry, name in _values_at(scene, place):
            what = f"marker {entry.id}" if place == "markers.body" else entry.name
            check_carrier(key, what, name, deformable, names_in(scene, *sections))
    for place, words, sections, others in _NAMES:
        for key, entry, name in _values_at(scene, place):
            known = names_in(scene, *sections)
            if place.split(".")[0] in sections:
                known.remove(entry.name)
            if name is not None:
                check_known(key, words.format(entry.name), name, [*others, *known])
    for place, words in _PATTERNS:
        for key, entry, name in _values_at(scene, place):
            check_pattern(key, words.format(entry.name), name, deformable + framed)
    for key, sensor in scene.keyed("sensors"):
        if sensor.string is not None or sensor.bend is not None:
            check_carrier(f"{key}.on", sensor.name, sensor.on, deformable, framed)
    for key, entry in scene.keyed("reactions"):
        if entry.attached_to is not None:
            check_known(f"{key}.of", f"reaction {entry.name} is at an attachment, and is of", entry.of, deformable)
    for key, beam in scene.keyed("beams"):
        for index, joint in enumerate(beam.joined):
            joined = [name for name in framed if name != beam.name]
            joined += ["world"] if joint.by != "rigid" and not is_pattern(joint.to) else []
            what = f"beam {beam.name} is joined to"
            check_pattern(f"{key}.joined[{index}].to", what, joint.to, joined)
    _check_pulleys(scene)
    if scene.contact is not None:
        for number, touching in enumerate(scene.contact.between):
            for index, name in enumerate(touching.pair):
                check_known(f"contact.between[{number}].pair[{index}]", "contact is between",
                            name, deformable + framed + names_in(scene, "obstacles"))  # fmt: skip
        for index, point in enumerate(scene.contact.points):
            check_carrier(f"contact.points[{index}].on", "contact.points", point.on, deformable, [])
    _check_observation(scene)


def _values_at(scene, place: str) -> Iterator[tuple[str, Any, Any]]:
    """The values at a place such as ``springs.ends.on``: their keys, entries of the section, and values."""
    section, *words = place.split(".")
    for key, entry in scene.keyed(section):
        found = [(key, entry)]
        for word in words:
            inner = [(f"{above}.{word}", getattr(one, word)) for above, one in found if one is not None]
            found = [item for below, value in inner for item in (
                [(f"{below}[{index}]", one) for index, one in enumerate(value)]
                if isinstance(value, tuple) else [(below, value)])]  # fmt: skip
        yield from ((below, entry, value) for below, value in found)


def _check_observation(scene) -> None:
    """Refuses forces that an observer cannot find, and effectors that are measured by no marker."""
    deformable, framed = names_in(scene, *_DEFORMABLE), names_in(scene, *FRAMED)
    for index, force in enumerate(scene.observer.forces if scene.observer else ()):
        key, what = f"observer.forces[{index}]", f"force {force.name}"
        if force.touch is not None:
            check_known(f"{key}.touch", f"{what} acts at", force.touch, names_in(scene, "touches"))
        else:
            others = framed if force.points else names_in(scene, *_RIGID)
            check_carrier(f"{key}.body", what, force.body, deformable, others)
    if scene.observer is not None and len(scene.markers) < 3 and not scene.sensors:
        raise refusal("markers", f"{len(scene.markers)} markers",
                      "an observer needs three markers or more, or a sensor, which tell it of forces")
    ids = {marker.id for marker in scene.markers}
    for key, effector in scene.keyed("effectors"):
        missing = sorted(set(effector.measured_by) - ids)
        if missing:
            raise refusal(f"{key}.measured_by", list(effector.measured_by),
                          f"effector {effector.name} is measured by markers {missing}, which the "
                          "scene does not have")


def _check_pulleys(scene) -> None:
    """Refuses cables that are wound by two pulleys."""
    wound = {cable.name: f"{key}.pulley" for key, cable in scene.keyed("cables") if cable.pulley}
    for key, motor in scene.keyed("motors"):
        for cable in motor.cables if motor.pulley else ():
            if cable in wound:
                raise refusal(f"{key}.pulley", motor.name,
                              f"winds cable {cable}, which {wound[cable]} winds too")
            wound[cable] = f"{key}.pulley"


def names_in(scene, *sections: str) -> list[str]:
    """Names of all entries of some sections.

    Args:
        scene: The scene.
        *sections: Such as ``beams``.
    """
    return [entry.name for section in sections for entry in getattr(scene, section)]


def check_known(key: str, what: str, name: str, known: list[str]) -> None:
    """Refuses a name that is not known.

    Args:
        key: Key of the entry.
        what: Subject of the message, such as ``slide lift moves``.
        name: The name.
        known: Names that the scene has.

    Raises:
        PydanticCustomError: The scene does not have this name.
    """
    if name not in known:
        raise refusal(key, name, f"{what} {name}, which the scene does not have"
                      f"{nearest(name, known)}; it has {_listed(known)}")  # fmt: skip


def is_pattern(word: str) -> bool:
    """Whether a word is a pattern, and no name.

    Args:
        word: The word.
    """
    return any(letter in word for letter in "*?[")


def matching(pattern: str, known: list[str]) -> list[str]:
    """Known names that match a pattern as in a shell, such as ``rib_*``, in their order.

    Args:
        pattern: The pattern; without ``*``, ``?`` and ``[`` it is a name.
        known: The names.
    """
    return [name for name in known if fnmatchcase(name, pattern)]


def check_pattern(key: str, what: str, pattern: str, known: list[str]) -> None:
    """Refuses a pattern that no name matches; see `matching` and `check_known`.

    Raises:
        PydanticCustomError: The scene has no such name.
    """
    if matching(pattern, known):
        return
    if is_pattern(pattern):
        raise refusal(key, pattern,
                      f"{what} {pattern}, which no body of the scene matches; it has "
                      f"{_listed(known)}")  # fmt: skip
    check_known(key, what, pattern, known)


def check_carrier(key: str, what: str, name: str | None, deformable: list[str], rigid: list[str]) -> None:
    """Checks the body of an entry; without a name the only deformable body is meant.

    Args:
        key: Key of the entry.
        what: Subject of the message.
        name: The body, or None.
        deformable: Names of the deformable bodies.
        rigid: Names of the rigid bodies.

    Raises:
        PydanticCustomError: The body does not exist, or a name is required.
    """
    known = deformable + rigid
    if name is None and len(deformable) != 1:
        raise refusal(key, "(nothing)", f"{what} must name the body it is on, one of {_listed(known)}")
    if name is not None:
        check_known(key, f"{what} is on", name, known)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if names else "none"
