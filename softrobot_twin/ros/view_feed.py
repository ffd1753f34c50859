"""What the node shows of its loop. The view room is imported only where one is made."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softrobot_twin.control.tick_outcome import TickOutcome
from softrobot_twin.simulation import Simulation

if TYPE_CHECKING:
    from softrobot_twin.view import RerunMirror


OPEN_TENSION = 10.0
"""Upper end of the colour scale where no cable has a limit [N]."""


class ViewFeed:
    """Turns ticks into frames and offers them to the mirror, which never waits.

    Args:
        simulation: What is shown.
        parameters: Values of ``view``, ``view_port``, ``view_every``, ``view_spawn``,
            ``view_force_scale``, ``record_file`` and ``record_every``.

    Raises:
        ViewError: The view cannot do what it is asked.
    """

    def __init__(self, simulation: Simulation, parameters: Mapping[str, object]):
        from softrobot_twin.view import Frame, RerunMirror, Stage, Surface

        self._frame = Frame
        self._simulation = simulation
        self._every = int(parameters["view_every"])
        self._ticks = 0
        self._cable_count = len(simulation.actuator_names) - len(simulation.slide_names)
        limits = simulation.limits.effort_max[: self._cable_count]
        limits = limits[np.isfinite(limits)]
        stage = Stage(
            name=simulation.scene.name,
            bodies=tuple(Surface(skin.name, skin.triangles) for skin in simulation.skins),
            cable_names=simulation.actuator_names[: self._cable_count],
            tension_range=(0.0, float(limits.max(initial=0.0)) or OPEN_TENSION),
            slide_names=simulation.slide_names,
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
        """True when there is a viewer to serve or a file to write."""
        return bool(parameters["view"] or parameters["record_file"] or parameters["view_spawn"])

    def offer(
        self, outcome: TickOutcome, time_ns: int, discretization_error: float = float("nan")
    ) -> None:
        """Shows a tick, if it is one of those to show.

        Args:
            outcome: The tick.
            time_ns: Its time [ns].
            discretization_error: How far the mesh puts the effectors off, the newest estimate [m].
        """
        self._ticks += 1
        if (self._ticks - 1) % self._every:
            return
        simulation, result = self._simulation, outcome.result
        errors = outcome.tracking_errors[np.isfinite(outcome.tracking_errors)]
        self.mirror.offer(
            self._frame(
                step=self._ticks,
                time_ns=time_ns,
                surface_positions=simulation.skin_positions(),
                cable_paths=simulation.cable_paths(),
                cable_lengths=result.setpoints[: self._cable_count],
                cable_tensions=result.efforts[: self._cable_count],
                slide_positions=result.setpoints[self._cable_count :],
                slide_forces=result.efforts[self._cable_count :],
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
                **self._of_solids(outcome),
            )
        )

    def _of_solids(self, outcome: TickOutcome) -> dict[str, np.ndarray]:
        """Where rigid bodies are and what touches, for scenes that have them."""
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
