"""What a run wrote is read again: as targets, as commands, and by those who plot it."""

import numpy as np
import pytest
import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.command import CommandEfforts, Hold
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.study.offline_run import run_file
from softrobot_twin.tables.column_names import UNITS, unit_of
from softrobot_twin.tables.input_tables import TableFileError, read_commands, read_targets
from softrobot_twin.tables.run_columns import COMPUTE_TIME, TEXT_COLUMNS, RunColumns
from test.run_files import TARGETS, rows_of
from test.scene_changes import entries_of

NAMES = "abcd"


def numbers_of(path):
    """Cells of the file as numbers, without those that depend on the clock."""
    return np.array([[float(cell) for name, cell in row.items()
                      if name not in (COMPUTE_TIME, *TEXT_COLUMNS)] for row in rows_of(path)])


@pytest.fixture(scope="module")
def robot(column):
    """The column with a touch, a guided palm and a free ball."""
    content = yaml.safe_load(column.read_text())
    content["body"]["mesh"]["file"] = str(column.parent / "column.vtk")
    content["integration"] = "dynamic"
    content["touches"] = [{"name": "finger", "points": [[0.01, 0.01, 0.10]]}]
    content["rigid_bodies"] = [
        {"name": "tip", "motion": "guided", "position": [0.5, 0.0, 0.0],
         "box": {"size": [0.1, 0.1, 0.1]}},
        {"name": "ball", "mass": 0.1, "position": [0.0, 0.5, 0.0], "sphere": {"radius": 0.01}}]
    return Simulation(scene_from_mapping(content))


def test_a_run_by_targets_is_reproduced_by_its_own_file(tmp_path, column, call):
    (tmp_path / "targets.csv").write_text(TARGETS)
    first, again, directly = (tmp_path / f"{name}.csv" for name in ("first", "again", "directly"))
    for given, made in ((tmp_path / "targets.csv", first), (first, again)):
        done = call("simulate", column, "--targets", given, "--output", made)
        assert "warning" not in done.errors, done.errors
    assert rows_of(first)[0].keys() == rows_of(again)[0].keys()
    np.testing.assert_array_equal(numbers_of(first), numbers_of(again))
    assert [row["driven_by"] for row in rows_of(first)] == ["targets"] * 3
    # The lengths alone lead to the same places, but for the error of one linearization.
    call("simulate", column, "--commands", first, "--rate", 50, "--output", directly)
    told = [[[float(row[name]) for name in ("time_s", *(f"{n}_length_m" for n in NAMES))]
             for row in rows_of(path)] for path in (first, directly)]
    np.testing.assert_allclose(told[1], told[0], atol=1e-9)
    assert {row["driven_by"] for row in rows_of(directly)} == {"setpoints"}
    assert not any("target" in name for name in rows_of(directly)[0])


def driven(simulation, path, table, rate=10.0) -> None:
    """Runs a table of commands from rest, and writes the file of the run."""
    simulation.reset()
    commanded = read_commands(table, simulation)
    with run_file(path, RunColumns(simulation)) as write:
        for row in run_commands(simulation, commanded, rate):
            write(row)


@pytest.mark.parametrize("driver", ["shortening_m", "tension_N"])
def test_a_run_by_commands_is_reproduced_by_its_own_file(tmp_path, robot, driver):
    table = {"time_s": [0.0, 0.2, 0.4], **{f"{name}_{driver}": [0.0, value, 0.0] for name, value in
                                           zip(NAMES, (2e-3, 1e-3, 1.5e-3, 0.5e-3))}}
    table |= {"tip_x_m": [0.5, 0.51, 0.51], "tip_y_m": [0, 0, 0], "tip_z_m": [0, 0, 0.01],
              "finger_force_y_N": [0.0, 0.01, 0.0]}
    driven(robot, tmp_path / "first.csv", table)
    driven(robot, tmp_path / "again.csv", tmp_path / "first.csv")
    first, again = (np.array([[float(one[name]) for name in one if name.endswith(("_m", "_N"))
                               and name not in ("residual_N", "linearization_error_m")]
                              for one in rows_of(tmp_path / name)])
                    for name in ("first.csv", "again.csv"))
    np.testing.assert_allclose(again, first, rtol=1e-6, atol=1e-9)
    last = rows_of(tmp_path / "first.csv")[1]
    assert float(last["tip_body_x_m"]) == pytest.approx(0.51), "the effector has this name"
    assert float(last["finger_force_y_N"]) == pytest.approx(0.01)
    assert last["driven_by"] == ("setpoints" if driver == "shortening_m" else "efforts")
    command = read_commands(tmp_path / "first.csv", robot).command(0.2, 0.1)
    assert isinstance(command, CommandEfforts) == (driver == "tension_N")


def test_a_run_without_commands_is_given_back_as_one_that_holds(tmp_path, robot):
    robot.reset()
    columns = RunColumns(robot)
    with run_file(tmp_path / "held.csv", columns) as write:
        for step in range(2):
            write(columns.row(step, 0.1 * (step + 1), robot.step(Hold(0.1))))
    table = read_targets(tmp_path / "held.csv", robot)
    np.testing.assert_array_equal(table.values, np.tile(robot.rest_setpoints, (2, 1)))


def test_all_columns_of_a_run_have_different_names_and_known_units(robot):
    names = RunColumns(robot, observed=("elastic_energy_J",)).names
    assert len(set(names)) == len(names)
    plain = {"step", "iterations", *TEXT_COLUMNS}
    quaternions = {name for name in names if name[-3:] in ("_qx", "_qy", "_qz", "_qw")}
    for name in set(names) - plain - quaternions:
        assert unit_of(name) in UNITS, name
    assert not {"contact_count", "sampled_range"} & set(names), "no contact, no reduced body"


def test_one_row_of_a_run_is_too_few_for_commands(tmp_path, robot):
    robot.reset()
    columns = RunColumns(robot)
    with run_file(tmp_path / "one.csv", columns) as write:
        write(columns.row(0, 0.1, robot.step(Hold(0.1))))
    with pytest.raises(TableFileError, match="has one row"):
        read_commands(tmp_path / "one.csv", robot)


def test_active_limits_of_a_step_are_named_in_its_row(tmp_path, column, call):
    content = entries_of(column, {"body.mesh.file": str(column.parent / "column.vtk")})
    for cable in content["cables"]:
        cable["tension"] = [0.0, 0.05]
    (tmp_path / "weak.yaml").write_text(yaml.safe_dump(content))
    (tmp_path / "targets.csv").write_text(TARGETS)
    done = call("simulate", tmp_path / "weak.yaml", "--targets", tmp_path / "targets.csv",
                "--output", tmp_path / "run.csv")
    named = {name for row in rows_of(tmp_path / "run.csv") for name in row["active_limits"].split()}
    assert {f"{name}.tension_max" for name in NAMES} & named
    assert "limits met most" in done.output and ".tension_max 100 %" in done.output
