"""Cables as actuators: their constraint term from a scene, their quantities, and warnings of
unlikely limits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.cable import CablePath, Cables, Wrap, folds
from softrobot_twin.constraints.cable_friction import CableMaterials, FrictionCables
from softrobot_twin.constraints.elastic_cable import ElasticCables
from softrobot_twin.constraints.wrapped_cable import RubbingWraps, WrappedCables, drawn_path, side_at
from softrobot_twin.scene import Scene
from softrobot_twin.scene.actuator_entries import Cable, Pulley
from softrobot_twin.scene.shapes import AxialShape
from softrobot_twin.scene.references import matching
from softrobot_twin.scene.words import count, words
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
    numbers_of,
)
from softrobot_twin.simulation.building.limits import (
    efforts_at_scale,
    pulley_of_cable,
    shortenings_of_angles,
    unlikely,
)
from softrobot_twin.simulation.building.scene_layout import Layout

# Limits outside these shares of a cable's natural scales are reported: a wrong unit is a factor of
# a thousand.
SHORTENING_RANGE = (1.0e-3, 10.0)
"""Of the cable's length at rest."""
RATE_RANGE = (1.0e-3, 100.0)
"""Of the cable's length at rest, in a second."""
TENSION_RANGE = (2.0e-3, 50.0)
"""Of the tension that would shorten the whole cable, if the body were linear."""

PLACES = 25
"""Places along a straight part of a cable at which what it passes through is looked for."""
PRESLIDING = 1.0e-3
"""Presliding of a cable with friction, as a share of its length at rest."""


class CableActuator(ActuatorKind):
    """The kind `cables`; see `ActuatorKind`."""

    section = "cables"
    entry = Cable
    setpoint = Quantity("length", "m")
    displacement = Quantity("shortening", "m")
    effort = Quantity("tension", "N")
    sign = -1
    one_sided = True
    least_setpoint = 0.0

    def build(self, layout: Layout, entries: tuple[Cable, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`. No cable is shortened by more than its length at rest."""
        rest = layout.nodes.rest_positions
        paths = [_path(layout, *keyed, notes) for keyed in layout.scene.keyed("cables")]
        cables = _term(layout, tuple(paths), entries)
        ranges, rates = numbers_of(entries, "shortening"), numbers_of(entries, "rate")
        names = _limit_by_pulleys(entries, pulley_of_cable(layout.scene), ranges, rates)
        ranges[:, 1] = np.where(np.isinf(ranges[:, 1]), cables.rest_lengths, ranges[:, 1])
        return group_of(
            self, entries, cables, cables.scales, numbers_of(entries, "tension"), np.ones(len(entries)),
            rest_setpoints=cables.rest_lengths + numbers_of(entries, "offset"), displacement_bounds=ranges,
            rates=rates, rest_extents=cables.rest_lengths, limit_names=names,
        )  # fmt: skip

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """Limits that are a thousand times out of scale; see `ActuatorKind.doubts`."""
        asked = any(0.0 < cable.tension[1] < np.inf for cable in model.scene.cables)
        tensions = efforts_at_scale(model, group.term) if asked else None
        yield from _crossings(model, group)
        for index, (key, cable) in enumerate(model.scene.keyed("cables")):
            length = float(group.term.rest_lengths[index])
            stated = f"the cable is {length:.4g} m long at rest"
            ends = [abs(end) for end in cable.shortening if np.isfinite(end)]
            yield from unlikely(f"{key}.shortening", max(ends, default=0.0), "m", length,
                              SHORTENING_RANGE, f"{stated}; is the limit in metres?")  # fmt: skip
            yield from unlikely(f"{key}.rate", cable.rate or 0.0, "m/s", length, RATE_RANGE,
                              f"{stated}; is the rate in m/s?")  # fmt: skip
            if tensions is not None:
                yield from unlikely(
                    f"{key}.tension", cable.tension[1], "N", float(tensions[index]), TENSION_RANGE,
                    f"about {tensions[index]:.2g} N would shorten it to nothing; is the limit in "
                    "newtons?",
                )  # fmt: skip

    def paths(self, group: ActuatorGroup, positions: np.ndarray) -> tuple[np.ndarray, ...]:
        """The cables, pull point first; see `ActuatorKind.paths`."""
        return tuple(drawn_path(path, path.positions(positions)) for path in group.term.paths)

    def details(self, entry: Cable, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        radius = entry.pulley and f"{1e3 * entry.pulley.radius:.6g} mm"
        return words(
            f"{count(entry.points, 'point')}, pulled from the {entry.pull_point_on}",
            radius and f"wound by a pulley of radius {radius}",
            f"stretches, EA {entry.axial_stiffness:.6g} N" if _stretches(entry) else None,
            f"zero error {1e3 * entry.offset:.6g} mm" if entry.offset else None,
            f"around {', '.join(entry.wraps)}" if entry.wraps else None,
            f"friction {entry.friction:.6g} along its path" if entry.friction else None,
        )


def _stretches(cable: Cable) -> bool:
    return cable.axial_stiffness is not None and np.isfinite(cable.axial_stiffness)


def _term(layout: Layout, paths: tuple[CablePath, ...], entries: tuple[Cable, ...]) -> Cables:
    """The constraint term; only one that yields where a cable stretches."""
    nodes = layout.nodes
    for index, cable in enumerate(entries if any(map(_stretches, entries)) else ()):
        if cable.wraps:
            raise layout.scene.error(f"cables[{index}].wraps", list(cable.wraps), "is not built beside "
                                     "cables that stretch")  # fmt: skip
    if any(cable.friction for cable in entries):
        return _friction_term(layout, paths, entries)
    # Past limit points a given volume needs the whole of A, and so do beams that buckle.
    others = sum(map(len, layout.scene.actuator_entries.values())) - len(entries)
    taken = (paths, nodes.free_index, nodes.rest_positions, nodes.carried, not others and not layout.beams)
    if not any(_stretches(cable) for cable in entries):
        return cables_along(paths, *taken[1:])
    return ElasticCables(*taken, numbers_of(entries, "axial_stiffness"))


def cables_along(paths: tuple[CablePath, ...], *places) -> Cables:
    """The term of cables that do not stretch; only one that wraps where a path does.

    Args:
        paths: The cables.
        places: Further arguments of `Cables`.
    """
    return (WrappedCables if any(path.wraps for path in paths) else Cables)(paths, *places)


def _friction_term(layout: Layout, paths: tuple[CablePath, ...], entries: tuple[Cable, ...]) -> FrictionCables:
    """The term of cables of which some have friction along their paths.

    Raises:
        SceneError: The scene has what this friction is not built for.
    """
    scene, nodes = layout.scene, layout.nodes
    index = next(index for index, cable in enumerate(entries) if cable.friction)
    if scene.time_scheme != "backward_euler":
        raise scene.error(f"cables[{index}].friction", entries[index].friction,
                          f"friction along cables is not built for time_scheme {scene.time_scheme}")
    pieces = [np.diff(path.positions(nodes.rest_positions), axis=0) for path in paths]
    usual = PRESLIDING * np.array([np.linalg.norm(own, axis=1).sum() for own in pieces])
    given = numbers_of(entries, "presliding")
    materials = CableMaterials(numbers_of(entries, "axial_stiffness"), numbers_of(entries, "friction"),
                               np.where(np.isinf(given), usual, given))  # fmt: skip
    kind = RubbingWraps if any(path.wraps for path in paths) else FrictionCables
    return kind(paths, nodes.free_index, nodes.rest_positions, materials, nodes.carried)


def _limit_by_pulleys(
    entries: tuple[Cable, ...], pulleys: dict[str, Pulley], ranges: np.ndarray, rates: np.ndarray
) -> tuple[tuple[str, str], ...]:
    """Limit shortenings and rates by the angles and speeds of pulleys.

    Args:
        entries: The cables.
        pulleys: Pulley of each cable that has one.
        ranges: Limits of the shortenings [m], shape (count, 2); narrowed.
        rates: Greatest rates [m/s], shape (count,); lowered.

    Returns:
        Names of the least and the greatest shortening in reports: those of angles where a pulley
        sets them.
    """
    names = []
    for index, cable in enumerate(entries):
        own = ["shortening_min", "shortening_max"]
        pulley = pulleys.get(cable.name)
        if pulley:
            least, most = shortenings_of_angles(pulley)
            ends = ("angle_min", "angle_max")[:: 1 if pulley.wound > 0.0 else -1]
            if least > ranges[index, 0]:
                ranges[index, 0], own[0] = least, ends[0]
            if most < ranges[index, 1]:
                ranges[index, 1], own[1] = most, ends[1]
            if pulley.rate:
                rates[index] = min(rates[index], pulley.rate * pulley.radius)
        names.append(tuple(own))
    return tuple(names)


def _path(layout: Layout, key: str, cable: Cable, notes: list[str]) -> CablePath:
    """A cable's path, carried by its bodies; a note names the points where it folds back."""
    path = cable_path(layout, key, cable, notes)
    for fold in folds(path.positions(layout.nodes.rest_positions)):
        where = "pull_point" if fold == 0 else f"points[{fold - 1}]"
        notes.append(f"{key} ({cable.name}) folds back on itself at {where}: are its points in the right order?")
    return path


def cable_path(layout: Layout, key: str, cable: Cable, notes: list[str]) -> CablePath:
    """The path of a cable, carried by its bodies, and around its obstacles.

    Args:
        layout: The bodies.
        key: Key of the cable's entry.
        cable: The entry.
        notes: List to which a warning for each snapped point is appended.

    Raises:
        SceneError: A point is too far from its body, or an obstacle is none to lay a cable around.
    """
    path, wraps = _straight_path(layout, key, cable, notes), dict[int, Wrap]()
    points = path.positions(layout.nodes.rest_positions)
    obstacles = {obstacle.name: obstacle for obstacle in layout.scene.obstacles}
    for place, name in enumerate(cable.wraps):
        obstacle, at = obstacles[name], f"{key}.wraps[{place}]"
        shape = obstacle.shape
        if not isinstance(shape, AxialShape):
            raise layout.scene.error(at, name, "is no capsule and no cylinder")
        turn = Rotation.from_euler("xyz", obstacle.rotation)
        ends = turn.apply(np.array(shape.ends)) + obstacle.position
        axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        wrap = Wrap(ends.mean(axis=0), axis, shape.radius)
        segment = _nearest_segment(points, wrap)
        if segment in wraps:
            raise layout.scene.error(at, name, "is nearest to the same part of the cable as another "
                                     "obstacle: give a point between both")  # fmt: skip
        side = side_at(points[segment], points[segment + 1], wrap)
        if side == 0.0:
            raise layout.scene.error(at, name, "has its axis on the cable at rest: which side it is "
                                     "laid around is not known")  # fmt: skip
        far = np.linalg.norm(np.cross(points[segment : segment + 2] - wrap.centre, axis), axis=1)
        if (far <= wrap.radius).any():
            raise layout.scene.error(at, name, "holds a point of the cable inside")
        wraps[segment] = wrap._replace(side=side)
    return path._replace(wraps=wraps) if wraps else path


def _nearest_segment(points: np.ndarray, wrap: Wrap) -> int:
    """The segment of a path [m], shape (point_count, 3), that is nearest to the axis of a cylinder."""
    shares = np.linspace(0.0, 1.0, PLACES)
    ways = points[:-1, None] + shares[:, None] * np.diff(points, axis=0)[:, None]
    far = np.linalg.norm(np.cross(ways - wrap.centre, wrap.axis), axis=2)
    return int(np.argmin(far.min(axis=1)))


def _crossings(model, group: ActuatorGroup) -> Iterator[str]:
    """Obstacles and rigid bodies that a straight part of a cable passes through at rest."""
    scene, rest = model.scene, model.nodes.rest_positions
    solid = [(one.name, one.shape.solid(scene.file_path, []), np.array(one.position, float),
              Rotation.from_euler("xyz", one.rotation).as_matrix()) for one in scene.obstacles]  # fmt: skip
    solid += [(part.name, part.shape, part.origin, part.rotation) for part in model.rigid]
    for (key, cable), path in zip(scene.keyed("cables"), group.term.paths, strict=True):
        points = path.positions(rest)
        own = {cable.body, cable.pull_point_on, *cable.wraps}
        own |= {name for pattern in cable.also_on for name in matching(pattern, [one[0] for one in solid])}
        inner = np.linspace(0.0, 1.0, PLACES)[1:-1, None]
        for name, shape, origin, rotation in (one for one in solid if one[0] not in own):
            for index, (first, second) in enumerate(zip(points[:-1], points[1:])):
                places = (first + inner * (second - first) - origin) @ rotation
                if index not in path.wraps and (shape.distances(places) == 0.0).any():
                    yield (f"{key} ({cable.name}) passes through {name} after its point {index}: lay it "
                           "around (wraps, of an obstacle), or give it other points.")  # fmt: skip


def _straight_path(layout: Layout, key: str, cable: Cable, notes: list[str]) -> CablePath:
    """A cable's path between its points."""
    places, pull_point = (layout.in_world(cable.body, cable.frame, one) for one in (cable.points, [cable.pull_point]))
    points = layout.carried_along(cable, places, f"{key}.points", notes, cable.hold_radius)
    if cable.pull_point_on == "world":
        return CablePath(cable.name, points, pull_point[0])
    if cable.pull_point_on == "body":
        start = layout.carried_along(cable, pull_point, f"{key}.pull_point", notes, cable.hold_radius)
    else:
        start = layout.carried(cable.pull_point_on, pull_point, f"{key}.pull_point", notes)
    return CablePath(cable.name, start.followed_by(points), None)
