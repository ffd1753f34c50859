"""``simulate`` as a command: its files and its errors."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.record.rest_poses import poses_of_table
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study.offline_run import commands_of, unlikely_warning
from softrobot_twin.tables.input_tables import read_targets
from test.builder import builder
from test.run_files import TARGETS, rows_of

REACHED = (0.011, 0.0095, 0.097)


@builder
def targets(tmp_path, /, text=TARGETS):
    path = tmp_path / "targets.csv"
    path.write_text(text)
    return path


def tip_of(row):
    return np.array([float(row[f"tip_{axis}_m"]) for axis in "xyz"])


@pytest.mark.exhaustive
def test_a_run_has_the_stated_columns_and_a_row_for_each_target(tmp_path, column, targets, command):
    done = command("simulate", column, "--targets", targets(), "--output", tmp_path / "run.csv")
    assert done.code == 0, done.errors
    assert (tmp_path / "run.csv").read_text().splitlines()[0] == (
        "step,time_s,tip_x_m,tip_y_m,tip_z_m,tip_target_x_m,tip_target_y_m,tip_target_z_m,"
        "tip_error_m,"
        + "".join(f"{name}_length_m,{name}_tension_N,{name}_shortening_m,{name}_rest_length_m,"
                  f"{name}_path_m,"
                  for name in "abcd")
        + "residual_N,linearization_error_m,iterations,compute_time_s,active_limits,driven_by,"
        "status")
    rows = rows_of(tmp_path / "run.csv")
    assert [row["step"] for row in rows] == ["0", "1", "2"]
    assert [row["time_s"] for row in rows] == ["0.0", "0.02", "0.04"]
    assert {row["status"] for row in rows} <= {"ok", "linearized"}
    np.testing.assert_allclose(tip_of(rows[-1]), REACHED, atol=1e-4)
    assert "━" not in done.errors and "warning" not in done.errors, "no bar through a pipe"


def test_settling_runs_the_first_row_before_recording(tmp_path, column, targets, call):
    call("simulate", column, "--targets", targets(), "--output", tmp_path / "once.csv")
    repeated = TARGETS.replace("0,0.0105", "-0.04,0.0105,0.01,0.098\n-0.02,0.0105,0.01,0.098\n"
                               "0,0.0105", 1)
    call("simulate", column, "--targets", targets(repeated), "--output", tmp_path / "repeated.csv")
    call("simulate", column, "--targets", targets(), "--settle", 2, "--output", tmp_path / "settled.csv")
    settled, once = rows_of(tmp_path / "settled.csv"), rows_of(tmp_path / "once.csv")
    assert len(settled) == 3
    assert settled[0]["tip_x_m"] != once[0]["tip_x_m"]
    for row, longer in zip(settled, rows_of(tmp_path / "repeated.csv")[2:], strict=True):
        np.testing.assert_array_equal(tip_of(row), tip_of(longer))


def test_targets_in_another_frame_are_followed_in_that_of_the_scene(tmp_path, column, targets, call):
    _, rows = TARGETS.split("\n", 1)
    for text, axes in ((TARGETS, "x,y,z"), (f"time_s,tip_y_m,tip_z_m,tip_x_m\n{rows}", "y,z,x")):
        call("simulate", column, "--targets", targets(text), "--output", tmp_path / f"{axes}.csv", "--axes", axes)
    own, turned = (rows_of(tmp_path / f"{axes}.csv") for axes in ("x,y,z", "y,z,x"))
    assert [tip_of(row).tolist() for row in own] == [tip_of(row).tolist() for row in turned]


def test_lengths_and_their_tensions_lead_to_the_same_state(tmp_path, column, targets, call):
    simulation = Simulation.from_scene_file(column)
    names = simulation.actuator_names
    wound = simulation.rest_setpoints - np.array([0.006, 0.003, 0.002, 0.004])
    by_length = targets(",".join(["time_s", *(f"{name}_length_m" for name in names)]) + "\n"
                        + ",".join(["0", *map(repr, map(float, wound))]) + "\n")
    done = call("simulate", column, "--targets", by_length, "--settle", 30, "--output",
                   tmp_path / "by_length.csv")
    (reached,) = rows_of(tmp_path / "by_length.csv")
    assert all(float(reached[f"{name}_tension_N"]) > 0.01 for name in names)
    np.testing.assert_allclose([float(reached[f"{name}_length_m"]) for name in names], wound, atol=1e-9)
    by_tension = targets(",".join(["time_s", *(f"{name}_tension_N" for name in names)]) + "\n"
                         + ",".join(["0", *(reached[f"{name}_tension_N"] for name in names)]) + "\n")
    call("simulate", column, "--targets", by_tension, "--settle", 30, "--output",
            tmp_path / "by_tension.csv")
    (again,) = rows_of(tmp_path / "by_tension.csv")
    np.testing.assert_allclose(tip_of(again), tip_of(reached), atol=1e-6)
    np.testing.assert_allclose([float(again[f"{name}_length_m"]) for name in names], wound, atol=1e-6)
    moved = np.linalg.norm(tip_of(reached) - simulation.effector_positions()[0])
    assert moved > 1e-3, "the cables must move the tip for this to say anything"


@pytest.mark.parametrize("text, scene, output, words", [
    *((text, None, "run.csv", ("targets.csv", told)) for text, told in (
        ("time_s,nose_x_m,nose_y_m,nose_z_m\n0,0,0,0\n", "no effector 'nose'"),
        ("time_s,north_length_m\n0,0.1\n", "no actuator 'north'"),
        ("time_s,tip_x_m,tip_y_m,tip_z_m\n0,0,nan,0\n",
         "row 2: tip_y_m = 'nan' m: must be finite"))),
    (TARGETS, "none.yaml", "run.csv", ("none.yaml",)),
    (TARGETS, None, "file/run.csv", ("cannot be written",)),
])  # fmt: skip
def test_an_invalid_run_gives_one_line_and_exit_code_two(
    tmp_path, column, targets, call, text, scene, output, words
):
    (tmp_path / "file").write_text("")
    scene = column if scene is None else tmp_path / scene
    done = call("simulate", scene, "--targets", targets(text), "--output", tmp_path / output, code=2)
    assert len(done.errors.splitlines()) == 1
    assert all(one in done.errors for one in words)
    assert not (tmp_path / output).exists()


def test_a_picture_of_the_last_state_is_drawn(tmp_path, column, targets, call):
    pytest.importorskip("matplotlib")
    call("simulate", column, "--targets", targets(), "--output", tmp_path / "run.csv",
            "--picture", tmp_path / "column.png")
    assert (tmp_path / "column.png").read_bytes().startswith(b"\x89PNG")


def test_targets_in_millimetres_are_warned_of(column, targets):
    simulation = Simulation.from_scene_file(column)
    likely = commands_of(read_targets(targets(), simulation))
    assert unlikely_warning(simulation, likely) is None
    slipped = targets("time_s,tip_x_m,tip_y_m,tip_z_m\n0,10.5,10,98\n")
    unlikely = commands_of(read_targets(slipped, simulation))
    assert "in metres?" in unlikely_warning(simulation, unlikely)


@pytest.mark.exhaustive
def test_a_run_of_a_reduced_body_ends_with_its_errors(tmp_path, half_trained, call):
    def run(*rows):
        path = tmp_path / "targets.csv"
        path.write_text("\n".join(["time_s,tip_x_m,tip_y_m,tip_z_m", *rows]) + "\n")
        done = call("simulate", half_trained, "--targets", path, "--output", tmp_path / "run.csv")
        return " ".join(done.output.split()), " ".join(done.errors.split())

    output, errors = run("0,0.001,0,0.126", "0.2,0.002,0,0.126", "0.4,0.003,0.001,0.126")
    assert "body: at the last pose the reduced model is" in output
    assert "mm from the full one" in output and "by its spare modes" in output
    assert "range of the training" not in errors and "reduction error, max" in output
    for row in rows_of(tmp_path / "run.csv"):
        assert 0.0 < float(row["sampled_range"]) < 1.0
        assert 0.0 <= float(row["body_reduction_error_m"]) < 1e-3
    far = [f"{0.2 * k},{0.03 * k / 10},0,{0.132 - 0.012 * k / 10}" for k in range(11)]
    assert "the run left the range of the training" in run(*far)[1]


EMIO = Path(__file__).resolve().parents[2] / "config" / "scenes" / "emio.yaml"
LARGE = """time_s,servo_1_angle_rad,servo_2_angle_rad,servo_3_angle_rad,servo_4_angle_rad\n0,0,0,0,0
1,0.6,0.6,-0.3,0.2
2,-0.6,0.9,0.9,0.2
3,{last},0.2,0.9,0.2
"""


@pytest.mark.parametrize("last, code, status, way", [
    (0.3, 0, "ok", ["--targets"]), (2.6, 3, "saturated", ["--rate", 1, "--commands"])])
def test_large_moves_of_a_row_come_into_balance_and_a_limit_that_stops_the_last_one_is_an_exit_code(
    tmp_path, call, last, code, status, way
):
    commands, run = tmp_path / "commands.csv", tmp_path / "run.csv"
    commands.write_text(LARGE.format(last=last))
    done = call("simulate", EMIO, *way, commands, "--output", run, code=code)
    assert "repeated" in done.output
    rows = rows_of(run)[-3:]
    assert [row["status"] for row in rows] == ["ok", "ok", status]
    assert max(float(row["residual_N"]) for row in rows) < 1e-4
    # The row stands where small moves lead, and its markers are what a calibration reads.
    simulation = Simulation.from_scene_file(EMIO)
    for share in np.linspace(0.05, 1.0, 20):
        simulation.step(CommandSetpoints(share * np.array([0.6, 0.6, -0.3, 0.2]), 1.0))
    np.testing.assert_allclose(tip_of(rows[0]), simulation.effector_positions()[0], atol=1e-6)
    table = {name: [float(row[name]) for row in rows] for name in rows[0] if name.endswith(("_rad", "_m")) and name[:5] in ("servo", "marke")}
    poses, _ = poses_of_table({k: v for k, v in table.items() if "servo_1_" not in k or "angle" in k}, simulation)
    np.testing.assert_allclose(poses[0].markers, simulation.marker_positions(), atol=1e-6)
