"""Checks of names in a scene: each name is given once, and every named object exists."""

from __future__ import annotations

from fnmatch import fnmatchcase

from softrobot_twin.scene.entry import refusal
from softrobot_twin.scene.refusal_messages import nearest


def check_names(scene) -> None:
    """Refuses names that are given twice.

    Args:
        scene: The scene.

    Raises:
        PydanticCustomError: A name is given more than once.
    """
    if scene.body is not None and scene.bodies:
        raise refusal("bodies", "(and body)",
                      "a single body is given as body, several as bodies, not both")  # fmt: skip
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
                raise refusal(key, name,
                              f"{kind} {name} is given more than once, also in ", seen[name])
            if name == "world":
                raise refusal(key, name, f"{kind} world: this name is reserved for the fixed world")
            seen[name] = key


def check_references(scene) -> None:
    """Refuses names of objects that the scene does not have.

    Args:
        scene: The scene.

    Raises:
        PydanticCustomError: A named object does not exist.
    """
    sections = "deformables", "rigid_bodies", "beams", "mass_springs", "obstacles", "cables"
    deformable, rigid, beams, masses, obstacles, cables = (names_in(scene, one) for one in sections)
    framed = rigid + beams
    for section in (*scene.actuator_entries, "sealed_cavities", "sensors"):
        for key, entry in scene.keyed(section):
            entry.check_references(scene, key)
    for section, word, others in (
        ("effectors", "body", framed), ("tubes", "on", framed), ("touches", "body", []),
        ("fibres", "on", []), ("markers", "body", framed),
    ):  # fmt: skip
        for key, entry in scene.keyed(section):
            name = f"marker {entry.id}" if section == "markers" else entry.name
            check_carrier(f"{key}.{word}", name, getattr(entry, word), deformable, others)
    for key, grip in scene.keyed("grips"):
        check_carrier(f"{key}.body", grip.name, grip.body, deformable, framed)
        check_known(f"{key}.holds", f"grip {grip.name} holds", grip.holds, ["world", *rigid])
    for key, entry in scene.keyed("reactions"):
        what = f"reaction {entry.name}"
        check_known(f"{key}.of", f"{what} is of", entry.of, deformable + framed + masses)
        if entry.attached_to is not None:
            check_known(f"{key}.of", f"{what} is at an attachment, and is of", entry.of, deformable)
            check_known(f"{key}.attached_to", f"{what} is at", entry.attached_to, rigid)
    touches = [touch.name for touch in scene.touches]
    for index, force in enumerate(scene.observer.forces if scene.observer else ()):
        key, what = f"observer.forces[{index}]", f"force {force.name}"
        if force.touch is not None:
            check_known(f"{key}.touch", f"{what} acts at", force.touch, touches)
        else:
            others = framed if force.points else rigid
            check_carrier(f"{key}.body", what, force.body, deformable, others)
    if scene.observer is not None and len(scene.markers) < 3:
        raise refusal("markers", f"{len(scene.markers)} markers",
                      "an observer needs three markers or more, which tell it of forces")
    for key, beam in scene.keyed("beams"):
        for index, joint in enumerate(beam.joined):
            others = [name for name in framed if name != beam.name]
            others += ["world"] if joint.by != "rigid" and not is_pattern(joint.to) else []
            what = f"beam {beam.name} is joined to"
            check_pattern(f"{key}.joined[{index}].to", what, joint.to, others)
    for key, body in scene.keyed("rigid_bodies"):
        for index, joint in enumerate(body.joined):
            check_known(f"{key}.joined[{index}].to", f"rigid body {body.name} is joined to", joint.to,
                        ["world", *(name for name in rigid if name != body.name)])
    for key, body in scene.keyed("deformables"):
        for index, attachment in enumerate(body.attached):
            what = f"body {body.name} is attached to"
            check_known(f"{key}.attached[{index}].to", what, attachment.to, rigid)
    for key, spring in scene.keyed("springs"):
        for index, end in enumerate(spring.ends):
            what, known = f"spring {spring.name} is connected to", deformable + framed + masses
            check_known(f"{key}.ends[{index}].on", what, end.on, ["world", *known])
    for key, motor in scene.keyed("motors"):
        for index, cable in enumerate(motor.cables):
            check_known(f"{key}.cables[{index}]", f"motor {motor.name} drives", cable, cables)
    _check_pulleys(scene)
    if scene.contact is not None:
        for place, touching in enumerate(scene.contact.between):
            for index, name in enumerate(touching.pair):
                check_known(f"contact.between[{place}].pair[{index}]", "contact is between",
                            name, deformable + framed + obstacles)  # fmt: skip
        for index, point in enumerate(scene.contact.points):
            check_carrier(f"contact.points[{index}].on", "contact.points", point.on, deformable, [])
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


def check_carrier(
    key: str, what: str, name: str | None, deformable: list[str], rigid: list[str]
) -> None:
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
        raise refusal(key, "(nothing)",
                      f"{what} must name the body it is on, one of {_listed(known)}")  # fmt: skip
    if name is not None:
        check_known(key, f"{what} is on", name, known)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if names else "none"
