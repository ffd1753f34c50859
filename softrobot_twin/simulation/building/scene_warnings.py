"""Entries of a scene that have no effect, and angles and lengths that may be in a wrong unit."""

from __future__ import annotations

import math
from collections.abc import Iterator

from softrobot_twin.scene import Scene
from softrobot_twin.scene.entry import values_below

# A slide's travel of more than this number of sizes of the largest body is reported.
MOST_SIZES = 20.0


def scene_warnings(scene: Scene, size: float) -> Iterator[str]:
    """Entries without effect, and entries in the wrong unit.

    Args:
        scene: The scene.
        size: Diagonal of its largest body's bounding box [m]; infinite for a single point.

    Yields:
        A sentence for each.
    """
    yield from _idle_damping(scene)
    yield from _untouched_obstacles(scene)
    yield from _angles_in_degrees(scene)
    yield from _long_lengths(scene, size)


def _idle_damping(scene: Scene) -> Iterator[str]:
    if scene.integration != "quasi_static":
        return
    for section in ("deformables", "beams", "springs", "mass_springs"):
        for index, entry in enumerate(getattr(scene, section)):
            rate = entry.damping
            if not isinstance(rate, float):
                rate = max(rate.mass, rate.stiffness)
            key = f"{section.replace('deformables', 'bodies')}[{index}].damping"
            if section == "deformables" and scene.body is not None:
                key = "body.damping"
            if rate > 0.0:
                yield (f"{key} has no effect: integration is quasi_static, where nothing has a "
                       "speed; first_order and dynamic scenes are damped")  # fmt: skip


def _untouched_obstacles(scene: Scene) -> Iterator[str]:
    pairs = () if scene.contact is None else scene.contact.between
    named = {name for touching in pairs for name in touching.pair}
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.name not in named:
            yield (f"obstacles[{index}] ({obstacle.name}) has no effect: contact.between names no "
                   "pair with it, so everything passes through it")  # fmt: skip


def _angles_in_degrees(scene: Scene) -> Iterator[str]:
    """Rotations of more than a turn; those of meshes are reported when the mesh is read."""
    for key, name, value in values_below(scene):
        if name != "rotation" or key.endswith("mesh.rotation"):
            continue
        largest = max(map(abs, value))
        if largest > 2.0 * math.pi:
            yield (f"{key} holds {largest:g} rad, more than a turn: are the angles in "
                   "degrees?")  # fmt: skip


def _long_lengths(scene: Scene, size: float) -> Iterator[str]:
    """Lengths that are not part of the largest body, but larger than it."""
    found = [(f"cables[{index}].hold_radius", cable.hold_radius, size)
             for index, cable in enumerate(scene.cables)]  # fmt: skip
    found += [(f"slides[{index}].travel", max(map(abs, slide.travel)), MOST_SIZES * size)
              for index, slide in enumerate(scene.slides)]  # fmt: skip
    if scene.contact is not None:
        found += [("contact.alarm_distance", scene.contact.alarm_distance, size),
                  ("contact.contact_distance", scene.contact.contact_distance, size)]  # fmt: skip
    for key, length, most in found:
        if length > most:
            yield (f"{key} = {length:g} m is very large: the largest body is {size:.4g} m large; "
                   "is it in metres?")  # fmt: skip
