"""Forces at points or over patches of bodies as actuators: by force, or by displacement."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.constraints.effector_orientation import frame_arms, patch_arms, spans_a_plane
from softrobot_twin.constraints.point_forces import PointForce, PointForces, TurningForces
from softrobot_twin.geometry.regions import nodes_in_box, nodes_in_sphere
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene.actuator_entries import Force
from softrobot_twin.scene.words import count, vector, words
from softrobot_twin.simulation.building.actuator_kinds import (
    ActuatorGroup,
    ActuatorKind,
    Quantity,
    group_of,
    numbers_of,
)
from softrobot_twin.simulation.building.effector_building import frame_of
from softrobot_twin.simulation.building.limits import efforts_at_scale, unlikely
from softrobot_twin.simulation.building.scene_layout import Layout

# Limits outside these shares of their natural scales are reported: a wrong unit is a factor of a
# thousand.
FORCE_RANGE = (1.0e-4, 50.0)
"""Of the force that would move its points by the size of the body, if it were linear."""
AXES = ("x", "y", "z")


class ForceActuator(ActuatorKind):
    """The kind `forces`; see `ActuatorKind`. Its setpoint is what the entry controls.

    An entry without a direction is three actuators.
    """

    section = "forces"
    entry = Force
    displacement = extent = Quantity("displacement", "m")
    effort = Quantity("force", "N")
    stalls = True

    def __init__(self, control: str = "force"):
        """Take what is commanded.

        Args:
            control: ``force`` or ``displacement``.
        """
        self.is_effort_driven = control == "force"
        self.setpoint = self.effort if self.is_effort_driven else self.displacement

    def build(self, layout: Layout, entries: tuple[Force, ...], notes: list[str]) -> ActuatorGroup:
        """See `ActuatorKind.build`."""
        forces, owners, names = [], [], []
        for key, entry in layout.scene.keyed(self.section):
            own = _forces(layout, key, entry, notes)
            forces += own
            owners += [entry] * len(own)
            names += [entry.name] if len(own) == 1 else [f"{entry.name}_{axis}" for axis in AXES]
        nodes, kind = layout.nodes, TurningForces if any(f.patch for f in forces) else PointForces
        term = kind(tuple(forces), nodes.free_index, nodes.rest_positions, nodes.size, nodes.carried)
        kinds = tuple(ForceActuator(entry.control) for entry in owners)
        return group_of(
            self, owners, term, term.scales, numbers_of(owners, "force"), np.ones(len(owners)),
            displacement_bounds=numbers_of(owners, "displacement"), names=tuple(names), kinds=kinds,
            entries=tuple(owners),
        )  # fmt: skip

    def doubts(self, model, group: ActuatorGroup) -> Iterator[str]:
        """Limits that are a thousand times out of scale; see `ActuatorKind.doubts`."""
        asked, first = any(max(map(abs, force.force)) < np.inf for force in model.scene.forces), 0
        moving = efforts_at_scale(model, group.term) if asked else None
        for key, force in model.scene.keyed(self.section):
            if moving is not None:
                yield from unlikely(f"{key}.force", max(map(abs, force.force)), "N",
                                    float(moving[first]), FORCE_RANGE,
                                    f"some {moving[first]:.2g} N would move it by the size of the "
                                    "body; is the limit in newtons?")  # fmt: skip
            first += 1 if force.direction else 3

    def paths(self, group: ActuatorGroup, positions: np.ndarray) -> tuple[np.ndarray, ...]:
        """A line along each force to where it acts; see `ActuatorKind.paths`."""
        return tuple(group.term.lines(positions, 0.1 * float(group.displacement_scale[0])))

    def details(self, entry: Force, group: ActuatorGroup, index: int) -> str:
        """See `ActuatorKind.details`."""
        at = count(entry.points, "point") if entry.points else f"the surface in a {_word(entry)}"
        along = vector(entry.direction) if entry.direction else AXES[index % 3]
        turns = "turns with the body" if entry.turns_with_body else None
        return words(f"at {at}, along {along}", turns, f"driven by {entry.control}")


def _word(entry: Force) -> str:
    return "box" if entry.box else "sphere"


def _forces(layout: Layout, key: str, entry: Force, notes: list[str]) -> list[PointForce]:
    """The force of an entry, or the three along the axes."""
    points, shares = _surface(layout, key, entry) if entry.points is None else (
        layout.carried(entry.body, entry.points, f"{key}.points", notes),
        None if entry.shares is None else np.array(entry.shares))  # fmt: skip
    patch = _patch(layout, key, points) if entry.turns_with_body else None
    directions = np.eye(3)
    if entry.direction:
        directions = np.array([entry.direction], float)
        directions /= np.linalg.norm(directions)
    point = points.mean(shares)
    return [PointForce(point, direction, patch) for direction in directions]


def _surface(layout: Layout, key: str, entry: Force) -> tuple[BarycentricMapping, np.ndarray]:
    """Nodes of the surface of a body in the region of a force, and their shares of its area."""
    body = layout.body_named(entry.body)
    places, triangles = body.mesh.node_positions, body.mesh.surface_triangles
    if entry.box:
        inside = nodes_in_box(places, entry.box.minimum, entry.box.maximum)
    else:
        inside = nodes_in_sphere(places, entry.sphere.centre, entry.sphere.radius)
    own = triangles[np.isin(triangles, inside).all(axis=1)]
    if not len(own):
        word = _word(entry)
        raise layout.scene.error(f"{key}.{word}", str(getattr(entry, word)),
                                 "holds no whole triangle of the body's surface", unit="m")
    a, b, c = (places[own[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    nodes, place = np.unique(own, return_inverse=True)
    return body.node_mapping(nodes), np.bincount(place.ravel(), np.repeat(areas, 3), len(nodes))


def _patch(layout: Layout, key: str, points: BarycentricMapping):
    """Nodes and arms by whose rotation a force turns, and whether they are a frame."""
    rest, frame = layout.nodes.rest_positions, frame_of(layout, points)
    if frame is not None:
        return *frame_arms(frame, rest), True
    if not spans_a_plane(points.positions(rest)):
        raise layout.scene.error(f"{key}.turns_with_body", True,
                                 "on a deformable body three or more points that do not lie on one "
                                 "line tell how it turns")
    return *patch_arms(points, rest), False
