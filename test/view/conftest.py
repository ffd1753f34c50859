"""A small robot to show, and a reader of recordings."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.view import Frame, Stage, Surface

# The names that rerun gave components before 0.24.
OLD_NAMES = {
    "ViewCoordinates:xyz": "ViewCoordinates",
    "Mesh3D:triangle_indices": "TriangleIndices",
    "Mesh3D:vertex_positions": "Position3D",
    "Mesh3D:vertex_normals": "Vector3D",
    "Mesh3D:albedo_factor": "AlbedoFactor",
    "LineStrips3D:strips": "LineStrip3D",
    "LineStrips3D:colors": "Color",
    "LineStrips3D:labels": "Text",
    "Arrows3D:vectors": "Vector3D",
    "Arrows3D:origins": "Position3D",
    "Transform3D:translation": "Translation3D",
    "Transform3D:quaternion": "RotationQuat",
    "Points3D:positions": "Position3D",
    "Points3D:labels": "Text",
    "Scalars:scalars": "Scalar",
    "SeriesLines:names": "Name",
    "TextLog:text": "Text",
}


class Recorded:
    """Content of a recording, read with the installed rerun.

    Args:
        path: An ``.rrd`` file.
    """

    def __init__(self, path: Path):
        try:
            from rerun.chunk import RrdReader
        except ImportError:
            self._cells = self._cells_of_old(path)
        else:
            with warnings.catch_warnings():
                # A stopped client writes no footer; its chunks are complete.
                warnings.simplefilter("ignore")
                chunks = RrdReader(path).stream().to_chunks()
            # Chunks have no fixed order; of static values the last logged one is valid.
            cells = [cell for chunk in chunks for cell in self._cells_of(chunk)]
            self._cells = [cell for _, *cell in sorted(cells, key=lambda cell: cell[0])]

    @staticmethod
    def _cells_of(chunk):
        batch = chunk.to_record_batch()
        rows = batch.column("rerun.controls.RowId").to_pylist()
        steps = [None] * len(rows) if chunk.is_static else batch.column("step").to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                for row, step, cell in zip(rows, steps, batch.column(name).to_pylist()):
                    yield row, chunk.entity_path, name, step, cell

    @staticmethod
    def _cells_of_old(path):
        import rerun
        recording = rerun.dataframe.load_recording(str(path))
        view = recording.view(index="step", contents="/**")
        static = {f"{column.entity_path}:{column.component_name.split('.')[-1]}"
                  for column in recording.schema().component_columns() if column.is_static}
        cells = []
        table = view.select().read_all()
        steps = table.column("step").to_pylist() if table.num_rows else []
        static_table = view.select_static().read_all()
        for rows, at, wanted in ((table, steps, False), (static_table, [None], True)):
            for name in rows.schema.names:
                if name.startswith("/") and (name in static) == wanted:
                    path, _, component = name.rpartition(":")
                    cells += [(path, component, step, cell)
                              for step, cell in zip(at, rows.column(name).to_pylist())]
        return cells

    @property
    def entities(self) -> set[str]:
        """Entity paths."""
        return {path for path, _, _, _ in self._cells}

    def at_steps(self, entity: str, component: str) -> dict[int, list]:
        """Values of a component at the steps it was logged at."""
        return {step: cell for step, cell in self._select(entity, component)
                if step is not None and cell is not None}

    def static(self, entity: str, component: str) -> list:
        """Value of a static component."""
        values = [cell for step, cell in self._select(entity, component)
                  if step is None and cell is not None]
        assert values, f"{entity} has no static {component}"
        return values[-1]

    def curves(self, plot: str) -> dict[int, list[float]]:
        """Values of all curves of a plot at each step."""
        together = self.at_steps(plot, "Scalars:scalars")
        if together:
            return together
        apart = [self.at_steps(path, "Scalars:scalars") for path in self._parts_of(plot)]
        return {step: [value for curve in apart for value in curve.get(step, [])]
                for step in apart[0]}

    def curve_names(self, plot: str) -> list[str]:
        """Names of the curves of a plot."""
        paths = [plot] if plot in self.entities else self._parts_of(plot)
        return [name for path in paths for name in self.static(path, "SeriesLines:names")]

    def _parts_of(self, plot: str) -> list[str]:
        return sorted(path for path in self.entities if path.startswith(f"{plot}/"))

    def _select(self, entity: str, component: str):
        names = {component, OLD_NAMES[component]}
        return [(step, cell) for path, name, step, cell in self._cells
                if path == entity and name in names]


@pytest.fixture
def read_recording():
    """Reads an ``.rrd`` file."""
    return Recorded


@pytest.fixture
def stage() -> Stage:
    """A tetrahedron with two cables, one effector and three markers."""
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    return Stage("tetrahedron", (Surface("body", triangles),), ("left", "right"), (0.0, 20.0), ("tip",),
                 np.array([4, 7, 9]))


@pytest.fixture
def make_frame():
    """Makes a frame of the stage, different at each step; fields may be replaced."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])

    def make(step: int, **changes) -> Frame:
        shift = 0.001 * step
        tip = corners[3:] + [shift, 0.0, 0.0]
        fields = dict(
            step=step, time_ns=1_800_000_000_000_000_000 + step * 5_000_000,
            surface_positions=(corners + corners[:, 2:] * [shift, 0.0, 0.0] * 10,),
            cable_paths=(np.array([[0, 0, 0.1], [0, 0, 0.2]]) + [shift, 0, 0],
                         np.array([[0.1, 0, 0], [0.1, 0, 0.1], [0.1, 0, 0.2]])),
            cable_lengths=np.array([0.1 + shift, 0.2]), cable_tensions=np.array([0.0, 20.0]),
            effector_positions=tip, targets=tip + [0.0, 0.002, 0.0],
            predicted_markers=corners[1:] + [0.0, 0.0, shift],
            measured_markers=corners[1:] + [0.0, 0.001, shift],
            effector_error=0.002, linearization_error=0.0005, discretization_error=0.003, stage_times={"assembly": 0.001, "factor": 0.0015},
            compute_time=0.003, status="ok", residual=1e-6)
        return Frame(**{**fields, **changes})

    return make
