"""Targets files: valid content, and errors with file, row, column and value."""

import numpy as np
import pytest

from softrobot_twin.simulation.cable_actuator import CableActuator
from softrobot_twin.simulation.command import CommandEfforts, CommandSetpoints, FollowTargets
from softrobot_twin.simulation.input_tables import (
    SINGLE_ROW_TIME_STEP,
    TableFileError,
    read_targets,
)

EFFECTORS = ("tip", "side")
ACTUATORS = dict.fromkeys(("north", "south"), CableActuator())


def read(tmp_path, text):
    path = tmp_path / "targets.csv"
    path.write_text(text, encoding="utf-8")
    return read_targets(path, EFFECTORS, ACTUATORS)


def refusal(tmp_path, text) -> TableFileError:
    with pytest.raises(TableFileError) as caught:
        read(tmp_path, text)
    assert "targets.csv" in str(caught.value)
    assert "\n" not in str(caught.value)
    return caught.value


def test_targets_are_sorted_into_the_order_of_the_simulation(tmp_path):
    table = read(tmp_path, "side.z,t,tip.x,tip.y,tip.z,side.x,side.y\n"
                           "6,0,1,2,3,4,5\n")
    assert table.kind == "targets"
    np.testing.assert_array_equal(table.values, [[[1, 2, 3], [4, 5, 6]]])
    assert isinstance(table.command(0), FollowTargets)


def test_an_effector_not_in_the_file_is_free(tmp_path):
    table = read(tmp_path, "t,side.x,side.y,side.z\n0,1,2,3\n")
    assert np.isnan(table.values[0, 0]).all()
    np.testing.assert_array_equal(table.values[0, 1], [1, 2, 3])


@pytest.mark.parametrize(("quantity", "command"),
                         [("length", CommandSetpoints), ("tension", CommandEfforts)])
def test_direct_runs_drive_every_actuator(tmp_path, quantity, command):
    table = read(tmp_path, f"t,south.{quantity},north.{quantity}\n0,2,1\n0.5,4,3\n")
    assert isinstance(table.command(1), command)
    np.testing.assert_array_equal(table.values, [[1, 2], [3, 4]])


def test_a_time_step_is_the_distance_to_the_row_before(tmp_path):
    table = read(tmp_path, "t,tip.x,tip.y,tip.z\n1,0,0,0\n1.5,0,0,0\n3.5,0,0,0\n")
    np.testing.assert_array_equal(table.time_steps, [0.5, 0.5, 2.0])
    assert table.command(2).time_step == 2.0


def test_a_single_row_has_the_stated_time_step(tmp_path):
    table = read(tmp_path, "t,tip.x,tip.y,tip.z\n7,0,0,0\n")
    np.testing.assert_array_equal(table.time_steps, [SINGLE_ROW_TIME_STEP])


def test_a_byte_order_mark_spaces_and_blank_lines_are_ignored(tmp_path):
    table = read(tmp_path, "\ufefft, tip.x ,tip.y,tip.z\n\n0, 1,2,3\n,,,\n\n")
    np.testing.assert_array_equal(table.values[0, 0], [1, 2, 3])


@pytest.mark.parametrize(("text", "row", "column", "words"), [
    ("", None, "", "is empty"),
    ("t,tip.x,tip.y,tip.z\n", None, "", "no row"),
    ("t\n0\n", 1, "", "nothing to drive"),
    ("tip.x,tip.y,tip.z\n0,0,0\n", 1, "t", "lacks this column"),
    ("t,tip.x,tip.y\n0,0,0\n", 1, "tip.z", "lacks this column"),
    ("t,north.length\n0,0.1\n", 1, "south.length", "every actuator"),
    ("t,tip.x,tip.x,tip.y,tip.z\n0,0,0,0,0\n", 1, "tip.x", "twice"),
    ("t,tip.q\n0,0\n", 1, "tip.q", "not a valid column"),
    ("t,tip\n0,0\n", 1, "tip", "not a valid column"),
    ("t,nose.x,nose.y,nose.z\n0,0,0,0\n", 1, "nose.x", "no effector 'nose'; its effectors: tip"),
    ("t,north.length,up.length\n0,1,1\n", 1, "up.length", "no actuator 'up'"),
    ("t,tip.x,tip.y,tip.z,north.length\n0,0,0,0,1\n", 1, "north.length", "only one of these"),
    ("t,north.length,south.tension\n0,1,1\n", 1, "south.tension", "only one of these"),
    ("t,tip.x,tip.y,tip.z\n0,0,0\n", 2, "", "3 cells"),
    ("t,tip.x,tip.y,tip.z\n0,0,left,0\n", 2, "tip.y", "a number"),
    ("t,tip.x,tip.y,tip.z\n0,0,0,\n", 2, "tip.z", "a number"),
    ("t,tip.x,tip.y,tip.z\n0,0,nan,0\n", 2, "tip.y", "finite"),
    ("t,tip.x,tip.y,tip.z\ninf,0,0,0\n", 2, "t", "finite"),
    ("t,tip.x,tip.y,tip.z\n\n0,0,0,0\n0,0,0,0\n", 4, "t", "later than 0.0 s"),
    ("t,tip.x,tip.y,tip.z\n0,0,0,0\n1,0,0,0\n0.5,0,0,0\n", 4, "t", "later than 1.0 s"),
    ("t,north.tension,south.tension\n0,1,-2\n", 2, "south.tension", "cannot push"),
])
def test_an_invalid_targets_file_is_refused_with_row_and_column(tmp_path, text, row, column, words):
    error = refusal(tmp_path, text)
    assert (error.row, error.column) == (row, column)
    assert words in str(error)


def test_a_refused_value_is_reported_with_its_unit(tmp_path):
    error = refusal(tmp_path, "t,north.tension,south.tension\n0,1,-2\n")
    assert (error.value, error.unit) == (-2.0, "N")
    assert "-2.0 N" in str(error)


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(TableFileError, match="No such file"):
        read_targets(tmp_path / "none.csv", EFFECTORS, ACTUATORS)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(TableFileError, match="cannot be read"):
        read_targets(binary, EFFECTORS, ACTUATORS)


@pytest.mark.parametrize("mark, name", [(";", "';'"), ("\t", r"'\\t'")])
def test_cells_with_another_separator_are_refused_naming_the_separator(tmp_path, mark, name):
    path = tmp_path / "targets.csv"
    path.write_text("t,tip.x,tip.y,tip.z\n0,0,0,0\n".replace(",", mark))
    with pytest.raises(TableFileError, match=f"separated by commas, not by {name}"):
        read_targets(path, ["tip"], {})


def read_posed(tmp_path, text, oriented=(True, False)):
    path = tmp_path / "targets.csv"
    path.write_text(text, encoding="utf-8")
    return read_targets(path, EFFECTORS, ACTUATORS, oriented)


POSED = "t,tip.x,tip.y,tip.z,tip.qx,tip.qy,tip.qz,tip.qw"


def test_a_targets_file_may_give_orientations(tmp_path):
    table = read_posed(tmp_path, f"{POSED}\n0,1,2,3,0,0,0,1\n1,1,2,3,0,1.005,0,0\n")
    np.testing.assert_array_equal(table.values[:, 0], [[1, 2, 3]] * 2)
    np.testing.assert_allclose(table.orientations[:, 0], [[0, 0, 0, 1], [0, 1, 0, 0]])
    assert np.isnan(table.values[:, 1]).all() and np.isnan(table.orientations[:, 1]).all()
    command = table.command(1)
    np.testing.assert_allclose(command.orientations[0], [0, 1, 0, 0])


def test_a_targets_file_without_quaternions_gives_no_orientation(tmp_path):
    table = read_posed(tmp_path, "t,tip.x,tip.y,tip.z\n0,1,2,3\n")
    assert table.orientations is None and table.command(0).orientations is None


@pytest.mark.parametrize(
    ("text", "oriented", "reason"),
    [
        (f"{POSED}\n0,1,2,3,0,0,0,1\n", (False, True), "no orientation in the scene"),
        (f"{POSED}\n0,1,2,3,0,0,0,1\n", (), "no orientation in the scene"),
        (f"{POSED}\n0,1,2,3,0,0,0,2\n", (True, False), "not of unit length"),
        (f"{POSED}\n0,1,2,3,0,0,0,0\n", (True, False), "not of unit length"),
        ("t,tip.x,tip.y,tip.z,tip.qx\n0,1,2,3,0\n", (True, False), "lacks this column"),
        ("t,tip.qx,tip.qy,tip.qz,tip.qw\n0,0,0,0,1\n", (True, False), "lacks this column"),
    ],
)
def test_wrong_orientations_of_a_targets_file_are_refused(tmp_path, text, oriented, reason):
    with pytest.raises(TableFileError, match=reason):
        read_posed(tmp_path, text, oriented)


def read_stiff(tmp_path, text, stiff=(True, False)):
    path = tmp_path / "targets.csv"
    path.write_text(text, encoding="utf-8")
    return read_targets(path, EFFECTORS, ACTUATORS, (), stiff)


def test_a_targets_file_may_give_stiffnesses_along_some_axes(tmp_path):
    table = read_stiff(tmp_path, "t,tip.x,tip.y,tip.z,tip.kz\n0,1,2,3,300\n1,1,2,3,350\n")
    np.testing.assert_array_equal(table.stiffness[:, 0], [[np.nan, np.nan, 300.0],
                                                          [np.nan, np.nan, 350.0]])
    assert np.isnan(table.stiffness[:, 1]).all() and table.orientations is None
    np.testing.assert_array_equal(table.command(1).stiffness, table.stiffness[1])
    plain = read_stiff(tmp_path, "t,tip.x,tip.y,tip.z\n0,1,2,3\n")
    assert plain.stiffness is None and plain.command(0).stiffness is None


@pytest.mark.parametrize(
    ("text", "stiff", "reason"),
    [
        ("t,tip.x,tip.y,tip.z,tip.kz\n0,1,2,3,300\n", (False, True), "no stiffness in the scene"),
        ("t,tip.x,tip.y,tip.z,tip.kz\n0,1,2,3,0\n", (True, False), "tip.kz.*0.*N/m.*positive"),
        ("t,tip.x,tip.y,tip.z,tip.kz\n0,1,2,3,-5\n", (True, False), "tip.kz.*-5.*N/m.*positive"),
        ("t,tip.x,tip.y,tip.z,tip.kz\n0,1,2,3,nan\n", (True, False), "tip.kz"),
        ("t,tip.kz\n0,300\n", (True, False), "lacks this column"),
    ],
)
def test_wrong_stiffnesses_of_a_targets_file_are_refused(tmp_path, text, stiff, reason):
    with pytest.raises(TableFileError, match=reason):
        read_stiff(tmp_path, text, stiff)
