"""Which part of a frame becomes which rerun entity.

Space is in metres, right-handed, z up. Plots are for people to read: lengths and errors in mm,
times in ms. Importing this module imports rerun.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from softrobot_twin.view.frame import Frame, Stage
from softrobot_twin.view.recording import Recording
from softrobot_twin.view.slide_curves import SlideCurves
from softrobot_twin.view.solids import Solids
from softrobot_twin.view.surface_normals import SurfaceNormals
from softrobot_twin.view.tension_colours import tension_colours
from softrobot_twin.view.touch import Touch
from softrobot_twin.view.trail import EffectorTrail

SURFACE = "/robot/surface"
CABLES = "/robot/cables"
EFFECTORS = "/robot/effectors"
TRAIL = "/robot/effector_trail"
TARGETS = "/targets"
PREDICTED_MARKERS = "/markers/predicted"
MEASURED_MARKERS = "/markers/measured"
ERROR_PLOT = "/plots/effector_error"
LENGTH_PLOT = "/plots/cable_lengths"
TENSION_PLOT = "/plots/cable_tensions"
TIME_PLOT = "/plots/stage_times"
RESIDUAL_PLOT = "/plots/residual"
STATUS = "/status"

_WHOLE_STEP = "whole step"
_ERRORS = ("to the target", "of linearizing, estimated", "of the mesh, estimated")
_TRAIL_DURATION = 5.0

_SURFACE_COLOUR = (178, 190, 208, 130)
_EFFECTOR_COLOUR = (255, 255, 255)
_TRAIL_COLOUR = (130, 190, 255)
_TARGET_COLOUR = (60, 220, 110)
_PREDICTED_COLOUR = (70, 150, 255)
_MEASURED_COLOUR = (255, 160, 40)
# Okabe and Ito's colours, which people who are colour-blind can tell apart, without black.
_CURVE_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (240, 228, 66),
                  (204, 121, 167), (213, 94, 0), (0, 114, 178), (200, 200, 200))


class Picture:
    """Draws the frames of one stage into one recording.

    Args:
        recording: Where to; everything but the stage is logged from one thread.
        stage: What never changes; it is logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording = recording
        self._stage = stage
        self._normals: list[SurfaceNormals] = []
        self._trail = EffectorTrail(_TRAIL_DURATION)
        self._time_names: list[str] = []
        self._status: str | None = None
        self._log_stage()
        solid = stage.rigid_bodies or stage.obstacles
        self._solids = Solids(recording, stage) if solid else None
        slides = stage.slide_names
        self._slides = SlideCurves(recording, slides) if slides else None
        self._touch = Touch(recording, stage.force_scale) if stage.shows_contact else None

    def _log_stage(self) -> None:
        stage, log = self._stage, self._recording.log
        log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for body in stage.bodies:
            triangles = np.asarray(body.triangles, dtype=np.uint32)
            log(f"{SURFACE}/{body.name}", rr.Mesh3D.from_fields(
                triangle_indices=triangles, albedo_factor=_SURFACE_COLOUR), static=True)
        marker_names = [str(marker) for marker in stage.marker_ids]
        radius = rr.Radius.ui_points
        for path, colour, size, names in (
                (EFFECTORS, _EFFECTOR_COLOUR, 5.0, stage.effector_names),
                (TARGETS, _TARGET_COLOUR, 6.0, None),
                (PREDICTED_MARKERS, _PREDICTED_COLOUR, 4.5, marker_names),
                (MEASURED_MARKERS, _MEASURED_COLOUR, 4.5, None)):
            log(path, rr.Points3D.from_fields(colors=[colour], radii=[radius(size)], labels=names,
                                              show_labels=False), static=True)
        log(TRAIL, rr.LineStrips3D.from_fields(colors=[_TRAIL_COLOUR], radii=[radius(1.2)]),
            static=True)
        log(CABLES, rr.LineStrips3D.from_fields(labels=stage.cable_names, radii=[radius(2.5)],
                                                show_labels=True), static=True)
        self._name_curves(LENGTH_PLOT, stage.cable_names)
        self._name_curves(TENSION_PLOT, stage.cable_names)
        self._name_curves(ERROR_PLOT, _ERRORS)
        self._name_curves(RESIDUAL_PLOT, ["residual"])

    def log(self, frame: Frame) -> None:
        """Draw one frame.

        Raises:
            ViewError: The frame is not of this stage.
        """
        frame.refuse_if_unlike(self._stage)
        self._recording.set_time(frame.step, frame.time_ns)
        self._log_bodies(frame)
        if self._solids is not None:
            self._solids.log(frame)
        if self._slides is not None:
            self._slides.log(frame)
        if self._touch is not None:
            self._touch.log(frame)
        self._log_points(frame)
        self._log_curves(frame)
        if frame.status != self._status:
            self._recording.log(STATUS, rr.TextLog(frame.status))
            self._status = frame.status

    def close(self, timeout: float) -> None:
        """Finish the recording, for at most so long [s]."""
        self._recording.close(timeout)

    def _log_bodies(self, frame: Frame) -> None:
        log, bodies = self._recording.log, self._stage.bodies
        if not self._normals:
            self._normals = [SurfaceNormals(body.triangles, len(positions))
                             for body, positions in zip(bodies, frame.surface_positions)]
        for body, normals, positions in zip(bodies, self._normals, frame.surface_positions):
            log(f"{SURFACE}/{body.name}", rr.Mesh3D.from_fields(
                vertex_positions=np.asarray(positions, dtype=np.float32),
                vertex_normals=normals.at(positions).astype(np.float32)))
        colours = tension_colours(frame.cable_tensions, self._stage.tension_range)
        log(CABLES, rr.LineStrips3D.from_fields(strips=frame.cable_paths, colors=colours))

    def _log_points(self, frame: Frame) -> None:
        log = self._recording.log
        log(EFFECTORS, _points(frame.effector_positions))
        log(TARGETS, _seen(frame.targets, self._stage.effector_names))
        log(PREDICTED_MARKERS, _points(frame.predicted_markers))
        log(MEASURED_MARKERS, _seen(frame.measured_markers, self._stage.marker_ids))
        if np.isfinite(frame.effector_positions).all():
            strips = self._trail.extend(frame.time_ns, frame.effector_positions)
            log(TRAIL, rr.LineStrips3D.from_fields(strips=strips))

    def _log_curves(self, frame: Frame) -> None:
        log_series = self._recording.log_series
        log_series(LENGTH_PLOT, 1e3 * np.asarray(frame.cable_lengths))
        log_series(TENSION_PLOT, frame.cable_tensions)
        errors = (frame.effector_error, frame.linearization_error, frame.discretization_error)
        log_series(ERROR_PLOT, [1e3 * error for error in errors])
        log_series(RESIDUAL_PLOT, [frame.residual])
        times = {_WHOLE_STEP: frame.compute_time, **frame.stage_times}
        new_names = [name for name in times if name not in self._time_names]
        if new_names:
            self._time_names += new_names
            self._name_curves(TIME_PLOT, self._time_names)
        log_series(TIME_PLOT, [1e3 * times.get(name, np.nan) for name in self._time_names])

    def _name_curves(self, path: str, names: Sequence[str]) -> None:
        colours = [_CURVE_COLOURS[index % len(_CURVE_COLOURS)] for index in range(len(names))]
        self._recording.name_series(path, names, colours)


def _points(positions: np.ndarray) -> rr.Points3D:
    return rr.Points3D.from_fields(positions=np.asarray(positions, dtype=np.float32))


def _seen(positions: np.ndarray, names: Sequence) -> rr.Points3D:
    """Points without the rows that are not finite, each with its name."""
    seen = np.isfinite(positions).all(axis=1)
    return rr.Points3D.from_fields(
        positions=np.asarray(positions, dtype=np.float32)[seen],
        labels=[str(name) for name, shown in zip(names, seen) if shown])
