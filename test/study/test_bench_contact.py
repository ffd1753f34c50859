"""``bench`` with contact: held commands, and the paper's robots."""

import math

import numpy as np
import pytest

from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.runs.input_tables import read_commands
from softrobot_twin.study import bench
from softrobot_twin.study.bench import draw_bench
from softrobot_twin.study.bench_measurement import (
    WHOLE_STEP,
    BenchCase,
    NoHoldError,
    Paper,
    given_cases,
    held_commands,
    measure,
    robot_cases,
)


@pytest.fixture(scope="module")
def held(stamp):
    case = given_cases([stamp], stamp.parent / "stamping.csv")[0]
    return measure(case._replace(paper=Paper(1000, 1.0)), 5)


def test_a_hold_is_timed_in_contact(held):
    assert held.contact_count > 4  # the cube's corners on the floor, and the pad on the cube
    assert held.row_count >= 3 * held.contact_count
    assert math.isnan(held.beside)  # no targets lead
    assert {"detect", "optimise", WHOLE_STEP} <= set(held.stages)
    assert held.statuses["ok"] == 5


def test_a_verdict_on_the_paper_states_both_sizes(held):
    words = bench.compare_with_paper(held)
    assert words.startswith("required 250.0 ms: met")
    assert f"{held.dof_count} dof here, 1000 there" in words
    slow = bench.compare_with_paper(
        type(held)(**{**held.__dict__, "case": held.case._replace(paper=Paper(1000, 1e-7))}))
    assert "not met" in slow


def test_the_timed_hold_lies_inside_the_longest_hold(stamp):
    simulation = Simulation.from_scene_file(stamp)
    held_commands(simulation, stamp.parent / "stamping.csv")
    assert 0.2 < simulation.state.time < 0.5
    press = simulation.model.guides.pose("press", simulation.state.positions)[0]
    np.testing.assert_allclose(press, [0.0, 0.0, -0.003], atol=1e-12)


def test_a_file_without_a_hold_is_refused(tmp_path, stamp):
    path = tmp_path / "moving.csv"
    path.write_text("time_s,press_x_m,press_y_m,press_z_m\n0,0,0,0\n1,0,0,0.1\n")
    with pytest.raises(NoHoldError, match="no command"):
        held_commands(Simulation.from_scene_file(stamp), path)


def test_the_robots_of_the_package_hold_and_have_the_papers_figures():
    cases = {case.name: case for case in robot_cases() if case.commands is not None}
    assert cases.keys() == {"grasper", "octoleg"}
    assert cases["grasper"].paper == Paper(1422, 5.0e-3)
    assert cases["octoleg"].paper == Paper(360, 1.7e-3)
    for case in cases.values():
        table = read_commands(case.commands, Simulation(case.scene))
        begin, end = table.longest_hold
        assert end > begin
    given = given_cases([cases["grasper"].scene.path])[0]
    assert isinstance(given, BenchCase) and given.commands == cases["grasper"].commands


def test_a_picture_holds_sizes_with_and_without_contact(tmp_path, held, column):
    pytest.importorskip("matplotlib")
    plain = measure(given_cases([column])[0], 2)
    assert "detect" not in plain.stages
    draw_bench(tmp_path / "bench.png", [plain, held], "here")
    assert (tmp_path / "bench.png").read_bytes().startswith(b"\x89PNG")
    table = bench.stage_table([plain, held])
    assert list(table.columns[1].cells)[list(table.columns[0].cells).index("detect")] == "-"
