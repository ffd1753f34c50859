"""What a viewer shows of a simulation: surfaces and ends of colour scales; and the feed of rerun."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.simulation import Simulation
from softrobot_twin.view import Frame, RerunMirror, Stage, Surface
from softrobot_twin.view.frame import OtherActuator

OPEN_TENSION = 10.0
"""Upper end of the colour scale when no cable has a tension limit [N]."""
OPEN_PRESSURE = 1.0e4
"""The same when no cavity has a pressure limit [Pa]."""
AXIS_SHARE = 0.1
"""Length of the axes of an effector's orientation, as a share of the robot's size."""
# Sections of a scene whose actuators have drawings of their own.
_DRAWN_SECTIONS = ("cables", "cavities")


class BodySurfaces:
    """Surfaces by which the deformable bodies are drawn.

    All beams are one surface: each surface takes time that an arm of many ribs has not.

    Args:
        simulation: The simulation.

    Attributes:
        surfaces: A surface of each soft body, and one of all beams.
    """

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        skins = simulation.skins
        self._soft_count = len(skins) - len(simulation.model.beams)
        soft = [Surface(skin.name, skin.triangles) for skin in skins[: self._soft_count]]
        beams = skins[self._soft_count :]
        if len(beams) < 2:
            self.surfaces = (*soft, *(Surface(skin.name, skin.triangles) for skin in beams))
            return
        points = simulation.skin_positions()[self._soft_count :]
        firsts = np.cumsum([0, *map(len, points)])
        triangles = np.vstack([
            skin.triangles + first for skin, first in zip(beams, firsts, strict=False)
        ])  # fmt: skip
        self.surfaces = (*soft, Surface("beams", triangles))

    def points(self) -> tuple[np.ndarray, ...]:
        """Present points of the surfaces [m], each of shape (point_count, 3)."""
        points = self._simulation.skin_positions()
        if len(points) - self._soft_count < 2:
            return points
        return (*points[: self._soft_count], np.vstack(points[self._soft_count :]))


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


class ViewFeed:
    """Turns ticks into frames and offers them to the mirror, which never waits.

    Args:
        simulation: The simulation to show.
        parameters: Values of ``view``, ``view_port``, ``view_every``, ``view_spawn``,
            ``view_force_scale``, ``record_file`` and ``record_every``.

    Raises:
        ViewError: The view cannot be opened.
    """

    def __init__(self, simulation: Simulation, parameters: Mapping[str, object]):
        self._simulation = simulation
        self._is_oriented = any(simulation.oriented_effectors)
        self._bodies = BodySurfaces(simulation)
        self._every = int(parameters["view_every"])
        self._ticks = 0
        self._cables = simulation.actuators.of_section("cables")
        kind_of = simulation.actuators.kind_of
        others = {
            name: kind for name, kind in kind_of.items() if kind.section not in _DRAWN_SECTIONS
        }
        self._others = np.array([list(kind_of).index(name) for name in others], int)
        stage = Stage(
            name=simulation.scene.name,
            bodies=self._bodies.surfaces,
            cable_names=simulation.actuator_names[self._cables],
            tension_range=tension_range(simulation),
            cavities=tuple(
                Surface(skin.name, skin.triangles) for skin in simulation.cavities.skins
            ),
            pressure_range=pressure_range(simulation),
            other_actuators=tuple(
                OtherActuator(name, kind.setpoint.unit, kind.effort.unit)
                for name, kind in others.items()
            ),
            effector_names=simulation.effector_names,
            marker_ids=simulation.marker_ids,
            rigid_bodies=tuple(
                Surface(skin.name, skin.triangles, skin.points)
                for skin in simulation.rigid_skins()
            ),
            obstacles=tuple(
                Surface(skin.name, skin.triangles, skin.points)
                for skin in simulation.obstacle_skins()
            ),
            shows_contact=simulation.scene.contact is not None,
            axis_length=AXIS_SHARE * simulation.model.nodes.size if self._is_oriented else 0.0,
            force_scale=float(parameters["view_force_scale"]),
        )
        record = str(parameters["record_file"])
        self.mirror: RerunMirror = RerunMirror(
            stage,
            serve=bool(parameters["view"]),
            port=int(parameters["view_port"]),
            record=Path(record) if record else None,
            record_every=int(parameters["record_every"]),
            spawn_viewer=bool(parameters["view_spawn"]),
        )

    @staticmethod
    def is_wanted(parameters: Mapping[str, object]) -> bool:
        """True when the parameters request viewers or a recording."""
        return bool(parameters["view"] or parameters["record_file"] or parameters["view_spawn"])

    def offer(
        self, outcome: TickOutcome, time_ns: int, discretization_error: float = float("nan")
    ) -> None:
        """Offers a tick to the mirror, if it is one of those to show.

        Args:
            outcome: The tick.
            time_ns: Its time [ns].
            discretization_error: Newest estimate of the effectors' error due to the mesh [m].
        """
        self._ticks += 1
        if (self._ticks - 1) % self._every:
            return
        simulation, result = self._simulation, outcome.result
        names, paths = simulation.actuator_names, simulation.actuator_paths()
        errors = outcome.tracking_errors[np.isfinite(outcome.tracking_errors)]
        self.mirror.offer(
            Frame(
                step=self._ticks,
                time_ns=time_ns,
                surface_positions=self._bodies.points(),
                cable_paths=tuple(paths[name] for name in names[self._cables]),
                cable_lengths=result.setpoints[self._cables],
                cable_tensions=result.efforts[self._cables],
                other_setpoints=result.setpoints[self._others],
                other_efforts=result.efforts[self._others],
                effector_positions=result.effector_positions,
                targets=outcome.reading.targets,
                predicted_markers=outcome.predicted_markers,
                measured_markers=outcome.measured_markers,
                effector_error=float(errors.max()) if len(errors) else float("nan"),
                stage_times=result.report.stage_times,
                compute_time=result.report.compute_time,
                status=f"{outcome.activity.value}: {result.status.value}",
                residual=result.report.residual,
                linearization_error=result.report.linearization_error,
                discretization_error=discretization_error,
                **self._of_cavities(),
                **self._of_solids(outcome),
                **self._of_orientations(outcome),
            )
        )

    def _of_orientations(self, outcome: TickOutcome) -> dict[str, np.ndarray]:
        """Turns of effectors and targets as fields of a frame, for scenes that ask for them."""
        if not self._is_oriented:
            return {}
        return {
            "effector_orientations": outcome.result.effector_orientations,
            "target_orientations": outcome.reading.orientations,
        }

    def _of_cavities(self) -> dict[str, object]:
        """Walls, pressures and volumes of cavities as fields of a frame, for scenes with them."""
        simulation = self._simulation
        if not simulation.cavities.skins:
            return {}
        return {
            "cavity_positions": simulation.cavity_positions(),
            "cavity_pressures": simulation.cavities.pressures(simulation.state),
            "cavity_volumes": simulation.cavities.volumes(simulation.state),
        }

    def _of_solids(self, outcome: TickOutcome) -> dict[str, np.ndarray]:
        """Rigid poses and contacts as fields of a frame, for scenes that have them."""
        shown = {}
        if self._simulation.rigid_names:
            shown["rigid_positions"], shown["rigid_quaternions"] = self._simulation.rigid_poses()
        if outcome.result.contacts is not None:
            shown["contact_positions"] = outcome.result.contacts.positions
            shown["contact_forces"] = outcome.result.contacts.forces
        return shown

    def close(self) -> None:
        """Finishes the file and stops serving."""
        self.mirror.close()
