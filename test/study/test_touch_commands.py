"""Touches in a table of commands."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.study.offline_run import run_file
from softrobot_twin.tables.input_tables import TableFileError, read_commands
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import at_rest
from test.run_files import rows_of

LENGTHS = ",".join(f"{name}_shortening_m" for name in "abcd")


@pytest.fixture(scope="module")
def built(column):
    mapping = yaml.safe_load(column.read_text())
    mapping["body"]["mesh"]["file"] = str(column.parent / "column.vtk")
    mapping["touches"] = [{"name": "finger", "points": [[0.01, 0.01, 0.10]]}]
    mapping["solver"] = {"newton_iterations": 10, "residual_tolerance": 1e-8}
    return Simulation(scene_from_mapping(mapping))


simulation = at_rest("built")


def table(tmp_path, columns, *rows) -> Path:
    lines = [f"time_s,{LENGTHS},{columns}", *(f"{row[0]},0,0,0,0,{row[1]}" for row in rows)]
    path = tmp_path / "commands.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def run(simulation, path) -> list:
    return list(run_commands(simulation, read_commands(path, simulation), 10.0))


def test_a_force_is_interpolated_and_answered_with_a_displacement(simulation, tmp_path):
    rows = run(simulation, table(tmp_path, "finger_force_y_N", (0.0, 0), (1.0, 0.02)))
    forces = np.array([row.result.touches.forces[0] for row in rows])
    assert forces[:, 1] == pytest.approx(np.linspace(0.002, 0.02, 10))
    assert not forces[:, [0, 2]].any()
    moved = [row.result.touches.displacements[0, 1] for row in rows]
    assert (np.diff(moved) > 0.0).all()


def test_a_displacement_counts_from_where_the_touch_begins(simulation, tmp_path):
    path = table(tmp_path, "finger_displacement_x_m,finger_displacement_z_m",
                 (0.0, "0,0"), (0.5, "0,0"), (1.0, "0.002,0"))  # fmt: skip
    rows = run(simulation, path)
    assert not any(row.result.touches.is_touched[0] for row in rows[:5])
    moved = rows[-1].result.touches.displacements[0]
    assert moved == pytest.approx([0.002, 0.0, 0.0], abs=1e-6)
    assert rows[-1].result.touches.forces[0, 0] > 1e-4


def test_the_output_has_force_and_displacement(simulation, tmp_path):
    path = table(tmp_path, "finger_force_y_N", (0.0, 0), (1.0, 0.02))
    with run_file(tmp_path / "out.csv", RunColumns(simulation)) as write:
        for row in run_commands(simulation, read_commands(path, simulation), 10.0):
            write(row)
    last = rows_of(tmp_path / "out.csv")[-1]
    assert float(last["finger_force_y_N"]) == 0.02
    assert float(last["finger_displacement_y_m"]) > 1e-4


@pytest.mark.parametrize("columns, cells, reason", [
    ("finger_force_y_N,finger_displacement_y_m", "0,0", "by forces or by displacements"),
    ("thumb_force_y_N", "0", "is not a valid column.*<touch>_force_x_N"),
])  # fmt: skip
def test_columns_that_cannot_be_used_are_refused(simulation, tmp_path, columns, cells, reason):
    path = table(tmp_path, columns, (0.0, cells), (1.0, cells))
    with pytest.raises(TableFileError, match=reason):
        read_commands(path, simulation)
