"""``plot``: how columns are grouped, what the picture shows, and what is refused."""

import csv

import numpy as np
import pytest

from softrobot_twin.harness.figure import load_pyplot
from softrobot_twin.study.run_plot import draw_run, panels_of, plot, read_series
from softrobot_twin.tables.input_tables import TableFileError

TIMES = np.linspace(0.0, 1.0, 21)


def written(path, columns):
    """Writes a file with these columns."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def robot(cables=4):
    """Columns of a run of a robot with an effector, a rigid body, cables and a cavity."""
    columns = {"step": range(len(TIMES)), "time_s": TIMES}
    columns |= {f"tip_{axis}_m": 0.01 * TIMES for axis in "xyz"}
    columns |= {f"tip_target_{axis}_m": 0.011 * TIMES for axis in "xyz"}
    columns |= {"tip_error_m": 1e-3 * TIMES}
    for index in range(cables):
        columns |= {f"cable_{index}_length_m": 0.1 - index * 1e-3 * TIMES,
                    f"cable_{index}_tension_N": index * TIMES,
                    f"cable_{index}_shortening_m": index * 1e-3 * TIMES,
                    f"cable_{index}_rest_length_m": 0.1 + 0.0 * TIMES}
    columns |= {"air_pressure_Pa": 1e3 * TIMES, "air_growth_m3": 1e-6 * TIMES,
                "air_volume_m3": 1e-5 + 1e-6 * TIMES}
    columns |= {f"palm_{part}": TIMES for part in ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")}
    columns |= {"contact_count": 21 * [1], "force_on_tip_by_wall_x_N": TIMES,
                "sum_of_magnitudes_tip_wall_N": TIMES, "residual_N": 21 * [0.0],
                "linearization_error_m": 21 * [np.nan], "compute_time_s": 21 * [0.002],
                "active_limits": 10 * ["cable_1.rate"] + 11 * ["cable_1.rate cable_2.tension_max"],
                "driven_by": 21 * ["targets"], "status": 10 * ["ok"] + 11 * ["saturated"]}
    return columns


def drawn(series, globs=(), bands=("status", "active_limits")):
    pyplot = load_pyplot()
    figure = pyplot.figure(layout="constrained")
    draw_run(series, panels_of(series, globs), bands, figure)
    figure.canvas.draw()
    return figure


def test_columns_of_one_quantity_share_a_panel_with_its_unit(tmp_path):
    panels = {panel.title: panel for panel in panels_of(read_series(
        written(tmp_path / "run.csv", robot())))}
    assert list(panels) == ["position", "body position", "error", "shortening", "growth",
                            "pressure", "tension"]
    assert [line.label for line in panels["tension"].lines] == [f"cable_{k}" for k in range(4)]
    assert (panels["shortening"].unit, panels["shortening"].factor) == ("mm", 1e3)
    assert [(line.label, line.target) for line in panels["position"].lines] == [
        (f"tip {axis}", f"tip_target_{axis}_m") for axis in "xyz"]


def test_named_columns_are_drawn_and_no_others(tmp_path):
    series = read_series(written(tmp_path / "run.csv", robot()))
    panels = panels_of(series, ["cable_[12]_length_m", "*_tension_N"])
    assert {panel.title: len(panel.lines) for panel in panels} == {"tension": 4, "length": 2}
    (quaternion,) = panels_of(series, ["palm_q*"])
    assert [line.label for line in quaternion.lines] == [f"palm q{axis}" for axis in "xyzw"]
    with pytest.raises(TableFileError, match="no column matches 'nose_.'; columns: tip_x_m"):
        panels_of(series, ["tip_*", "nose_*"])


@pytest.mark.libraries
def test_tables_of_commands_and_samples_of_a_workspace_are_drawn(tmp_path):
    commands = written(tmp_path / "commands.csv", {
        "time_s": [0, 1, 2], "a_shortening_m": [0, 1e-3, 0], "a_length_m": [1, 2, 3]})
    assert [panel.title for panel in panels_of(read_series(commands))] == ["shortening"]
    samples = written(tmp_path / "workspace.csv", {
        "sample": [0, 1], "tip_x_m": [0, 1], "tip_stiffness_1_N_per_m": [5, "nan"],
        "tip_compliance_xx_m_per_N": [0.2, "nan"], "a_tension_N": [0, 1], "residual_N": [0, 0],
        "active_limits": ["", ""], "status": ["ok", "lost"]})
    series = read_series(samples)
    assert series.over == "sample"
    assert [panel.title for panel in panels_of(series)] == [
        "position", "stiffness", "tension", "residual"]
    drawn(series)


@pytest.mark.parametrize(("text", "words"), [
    ("level,error\n1,2\n", "is nothing that a run writes or reads"),
    ("", "is empty"), ("time_s,tip_x_m\n", "no row"),
    ("time_s,tip_x_m\n0,left\n", "row 2: tip_x_m = 'left' m: must be a number"),
    ("time_s,tip_x_m\n0\n", "has 1 cells"), ("time_s\n0\n", "no column with a number to draw"),
    ("time_s,tip_x_m\nnan,1\n", "row 2: time_s = 'nan' s: must be finite"),
])
def test_a_file_of_another_kind_is_refused_by_name(tmp_path, text, words):
    (tmp_path / "run.csv").write_text(text)
    with pytest.raises(TableFileError, match=words):
        plot(tmp_path / "run.csv")
    assert not (tmp_path / "run_plot.png").exists()
