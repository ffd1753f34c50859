"""Grips: what is held moves along, what is let go falls, and nothing is built for scenes without."""

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.mechanics.grips import Grips
from softrobot_twin.simulation import Hold
from softrobot_twin.study.direct_run import run_commands
from softrobot_twin.tables.input_tables import TableFileError, read_commands
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder

G, H = 9.81, 0.004
TIP = [[0.005, 0.005, 0.0], [0.015, 0.005, 0.0], [0.005, 0.015, 0.0]]
CUP = {"name": "cup", "points": TIP, "holds": "cube", "reach": 0.002}
TOP = {"box": {"minimum": [-1, -1, 0.0399], "maximum": [1, 1, 1]}}
CUBE = {"name": "cube", "mass": 0.02, "box": {"size": [0.02, 0.02, 0.02]},
        "position": [0.01, 0.01, -0.0105]}  # fmt: skip


@builder
def hanging(simulate, body_of, block, /, grips=(CUP,), cube=CUBE, integration="dynamic", **entries):
    """Makes a soft block that hangs from its top above a free cube, which a floor bears."""
    body = body_of(block(size=(0.02, 0.02, 0.04), cells=(2, 2, 3)), fixed=[TOP],
                   damping={"mass": 20.0, "stiffness": 0.01})  # fmt: skip
    return simulate(
        body=body, rigid_bodies=[cube], grips=list(grips), integration=integration,
        gravity=[0.0, 0.0, -G], **entries,
    )  # fmt: skip


def cube_place(robot):
    return robot.rigid_poses()[0][0]


def test_a_cube_that_is_held_hangs_and_one_that_is_let_go_falls(hanging):
    robot = hanging()
    robot.grip("cup", True)
    for _ in range(250):
        result = robot.step(Hold(H))
    memory = result.state.memory
    assert memory["grips.holds"].tolist() == [1.0]
    assert memory["grips.forces"][0] == pytest.approx([0.0, 0.0, -0.02 * G], abs=1e-4)
    assert cube_place(robot)[2] == pytest.approx(-0.0105, abs=1.5e-3)
    robot.grip("cup", False)
    start = cube_place(robot)[2]
    for count in range(1, 11):
        robot.step(Hold(H))
    assert start - cube_place(robot)[2] == pytest.approx(0.5 * G * H**2 * count * (count + 1), rel=1e-3)


def test_what_is_out_of_reach_is_not_held_and_told(hanging):
    robot = hanging(cube={**CUBE, "position": [0.01, 0.01, -0.02]})
    robot.grip("cup", True)
    result = robot.step(Hold(H))
    assert result.state.memory["grips.holds"].tolist() == [0.0]
    assert "cup.out_of_reach" in result.report.active_limits


def test_a_grip_lets_go_where_it_bears_too_much(hanging):
    robot = hanging([{**CUP, "force_limit": 0.05}])
    robot.grip("cup", True)
    told = [robot.step(Hold(H)) for _ in range(60)]
    holds = [result.state.memory["grips.holds"][0] for result in told]
    assert holds[0] == 1.0 and holds[-1] == 0.0
    assert any("cup.force_limit" in result.report.active_limits for result in told)


def test_a_saved_state_holds_what_it_held(hanging):
    robot = hanging()
    robot.grip("cup", True)
    robot.step(Hold(H))
    saved = robot.state
    ahead = [robot.step(Hold(H)).state for _ in range(3)][-1]
    robot.grip("cup", False)
    robot.step(Hold(H))
    robot.restore(saved)
    again = [robot.step(Hold(H)).state for _ in range(3)][-1]
    assert np.array_equal(ahead.positions, again.positions)
    robot.reset()
    assert robot.step(Hold(H)).state.memory["grips.holds"].tolist() == [0.0]


def test_a_file_and_python_tell_grips(hanging, tmp_path):
    robot = hanging()
    path = tmp_path / "commands.csv"
    path.write_text("time_s,cup_holds\n0,0\n0.008,1\n0.048,0\n0.068,0\n")
    table = read_commands(path, robot)
    columns = RunColumns(robot)
    rows = list(run_commands(robot, table, 250.0, columns))
    cells = [dict(zip(columns.names, columns.cells(row), strict=True)) for row in rows]
    assert [cell["cup_holds"] for cell in cells] == 2 * [0.0] + 10 * [1.0] + 5 * [0.0]
    scripted = st.Robot(robot.scene)
    assert scripted.step(grips={"cup": True}, time_step=H)["cup_holds"] == 1.0
    for grips, said in (({"cap": True}, "cap.*is cup meant"), ({"cup": "no"}, "cup: 'no' must be True")):
        with pytest.raises(CommandError, match=said):
            scripted.step(grips=grips)
    path.write_text("time_s,cup_holds\n0,0\n0.02,0.5\n")
    with pytest.raises(TableFileError, match="row 3: cup_holds = 0.5: must be 1 to hold or 0"):
        read_commands(path, robot)


def test_without_grips_no_term_is_built_and_wrong_ones_are_refused(hanging):
    robot = hanging(grips=())
    assert robot.model.force_term(Grips) is None
    with pytest.raises(CommandError, match="this scene has none"):
        robot.grip("cup", True)
    with pytest.raises(SceneError, match="is cube meant"):
        hanging([{**CUP, "holds": "cub"}])
    with pytest.raises(SceneError, match="a stiffness is needed"):
        hanging([{**CUP, "body": "cube", "holds": "world"}])
