"""What is warned of in the entries of a scene alone: what has no effect, and wrong units."""

from __future__ import annotations

import math
from collections.abc import Iterator

from softrobot_twin.scene.entry import values_below
from softrobot_twin.scene.schema import Scene

# A slide's travel of more than this number of sizes of the largest body is reported.
MOST_SIZES = 20.0
FOR_JOINTS = 5
"""Linearizations of a step that joints of rigid bodies take."""


def entry_warnings(scene: Scene, size: float) -> Iterator[str]:
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
    yield from _loose_joints(scene)


def _idle_damping(scene: Scene) -> Iterator[str]:
    if scene.integration != "quasi_static":
        return
    for section in ("deformables", "beams", "springs", "mass_springs"):
        for key, entry in scene.keyed(section):
            rate = entry.damping
            if not isinstance(rate, float):
                rate = max(rate.mass, rate.stiffness)
            if rate > 0.0:
                yield (f"{key}.damping has no effect: integration is quasi_static, where nothing has a "
                       "speed; first_order and dynamic scenes are damped")  # fmt: skip


def _untouched_obstacles(scene: Scene) -> Iterator[str]:
    named = {name for touching in scene.touching for name in touching.pair}
    named |= {name for cable in scene.cables for name in cable.wraps}
    for key, obstacle in scene.keyed("obstacles"):
        if obstacle.name not in named:
            yield (f"{key} ({obstacle.name}) has no effect: contact.between names no "
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
    found = [(f"{key}.hold_radius", one.hold_radius, size) for key, one in scene.keyed("cables")]
    found += [(f"{key}.travel", max(map(abs, slide.travel)), MOST_SIZES * size)
              for key, slide in scene.keyed("slides")]  # fmt: skip
    if scene.contact:
        found += [("contact.alarm_distance", scene.contact.alarm_distance, size),
                  ("contact.contact_distance", scene.contact.contact_distance, size)]  # fmt: skip
    for key, length, most in found:
        if length > most:
            yield (f"{key} = {length:g} m is very large: the largest body is {size:.4g} m large; "
                   "is it in metres?")  # fmt: skip


def _loose_joints(scene: Scene) -> Iterator[str]:
    """Joints of rigid bodies that one linearization leaves open."""
    count = scene.solver.newton_iterations
    if count < FOR_JOINTS and any(body.joined for body in scene.rigid_bodies):
        yield (f"solver.newton_iterations = {count}: where joined rigid bodies turn, each linearization "
               f"leaves a gap in their stiff bearings; {FOR_JOINTS} or more close it")  # fmt: skip
