"""Names in a scene: each stands once, and what is named exists."""

from __future__ import annotations


def check_names(scene) -> None:
    """Refuse names that stand twice.

    Args:
        scene: The scene.

    Raises:
        ValueError: A name stands more than once.
    """
    if scene.body is not None and scene.bodies:
        raise ValueError("one body is given as body, several as bodies, not both")
    if not (scene.deformables or scene.rigid_bodies or scene.mass_springs):
        raise ValueError("has no body: give body, bodies, rigid_bodies or mass_springs")
    bodies = (scene.deformables, scene.rigid_bodies, scene.mass_springs, scene.obstacles)
    for kind, names in (
        ("cable, motor or slide",
         [entry.name for entry in (*scene.cables, *scene.motors, *scene.slides)]),
        ("effector", [effector.name for effector in scene.effectors]),
        ("marker id", [marker.id for marker in scene.markers]),
        ("body or obstacle", [entry.name for group in bodies for entry in group]),
        ("spring", [entry.name for entry in (*scene.springs, *scene.tubes)]),
    ):  # fmt: skip
        twice = sorted({str(name) for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"{kind} {', '.join(twice)} stands more than once")
        if "world" in names:
            raise ValueError(f"{kind} world: this name means what does not move")


def check_references(scene) -> None:
    """Refuse names of what the scene does not have.

    Args:
        scene: The scene.

    Raises:
        ValueError: Something is named that does not exist.
    """
    deformable = [body.name for body in scene.deformables]
    rigid = [body.name for body in scene.rigid_bodies]
    masses = [body.name for body in scene.mass_springs]
    obstacles = [obstacle.name for obstacle in scene.obstacles]
    movable = deformable + rigid + masses
    for entry in (*scene.cables, *scene.effectors, *scene.tubes):
        named = entry.on if hasattr(entry, "on") else entry.body
        _check_carrier(entry.name, named, deformable, rigid)
    for marker in scene.markers:
        _check_carrier(f"marker {marker.id}", marker.body, deformable, rigid)
    for cable in scene.cables:
        _check_known(f"cable {cable.name} is pulled from", cable.pull_point_on,
                     ["world", "body", *rigid])  # fmt: skip
    for body in scene.deformables:
        for attachment in body.attached:
            _check_known(f"body {body.name} is attached to", attachment.to, rigid)
    for spring in scene.springs:
        for end in spring.ends:
            _check_known(f"spring {spring.name} holds", end.on, ["world", *movable])
    for motor in scene.motors:
        for cable in motor.cables:
            _check_known(f"motor {motor.name} winds", cable, [c.name for c in scene.cables])
    for slide in scene.slides:
        guided = [body.name for body in scene.rigid_bodies if body.motion == "guided"]
        _check_known(f"slide {slide.name} moves", slide.body, guided)
    if scene.contact is not None:
        for touching in scene.contact.between:
            for name in touching.pair:
                _check_known("contact is between", name, deformable + rigid + obstacles)
        for point in scene.contact.points:
            _check_carrier("contact.points", point.on, deformable, [])
    _check_markers(scene)


def _check_known(what: str, name: str, known: list[str]) -> None:
    if name not in known:
        raise ValueError(f"{what} {name}, which the scene does not have; it has {_listed(known)}")


def _check_carrier(what: str, name: str | None, deformable: list[str], rigid: list[str]) -> None:
    """Unnamed, it is the only deformable body."""
    known = deformable + rigid
    if name is None and len(deformable) != 1:
        raise ValueError(f"{what} must say which body it is on, of {_listed(known)}")
    if name is not None:
        _check_known(f"{what} is on", name, known)


def _listed(names: list[str]) -> str:
    return ", ".join(names) if names else "none"


def _check_markers(scene) -> None:
    known = {marker.id for marker in scene.markers}
    for effector in scene.effectors:
        missing = sorted(set(effector.measured_by) - known)
        if missing:
            raise ValueError(
                f"effector {effector.name} is measured by markers {missing}, "
                "which the scene does not have"
            )
