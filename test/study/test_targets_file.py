"""Targets files: valid content, and errors with file, row, column and value."""

from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.simulation.building.cable_actuator import CableActuator
from softrobot_twin.simulation.building.limits import Pulleys
from softrobot_twin.simulation.command import CommandEfforts, CommandSetpoints, FollowTargets
from softrobot_twin.tables.input_tables import TableFileError, read_targets

EFFECTORS = ("tip", "side")
CABLES = ("north", "south")
REST = np.array([0.3, 0.4])


def robot(oriented=(False, False), stiff=(False, False)):
    """What the reader asks of a simulation with two effectors and two cables."""
    kinds = (CableActuator(),) * 2
    actuators = SimpleNamespace(
        names=CABLES, kinds=kinds, kind_of=dict(zip(CABLES, kinds)), count=2, rest_setpoints=REST,
        pulleys=Pulleys(None, CABLES, REST), takes_efforts=np.ones(2, bool),
        limits=SimpleNamespace(slopes=-np.ones(2)), efforts=lambda told: told)
    return SimpleNamespace(
        actuators=actuators, effector_names=EFFECTORS, oriented_effectors=oriented,
        stiff_effectors=stiff, touch_names=(), sensor_columns={}, grip_names=(), scene=SimpleNamespace(motors=(), rigid_bodies=()))


def read(tmp_path, text, simulation=None):
    path = tmp_path / "targets.csv"
    path.write_text(text, encoding="utf-8")
    return read_targets(path, simulation or robot())


def test_targets_are_sorted_into_the_order_of_the_simulation(tmp_path):
    table = read(tmp_path, "side_z_m,time_s,tip_x_m,tip_y_m,tip_z_m,side_x_m,side_y_m\n"
                           "6,0,1,2,3,4,5\n")
    assert table.kind == "targets"
    np.testing.assert_array_equal(table.values, [[[1, 2, 3], [4, 5, 6]]])
    assert isinstance(table.command(0), FollowTargets)


def test_an_effector_not_in_the_file_is_free(tmp_path):
    table = read(tmp_path, "time_s,side_x_m,side_y_m,side_z_m\n0,1,2,3\n")
    assert np.isnan(table.values[0, 0]).all()
    np.testing.assert_array_equal(table.values[0, 1], [1, 2, 3])


@pytest.mark.parametrize(("quantity", "command"),
                         [("length_m", CommandSetpoints), ("tension_N", CommandEfforts)])
def test_direct_runs_drive_every_actuator(tmp_path, quantity, command):
    table = read(tmp_path, f"time_s,south_{quantity},north_{quantity}\n0,2,1\n0.5,4,3\n")
    assert isinstance(table.command(1), command)
    np.testing.assert_array_equal(table.values, [[1, 2], [3, 4]])


def test_a_time_step_is_the_distance_to_the_row_before(tmp_path):
    table = read(tmp_path, "time_s,tip_x_m,tip_y_m,tip_z_m\n1,0,0,0\n1.5,0,0,0\n3.5,0,0,0\n")
    np.testing.assert_array_equal(table.time_steps, [0.5, 0.5, 2.0])
    assert table.command(2).time_step == 2.0


def test_a_byte_order_mark_spaces_and_blank_lines_are_ignored(tmp_path):
    table = read(tmp_path, "\ufefftime_s, tip_x_m ,tip_y_m,tip_z_m\n\n0, 1,2,3\n,,,\n\n")
    np.testing.assert_array_equal(table.values[0, 0], [1, 2, 3])


@pytest.mark.parametrize(("text", "row", "column", "words"), [
    ("", None, "", "is empty"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n", None, "", "no row"),
    ("time_s\n0\n", 1, "", "nothing to drive"),
    ("tip_x_m,tip_y_m,tip_z_m\n0,0,0\n", 1, "time_s", "lacks this column"),
    ("time_s,tip_x_m,tip_y_m\n0,0,0\n", 1, "tip_z_m", "lacks this column"),
    ("time_s,tip_x_m,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0,0\n", 1, "tip_x_m", "twice"),
    ("time_s,tip_q\n0,0\n", 1, "tip_q", "not a valid column"),
    ("time_s,tip\n0,0\n", 1, "tip", "not a valid column"),
    ("time_s,nose_x_m,nose_y_m,nose_z_m\n0,0,0,0\n", 1, "nose_x_m",
     "no effector 'nose'; its effectors: tip"),
    ("time_s,north_length_m,up_length_m\n0,1,1\n", 1, "up_length_m", "no actuator 'up'"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m,north_length_m\n0,0,0,0,1\n", 1, "north_length_m",
     "only one of these"),
    ("time_s,north_length_m,south_tension_N\n0,1,1\n", 1, "south_tension_N", "all in the same way"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0\n", 2, "", "3 cells"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,left,0\n", 2, "tip_y_m", "a number"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,\n", 2, "tip_z_m", "a number"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,nan,0\n", 2, "tip_y_m", "finite"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\ninf,0,0,0\n", 2, "time_s", "finite"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n\n0,0,0,0\n0,0,0,0\n", 4, "time_s", "later than 0.0 s"),
    ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0\n1,0,0,0\n0.5,0,0,0\n", 4, "time_s",
     "later than 1.0 s"),
    ("time_s,north_tension_N,south_tension_N\n0,1,-2\n", 2, "south_tension_N", "cannot push"),
    ("time_s,nose_x_m,nose_y_m,nose_z_m\n0,0,0,0\n", 1, "nose_x_m", "no effector 'nose'"),
    # What no run wrote has no results.
    ("time_s,tip_x_m,tip_y_m,tip_z_m,residual_N\n0,0,0,0,0\n", 1, "residual_N",
     "not a valid column; valid are time_s"),
    ("time_s,north_lenght_m,south_length_m\n0,1,1\n", 1, "north_lenght_m",
     "is north_length_m meant?"),
    ("time_s,tip_x_mm,tip_y_m,tip_z_m\n0,1,1,1\n", 1, "tip_x_m", "is tip_x_mm meant?"),
])
def test_an_invalid_targets_file_is_refused_with_row_and_column(tmp_path, text, row, column, words):
    with pytest.raises(TableFileError) as caught:
        read(tmp_path, text)
    error, told = caught.value, str(caught.value)
    assert (error.row, error.column) == (row, column)
    assert "targets.csv" in told and words in told and "\n" not in told
    if words.endswith("meant?"):
        assert told.endswith(words)
    if words == "cannot push":
        assert (error.value, error.unit) == (-2.0, "N") and "-2.0 N" in told


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(TableFileError, match="No such file"):
        read_targets(tmp_path / "none.csv", robot())
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(TableFileError, match="cannot be read"):
        read_targets(binary, robot())


@pytest.mark.parametrize("mark, name", [(";", "';'"), ("\t", r"'\\t'")])
def test_cells_with_another_separator_are_refused_naming_the_separator(tmp_path, mark, name):
    path = tmp_path / "targets.csv"
    path.write_text("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,0,0\n".replace(",", mark))
    with pytest.raises(TableFileError, match=f"separated by commas, not by {name}"):
        read_targets(path, robot())


POSED = "time_s,tip_x_m,tip_y_m,tip_z_m,tip_qx,tip_qy,tip_qz,tip_qw"


def test_a_targets_file_may_give_orientations(tmp_path):
    table = read(tmp_path, f"{POSED}\n0,1,2,3,0,0,0,1\n1,1,2,3,0,1.005,0,0\n", robot(oriented=(True, False)))
    np.testing.assert_array_equal(table.values[:, 0], [[1, 2, 3]] * 2)
    np.testing.assert_allclose(table.wanted["orientations"][:, 0], [[0, 0, 0, 1], [0, 1, 0, 0]])
    assert np.isnan(table.values[:, 1]).all() and np.isnan(table.wanted["orientations"][:, 1]).all()
    command = table.command(1)
    np.testing.assert_allclose(command.orientations[0], [0, 1, 0, 0])


STIFF = "time_s,tip_x_m,tip_y_m,tip_z_m,tip_kz_N_per_m"


def test_a_targets_file_may_give_stiffnesses_along_some_axes(tmp_path):
    stiff = robot(stiff=(True, False))
    table = read(tmp_path, f"{STIFF}\n0,1,2,3,300\n1,1,2,3,350\n", stiff)
    stiffness = table.wanted["stiffness"]
    np.testing.assert_array_equal(stiffness[:, 0], [[np.nan, np.nan, 300.0], [np.nan, np.nan, 350.0]])
    assert np.isnan(stiffness[:, 1]).all() and set(table.wanted) == {"stiffness"}
    np.testing.assert_array_equal(table.command(1).stiffness, stiffness[1])
    plain = read(tmp_path, "time_s,tip_x_m,tip_y_m,tip_z_m\n0,1,2,3\n", stiff)
    assert not plain.wanted and plain.command(0).stiffness is None


@pytest.mark.parametrize("text, simulation, reason", [
    *((text, robot(oriented=oriented), reason) for text, oriented, reason in (
        (f"{POSED}\n0,1,2,3,0,0,0,1\n", (False, True), "no orientation in the scene"),
        (f"{POSED}\n0,1,2,3,0,0,0,1\n", (), "no orientation in the scene"),
        (f"{POSED}\n0,1,2,3,0,0,0,2\n", (True, False), "not of unit length"),
        (f"{POSED}\n0,1,2,3,0,0,0,0\n", (True, False), "not of unit length"),
        ("time_s,tip_x_m,tip_y_m,tip_z_m,tip_qx\n0,1,2,3,0\n", (True, False),
         "lacks this column"),
        ("time_s,tip_qx,tip_qy,tip_qz,tip_qw\n0,0,0,0,1\n", (True, False), "lacks this column"))),
    *((text, robot(stiff=stiff), reason) for text, stiff, reason in (
        (f"{STIFF}\n0,1,2,3,300\n", (False, True), "no stiffness in the scene"),
        (f"{STIFF}\n0,1,2,3,0\n", (True, False), "tip_kz_N_per_m.*0.*N/m.*positive"),
        (f"{STIFF}\n0,1,2,3,-5\n", (True, False), "tip_kz_N_per_m.*-5.*N/m.*positive"),
        (f"{STIFF}\n0,1,2,3,nan\n", (True, False), "tip_kz_N_per_m"),
        ("time_s,tip_kz_N_per_m\n0,300\n", (True, False), "lacks this column"))),
])  # fmt: skip
def test_wrong_orientations_and_stiffnesses_are_refused(tmp_path, text, simulation, reason):
    with pytest.raises(TableFileError, match=reason):
        read(tmp_path, text, simulation)


def test_a_targets_file_may_give_shortenings(tmp_path):
    table = read(tmp_path, "time_s,north_shortening_m,south_length_m\n0,0.01,0.2\n")
    assert table.kind == "setpoints"
    np.testing.assert_allclose(table.values, [[REST[0] - 0.01, 0.2]], rtol=1e-15)


def test_a_table_of_arrays_is_read_as_a_file_is():
    table = read_targets({"time_s": np.arange(2.0), "side_x_m": [1, 1], "side_y_m": [2, 2],
                          "side_z_m": [3, 4]}, robot())
    np.testing.assert_array_equal(table.values[:, 1], [[1, 2, 3], [1, 2, 4]])
    with pytest.raises(TableFileError, match="table: side_x_m: has the shape"):
        read_targets({"time_s": np.arange(2.0), "side_x_m": [1]}, robot())
    with pytest.raises(TableFileError, match="table: has no rows"):
        read_targets({}, robot())


WRITTEN = ("step,time_s,tip_x_m,tip_y_m,tip_z_m{target},north_length_m,north_tension_N,"
           "south_length_m,south_tension_N,residual_N,driven_by,status\n"
           "0,0.1,9,9,9{given},0.1,1,0.2,2,nan,{by},ok\n")
TARGET = {"target": ",tip_target_x_m,tip_target_y_m,tip_target_z_m", "given": ",1,2,3"}
NONE = {"target": "", "given": ""}


@pytest.mark.parametrize(("by", "columns", "values"), [
    ("targets", TARGET, [[[1, 2, 3], [np.nan] * 3]]),
    ("setpoints", NONE, [[0.1, 0.2]]), ("hold", NONE, [[0.1, 0.2]]), ("efforts", NONE, [[1, 2]]),
])
def test_what_drove_a_run_is_read_from_what_it_wrote(tmp_path, by, columns, values):
    table = read(tmp_path, WRITTEN.format(by=by, **columns))
    assert table.kind == ("setpoints" if by == "hold" else by)
    np.testing.assert_array_equal(table.values, values)
