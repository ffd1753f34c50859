"""Angles of pulleys in commands files and in the files of runs."""

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.tables.input_tables import TableFileError, read_commands
from softrobot_twin.tables.run_columns import actuator_cells, actuator_columns
from test.scene_changes import entries_of

RADIUS = 0.01


@pytest.fixture(scope="module")
def wound(column):
    """The column with a pulley of its cable a, and one of the motor of c and d."""
    content = entries_of(column, {"cables.0.pulley": {"radius": RADIUS}})
    pulley = {"radius": 2 * RADIUS, "winds": "negative"}
    content["motors"] = [{"name": "winch", "cables": ["c", "d"], "pulley": pulley}]
    return Simulation(scene_from_mapping(content, column))


def read(tmp_path, simulation, text):
    path = tmp_path / "commands.csv"
    path.write_text(text)
    return read_commands(path, simulation)


def test_commanded_angles_are_shortenings(tmp_path, wound):
    table = read(tmp_path, wound,
                 "time_s,a_angle_rad,b_shortening_m,winch_angle_rad\n0,0,0,0\n1,0.2,0,-0.1\n")
    command = table.command(0.5, 0.01)
    assert isinstance(command, CommandSetpoints)
    np.testing.assert_allclose(wound.rest_setpoints - command.setpoints,
                               [0.001, 0.0, 0.001, 0.001], atol=1e-15)


@pytest.mark.parametrize("header, words", [
    ("nobody_angle_rad", r"_angle_rad \(pulleys: a, winch\)"),
    ("a_angle_rad,a_shortening_m,b_shortening_m,winch_angle_rad", "a_angle_rad.*twice"),
    ("a_angle_rad,b_angle_rad,winch_angle_rad", "b_angle_rad"),
    ("a_angle_rad,a_length_m,b_shortening_m,winch_angle_rad", "drives a"),
])  # fmt: skip
def test_angles_that_are_not_there_or_given_twice_are_named(tmp_path, wound, header, words):
    zeros = ",0" * header.count(",")
    with pytest.raises(TableFileError, match=words):
        read(tmp_path, wound, f"time_s,{header}\n0,0{zeros}\n1,0{zeros}\n")


def test_a_run_writes_angle_and_torque_of_each_pulley(wound):
    lengths = wound.rest_setpoints - [0.002, 0.0, 0.001, 0.001]
    result = wound.step(CommandSetpoints(lengths, 10.0))
    columns, cells = actuator_columns(wound.actuators), actuator_cells(result, wound.actuators)
    assert len(columns) == len(cells)
    found = {(name, *quantity): cell for (name, quantity), cell in zip(columns, cells)}
    assert found["a", "angle", "rad"] == pytest.approx(0.2)
    assert found["a", "torque", "Nm"] == pytest.approx(RADIUS * result.efforts[0])
    assert found["winch", "angle", "rad"] == pytest.approx(-0.05)
    assert found["winch", "torque", "Nm"] == pytest.approx(-2 * RADIUS * result.efforts[2:].sum())
