"""Draws frames as rerun entities, and defines the layout of the viewer.

The file contains, in this order: surface normals, the effectors' recent path, rigid bodies and obstacles, contacts, axes of effectors, cavities, slides, the picture of a whole frame,
and the layout.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import cycle, islice

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy import sparse
from scipy.spatial.transform import Rotation

from softrobot_twin.view.colours import (
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
from softrobot_twin.view.frame import Frame, Stage, Surface
from softrobot_twin.view.recording import Recording, past_range, time_panel


class SurfaceNormals:
    """Vertex normals of a triangle surface, n ∝ Σ (x₂ - x₁) × (x₃ - x₁) over a vertex's faces.

    The sum weights each face by its area. It is a product with a sparse matrix of ones, which took
    11 µs for 2000 triangles (three ``np.bincount`` 39 µs, ``np.add.at`` 168 µs).
    """

    def __init__(self, triangles: np.ndarray, node_count: int):
        self._corners = np.ascontiguousarray(np.asarray(triangles, dtype=np.intp).T)
        triangle_count = self._corners.shape[1]
        faces = np.tile(np.arange(triangle_count), 3)
        self._faces_around = sparse.csr_matrix(
            (np.ones(3 * triangle_count), (self._corners.ravel(), faces)),
            shape=(node_count, triangle_count))

    def at(self, positions: np.ndarray) -> np.ndarray:
        """Unit normals at the vertices, shape (node_count, 3); zero where the faces have no area.

        Args:
            positions: Surface nodes [m], shape (node_count, 3).
        """
        first, second, third = positions[self._corners]
        doubled_areas = np.cross(second - first, third - first)
        sums = self._faces_around @ doubled_areas
        lengths = np.sqrt(np.einsum("ij,ij->i", sums, sums))
        return sums / np.where(lengths > 0.0, lengths, 1.0)[:, None]


class DeformingSurfaces:
    """Draws surfaces whose points move.

    Args:
        recording: Recording to draw into.
        path: Where they are; each is below it, by its name.
        surfaces: The surfaces; their triangles are logged at once.
        colour: Of all of them; None where it changes.
    """

    def __init__(
        self, recording: Recording, path: str, surfaces: Sequence[Surface], colour=None
    ):  # fmt: skip
        self._recording, self._surfaces = recording, surfaces
        self._paths = [f"{path}/{surface.name}" for surface in surfaces]
        self._normals: list[SurfaceNormals] = []
        for own, surface in zip(self._paths, surfaces):
            triangles = np.asarray(surface.triangles, dtype=np.uint32)
            recording.log(own, rr.Mesh3D.from_fields(
                triangle_indices=triangles, albedo_factor=colour), static=True)

    def log(self, positions: Sequence[np.ndarray], colours: Sequence | None = None) -> None:
        """Draws them at the positions of their points [m], with other colours if given."""
        if not self._normals:
            self._normals = [SurfaceNormals(surface.triangles, len(points))
                             for surface, points in zip(self._surfaces, positions)]
        for own, normals, points, colour in zip(
            self._paths, self._normals, positions, colours or [None] * len(positions)
        ):
            self._recording.log(own, rr.Mesh3D.from_fields(
                vertex_positions=np.asarray(points, dtype=np.float32),
                vertex_normals=normals.at(points).astype(np.float32), albedo_factor=colour))


class RecentPath:
    """Path of the effectors over the last seconds, with a bounded number of points.

    Args:
        duration: Length of the path in time [s].
        point_count: Most points; they are duration / point_count apart.
    """

    def __init__(self, duration: float, point_count: int = 200):
        self._duration_ns = int(duration * 1e9)
        self._spacing_ns = self._duration_ns // point_count
        self._points: deque[tuple[int, np.ndarray]] = deque(maxlen=point_count + 1)

    def extend(self, time_ns: int, positions: np.ndarray) -> list[np.ndarray]:
        """Adds the present positions and returns the path up to them.

        When the clock goes back, a new path is started.

        Args:
            time_ns: Time of the positions [ns].
            positions: Effectors [m], shape (effector_count, 3).

        Returns:
            A polyline for each effector [m], oldest point first, each of shape (point_count, 3).
        """
        points = self._points
        if points and time_ns < points[-1][0]:
            points.clear()
        while points and time_ns - points[0][0] > self._duration_ns:
            points.popleft()
        path = np.array([past for _, past in points] + [positions], dtype=np.float32)
        if not points or time_ns - points[-1][0] >= self._spacing_ns:
            points.append((time_ns, np.array(positions)))
        return [path[:, effector] for effector in range(path.shape[1])]


def name_curves(
    recording: Recording, path: str, names: Sequence[str], colours: Sequence | None = None
) -> None:  # fmt: skip
    """Names the curves of a plot, in colours that repeat."""
    chosen = cycle(_CURVE_COLOURS if colours is None else colours)
    recording.name_series(path, names, list(islice(chosen, len(names))))


RIGID_BODIES = "/rigid_bodies"
OBSTACLES = "/obstacles"


class SolidDrawing:
    """Draws rigid bodies and obstacles.

    Args:
        recording: Recording to draw into.
        stage: The surfaces; they are logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording = recording
        self._names = [body.name for body in stage.rigid_bodies]
        for body in stage.rigid_bodies:
            recording.log(f"{RIGID_BODIES}/{body.name}", _mesh(body, RIGID_COLOUR), static=True)
        for obstacle in stage.obstacles:
            recording.log(f"{OBSTACLES}/{obstacle.name}", _mesh(obstacle, OBSTACLE_COLOUR),
                          static=True)

    def log(self, frame: Frame) -> None:
        """Moves the rigid bodies to their poses in a frame."""
        for name, position, quaternion in zip(self._names, frame.rigid_positions,
                                              frame.rigid_quaternions):
            pose = rr.Transform3D(translation=position, quaternion=quaternion)
            self._recording.log(f"{RIGID_BODIES}/{name}", pose)


def _mesh(surface: Surface, colour: tuple[int, int, int]) -> rr.Mesh3D:
    """The surface with separate corners for each triangle, so that edges look sharp."""
    corners = np.asarray(surface.points, dtype=float)[surface.triangles].reshape(-1, 3)
    triangles = np.arange(len(corners)).reshape(-1, 3)
    normals = SurfaceNormals(triangles, len(corners)).at(corners)
    return rr.Mesh3D(vertex_positions=corners.astype(np.float32),
                     triangle_indices=triangles.astype(np.uint32),
                     vertex_normals=normals.astype(np.float32), albedo_factor=colour)


CONTACT_POINTS = "/contacts/points"
CONTACT_FORCES = "/contacts/forces"
CONTACT_PLOT = "/plots/contacts"

_CONTACT_CURVES = ("count", "largest force [N]")
_CONTACT_COLOUR = (230, 60, 60)
_FORCE_COLOUR = (255, 110, 70)
_CONTACT_COLOURS = ((86, 180, 233), (213, 94, 0))


class ContactDrawing:
    """Draws contacts; a frame without contacts clears those of the last frame.

    Args:
        recording: Recording to draw into.
        force_scale: Length of the arrow of a force [m/N].
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording, self._force_scale = recording, stage.force_scale
        radius = rr.Radius.ui_points
        recording.log(CONTACT_POINTS, rr.Points3D.from_fields(
            colors=[_CONTACT_COLOUR], radii=[radius(3.0)]), static=True)
        recording.log(CONTACT_FORCES, rr.Arrows3D.from_fields(
            colors=[_FORCE_COLOUR], radii=[radius(1.5)]), static=True)
        recording.name_series(CONTACT_PLOT, _CONTACT_CURVES, _CONTACT_COLOURS)

    def log(self, frame: Frame) -> None:
        """Draws the contacts of a frame: the force on the first body, at the contact point."""
        positions = np.asarray(frame.contact_positions, dtype=np.float32)
        forces = np.asarray(frame.contact_forces, dtype=float)
        arrows = (self._force_scale * forces).astype(np.float32)
        self._recording.log(CONTACT_POINTS, rr.Points3D.from_fields(positions=positions))
        self._recording.log(CONTACT_FORCES,
                            rr.Arrows3D.from_fields(origins=positions, vectors=arrows))
        largest = np.linalg.norm(forces, axis=1).max(initial=0.0)
        self._recording.log_series(CONTACT_PLOT, [len(positions), largest])


EFFECTOR_AXES = "/robot/effector_axes"
TARGET_AXES = "/target_axes"

_AXIS_COLOURS = ((214, 80, 70), (80, 170, 90), (70, 120, 214))
_TARGET_AXIS_COLOURS = ((250, 190, 185), (190, 235, 195), (185, 205, 250))


class AxesDrawing:
    """Draws the orientations of effectors and of their targets: axes x red, y green, z blue.

    Args:
        recording: Recording to draw into.
        length: Length of an axis [m].
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording, self._length = recording, stage.axis_length
        for path in (EFFECTOR_AXES, TARGET_AXES):
            recording.log(path, rr.Arrows3D.from_fields(radii=[rr.Radius.ui_points(1.5)]),
                          static=True)

    def log(self, frame: Frame) -> None:
        """Draws the axes of a frame; the target's at the effector where it has no position."""
        places = np.asarray(frame.effector_positions, dtype=float)
        wanted = np.where(np.isfinite(frame.targets), frame.targets, places)
        self._draw(EFFECTOR_AXES, places, frame.effector_orientations, _AXIS_COLOURS)
        self._draw(TARGET_AXES, wanted, frame.target_orientations, _TARGET_AXIS_COLOURS)

    def _draw(self, path: str, places: np.ndarray, turns: np.ndarray, colours) -> None:
        known = np.isfinite(turns).all(axis=1) & np.isfinite(places).all(axis=1)
        matrices = [Rotation.from_quat(turn).as_matrix() for turn in turns[known]]
        axes = np.concatenate([np.empty((0, 3)), *(matrix.T for matrix in matrices)])
        self._recording.log(path, rr.Arrows3D.from_fields(
            origins=np.repeat(places[known], 3, axis=0).astype(np.float32),
            vectors=(self._length * axes).astype(np.float32), colors=colours * int(known.sum())))


CAVITIES = "/robot/cavities"
PRESSURE_PLOT = "/plots/cavity_pressures"
VOLUME_PLOT = "/plots/cavity_volumes"

_CAVITY_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (240, 228, 66),
                   (204, 121, 167), (213, 94, 0))


class CavityDrawing:
    """Draws the walls of cavities, coloured by pressure, and curves of pressures and volumes.

    Args:
        recording: Recording to draw into.
        stage: The cavities; their triangles are logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording, self._range = recording, stage.pressure_range
        self._walls = DeformingSurfaces(recording, CAVITIES, stage.cavities)
        for plot, unit in ((PRESSURE_PLOT, "kPa"), (VOLUME_PLOT, "cm³")):
            names = [f"{cavity.name} [{unit}]" for cavity in stage.cavities]
            name_curves(recording, plot, names, _CAVITY_COLOURS)

    def log(self, frame: Frame) -> None:
        """Draws the cavities of a frame."""
        colours = pressure_colours(frame.cavity_pressures, self._range)
        self._walls.log(frame.cavity_positions, [tuple(map(int, colour)) for colour in colours])
        self._recording.log_series(PRESSURE_PLOT, 1e-3 * np.asarray(frame.cavity_pressures))
        self._recording.log_series(VOLUME_PLOT, 1e6 * np.asarray(frame.cavity_volumes))


ACTUATOR_PLOT = "/plots/actuators"

_ACTUATOR_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (204, 121, 167))


class ActuatorCurves:
    """Draws two curves for each other actuator: setpoint and effort.

    Args:
        recording: Recording to draw into.
        actuators: The actuators.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording, actuators = recording, stage.other_actuators
        in_metres = np.array([one.setpoint_unit == "m" for one in actuators], bool)
        self._factors = np.where(in_metres, 1e3, 1.0)
        curves = [f"{one.name} [{unit}]" for one, metres in zip(actuators, in_metres, strict=True)
                  for unit in ("mm" if metres else one.setpoint_unit, one.effort_unit)]
        name_curves(recording, ACTUATOR_PLOT, curves, _ACTUATOR_COLOURS)

    def log(self, frame: Frame) -> None:
        """Draws the other actuators of a frame."""
        shown = np.column_stack([self._factors * frame.other_setpoints, frame.other_efforts])
        self._recording.log_series(ACTUATOR_PLOT, shown.ravel().tolist())


SURFACE = "/robot/surface"
CABLES = "/robot/cables"
EFFECTORS = "/robot/effectors"
TRAIL = "/robot/effector_trail"
TARGETS = "/targets"
PREDICTED_MARKERS = "/markers/predicted"
MEASURED_MARKERS = "/markers/measured"
FIXED_POINTS = "/robot/fixed"
PULL_POINTS = "/robot/pull_points"
ERROR_PLOT = "/plots/effector_error"
LENGTH_PLOT = "/plots/cable_lengths"
TENSION_PLOT = "/plots/cable_tensions"
TIME_PLOT = "/plots/stage_times"
RESIDUAL_PLOT = "/plots/residual"
STATUS = "/status"

_WHOLE_STEP = "whole step"
_ERRORS = ("to the target", "of linearizing, estimated", "of the mesh, estimated")
_TRAIL_DURATION = 5.0

_TRAIL_COLOUR = (130, 190, 255)
_PREDICTED_COLOUR = (70, 150, 255)
_MEASURED_COLOUR = (255, 160, 40)
_FIXED_COLOUR, _PULL_COLOUR = (110, 110, 120), (235, 235, 235)
# Okabe and Ito's colours without black; colour-blind people can distinguish them.
_CURVE_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (240, 228, 66),
                  (204, 121, 167), (213, 94, 0), (0, 114, 178), (200, 200, 200))


class Picture:
    """Draws the frames of one stage into one recording.

    Args:
        recording: Recording to draw into; frames are logged from one thread.
        stage: The constant part of the view; it is logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording = recording
        self._stage = stage
        colour = CLEAR_SURFACE_COLOUR if stage.cavities else SURFACE_COLOUR
        self._bodies = DeformingSurfaces(recording, SURFACE, stage.bodies, colour)
        self._recent_path = RecentPath(_TRAIL_DURATION)
        self._time_names: list[str] = []
        self._status: str | None = None
        self._log_stage()
        # What only some robots have.
        drawings = [drawing for is_shown, drawing in (
            (stage.rigid_bodies or stage.obstacles, SolidDrawing), (stage.cavities, CavityDrawing),
            (stage.other_actuators, ActuatorCurves), (stage.shows_contact, ContactDrawing),
            (stage.axis_length, AxesDrawing),
        ) if is_shown]  # fmt: skip
        self._drawings = [drawing(recording, stage) for drawing in drawings]

    def _log_stage(self) -> None:
        stage, log = self._stage, self._recording.log
        log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        marker_names = [str(marker) for marker in stage.marker_ids]
        radius = rr.Radius.ui_points
        for path, colour, size, names in (
                (EFFECTORS, EFFECTOR_COLOUR, 5.0, stage.effector_names),
                (TARGETS, TARGET_COLOUR, 6.0, None),
                (PREDICTED_MARKERS, _PREDICTED_COLOUR, 4.5, marker_names),
                (MEASURED_MARKERS, _MEASURED_COLOUR, 4.5, None)):
            log(path, rr.Points3D.from_fields(colors=[colour], radii=[radius(size)], labels=names,
                                              show_labels=False), static=True)
        log(TRAIL, rr.LineStrips3D.from_fields(colors=[_TRAIL_COLOUR], radii=[radius(1.2)]),
            static=True)
        if len(stage.fixed_points):
            log(FIXED_POINTS, rr.Points3D.from_fields(
                positions=np.asarray(stage.fixed_points, dtype=np.float32),
                colors=[_FIXED_COLOUR], radii=[radius(2.5)]), static=True)
        if stage.cable_names:
            log(PULL_POINTS, rr.Points3D.from_fields(colors=[_PULL_COLOUR], radii=[radius(4.0)]),
                static=True)
            log(CABLES, rr.LineStrips3D.from_fields(
                labels=stage.cable_names, radii=[radius(2.5)], show_labels=True), static=True)
            name_curves(self._recording, LENGTH_PLOT, stage.cable_names)
            name_curves(self._recording, TENSION_PLOT, stage.cable_names)
        name_curves(self._recording, ERROR_PLOT, _ERRORS)
        name_curves(self._recording, RESIDUAL_PLOT, ["residual"])

    def log(self, frame: Frame) -> None:
        """Draws one frame.

        Raises:
            ViewError: The frame does not fit the stage.
        """
        frame.check_against(self._stage)
        self._recording.set_time(frame.step, frame.time_ns)
        self._log_bodies(frame)
        for drawing in self._drawings:
            drawing.log(frame)
        self._log_points(frame)
        self._log_curves(frame)
        if frame.status != self._status:
            self._recording.log(STATUS, rr.TextLog(frame.status))
            self._status = frame.status

    def close(self, timeout: float) -> None:
        """Finishes the recording within a timeout [s]."""
        self._recording.close(timeout)

    def _log_bodies(self, frame: Frame) -> None:
        log = self._recording.log
        self._bodies.log(frame.surface_positions)
        if self._stage.cable_names:
            colours = tension_colours(frame.cable_tensions, self._stage.tension_range)
            log(CABLES, rr.LineStrips3D.from_fields(strips=frame.cable_paths, colors=colours))
            log(PULL_POINTS, _points([path[0] for path in frame.cable_paths]))

    def _log_points(self, frame: Frame) -> None:
        log = self._recording.log
        log(EFFECTORS, _points(frame.effector_positions))
        log(TARGETS, _known_points(frame.targets, self._stage.effector_names))
        log(PREDICTED_MARKERS, _points(frame.predicted_markers))
        log(MEASURED_MARKERS, _known_points(frame.measured_markers, self._stage.marker_ids))
        if np.isfinite(frame.effector_positions).all():
            strips = self._recent_path.extend(frame.time_ns, frame.effector_positions)
            log(TRAIL, rr.LineStrips3D.from_fields(strips=strips))

    def _log_curves(self, frame: Frame) -> None:
        log_series = self._recording.log_series
        if self._stage.cable_names:
            log_series(LENGTH_PLOT, 1e3 * np.asarray(frame.cable_lengths))
            log_series(TENSION_PLOT, frame.cable_tensions)
        errors = (frame.effector_error, frame.linearization_error, frame.discretization_error)
        log_series(ERROR_PLOT, [1e3 * error for error in errors])
        log_series(RESIDUAL_PLOT, [frame.residual])
        times = {_WHOLE_STEP: frame.compute_time, **frame.stage_times}
        new_names = [name for name in times if name not in self._time_names]
        if new_names:
            self._time_names += new_names
            name_curves(self._recording, TIME_PLOT, self._time_names)
        log_series(TIME_PLOT, [1e3 * times.get(name, np.nan) for name in self._time_names])


def _points(positions: np.ndarray) -> rr.Points3D:
    return rr.Points3D.from_fields(positions=np.asarray(positions, dtype=np.float32))


def _known_points(positions: np.ndarray, names: Sequence) -> rr.Points3D:
    """Points without the rows that are not finite, each with its name."""
    seen = np.isfinite(positions).all(axis=1)
    return rr.Points3D.from_fields(
        positions=np.asarray(positions, dtype=np.float32)[seen],
        labels=[str(name) for name, shown in zip(names, seen) if shown])


# How much of the past the curves show [s].
_PLOTTED_PAST = 20.0


def layout(stage: Stage) -> rrb.Blueprint:
    """The layout of the viewer for one robot: a view of space, and plots of what it has.

    The name of the view of space states the colours of pressures.

    Args:
        stage: The robot.
    """
    name, plots = stage.name, []
    if stage.cable_names:
        plots += [_plot("Cable lengths [mm]", LENGTH_PLOT),
                  _plot("Cable tensions [N]", TENSION_PLOT)]
    if stage.cavities:
        name = f"{name}; cavities: {pressure_legend(stage.pressure_range)}"
        plots += [_plot("Cavity gauge pressures [kPa]", PRESSURE_PLOT),
                  _plot("Cavity volumes [cm³]", VOLUME_PLOT)]
    if stage.other_actuators:
        plots.append(_plot("Actuators", ACTUATOR_PLOT))
    if stage.shows_contact:
        plots.append(_plot("Contacts", CONTACT_PLOT))
    space = rrb.Spatial3DView(origin="/", name=name,
                              contents=["/robot/**", "/targets/**", "/markers/**",
                                        "/rigid_bodies/**", "/obstacles/**", "/contacts/**"])
    status = rrb.TextLogView(origin=STATUS, name="Status")
    curves = rrb.Vertical(
        _plot("Effector error [mm]", ERROR_PLOT),
        *plots,
        _plot("Times [ms]", TIME_PLOT),
        _plot("Residual [N]", RESIDUAL_PLOT, legend=False),
        row_shares=[1.0] * (1 + len(plots)) + [1.2, 0.8])
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(space, status, row_shares=[6.0, 1.0]), curves,
                       column_shares=[3.0, 2.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel())


def _plot(title: str, origin: str, legend: bool = True) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=title, time_ranges=past_range(_PLOTTED_PAST),
                              plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend))
