"""The feed of rerun: ticks become frames, which the mirror shows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from softrobot_twin.control.twin_loop import TickOutcome
from softrobot_twin.simulation import Simulation
from softrobot_twin.view import RerunMirror
from softrobot_twin.view.simulation_frames import SimulationFrames


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
        self._frames = SimulationFrames(simulation, float(parameters["view_force_scale"]))
        self._every = int(parameters["view_every"])
        self._ticks = 0
        record = str(parameters["record_file"])
        self.mirror: RerunMirror = RerunMirror(
            self._frames.stage,
            serve=bool(parameters["view"]),
            port=int(parameters["view_port"]),
            record=Path(record) if record else None,
            record_every=int(parameters["record_every"]),
            spawn_viewer=bool(parameters["view_spawn"]),
        )

    @staticmethod
    def is_wanted(parameters: Mapping[str, object]) -> bool:
        """True when the parameters request viewers or a recording.

        Args:
            parameters: Values of the node's parameters by name.
        """
        return bool(parameters["view"] or parameters["record_file"] or parameters["view_spawn"])

    def offer(self, outcome: TickOutcome, time_ns: int, discretization_error: float = float("nan")) -> None:
        """Offers a tick to the mirror, if it is one of those to show.

        Args:
            outcome: The tick.
            time_ns: Its time [ns].
            discretization_error: Newest estimate of the effectors' error due to the mesh [m].
        """
        self._ticks += 1
        if (self._ticks - 1) % self._every:
            return
        self.mirror.offer(
            self._frames.frame(
                self._ticks, time_ns, outcome.result, **outcome.shown(),
                discretization_error=discretization_error,
            )
        )

    def close(self) -> None:
        """Finishes the file and stops serving."""
        self.mirror.close()
