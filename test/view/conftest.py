"""A small robot to show, and a reader of recordings."""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
from softrobot_twin.view import Drawn, Entity, Frame, Plot, Stage
from softrobot_twin.view.colours import tension_colours

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
        return {step: [value for curve in apart for value in curve.get(step, [])] for step in apart[0]}

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
    markers, tip, white = ("4", "7", "9"), ("tip",), (255, 255, 255)
    return Stage("tetrahedron", "tetrahedron", (
        Entity("/robot/surface/body", "surface", white, triangles=triangles),
        Entity("/robot/cables", "lines", size=2.5, labels=("left", "right"),
               colours_of=partial(tension_colours, tension_range=(0.0, 20.0))),
        Entity("/robot/effectors", "points", white, labels=tip),
        Entity("/robot/effector_trail", "trail", white),
        Entity("/targets", "points", white, labels=tip, may_miss=True),
        Entity("/markers/predicted", "points", white, labels=markers),
        Entity("/markers/measured", "points", white, labels=markers, may_miss=True),
    ), (Plot("Cable lengths [mm]", "/plots/cable_lengths", ("left", "right")),
        Plot("Residual [N]", "/plots/residual", ("residual",))))  # fmt: skip


@pytest.fixture
def make_frame():
    """Makes a frame of the stage, different at each step; entities and fields may be replaced."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])

    def make(step: int, drawn=(), **changes) -> Frame:
        shift = 0.001 * step
        tip = corners[3:] + [shift, 0.0, 0.0]
        paths = (np.array([[0, 0, 0.1], [0, 0, 0.2]]) + [shift, 0, 0],
                 np.array([[0.1, 0, 0], [0.1, 0, 0.1], [0.1, 0, 0.2]]))
        fields = dict(
            step=step, time_ns=1_800_000_000_000_000_000 + step * 5_000_000,
            drawn={
                "/robot/surface/body": Drawn(corners + corners[:, 2:] * [10.0 * shift, 0.0, 0.0]),
                "/robot/cables": Drawn(paths, values=np.array([0.0, 20.0])),
                "/robot/effectors": Drawn(tip), "/robot/effector_trail": Drawn(tip),
                "/targets": Drawn(tip + [0.0, 0.002, 0.0]),
                "/markers/predicted": Drawn(corners[1:] + [0.0, 0.0, shift]),
                "/markers/measured": Drawn(corners[1:] + [0.0, 0.001, shift]), **dict(drawn)},
            curves={"/plots/cable_lengths": [100.0 + step, 200.0], "/plots/residual": [1e-6]},
            times={"whole step": 0.003, "assembly": 0.001, "factor": 0.0015}, status="ok")
        return Frame(**{**fields, **changes})

    return make


@pytest.fixture
def draw(stage, tmp_path, read_recording):
    """Draws frames into a file, one by one, and reads it back."""
    from softrobot_twin.view import picture, recording

    def draw(frames, stage=stage):
        path = tmp_path / "drawn.rrd"
        drawn = picture.Picture(recording.record_to(path, "test", picture.layout(stage)), stage)
        for frame in frames:
            drawn.log(frame)
        drawn.close(10.0)
        return read_recording(path)

    return draw


@pytest.fixture
def oriented_rod():
    """Makes a beam, held at its start, with an effector at its tip that asks for an orientation."""

    def make(orientation) -> Simulation:
        return Simulation(scene_from_mapping({
            "name": "rod", "gravity": [0, 0, 0],
            "beams": [{
                "name": "rod", "elements": 2, "fixed": "start", "points": [[0, 0, 0], [0, 0, 0.2]],
                "section": {"circle": {"radius": 0.002}},
                "material": {"young_modulus": 35e6, "poisson_ratio": 0.45, "density": 1220},
            }],
            "effectors": [{"name": "tip", "body": "rod", "points": [[0, 0, 0.2]],
                           "orientation": orientation}],
        }))  # fmt: skip

    return make
