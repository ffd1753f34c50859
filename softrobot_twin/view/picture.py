"""Draws frames as rerun entities, and defines the layout of the viewer.

The file contains, in this order: surface normals, the effectors' recent path, the picture of a frame,
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

from softrobot_twin.view.frame import Drawn, Entity, Frame, Plot, Stage
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


_TIMES = Plot("Times [ms]", "/plots/stage_times", ())
_STATUS = "/status"
# Heights of plots beside that of the others.
_SHARES = {_TIMES.path: 1.2, "/plots/residual": 0.8}
# How long the trail of an effector is, and how much of the past the curves show [s].
_TRAIL_DURATION, _PLOTTED_PAST = 5.0, 20.0
# Okabe and Ito's colours without black; colour-blind people can distinguish them.
_CURVE_COLOURS = ((86, 180, 233), (230, 159, 0), (0, 158, 115), (240, 228, 66),
                  (204, 121, 167), (213, 94, 0), (0, 114, 178), (200, 200, 200))
_MARKS = {"points": rr.Points3D, "lines": rr.LineStrips3D, "trail": rr.LineStrips3D, "arrows": rr.Arrows3D}


def _fixed(entity: Entity) -> object:
    """What is logged of an entity once."""
    triangles, colour = entity.triangles, entity.colour
    if entity.shape == "surface":
        return rr.Mesh3D.from_fields(triangle_indices=np.asarray(triangles, dtype=np.uint32),
                                     albedo_factor=colour)
    if entity.shape == "solid":
        # With separate corners for each triangle, so that edges look sharp.
        corners = np.asarray(entity.points, dtype=float)[triangles].reshape(-1, 3)
        triangles = np.arange(len(corners)).reshape(-1, 3)
        return rr.Mesh3D.from_fields(
            vertex_positions=_float32(corners), triangle_indices=triangles.astype(np.uint32),
            vertex_normals=_float32(SurfaceNormals(triangles, len(corners)).at(corners)),
            albedo_factor=colour)
    fields: dict[str, object] = {"radii": [rr.Radius.ui_points(entity.size)]}
    if colour is not None:
        fields["colors"] = [colour]
    if entity.labels:
        fields["show_labels"] = entity.shape == "lines"
        if not entity.may_miss:
            fields["labels"] = entity.labels
    if entity.points is not None:
        fields["positions"] = _float32(entity.points)
    return _MARKS[entity.shape].from_fields(**fields)


def _float32(numbers) -> np.ndarray:
    return np.asarray(numbers, dtype=np.float32)


class Picture:
    """Draws the frames of one stage into one recording.

    Args:
        recording: Recording to draw into; frames are logged from one thread.
        stage: The constant part of the view; it is logged at once.
    """

    def __init__(self, recording: Recording, stage: Stage):
        self._recording, self._stage = recording, stage
        self._time_names: list[str] = []
        self._status: str | None = None
        self._normals: dict[str, SurfaceNormals] = {}
        self._trail = RecentPath(_TRAIL_DURATION)
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for entity in stage.entities:
            recording.log(entity.path, _fixed(entity), static=True)
        for plot in stage.plots:
            self._name_curves(plot.path, plot.names)

    def _name_curves(self, path: str, names: Sequence[str]) -> None:
        """Names the curves of a plot, in colours that repeat."""
        self._recording.name_series(path, names, list(islice(cycle(_CURVE_COLOURS), len(names))))

    def log(self, frame: Frame) -> None:
        """Draws one frame.

        Args:
            frame: The frame.
        """
        recording = self._recording
        recording.set_time(frame.step, frame.time_ns)
        for entity in self._stage.entities:
            if entity.path in frame.drawn:
                present = self._present(entity, frame.drawn[entity.path], frame.time_ns)
                if present is not None:
                    recording.log(entity.path, present)
        for plot in self._stage.plots:
            recording.log_series(plot.path, frame.curves[plot.path])
        new_names = [name for name in frame.times if name not in self._time_names]
        if new_names:
            self._time_names += new_names
            self._name_curves(_TIMES.path, self._time_names)
        recording.log_series(_TIMES.path,
                             [1e3 * frame.times.get(name, np.nan) for name in self._time_names])
        if frame.status != self._status:
            recording.log(_STATUS, rr.TextLog(frame.status))
            self._status = frame.status

    def _present(self, entity: Entity, drawn: Drawn, time_ns: int) -> object | None:
        """What is logged of an entity in a frame; None for nothing."""
        points, colours = drawn.points, None
        if entity.colours_of is not None and drawn.values is not None:
            colours = entity.colours_of(drawn.values)
        if entity.shape == "surface":
            if entity.path not in self._normals:
                self._normals[entity.path] = SurfaceNormals(entity.triangles, len(points))
            return rr.Mesh3D.from_fields(
                vertex_positions=_float32(points),
                vertex_normals=_float32(self._normals[entity.path].at(points)),
                albedo_factor=None if colours is None else tuple(map(int, colours[0])))
        if entity.shape == "solid":
            return rr.Transform3D(translation=points, quaternion=drawn.vectors)
        if entity.shape == "lines":
            return rr.LineStrips3D.from_fields(strips=points, colors=colours)
        if entity.shape == "arrows":
            return rr.Arrows3D.from_fields(origins=_float32(points), vectors=_float32(drawn.vectors),
                                           colors=colours)
        if entity.shape == "trail":
            if not np.isfinite(points).all():
                return None
            return rr.LineStrips3D.from_fields(strips=self._trail.extend(time_ns, points))
        if not entity.may_miss:
            return rr.Points3D.from_fields(positions=_float32(points))
        seen = np.isfinite(points).all(axis=1)
        return rr.Points3D.from_fields(
            positions=_float32(points)[seen],
            labels=[name for name, shown in zip(entity.labels, seen) if shown])

    def close(self, timeout: float) -> None:
        """Finishes the recording within a timeout [s].

        Args:
            timeout: Longest time that it may take [s].
        """
        self._recording.close(timeout)


def layout(stage: Stage) -> rrb.Blueprint:
    """The layout of the viewer for one robot: a view of space, and plots of what it has.

    Args:
        stage: The robot.
    """
    space = rrb.Spatial3DView(
        origin="/", name=stage.title,
        contents=sorted({f"/{entity.path.split('/')[1]}/**" for entity in stage.entities}))
    status = rrb.TextLogView(origin=_STATUS, name="Status")
    plots = (*stage.plots[:-1], _TIMES, *stage.plots[-1:])
    curves = rrb.Vertical(
        *(rrb.TimeSeriesView(
            origin=plot.path, name=plot.title, time_ranges=past_range(_PLOTTED_PAST),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.path != "/plots/residual"))
          for plot in plots),
        row_shares=[_SHARES.get(plot.path, 1.0) for plot in plots])
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Vertical(space, status, row_shares=[6.0, 1.0]), curves,
                       column_shares=[3.0, 2.0]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        time_panel())
