"""A robot in rerun: its states as they are stepped, live, into a file, or in a notebook."""

from __future__ import annotations

import weakref
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.simulation import Simulation, Status, StepReport, StepResult
from softrobot_twin.view import RerunMirror
from softrobot_twin.view.simulation_frames import SimulationFrames

# A step waits until its frame is drawn, but no longer [s]: a viewer may be frozen.
_LONGEST_WAIT = 1.0
# Frames a second that viewers get, at most: all of them [Hz].
_ANY_RATE = 1.0e9


class RobotView(AbstractContextManager):
    """Shows each step of a robot until it is closed; also a context manager.

    Attributes:
        address: Where viewers connect; None where it only writes a file.
        path: File that it writes, or None.
    """

    address: str | None
    path: Path | None

    def __init__(
        self, simulation: Simulation, path: Path | None, serve: bool, spawn: bool, port: int,
        force_scale: float, notebook: bool,
    ):  # fmt: skip
        """Open it.

        Args:
            simulation: The simulation to show.
            path: File to write, ``.rrd``, or None.
            serve: Whether viewers can connect.
            spawn: Whether to open a viewer, if there is a display.
            port: TCP port for viewers; 0 selects a free one.
            force_scale: Length of the arrow of a contact force [m/N].
            notebook: Whether a notebook that shows it gets a viewer inside.

        Raises:
            ViewError: The view cannot be opened.
        """
        self._simulation = simulation
        self._frames = SimulationFrames(simulation, force_scale)
        self._mirror = RerunMirror(
            self._frames.stage, serve=serve, port=port, record=path, spawn_viewer=spawn,
            live_rate=_ANY_RATE, notebook=notebook,
        )  # fmt: skip
        self.address, self.path = self._mirror.address, path
        self._name, self._count = simulation.scene.name, 0
        # Also at the end of a script, so that the last frames arrive.
        self._end = weakref.finalize(self, self._mirror.close)

    @property
    def is_open(self) -> bool:
        """Whether steps are still shown."""
        return self._end.alive

    @property
    def shown_count(self) -> int:
        """Number of states that were drawn, at rest and after steps."""
        return max((one.logged_count for one in self._mirror.drawing_threads), default=0)

    @property
    def failure(self) -> str | None:
        """What could not be drawn, or None."""
        return self._mirror.failure

    def show(self, result: StepResult | None = None, command: Any = None) -> None:
        """Shows the present state.

        Args:
            result: The step that led to it; None without one.
            command: What was asked, whose targets are shown.
        """
        if not self.is_open:
            return
        simulation = self._simulation
        shown = _standing(simulation) if result is None else result
        count = len(simulation.effector_names)
        targets = getattr(command, "targets", np.full((count, 3), np.nan))
        turns, markers = getattr(command, "orientations", None), simulation.marker_positions()
        self._count += 1
        self._mirror.offer(self._frames.frame(
            self._count, round(1.0e9 * shown.state.time), shown,
            targets=np.array(targets, float),
            target_orientations=np.full((count, 4), np.nan) if turns is None else turns,
            errors=shown.effector_errors, predicted_markers=markers,
            measured_markers=np.full_like(markers, np.nan), status=shown.status.value,
        ))  # fmt: skip
        self._mirror.wait(_LONGEST_WAIT)

    def close(self) -> None:
        """Draws the last frames, finishes the file and stops serving; may be called twice."""
        self._end()

    def __exit__(self, *error: object) -> None:
        self.close()

    def _ipython_display_(self) -> None:
        """Shows the viewer inside a notebook, or what it is."""
        shown: Any = self._mirror.notebook_viewer
        print(self) if shown is None else shown.display()

    def __repr__(self) -> str:
        in_notebook = self._mirror.notebook_viewer and "a notebook"
        places = [f"{word} {place}" for word, place in (
            ("at", self.address), ("in", self.path), ("in", in_notebook)) if place]  # fmt: skip
        state = "" if self.is_open else ", closed"
        return f"<View of {self._name} {' and '.join(places)}{state}>"


def _standing(simulation: Simulation) -> StepResult:
    """A state without a step, as a result."""
    state, count = simulation.state, len(simulation.effector_names)
    actuators = simulation.actuators
    return StepResult(
        state, Status.OK, state.setpoints, state.efforts,
        actuators.displacements(state.setpoints, state.positions),
        simulation.effector_positions(), np.full(count, np.nan),
        StepReport({}, 0.0, float("nan"), 0),
        effector_orientations=simulation.effector_orientations(),
    )  # fmt: skip
