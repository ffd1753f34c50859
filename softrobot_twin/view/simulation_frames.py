"""What is shown of a simulation: each entity and each plot once, with where its frames take it from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.simulation.appearance import SolidSkin, fixed_ends, fixed_places
from softrobot_twin.simulation.colours import (
    CLEAR_SURFACE_COLOUR,
    EFFECTOR_COLOUR,
    OBSTACLE_COLOUR,
    RIGID_COLOUR,
    SURFACE_COLOUR,
    TARGET_COLOUR,
    pressure_colours,
    pressure_legend,
    tension_colours,
)
from softrobot_twin.view.frame import Drawn, Entity, Frame, Plot, Stage, ViewError

OPEN_TENSION = 10.0
"""Upper end of the colour scale when no cable has a tension limit [N]."""
OPEN_PRESSURE = 1.0e4
"""The same when no cavity has a pressure limit [Pa]."""
AXIS_SHARE = 0.1
"""Length of the axes of an effector's orientation, as a share of the robot's size."""
_AXIS_COLOURS = ((214, 80, 70), (80, 170, 90), (70, 120, 214))
"""Of the axes x, y and z of an effector's orientation, and of its target's."""
_TARGET_AXIS_COLOURS = ((250, 190, 185), (190, 235, 195), (185, 205, 250))
# Sections of a scene whose actuators have drawings of their own.
_DRAWN_SECTIONS = ("cables", "cavities")
_WHOLE_STEP = "whole step"


def tension_range(simulation: Simulation) -> tuple[float, float]:
    """Ends of the colour scale of tensions [N]: slack, and the greatest limit of a cable."""
    cables = simulation.actuators.of_section("cables")
    limits = simulation.limits.effort_max[cables]
    limits = limits[np.isfinite(limits)]
    return 0.0, float(limits.max(initial=0.0)) or OPEN_TENSION


def pressure_range(simulation: Simulation) -> tuple[float, float]:
    """Deepest vacuum and greatest pressure that the scene allows [Pa], gauge."""
    limits = np.array([skin.limits for skin in simulation.cavities.skins])
    limits = limits[np.isfinite(limits)]
    vacuum, most = float(limits.min(initial=0.0)), float(limits.max(initial=0.0))
    return (vacuum, most) if vacuum < most else (0.0, OPEN_PRESSURE)


class _Now(NamedTuple):
    """What a frame is made of.

    Attributes:
        result: Result of the step.
        contacts: Contact points [m] and forces [N], shape (contact_count, 3) each.
        paths: Lines of the actuators [m], by their names.
        targets: Targets of the effectors [m], NaN for none, shape (effector_count, 3).
        turns: Wanted turns (x, y, z, w), NaN for none, shape (effector_count, 4).
        predicted: Markers where the model has them [m], shape (marker_count, 3).
        measured: Measured markers [m], NaN for none, same shape.
        errors: Errors of the effectors: to the target, of linearizing, of the mesh [m].
    """

    result: StepResult
    contacts: tuple[np.ndarray, np.ndarray]
    paths: dict[str, np.ndarray]
    targets: np.ndarray
    turns: np.ndarray
    predicted: np.ndarray
    measured: np.ndarray
    errors: tuple[float, float, float]


def _axes(places: np.ndarray, turns: np.ndarray | None, length: float) -> Drawn:
    """Axes x, y and z of turns (x, y, z, w) at places [m]; of turns that are NaN none."""
    assert turns is not None  # where effectors have orientations
    known = np.isfinite(turns).all(axis=1) & np.isfinite(places).all(axis=1)
    axes = [length * Rotation.from_quat(turn).as_matrix().T for turn in turns[known]]
    return Drawn(np.repeat(places[known], 3, axis=0), np.concatenate([np.empty((0, 3)), *axes]),
                 np.arange(3 * len(axes)))  # fmt: skip


def _repeated(colours: tuple, values: np.ndarray) -> np.ndarray:
    """Colours that repeat, one for each value."""
    return np.resize(colours, (len(values), 3))


Things = tuple[list[Entity], Callable[[_Now], Iterable[Drawn]] | None]
"""Entities, and what a frame has of each of them; None for what never changes."""
Curves = tuple[str, str, Sequence[str], Callable[[_Now], Sequence[float] | np.ndarray]]
"""Title, path and names of the curves of a plot, and their values in a frame."""


class SimulationFrames:
    """The stage of a simulation, and frames of its states.

    Args:
        simulation: The simulation to show.
        force_scale: Length of the arrow of a contact force [m/N].

    Attributes:
        stage: The constant part of the view.

    Raises:
        ViewError: The force scale is not positive.
    """

    def __init__(self, simulation: Simulation, force_scale: float = 0.1):
        if not (np.isfinite(force_scale) and force_scale > 0.0):
            raise ViewError("force_scale", force_scale, "must be above zero, in m/N")
        self._simulation = simulation
        self._things = [things for things in self._all_things(force_scale) if things[0]]
        self._curves = [curves for curves in self._all_curves() if curves[2]]
        title = simulation.scene.name
        if simulation.cavities.skins:
            title += f"; cavities: {pressure_legend(pressure_range(simulation))}"
        self.stage = Stage(
            simulation.scene.name, title,
            tuple(entity for entities, _ in self._things for entity in entities),
            tuple(Plot(*curves[:3]) for curves in self._curves),
        )  # fmt: skip

    def _all_things(self, force_scale: float) -> Iterator[Things]:
        """All that may be drawn in space; a robot may have none of a kind."""
        simulation = self._simulation
        model, cavities = simulation.model, simulation.cavities
        yield self._bodies()
        cables = simulation.actuators.of_section("cables")
        names = simulation.actuator_names[cables]
        look = partial(tension_colours, tension_range=tension_range(simulation))
        if names:
            yield [
                Entity("/robot/cables", "lines", size=2.5, labels=names, colours_of=look),
                Entity("/robot/pull_points", "points", (235, 235, 235), 4.0),
            ], lambda now: (
                Drawn([now.paths[name] for name in names], values=now.result.efforts[cables]),
                Drawn(np.array([now.paths[name][0] for name in names])),
            )  # fmt: skip
        look = partial(pressure_colours, pressure_range=pressure_range(simulation))
        yield [
            Entity(f"/robot/cavities/{skin.name}", "surface", triangles=skin.triangles,
                   colours_of=look) for skin in cavities.skins
        ], lambda now: map(
            lambda points, pressure: Drawn(points, values=np.array([pressure])),
            simulation.cavity_positions(), cavities.pressures(simulation.state),
        )  # fmt: skip
        yield _solids("/rigid_bodies", RIGID_COLOUR, simulation.rigid_skins()), lambda now: map(
            Drawn, *simulation.rigid_poses()
        )  # fmt: skip
        yield _solids("/obstacles", OBSTACLE_COLOUR, simulation.obstacle_skins()), None
        if simulation.scene.contact is not None:
            yield [
                Entity("/contacts/points", "points", (230, 60, 60), 3.0),
                Entity("/contacts/forces", "arrows", (255, 110, 70), 1.5),
            ], lambda now: (
                Drawn(now.contacts[0]), Drawn(now.contacts[0], force_scale * now.contacts[1]),
            )  # fmt: skip
        if any(simulation.oriented_effectors):
            # Those of a target are at the effector where it has no position.
            length = AXIS_SHARE * model.nodes.size
            yield [
                Entity(path, "arrows", size=1.5, colours_of=partial(_repeated, colours))
                for path, colours in (("/robot/effector_axes", _AXIS_COLOURS),
                                      ("/target_axes", _TARGET_AXIS_COLOURS))
            ], lambda now: (
                _axes(now.result.effector_positions, now.result.effector_orientations, length),
                _axes(np.where(np.isfinite(now.targets), now.targets,
                               now.result.effector_positions), now.turns, length),
            )  # fmt: skip
        fixed = [fixed_places(body, simulation.state.positions) for body in model.bodies]
        points = np.concatenate([*fixed, fixed_ends(model.beams)])
        if len(points):
            yield [Entity("/robot/fixed", "points", (110, 110, 120), 2.5, points=points)], None
        tips, markers = simulation.effector_names, [str(one) for one in simulation.marker_ids]
        yield [
            Entity("/robot/effectors", "points", EFFECTOR_COLOUR, 5.0, tips),
            Entity("/robot/effector_trail", "trail", (130, 190, 255), 1.2),
            Entity("/targets", "points", TARGET_COLOUR, 6.0, tips, may_miss=True),
            Entity("/markers/predicted", "points", (70, 150, 255), 4.5, markers),
            Entity("/markers/measured", "points", (255, 160, 40), 4.5, markers, may_miss=True),
        ], lambda now: map(Drawn, (
            now.result.effector_positions, now.result.effector_positions, now.targets,
            now.predicted, now.measured,
        ))  # fmt: skip

    def _bodies(self) -> Things:
        """Deformable bodies; all beams are one surface: each takes time that many ribs have not."""
        simulation = self._simulation
        skins, soft = simulation.skins, len(simulation.model.bodies)
        shown = [(skin.name, skin.triangles) for skin in skins]
        if len(skins) > soft + 1:
            points = simulation.skin_positions()[soft:-1]
            firsts = np.cumsum([0, *map(len, points)])
            triangles = [skin.triangles + first
                         for skin, first in zip(skins[soft:], firsts, strict=True)]  # fmt: skip
            shown[soft:] = [("beams", np.vstack(triangles))]

        def present(now: _Now) -> Iterable[Drawn]:
            points = simulation.skin_positions()
            if len(points) > soft + 1:
                points = (*points[:soft], np.vstack(points[soft:]))
            return map(Drawn, points)

        colour = CLEAR_SURFACE_COLOUR if simulation.cavities.skins else SURFACE_COLOUR
        return [Entity(f"/robot/surface/{name}", "surface", colour, triangles=triangles)
                for name, triangles in shown], present  # fmt: skip

    def _all_curves(self) -> Iterator[Curves]:
        """All that may be drawn as curves but times; a robot may have none of a kind."""
        simulation = self._simulation
        actuators, cavities = simulation.actuators, simulation.cavities
        yield ("Effector error [mm]", "/plots/effector_error",
               ("to the target", "of linearizing, estimated", "of the mesh, estimated"),
               lambda now: 1e3 * np.array(now.errors))  # fmt: skip
        cables = actuators.of_section("cables")
        names = simulation.actuator_names[cables]
        yield ("Cable lengths [mm]", "/plots/cable_lengths", names,
               lambda now: 1e3 * now.result.setpoints[cables])  # fmt: skip
        yield ("Cable tensions [N]", "/plots/cable_tensions", names,
               lambda now: now.result.efforts[cables])  # fmt: skip
        walls = [skin.name for skin in cavities.skins]
        yield ("Cavity gauge pressures [kPa]", "/plots/cavity_pressures",
               [f"{name} [kPa]" for name in walls],
               lambda now: 1e-3 * cavities.pressures(simulation.state))  # fmt: skip
        yield ("Cavity volumes [cm³]", "/plots/cavity_volumes",
               [f"{name} [cm³]" for name in walls],
               lambda now: 1e6 * cavities.volumes(simulation.state))  # fmt: skip
        others = [(place, name, kind)
                  for place, (name, kind) in enumerate(actuators.kind_of.items())
                  if kind.section not in _DRAWN_SECTIONS]  # fmt: skip
        places = [place for place, _, _ in others]
        factors = np.array([1e3 if kind.setpoint.unit == "m" else 1.0 for _, _, kind in others])
        yield ("Actuators", "/plots/actuators", [
            f"{name} [{unit}]" for _, name, kind in others
            for unit in ("mm" if kind.setpoint.unit == "m" else kind.setpoint.unit,
                         kind.effort.unit)
        ], lambda now: np.column_stack(
            [factors * now.result.setpoints[places], now.result.efforts[places]]
        ).ravel())  # fmt: skip
        is_touching = simulation.scene.contact is not None
        yield ("Contacts", "/plots/contacts", ("count", "largest force [N]") if is_touching else (),
               lambda now: [len(now.contacts[1]), np.linalg.norm(
                   now.contacts[1], axis=1).max(initial=0.0)])  # fmt: skip
        yield ("Residual [N]", "/plots/residual", ("residual",),
               lambda now: [now.result.report.residual])  # fmt: skip

    def frame(
        self, step: int, time_ns: int, result: StepResult, *, targets: np.ndarray,
        target_orientations: np.ndarray, errors: np.ndarray, predicted_markers: np.ndarray,
        measured_markers: np.ndarray, status: str, discretization_error: float = float("nan"),
    ) -> Frame:  # fmt: skip
        """The frame of a step, just after it.

        Args:
            step: Count of steps.
            time_ns: Its time [ns].
            result: Its result.
            targets: Targets of the effectors [m], NaN for none, shape (effector_count, 3).
            target_orientations: Wanted turns (x, y, z, w), NaN for none, shape (effector_count, 4).
            errors: Distances of effectors from targets [m], NaN without one.
            predicted_markers: Markers where the model has them [m], shape (marker_count, 3).
            measured_markers: Measured markers [m], NaN for none, same shape.
            status: Text to show.
            discretization_error: Estimate of the effectors' error due to the mesh [m].
        """
        report, known = result.report, errors[np.isfinite(errors)]
        contacts, none = result.contacts, np.empty((0, 3))
        now = _Now(
            result, (none, none) if contacts is None else (contacts.positions, contacts.forces),
            self._simulation.actuator_paths(), targets, target_orientations, predicted_markers,
            measured_markers, (
                float(known.max()) if len(known) else float("nan"), report.linearization_error,
                discretization_error,
            ),
        )  # fmt: skip
        return Frame(
            step=step, time_ns=time_ns,
            drawn={
                entity.path: drawn for entities, present in self._things if present
                for entity, drawn in zip(entities, present(now), strict=True)
            },
            curves={path: values(now) for _, path, _, values in self._curves},
            times={_WHOLE_STEP: report.compute_time, **report.stage_times},
            status=status,
        )  # fmt: skip


def _solids(path: str, colour: Sequence[int], skins: tuple[SolidSkin, ...]) -> list[Entity]:
    """Rigid bodies or obstacles."""
    return [Entity(f"{path}/{skin.name}", "solid", colour, triangles=skin.triangles,
                   points=skin.points) for skin in skins]  # fmt: skip
