"""The commands file: valid columns, interpolation between rows, and errors."""

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Simulation
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.tables.input_tables import TableFileError, read_commands
from test.builder import builder
from test.scene_changes import entries_of


@pytest.fixture(scope="module")
def robot(column):
    """The column with a motor on two cables, a guided box and a free ball."""
    content = entries_of(column, {"integration": "dynamic"})
    content["rigid_bodies"] = [
        {"name": "gantry", "motion": "guided", "position": [0.5, 0.0, 0.0],
         "box": {"size": [0.1, 0.1, 0.1]}},
        {"name": "ball", "mass": 0.1, "position": [0.0, 0.5, 0.0], "sphere": {"radius": 0.01}}]
    content["motors"] = [{"name": "winch", "cables": ["a", "b"]}]
    return Simulation(scene_from_mapping(content, column))


@builder
def read(tmp_path, robot, /, text):
    path = tmp_path / "commands.csv"
    path.write_text(text)
    return read_commands(path, robot)


REST = "c_shortening_m,d_shortening_m"


def test_a_motor_shortens_its_cables_by_the_same_length(read, robot):
    table = read(f"time_s,winch_shortening_m,{REST}\n0,0,0,0.001\n2,0.004,0.002,0.001\n")
    command = table.command(1.0, 0.01)
    assert isinstance(command, CommandSetpoints) and command.time_step == 0.01
    np.testing.assert_allclose(robot.rest_setpoints - command.setpoints,
                               [0.002, 0.002, 0.001, 0.001], atol=1e-15)


def test_lengths_and_shortenings_may_stand_side_by_side(read, robot):
    table = read(f"time_s,a_length_m,b_shortening_m,{REST}\n0,0.1,0.003,0,0\n1,0.1,0.003,0,0\n")
    lengths = table.command(0.5, 0.01).setpoints
    assert lengths[0] == 0.1
    assert lengths[1] == pytest.approx(robot.rest_setpoints[1] - 0.003, abs=1e-15)


def test_tensions_are_interpolated_between_rows(read):
    names = ",".join(f"{name}_tension_N" for name in "abcd")
    table = read(f"time_s,{names}\n0,0,0,0,0\n1,1,2,3,4\n3,1,2,3,0\n")
    command = table.command(2.0, 0.01)
    assert isinstance(command, CommandEfforts)
    np.testing.assert_allclose(command.efforts, [1.0, 2.0, 3.0, 2.0])
    np.testing.assert_allclose(table.command(0.25, 0.01).efforts, [0.25, 0.5, 0.75, 1.0])


@pytest.mark.parametrize("quantity", ["shortening_m", "tension_N"])
def test_actuators_without_a_column_hold_their_setpoints(read, robot, quantity):
    start = robot.state
    table = read(f"time_s,c_{quantity}\n0,0\n0.1,0.002\n0.3,0.002\n")
    for row in run_commands(robot, table, 50.0):
        np.testing.assert_array_equal(row.result.setpoints[[0, 1, 3]], start.setpoints[[0, 1, 3]])
    value = start.setpoints[2] - 0.002 - row.result.setpoints[2], row.result.efforts[2] - 0.002
    assert value[quantity == "tension_N"] == pytest.approx(0.0, abs=1e-6)
    robot.restore(start)


def test_a_guided_body_moves_straight_and_rotates_about_one_axis(read):
    half = float(np.sqrt(0.5))
    text = (f"time_s,winch_shortening_m,{REST},gantry_x_m,gantry_y_m,gantry_z_m,gantry_qx,"
            "gantry_qy,gantry_qz,gantry_qw\n0,0,0,0,0.5,0,0,0,0,0,1\n"
            f"1,0,0,0,0.7,0,0.2,0,0,{half!r},{half!r}\n")
    table = read(text)
    position, quaternion = table.poses["gantry"].at(0.5)
    np.testing.assert_allclose(position, [0.6, 0.0, 0.1])
    np.testing.assert_allclose(quaternion, [0, 0, np.sin(np.pi / 8), np.cos(np.pi / 8)], atol=1e-12)


def test_the_longest_hold_is_the_longest_time_without_a_change(read):
    table = read(f"time_s,winch_shortening_m,{REST}\n0,0,0,0\n1,0,0,0\n2,0.01,0,0\n4,0.01,0,0\n"
                 "7,0.01,0,0\n8,0,0,0\n")
    assert table.longest_hold == (2.0, 7.0)
    moving = read(f"time_s,winch_shortening_m,{REST}\n0,0,0,0\n1,0.01,0,0\n")
    assert np.isnan(moving.longest_hold).all()


def test_a_scene_without_cables_holds(tmp_path, column):
    path = tmp_path / "commands.csv"
    path.write_text("time_s,press_x_m,press_y_m,press_z_m\n0,0,0,0\n1,0,0,1\n")
    bare = Simulation(scene_from_mapping({
        "name": "bare", "integration": "dynamic",
        "rigid_bodies": [
            {"name": "press", "motion": "guided", "box": {"size": [0.1, 0.1, 0.1]}},
            {"name": "ball", "mass": 0.1, "sphere": {"radius": 0.01}}]}, column))
    table = read_commands(path, bare)
    assert table.command(0.5, 0.02) == Hold(0.02)


@pytest.mark.parametrize(("text", "words"), [
    (f"t,winch_shortening_m,{REST}\n0,0,0,0\n1,0,0,0\n", "time_s: the header lacks"),
    (f"time_s,winch_shortening_m,{REST},nose_x_m\n0,0,0,0,0\n1,0,0,0,0\n", "nose_x_m"),
    (f"time_s,winch_length_m,{REST}\n0,0,0,0\n1,0,0,0\n", "use winch_shortening_m"),
    (f"time_s,winch_shortening_m,a_shortening_m,{REST}\n0,0,0,0,0\n1,0,0,0,0\n", "drives a, as"),
    ("time_s,winch_shortening_m,c_shortening_m,d_tension_N\n0,0,0,0\n1,0,0,0\n",
     "cannot be combined with"),
    ("time_s,a_tension_N,b_tension_N,c_tension_N,d_tension_N\n0,0,0,0,0\n1,0,0,-1,0\n",
     "row 3: c_tension_N = -1.0 N: must not be negative"),
    (f"time_s,winch_shortening_m,{REST}\n0,0,0,0\n0,0,0,0\n", "must be later than 0.0 s"),
    (f"time_s,winch_shortening_m,{REST}\n0,0,0,0\n", "has one row"),
    (f"time_s,winch_shortening_m,{REST}\n0,0,0,0\n1,inf,0,0\n", "row 3: winch_shortening_m"),
    (f"time_s,winch_shortening_m,{REST}\n0,0,0,0\n1,0,0\n", "has 3 cells"),
    (f"time_s,winch_shortening_m,winch_shortening_m,{REST}\n0,0,0,0,0\n1,0,0,0,0\n", "twice"),
    (f"time_s,winch_shortening_m,{REST},gantry_x_m,gantry_y_m\n0,0,0,0,0,0\n1,0,0,0,0,0\n",
     "gantry_z_m: the header lacks"),
    (f"time_s,winch_shortening_m,{REST},ball_x_m,ball_y_m,ball_z_m\n0,0,0,0,0,0,0\n"
     "1,0,0,0,0,0,0\n", "ball is a free body"),
    (f"time_s,winch_shortening_m,{REST},gantry_x_m,gantry_y_m,gantry_z_m,gantry_qx,gantry_qy,"
     "gantry_qz,gantry_qw\n0,0,0,0,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,0,0,0,2\n", "unit length"),
])
def test_an_invalid_commands_file_is_refused_by_name(read, text, words):
    with pytest.raises(TableFileError) as caught:
        read(text)
    assert words in str(caught.value) and "commands.csv" in str(caught.value)
    assert "\n" not in str(caught.value)
