"""What is shown of a simulation: surfaces, ends of colour scales, its stage and its frames."""

from __future__ import annotations

from typing import Any

import numpy as np

from softrobot_twin.simulation import Simulation, StepResult
from softrobot_twin.simulation.appearance import fixed_ends, fixed_places
from softrobot_twin.view.frame import Frame, OtherActuator, Stage, Surface

OPEN_TENSION = 10.0
"""Upper end of the colour scale when no cable has a tension limit [N]."""
OPEN_PRESSURE = 1.0e4
"""The same when no cavity has a pressure limit [Pa]."""
AXIS_SHARE = 0.1
"""Length of the axes of an effector's orientation, as a share of the robot's size."""
# Sections of a scene whose actuators have drawings of their own.
_DRAWN_SECTIONS = ("cables", "cavities")


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


def _fixed_points(simulation: Simulation) -> np.ndarray:
    """Places where bodies and beams are fixed [m], shape (fixed_count, 3)."""
    model, positions = simulation.model, simulation.state.positions
    places = [fixed_places(body, positions) for body in model.bodies]
    return np.concatenate([*places, fixed_ends(model.beams)])


def _solids(skins) -> tuple[Surface, ...]:
    """Surfaces of rigid bodies or obstacles, with their points."""
    return tuple(Surface(skin.name, skin.triangles, skin.points) for skin in skins)


def _joined(skins: tuple, points: tuple[np.ndarray, ...]) -> tuple[Surface, ...]:
    """Several skins as one surface; each surface takes time that an arm of many ribs has not."""
    if len(skins) < 2:
        return tuple(Surface(skin.name, skin.triangles) for skin in skins)
    firsts = np.cumsum([0, *map(len, points[:-1])])
    return (Surface("beams", np.vstack([
        skin.triangles + first for skin, first in zip(skins, firsts, strict=True)
    ])),)  # fmt: skip


class SimulationFrames:
    """The stage of a simulation, and frames of its states.

    Args:
        simulation: The simulation to show.
        force_scale: Length of the arrow of a contact force [m/N].

    Attributes:
        stage: The constant part of the view.
    """

    def __init__(self, simulation: Simulation, force_scale: float = 0.1):
        self._simulation = simulation
        self._is_oriented = any(simulation.oriented_effectors)
        skins = simulation.skins
        self._soft_count = soft = len(skins) - len(simulation.model.beams)
        self._cables = simulation.actuators.of_section("cables")
        kind_of = simulation.actuators.kind_of
        others = {
            name: kind for name, kind in kind_of.items() if kind.section not in _DRAWN_SECTIONS
        }
        self._others = np.array([list(kind_of).index(name) for name in others], int)
        self.stage = Stage(
            name=simulation.scene.name,
            bodies=(
                *(Surface(skin.name, skin.triangles) for skin in skins[:soft]),
                *_joined(skins[soft:], simulation.skin_positions()[soft:]),
            ),
            cable_names=simulation.actuator_names[self._cables],
            tension_range=tension_range(simulation),
            cavities=tuple(Surface(skin.name, skin.triangles) for skin in simulation.cavities.skins),
            pressure_range=pressure_range(simulation),
            other_actuators=tuple(
                OtherActuator(name, kind.setpoint.unit, kind.effort.unit)
                for name, kind in others.items()
            ),
            effector_names=simulation.effector_names,
            marker_ids=simulation.marker_ids,
            rigid_bodies=_solids(simulation.rigid_skins()),
            obstacles=_solids(simulation.obstacle_skins()),
            shows_contact=simulation.scene.contact is not None,
            axis_length=AXIS_SHARE * simulation.model.nodes.size if self._is_oriented else 0.0,
            force_scale=force_scale,
            fixed_points=_fixed_points(simulation),
        )

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
        simulation, cables = self._simulation, self._cables
        names, paths = simulation.actuator_names, simulation.actuator_paths()
        rigid_positions, rigid_quaternions = simulation.rigid_poses()
        known = errors[np.isfinite(errors)]
        return Frame(
            step=step,
            time_ns=time_ns,
            surface_positions=self._surface_points(),
            cable_paths=tuple(paths[name] for name in names[cables]),
            cable_lengths=result.setpoints[cables],
            cable_tensions=result.efforts[cables],
            other_setpoints=result.setpoints[self._others],
            other_efforts=result.efforts[self._others],
            effector_positions=result.effector_positions,
            targets=targets,
            predicted_markers=predicted_markers,
            measured_markers=measured_markers,
            effector_error=float(known.max()) if len(known) else float("nan"),
            stage_times=result.report.stage_times,
            compute_time=result.report.compute_time,
            status=status,
            residual=result.report.residual,
            linearization_error=result.report.linearization_error,
            discretization_error=discretization_error,
            cavity_positions=simulation.cavity_positions(),
            cavity_pressures=simulation.cavities.pressures(simulation.state),
            cavity_volumes=simulation.cavities.volumes(simulation.state),
            rigid_positions=rigid_positions,
            rigid_quaternions=rigid_quaternions,
            **self._optional_fields(result, target_orientations),
        )

    def _surface_points(self) -> tuple[np.ndarray, ...]:
        """Present points of the bodies' surfaces [m]; those of several beams are one array."""
        points, soft = self._simulation.skin_positions(), self._soft_count
        return points if len(points) < soft + 2 else (*points[:soft], np.vstack(points[soft:]))

    def _optional_fields(self, result: StepResult, target_orientations: np.ndarray) -> dict:
        """Fields of a frame for scenes with orientations or contact."""
        shown = dict[str, Any]()
        if self._is_oriented:
            shown["effector_orientations"] = result.effector_orientations
            shown["target_orientations"] = target_orientations
        if result.contacts is not None:
            shown["contact_positions"] = result.contacts.positions
            shown["contact_forces"] = result.contacts.forces
        return shown
