"""The draw list of a simulation: each effect describes once what is drawn of it in space.

rerun, markers of RViz, pictures and notebooks draw this list, each in its own look.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.scene_layout import FACETS
from softrobot_twin.simulation.effects.touches import touch_term
from softrobot_twin.view.colours import (
    CLEAR_SURFACE_COLOUR,
    EFFECTOR_COLOUR,
    OBSTACLE_COLOUR,
    RIGID_COLOUR,
    SURFACE_COLOUR,
    TARGET_COLOUR,
    pressure_colours,
    tension_colours,
)
from softrobot_twin.view.drawn_parts import (
    CavityDisplay,
    SolidSkin,
    fixed_ends,
    fixed_places,
    obstacle_skins,
    rigid_skins,
    spring_places,
)
from softrobot_twin.view.frame import Drawn, Entity

OPEN_TENSION = 10.0
"""Upper end of the colour scale when no cable has a tension limit [N]."""
OPEN_PRESSURE = 1.0e4
"""The same when no cavity has a pressure limit [Pa]."""
AXIS_SHARE = 0.1
"""Length of the axes of an effector's orientation, as a share of the robot's size."""
# Length of the axes of a rigid body, as a share of the robot's size, and of its own at most.
_FRAME_SHARE, _OWN_SHARE = 0.09, 0.7
_AXIS_COLOURS = ((214, 80, 70), (80, 170, 90), (70, 120, 214))
"""Of the axes x, y and z of an orientation, and of a target's."""
_TARGET_AXIS_COLOURS = ((250, 190, 185), (190, 235, 195), (185, 205, 250))
_CONTACT_COLOUR, _GRIPS_COLOUR = (230, 60, 60), np.array((40, 190, 90))
_FIXED_COLOUR, _FORCE_COLOUR = (110, 110, 120), (255, 110, 70)
_SPRING_COLOUR, _AXIS_COLOUR = (165, 165, 178), (205, 205, 212)
# Least size of lines and marks, as a share of that of the whole scene.
_LEAST_SHARE = 0.4
_SIZE_OF_A_POINT = 0.1
_NOWHERE = np.empty((0, 3))


def tension_range(simulation: Simulation) -> tuple[float, float]:
    """Ends of the colour scale of tensions [N]: slack, and the greatest limit of a cable.

    Args:
        simulation: The simulation.
    """
    cables = simulation.actuators.of_section("cables")
    limits = simulation.limits.effort_max[cables]
    limits = limits[np.isfinite(limits)]
    return 0.0, float(limits.max(initial=0.0)) or OPEN_TENSION


def pressure_range(cavities: CavityDisplay) -> tuple[float, float]:
    """Deepest vacuum and greatest pressure that the scene allows [Pa], gauge.

    Args:
        cavities: The cavities.
    """
    limits = np.array([skin.limits for skin in cavities.skins])
    limits = limits[np.isfinite(limits)]
    vacuum, most = float(limits.min(initial=0.0)), float(limits.max(initial=0.0))
    return (vacuum, most) if vacuum < most else (0.0, OPEN_PRESSURE)


class Shown(NamedTuple):
    """What is drawn beside the places of a state.

    Attributes:
        efforts: Efforts of the actuators, such as tensions [N], shape (actuator_count,).
        contacts: Contact points [m] and forces [N], shape (contact_count, 3) each, and the grip margin
            of the pair of each, NaN where none is asked for, shape (contact_count,), or None.
        effectors: Positions of the effectors [m], shape (effector_count, 3).
        turned: Their turns from rest (x, y, z, w), shape (effector_count, 4), or None.
        targets: Targets of the effectors [m], NaN for none, shape (effector_count, 3).
        turns: Wanted turns (x, y, z, w), NaN for none, shape (effector_count, 4).
        predicted: Markers where the model has them [m], shape (marker_count, 3).
        measured: Measured markers [m], NaN for none, same shape.
    """

    efforts: np.ndarray
    contacts: tuple[np.ndarray, np.ndarray, np.ndarray | None]
    effectors: np.ndarray
    turned: np.ndarray | None
    targets: np.ndarray
    turns: np.ndarray
    predicted: np.ndarray
    measured: np.ndarray

    @classmethod
    def of(cls, simulation: Simulation) -> Self:
        """What a simulation shows by itself, without contacts, targets and measurements.

        Args:
            simulation: The simulation at the state that is shown.
        """
        places, markers = simulation.effector_positions(), simulation.marker_positions()
        return cls(
            simulation.state.efforts, (_NOWHERE, _NOWHERE, None), places,
            simulation.effector_orientations(), np.full_like(places, np.nan),
            np.full((len(places), 4), np.nan), markers, np.full_like(markers, np.nan),
        )  # fmt: skip


Effect = tuple[Sequence[Entity], Callable[[Shown], Iterable[Drawn]] | None]
"""Entities, and what is drawn of each of them now; None for what never changes."""


class DrawList:
    """All that is drawn of a simulation in space, and where it is now.

    Args:
        simulation: The simulation.
        force_scale: Length of the arrow of a force [m/N].
        facets: Length of the facets of round shapes, as a share of their radius.

    Attributes:
        size: About the size of the largest body [m], by which lines and marks are scaled.
        cavities: The cavities.
        entities: What is drawn, without what changes.
    """

    def __init__(self, simulation: Simulation, force_scale: float = 0.1, facets: float = FACETS):
        self._simulation, self._force_scale = simulation, force_scale
        self.size, self.cavities = size_of(simulation), CavityDisplay(simulation.model)
        every = (self._bodies(), self._actuators(), self._springs(), self._cavities(),
                 self._rigid(facets), self._obstacles(facets), self._contacts(), self._touches(),
                 self._observed(), self._axes(), self._fixed(), self._points())  # fmt: skip
        self._effects: list[Effect] = [effect for effect in every if effect[0]]
        self.entities = tuple(entity for entities, _ in self._effects for entity in entities)

    def drawn(self, shown: Shown) -> dict[str, Drawn]:
        """What the present state has of the entities that change, by their paths.

        Args:
            shown: What is shown of the state.
        """
        return {
            entity.path: drawn for entities, present in self._effects if present
            for entity, drawn in zip(entities, present(shown), strict=True)
        }  # fmt: skip

    def _bodies(self) -> Effect:
        """Deformable bodies; all beams are one surface: each takes time that many ribs have not."""
        simulation, every = self._simulation, self._simulation.skins
        soft, clear = len(simulation.model.bodies), bool(self.cavities.skins)
        colour = CLEAR_SURFACE_COLOUR if clear else SURFACE_COLOUR
        entities = [
            Entity(f"/robot/surface/{skin.name}", "surface", colour, labels=[skin.name],
                   anchors=[skin.triangles[len(skin.triangles) // 2, 0]], triangles=skin.triangles,
                   kind="clear body" if clear else "body", noun="body")
            for skin in every[:soft]
        ]  # fmt: skip
        if beams := [skin.name for skin in every[soft:]]:
            points = simulation.skin_positions()[soft:]
            firsts = np.cumsum([0, *map(len, points)])
            entities.append(Entity(
                f"/robot/surface/{'beams' if len(beams) > 1 else beams[0]}", "surface", colour,
                labels=beams, anchors=firsts[:-1] + list(map(_nearest, points)), kind="beam", noun="beam",
                triangles=np.vstack([skin.triangles + first
                                     for skin, first in zip(every[soft:], firsts)]),
            ))  # fmt: skip

        def present(_: Shown) -> Iterable[Drawn]:
            points = simulation.skin_positions()
            return map(Drawn, [*points[:soft], *([np.vstack(points[soft:])] if beams else [])])

        return entities, present

    def _actuators(self) -> Effect:
        """Lines of cables with the points that pull them, and of axes of motors."""
        simulation = self._simulation
        paths, order = simulation.actuator_paths(), list(simulation.actuator_names)
        look = partial(tension_colours, tension_range=tension_range(simulation))
        entities, owners, pulled = [], [], []
        for group in simulation.actuators.groups:
            if not (names := [name for name in group.names if name in paths]):
                continue
            owners.append((names, [order.index(name) for name in names]))
            pulls = group.kind.one_sided
            pulled += names if pulls else []
            entities.append(Entity(
                f"/robot/{group.kind.section}", "lines", None if pulls else _AXIS_COLOUR, 2.5, names,
                colours_of=look if pulls else None, kind="cable" if pulls else "axis",
                noun=group.kind.noun,
            ))  # fmt: skip
        if pulled:
            entities.append(Entity("/robot/pull_points", "points", (235, 235, 235), 4.0, kind="pull point"))

        def present(shown: Shown) -> Iterator[Drawn]:
            paths = simulation.actuator_paths()
            for names, places in owners:
                yield Drawn([paths[name] for name in names], values=shown.efforts[places])
            if pulled:
                yield Drawn(np.array([paths[name][0] for name in pulled]))

        return entities, present

    def _springs(self) -> Effect:
        """Points of masses, and lines of springs, tubes and fibres."""
        simulation = self._simulation
        looks: dict[str, Any] = {"mass": ("/robot/masses", "points", _SPRING_COLOUR, 4.0),
                                 "thread": ("/robot/threads", "lines", _SPRING_COLOUR, 0.8),
                                 "spring": ("/robot/springs", "lines", _SPRING_COLOUR, 2.0)}  # fmt: skip
        entities = [Entity(*looks[kind], kind=kind) for kind in spring_places(simulation)]
        return entities, lambda _: map(Drawn, spring_places(simulation).values())

    def _cavities(self) -> Effect:
        simulation, cavities = self._simulation, self.cavities
        look = partial(pressure_colours, pressure_range=pressure_range(cavities))
        driven = {entry.name for entry in simulation.scene.cavities}
        return [
            Entity(f"/robot/cavities/{skin.name}", "surface", triangles=skin.triangles,
                   labels=[skin.name], anchors=[_nearest(points)], colours_of=look, kind="cavity",
                   noun="cavity" if skin.name in driven else "sealed cavity")
            for skin, points in zip(cavities.skins, cavities.positions(simulation.state), strict=True)
        ], lambda _: map(
            lambda points, pressure: Drawn(points, values=np.array([pressure])),
            cavities.positions(simulation.state), cavities.pressures(simulation.state),
        )  # fmt: skip

    def _rigid(self, facets: float) -> Effect:
        """Rigid bodies, and their frames, which are not longer than the body."""
        simulation, parts = self._simulation, self._simulation.model.rigid
        skins = rigid_skins(simulation.model, facets)
        entities = [_solid("/rigid_bodies", RIGID_COLOUR, skin, "rigid body",
                           "free body" if part.is_free else "guided body")
                    for skin, part in zip(skins, parts, strict=True)]  # fmt: skip
        lengths = np.array([min(_FRAME_SHARE * self.size, _OWN_SHARE * np.ptp(skin.points, axis=0).max())
                            for skin in skins])  # fmt: skip
        numbers = np.arange(3 * len(skins)) % 3
        if not skins:
            return (), None
        entities.append(_frames("/rigid_frames", "frame", _AXIS_COLOURS))

        def present(_: Shown) -> Iterator[Drawn]:
            places, turns = simulation.rigid_poses()
            yield from map(Drawn, places, turns)
            axes = Rotation.from_quat(turns).as_matrix().transpose(0, 2, 1)
            vectors = lengths[:, None, None] * axes
            yield Drawn(np.repeat(places, 3, axis=0), vectors.reshape(-1, 3), numbers)

        return entities, present

    def _obstacles(self, facets: float) -> Effect:
        planes = {entry.name for entry in self._simulation.scene.obstacles if entry.plane is not None}
        return [_solid("/obstacles", OBSTACLE_COLOUR, skin, "obstacle",
                       "plane" if skin.name in planes else "obstacle")
                for skin in obstacle_skins(self._simulation.model, facets)], None  # fmt: skip

    def _contacts(self) -> Effect:
        if self._simulation.scene.contact is None:
            return (), None
        return [
            Entity("/contacts/points", "points", _CONTACT_COLOUR, 3.0, kind="contact",
                   colours_of=_grip_colours),
            Entity("/contacts/forces", "arrows", _FORCE_COLOUR, 1.5, kind="force"),
        ], lambda shown: self._acting(*shown.contacts)

    def _touches(self) -> Effect:
        simulation, term = self._simulation, touch_term(self._simulation.model)
        if term is None:
            return (), None
        return [
            Entity("/touches/points", "points", (255, 160, 60), 5.0, simulation.touch_names,
                   kind="touch", noun="touch"),
            Entity("/touches/forces", "arrows", _FORCE_COLOUR, 1.5, kind="force"),
        ], lambda _: self._acting(term.points(simulation.state.positions),
                                  term.forces(simulation.state.positions))  # fmt: skip

    def _observed(self) -> Effect:
        """Forces that an observer found, and the same with two deviations more or less."""
        simulation = self._simulation
        if not simulation.observed_names:
            return (), None
        return [
            Entity("/observer/points", "points", (150, 90, 210), 4.0, simulation.observed_names,
                   kind="observed", noun="observed force"),
            Entity("/observer/forces", "arrows", (150, 90, 210), 1.5, kind="force"),
            Entity("/observer/two_deviations", "arrows", (205, 175, 235), 4.0, kind="force"),
        ], lambda _: self._found(simulation.state.memory)  # fmt: skip

    def _found(self, memory: Mapping[str, np.ndarray]) -> tuple[Drawn, Drawn, Drawn]:
        """Places, forces, and what two deviations add and take away at the tips of these."""
        places = memory["observer.places"]
        forces = self._force_scale * memory["observer.wrenches"][:, :3]
        spread = 2.0 * self._force_scale * np.linalg.norm(
            memory["observer.deviations"][:, :3], axis=1, keepdims=True)
        along = forces / np.maximum(np.linalg.norm(forces, axis=1, keepdims=True), 1.0e-12)
        return (Drawn(places), Drawn(places, forces),
                Drawn(places + forces - spread * along, 2.0 * spread * along))

    def _acting(
        self, points: np.ndarray, forces: np.ndarray, values: np.ndarray | None = None
    ) -> tuple[Drawn, Drawn]:
        """Points, perhaps with values that colour them, and arrows of forces [N]."""
        return Drawn(points, values=values), Drawn(points, self._force_scale * forces)

    def _axes(self) -> Effect:
        """Axes of effectors with orientations and of their targets; of one that points, it alone."""
        found = [(place, axis, number)
                 for place, effector in enumerate(self._simulation.scene.effectors)
                 for axis, number in _asked_axes(effector.orientation)]  # fmt: skip
        if not found:
            return (), None
        owners, axes, numbers = map(np.array, zip(*found, strict=True))
        place = partial(_arrows, owners=owners, axes=axes, length=AXIS_SHARE * self.size, numbers=numbers)
        # Those of a target are at the effector where it has no position.
        return [
            _frames("/robot/effector_axes", "frame", _AXIS_COLOURS),
            _frames("/target_axes", "target frame", _TARGET_AXIS_COLOURS),
        ], lambda shown: (
            place(shown.effectors, shown.turned),
            place(np.where(np.isfinite(shown.targets), shown.targets, shown.effectors), shown.turns),
        )

    def _fixed(self) -> Effect:
        """Fixed nodes on the surface of each body, and fixed ends of beams."""
        model, positions = self._simulation.model, self._simulation.state.positions
        found = [(f"/{body.name}", "fixed", "node", fixed_places(body, positions))
                 for body in model.bodies]  # fmt: skip
        found.append(("_ends", "fixed end", "beam end", fixed_ends(model.beams)))
        return [Entity(f"/robot/fixed{path}", "points", _FIXED_COLOUR, 2.5, points=points,
                       kind=kind, noun=noun)
                for path, kind, noun, points in found if len(points)], None  # fmt: skip

    def _points(self) -> Effect:
        """Effectors, their trail and targets, and markers."""
        tips = self._simulation.effector_names
        markers = [str(one) for one in self._simulation.marker_ids]
        effector, marker = (dict(kind=kind, noun=kind) for kind in ("effector", "marker"))
        return [
            Entity("/robot/effectors", "points", EFFECTOR_COLOUR, 5.0, tips, **effector),
            Entity("/robot/effector_trail", "trail", (130, 190, 255), 1.2),
            Entity("/targets", "points", TARGET_COLOUR, 6.0, tips, may_miss=True, kind="target"),
            Entity("/markers/predicted", "points", (70, 150, 255), 4.5, markers, **marker),
            Entity("/markers/measured", "points", (255, 160, 40), 4.5, markers, may_miss=True),
        ], lambda shown: map(Drawn, (
            shown.effectors, shown.effectors, shown.targets, shown.predicted, shown.measured,
        ))  # fmt: skip


def size_of(simulation: Simulation) -> float:
    """Size by which lines and marks are scaled [m]: of the largest body, not too small for all.

    Args:
        simulation: The simulation.
    """
    points = np.vstack([
        _NOWHERE, *simulation.skin_positions(), *simulation.actuator_paths().values(),
        *(own.reshape(-1, 3) for own in spring_places(simulation).values()),
    ])  # fmt: skip
    whole = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    largest = simulation.model.nodes.size
    if np.isfinite(largest):
        return max(largest, _LEAST_SHARE * whole)
    return whole or _SIZE_OF_A_POINT  # nothing but a single point mass


def _solid(path: str, colour: Sequence[int], skin: SolidSkin, noun: str, kind: str) -> Entity:
    """A rigid body or an obstacle."""
    return Entity(f"{path}/{skin.name}", "solid", colour, labels=[skin.name],
                  triangles=skin.triangles, points=skin.points, kind=kind, noun=noun)  # fmt: skip


def _grip_colours(margins: np.ndarray) -> np.ndarray:
    """From red, where a pair slips, to green, where it bears no load along its surfaces."""
    share = np.nan_to_num(margins)[:, None]
    return ((1.0 - share) * _CONTACT_COLOUR + share * _GRIPS_COLOUR).astype(int)


def _frames(path: str, kind: str, colours: tuple) -> Entity:
    """Axes, whose values are the numbers of their colours."""
    return Entity(path, "arrows", size=1.5, kind=kind, colours_of=lambda numbers: np.array(colours)[numbers])


def _asked_axes(orientation) -> Iterator[tuple[np.ndarray, int]]:
    """Axes of an effector's orientation and the numbers of their colours; none without one."""
    if orientation is not None and orientation.pointing is not None:
        yield np.array(orientation.pointing) / np.linalg.norm(orientation.pointing), 2
    elif orientation is not None:
        yield from zip(np.eye(3), range(3), strict=True)


def _arrows(places: np.ndarray, turns: np.ndarray | None, owners: np.ndarray, axes: np.ndarray,
            length: float, numbers: np.ndarray) -> Drawn:  # fmt: skip
    """Axes of owners at places [m] with turns (x, y, z, w); of turns that are NaN none."""
    assert turns is not None  # where effectors have orientations
    known = (np.isfinite(turns).all(axis=1) & np.isfinite(places).all(axis=1))[owners]
    owners = owners[known]
    vectors = Rotation.from_quat(turns[owners]).apply(axes[known]) if len(owners) else _NOWHERE
    return Drawn(places[owners], length * vectors, numbers[known])


def _nearest(points: np.ndarray) -> int:
    """The point that is nearest to the middle of all."""
    return int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))
