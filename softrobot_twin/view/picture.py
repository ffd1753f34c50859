"""Draws frames as rerun entities, and defines the layout of the viewer.

A robot is a list of entities in space and a list of plots; drawing a frame is a loop over both. The
file contains, in this order: surface normals, the effectors' recent path, the entities, the plots,
the picture of a whole frame, and the layout.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from itertools import cycle, islice
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from scipy import sparse
from scipy.spatial.transform import Rotation

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


_TRAIL_COLOUR = (130, 190, 255)
_PREDICTED_COLOUR = (70, 150, 255)
_MEASURED_COLOUR = (255, 160, 40)
_FIXED_COLOUR, _PULL_COLOUR = (110, 110, 120), (235, 235, 235)
_CONTACT_COLOUR, _FORCE_COLOUR = (230, 60, 60), (255, 110, 70)
_AXIS_COLOURS = ((214, 80, 70), (80, 170, 90), (70, 120, 214))
_TARGET_AXIS_COLOURS = ((250, 190, 185), (190, 235, 195), (185, 205, 250))
# How long the trail of an effector is [s].
_TRAIL_DURATION = 5.0


class _Entity(NamedTuple):
    """One thing in the view of space.

    Attributes:
        path: Its entity path.
        fixed: What is logged of it once, an archetype of rerun.
        present: What is logged of it in each frame; its answer is None for nothing.
    """

    path: str
    fixed: object
    present: Callable[[Frame], object | None] | None = None


def _entities(stage: Stage) -> Iterator[_Entity]:
    """All things in the view of space; what a robot does not have is no entity."""
    yield _Entity("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    colour = CLEAR_SURFACE_COLOUR if stage.cavities else SURFACE_COLOUR
    for place, body in enumerate(stage.bodies):
        yield _deforming(f"/robot/surface/{body.name}", body, "surface_positions", place, colour)
    if stage.cable_names:
        yield _Entity("/robot/cables", rr.LineStrips3D.from_fields(
            labels=stage.cable_names, radii=[_width(2.5)], show_labels=True),
            lambda frame: rr.LineStrips3D.from_fields(
                strips=frame.cable_paths,
                colors=tension_colours(frame.cable_tensions, stage.tension_range)))
        yield _Entity("/robot/pull_points", _look(rr.Points3D, _PULL_COLOUR, 4.0),
                      lambda frame: _points([path[0] for path in frame.cable_paths]))
    for place, body in enumerate(stage.rigid_bodies):
        yield _Entity(f"/rigid_bodies/{body.name}", _mesh(body, RIGID_COLOUR), partial(_pose, place))
    for obstacle in stage.obstacles:
        yield _Entity(f"/obstacles/{obstacle.name}", _mesh(obstacle, OBSTACLE_COLOUR))
    for place, cavity in enumerate(stage.cavities):
        yield _deforming(f"/robot/cavities/{cavity.name}", cavity, "cavity_positions", place,
                         pressure_range=stage.pressure_range)
    if stage.shows_contact:
        yield _Entity("/contacts/points", _look(rr.Points3D, _CONTACT_COLOUR, 3.0),
                      lambda frame: _points(frame.contact_positions))
        yield _Entity("/contacts/forces", _look(rr.Arrows3D, _FORCE_COLOUR, 1.5),
                      lambda frame: _arrows(frame.contact_positions,
                                            stage.force_scale * np.asarray(frame.contact_forces)))
    if stage.axis_length:
        for path, field, colours in (
            ("/robot/effector_axes", "effector_orientations", _AXIS_COLOURS),
            ("/target_axes", "target_orientations", _TARGET_AXIS_COLOURS),
        ):
            yield _Entity(path, rr.Arrows3D.from_fields(radii=[_width(1.5)]),
                          partial(_axes, field, stage.axis_length, colours))
    if len(stage.fixed_points):
        yield _Entity("/robot/fixed", _look(rr.Points3D, _FIXED_COLOUR, 2.5,
                      positions=np.asarray(stage.fixed_points, dtype=np.float32)))
    markers = [str(marker) for marker in stage.marker_ids]
    tips = stage.effector_names
    for path, field, colour, size, names, may_miss in (
        ("/robot/effectors", "effector_positions", EFFECTOR_COLOUR, 5.0, tips, False),
        ("/targets", "targets", TARGET_COLOUR, 6.0, tips, True),
        ("/markers/predicted", "predicted_markers", _PREDICTED_COLOUR, 4.5, markers, False),
        ("/markers/measured", "measured_markers", _MEASURED_COLOUR, 4.5, markers, True),
    ):
        fixed = _look(rr.Points3D, colour, size, labels=None if may_miss else names,
                      show_labels=False)
        yield _Entity(path, fixed, partial(_named_points, field, names if may_miss else None))
    yield _Entity("/robot/effector_trail", _look(rr.LineStrips3D, _TRAIL_COLOUR, 1.2),
                  partial(_trail, RecentPath(_TRAIL_DURATION)))


def _width(size: float) -> object:
    """A radius in points of the screen."""
    return rr.Radius.ui_points(size)


def _look(archetype, colour: Sequence[int], size: float, **fields: object) -> object:
    """The colour and size of marks or lines, and other fields that do not change."""
    return archetype.from_fields(colors=[colour], radii=[_width(size)], **fields)


def _deforming(
    path: str, surface: Surface, field: str, place: int, colour: Sequence[int] | None = None,
    pressure_range: tuple[float, float] | None = None,
) -> _Entity:  # fmt: skip
    """A surface whose points move; its colour is that of its pressure if a range is given."""
    normals_of = cache(partial(SurfaceNormals, surface.triangles))

    def present(frame: Frame) -> object:
        points, now = getattr(frame, field)[place], None
        if pressure_range is not None:
            pressure = frame.cavity_pressures[place : place + 1]
            now = tuple(map(int, pressure_colours(pressure, pressure_range)[0]))
        return rr.Mesh3D.from_fields(
            vertex_positions=np.asarray(points, dtype=np.float32), albedo_factor=now,
            vertex_normals=normals_of(len(points)).at(points).astype(np.float32))

    triangles = np.asarray(surface.triangles, dtype=np.uint32)
    fixed = rr.Mesh3D.from_fields(triangle_indices=triangles, albedo_factor=colour)
    return _Entity(path, fixed, present)


def _mesh(surface: Surface, colour: tuple[int, int, int]) -> rr.Mesh3D:
    """The surface with separate corners for each triangle, so that edges look sharp."""
    corners = np.asarray(surface.points, dtype=float)[surface.triangles].reshape(-1, 3)
    triangles = np.arange(len(corners)).reshape(-1, 3)
    normals = SurfaceNormals(triangles, len(corners)).at(corners)
    return rr.Mesh3D(vertex_positions=corners.astype(np.float32),
                     triangle_indices=triangles.astype(np.uint32),
                     vertex_normals=normals.astype(np.float32), albedo_factor=colour)


def _pose(place: int, frame: Frame) -> rr.Transform3D:
    return rr.Transform3D(translation=frame.rigid_positions[place],
                          quaternion=frame.rigid_quaternions[place])


def _points(positions: Sequence | np.ndarray, labels: Sequence[str] | None = None) -> rr.Points3D:
    return rr.Points3D.from_fields(positions=np.asarray(positions, dtype=np.float32), labels=labels)


def _named_points(field: str, names: Sequence[str] | None, frame: Frame) -> rr.Points3D:
    """Points of a frame; with names, only those that are finite, each with its name."""
    positions = getattr(frame, field)
    if names is None:
        return _points(positions)
    seen = np.isfinite(positions).all(axis=1)
    return _points(positions[seen], [name for name, shown in zip(names, seen) if shown])


def _arrows(origins: np.ndarray, vectors: np.ndarray, **fields: object) -> rr.Arrows3D:
    return rr.Arrows3D.from_fields(origins=np.asarray(origins, dtype=np.float32),
                                   vectors=np.asarray(vectors, dtype=np.float32), **fields)


def _axes(field: str, length: float, colours: tuple, frame: Frame) -> rr.Arrows3D:
    """Axes x red, y green, z blue; those of a target at the effector where it has no position."""
    places, turns = np.asarray(frame.effector_positions, dtype=float), getattr(frame, field)
    if field == "target_orientations":
        places = np.where(np.isfinite(frame.targets), frame.targets, places)
    known = np.isfinite(turns).all(axis=1) & np.isfinite(places).all(axis=1)
    axes = [Rotation.from_quat(turn).as_matrix().T for turn in turns[known]]
    return _arrows(np.repeat(places[known], 3, axis=0),
                   length * np.concatenate([np.empty((0, 3)), *axes]), colors=colours * len(axes))


def _trail(path: RecentPath, frame: Frame) -> rr.LineStrips3D | None:
    if not np.isfinite(frame.effector_positions).all():
        return None
    return rr.LineStrips3D.from_fields(strips=path.extend(frame.time_ns, frame.effector_positions))


STATUS = "/status"
TIME_PLOT = "/plots/stage_times"
RESIDUAL_PLOT = "/plots/residual"

_ERRORS = ("to the target", "of linearizing, estimated", "of the mesh, estimated")
_WHOLE_STEP = "whole step"
# Okabe and Ito's colours without black; colour-blind people can distinguish them.
_CURVE_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (240, 228, 66),
                  (204, 121, 167), (213, 94, 0), (0, 114, 178), (200, 200, 200))


class _Plot(NamedTuple):
    """Curves that share a plot.

    Attributes:
        title: Title with the unit.
        path: Its entity path.
        names: Names of its curves; a plot without any is not shown.
        values: Values of its curves in a frame.
        share: Its height beside that of the other plots.
    """

    title: str
    path: str
    names: Sequence[str]
    values: Callable[[Frame], Sequence[float] | np.ndarray]
    share: float = 1.0


def _plots(stage: Stage) -> list[_Plot]:
    """All plots of a robot but that of times, whose curves are known only during the run."""
    cables, cavities = stage.cable_names, [cavity.name for cavity in stage.cavities]
    others = stage.other_actuators
    in_metres = np.array([one.setpoint_unit == "m" for one in others], bool)
    factors = np.where(in_metres, 1e3, 1.0)
    other_names = [f"{one.name} [{unit}]" for one, metres in zip(others, in_metres, strict=True)
                   for unit in ("mm" if metres else one.setpoint_unit, one.effort_unit)]
    contact_names = ("count", "largest force [N]") if stage.shows_contact else ()
    listed = (
        _Plot("Effector error [mm]", "/plots/effector_error", _ERRORS,
              lambda frame: [1e3 * error for error in (
                  frame.effector_error, frame.linearization_error, frame.discretization_error)]),
        _Plot("Cable lengths [mm]", "/plots/cable_lengths", cables,
              lambda frame: 1e3 * np.asarray(frame.cable_lengths)),
        _Plot("Cable tensions [N]", "/plots/cable_tensions", cables,
              lambda frame: frame.cable_tensions),
        _Plot("Cavity gauge pressures [kPa]", "/plots/cavity_pressures",
              [f"{name} [kPa]" for name in cavities],
              lambda frame: 1e-3 * np.asarray(frame.cavity_pressures)),
        _Plot("Cavity volumes [cm³]", "/plots/cavity_volumes",
              [f"{name} [cm³]" for name in cavities],
              lambda frame: 1e6 * np.asarray(frame.cavity_volumes)),
        _Plot("Actuators", "/plots/actuators", other_names, lambda frame: np.column_stack(
            [factors * frame.other_setpoints, frame.other_efforts]).ravel()),
        _Plot("Contacts", "/plots/contacts", contact_names, lambda frame: [
            len(frame.contact_positions),
            np.linalg.norm(frame.contact_forces, axis=1).max(initial=0.0)]),
        _Plot("Residual [N]", RESIDUAL_PLOT, ["residual"], lambda frame: [frame.residual], 0.8),
    )
    return [plot for plot in listed if plot.names]


class Picture:
    """Draws the frames of one stage into one recording.

    Args:
        recording: Recording to draw into; frames are logged from one thread.
        stage: The constant part of the view; it is logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording = recording
        self._stage = stage
        self._time_names: list[str] = []
        self._status: str | None = None
        self._entities, self._plots = list(_entities(stage)), _plots(stage)
        for entity in self._entities:
            recording.log(entity.path, entity.fixed, static=True)
        for plot in self._plots:
            self._name_curves(plot.path, plot.names)

    def _name_curves(self, path: str, names: Sequence[str]) -> None:
        """Names the curves of a plot, in colours that repeat."""
        self._recording.name_series(path, names, list(islice(cycle(_CURVE_COLOURS), len(names))))

    def log(self, frame: Frame) -> None:
        """Draws one frame.

        Raises:
            ViewError: The frame does not fit the stage.
        """
        frame.check_against(self._stage)
        recording = self._recording
        recording.set_time(frame.step, frame.time_ns)
        for entity in self._entities:
            present = entity.present and entity.present(frame)
            if present is not None:
                recording.log(entity.path, present)
        for plot in self._plots:
            recording.log_series(plot.path, plot.values(frame))
        times = {_WHOLE_STEP: frame.compute_time, **frame.stage_times}
        new_names = [name for name in times if name not in self._time_names]
        if new_names:
            self._time_names += new_names
            self._name_curves(TIME_PLOT, self._time_names)
        recording.log_series(TIME_PLOT,
                             [1e3 * times.get(name, np.nan) for name in self._time_names])
        if frame.status != self._status:
            recording.log(STATUS, rr.TextLog(frame.status))
            self._status = frame.status

    def close(self, timeout: float) -> None:
        """Finishes the recording within a timeout [s]."""
        self._recording.close(timeout)


# How much of the past the curves show [s].
_PLOTTED_PAST = 20.0


def layout(stage: Stage) -> rrb.Blueprint:
    """The layout of the viewer for one robot: a view of space, and plots of what it has.

    The name of the view of space states the colours of pressures.

    Args:
        stage: The robot.
    """
    name = stage.name
    if stage.cavities:
        name = f"{name}; cavities: {pressure_legend(stage.pressure_range)}"
    space = rrb.Spatial3DView(origin="/", name=name,
                              contents=["/robot/**", "/targets/**", "/target_axes/**", "/markers/**",
                                        "/rigid_bodies/**", "/obstacles/**", "/contacts/**"])
    status = rrb.TextLogView(origin=STATUS, name="Status")
    *plots, last = _plots(stage)
    shown = [*plots, _Plot("Times [ms]", TIME_PLOT, (), lambda _: (), 1.2), last]
    curves = rrb.Vertical(
        *(rrb.TimeSeriesView(
            origin=plot.path, name=plot.title, time_ranges=past_range(_PLOTTED_PAST),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.path != RESIDUAL_PLOT))
          for plot in shown),
        row_shares=[plot.share for plot in shown])
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(space, status, row_shares=[6.0, 1.0]), curves,
                       column_shares=[3.0, 2.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel())
