"""Tables of runs: the columns and bits of the files of the command line."""

import csv
import sys

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.study.direct_run import simulate_alone, simulate_commands
from softrobot_twin.study.offline_run import simulate
from test.scene_changes import yaml_file

pytestmark = pytest.mark.libraries

COMMANDS = ("time_s,upper_shortening_m,lower_shortening_m\n"
            "0,0,0\n0.05,0.002,0\n0.1,0.002,0.001\n")
TARGETS = "time_s,tip_x_m,tip_y_m,tip_z_m\n" + "".join(
    f"{0.02 * row:g},0.1,0.01,{0.01 + 0.0004 * row:g}\n" for row in range(5))


@pytest.fixture
def scene(entries, tmp_path):
    """The finger as a file."""
    return yaml_file(tmp_path / "finger.yaml", entries)


def columns_of(path) -> dict[str, list[str]]:
    """Columns of a run's file, as text."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def names_of(table) -> list[str]:
    """Names of the columns of a DataFrame or a structured array."""
    return list(table.dtype.names if isinstance(table, np.ndarray) else table)


def text(value) -> str:
    return value if isinstance(value, str) else repr(value)


def assert_same(table, path) -> None:
    """All columns of a table are those of a file, to the last bit; but the times they took."""
    written = columns_of(path)
    assert names_of(table) == list(written)
    for name, cells in written.items():
        if name != "compute_time_s":
            assert [text(one) for one in table[name].tolist()] == list(cells), name


@pytest.mark.parametrize("text, run, options, asked", [
    (TARGETS, simulate, (), {}), (COMMANDS, simulate_commands, (100.0,), {"rate": 100}),
], ids=["targets", "commands"])  # fmt: skip
def test_a_run_by_a_file_is_that_of_simulate_to_the_bit(finger, scene, tmp_path, text, run, options, asked):
    (tmp_path / "asked.csv").write_text(text)
    run(scene, tmp_path / "asked.csv", tmp_path / "run.csv", *options)
    assert_same(finger.run(tmp_path / "asked.csv", **asked), tmp_path / "run.csv")


def test_a_run_without_commands_is_that_of_simulate_to_the_bit(finger, scene, tmp_path):
    simulate_alone(scene, 0.03, tmp_path / "run.csv", 200.0)
    table = finger.run(seconds=0.03, rate=200)
    assert_same(table, tmp_path / "run.csv")
    assert "gravity_energy_J" in names_of(table) and len(table) == 6


def test_a_table_in_memory_is_a_file_of_the_same_columns(finger, tmp_path):
    (tmp_path / "commands.csv").write_text(COMMANDS)
    by_file = finger.run(tmp_path / "commands.csv", rate=100)
    header, *rows = csv.reader(COMMANDS.splitlines())
    table = {name: [float(row[place]) for row in rows] for place, name in enumerate(header)}
    finger.reset()
    assert by_file["tip_z_m"].tolist() == finger.run(table, rate=100)["tip_z_m"].tolist()
    finger.reset()
    pandas = pytest.importorskip("pandas")
    assert by_file["tip_z_m"].tolist() == finger.run(pandas.DataFrame(table), rate=100)["tip_z_m"].tolist()


def test_a_runs_table_given_back_repeats_the_run(finger):
    first = finger.run(st.targets(tip=[0.1, 0.01, 0.012]), steps=4)
    finger.reset()
    again = finger.run(first)
    # Time steps are differences of the table's times, with their rounding.
    assert again["tip_z_m"].tolist() == pytest.approx(first["tip_z_m"].tolist(), rel=1e-9)


def test_steps_one_by_one_are_the_rows_of_a_run(finger):
    table = finger.run(st.targets(tip=[0.1, 0.01, 0.012]), steps=3)
    finger.reset()
    for row in range(3):
        values = finger.step(st.targets(tip=[0.1, 0.01, 0.012])).values
        for name in set(values) - {"time_s", "compute_time_s"}:
            assert table[name].tolist()[row] == values[name], name
    assert table["time_s"].tolist() == pytest.approx([0.02, 0.04, 0.06])


def test_a_list_of_commands_has_a_step_for_each(finger):
    table = finger.run([st.setpoints(upper_shortening_m=0.001 * row) for row in range(1, 4)])
    assert table["upper_shortening_m"].tolist() == pytest.approx([0.001, 0.002, 0.003])
    assert set(table["driven_by"]) == {"setpoints"}


def test_a_list_may_mix_kinds_of_commands(finger):
    table = finger.run([st.targets(tip=[0.1, 0.01, 0.012]), st.hold(), st.efforts(upper_tension_N=0.5)])
    assert list(table["driven_by"]) == ["targets", "hold", "efforts"]
    assert "tip_target_x_m" not in names_of(table)


def test_a_list_with_a_wrong_command_moves_nothing(finger):
    before = finger.state
    with pytest.raises(st.SoftRobotTwinError, match="is tip meant"):
        finger.run([st.hold(), st.targets(tpi=[0, 0, 0])])
    assert finger.state is before


def test_seconds_and_rate_give_the_number_of_steps(finger):
    assert len(finger.run(st.hold(), seconds=0.1)) == 5
    assert len(finger.run(st.hold(), seconds=0.1, rate=100)) == 10
    assert finger.time == pytest.approx(0.2)


def test_poses_and_touches_act_in_all_steps(held):
    table = held.run(poses={"palm": [0.0, 0.01, 0.01]}, steps=3, rate=50, touches={"fingertip_force_N": [0, 0, -0.1]})
    assert table["palm_x_m"].tolist() == pytest.approx([-0.008, -0.006, -0.004])
    assert table["fingertip_force_z_N"].tolist() == pytest.approx([-0.1] * 3)


@pytest.mark.parametrize(("arguments", "said"), [
    ((st.hold(),), {"steps": 2, "seconds": 1.0, "said": "give one of them"}),
    *(((st.hold(),), {"steps": odd, "said": f"steps: {odd} must be a whole number from 1 to 10,000,000"})
      for odd in (0, 2.5, 10**12)),
    ((st.hold(),), {"seconds": -1.0, "said": "seconds: -1.0 s must be above 0"}),
    ((st.hold(),), {"rate": 0.0, "said": "rate: 0.0 Hz must be above 0"}),
    ((st.hold(),), {"rate": "fast", "said": "rate: must be a number"}),
    ((st.hold(),), {"seconds": 1e12, "said": "seconds: 1e+12 s are more than 10,000,000 steps at 50 Hz"}),
    ((5,), {"said": "takes commands, a file or a table, not 5"}),
    (([st.hold()],), {"steps": 3, "said": "steps: has no meaning"}),
    (({"time_s": [0, 1], "tip_x_m": [0.1] * 2, "tip_y_m": [0] * 2, "tip_z_m": [0] * 2},),
     {"rate": 10.0, "said": "rate: has no meaning"}),
    (("there_is_no_such.csv",), {"said": "there_is_no_such.csv"}),
])  # fmt: skip
def test_arguments_that_do_not_fit_are_refused(finger, arguments, said):
    with pytest.raises(st.SoftRobotTwinError) as caught:
        finger.run(*arguments, **{name: one for name, one in said.items() if name != "said"})
    assert said["said"] in str(caught.value)


def test_without_pandas_a_table_is_a_structured_array(finger, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    table = finger.run(st.setpoints(upper_shortening_m=0.001), steps=2)
    assert isinstance(table, np.ndarray) and table.shape == (2,)
    assert table["step"].tolist() == [0, 1] and table["status"].dtype.kind == "U"
    finger.reset()
    assert finger.run(table)["tip_z_m"].tolist() == table["tip_z_m"].tolist()


def test_with_pandas_a_table_is_a_data_frame(finger):
    pandas = pytest.importorskip("pandas")
    table = finger.run(st.setpoints(upper_shortening_m=0.001), steps=2)
    assert isinstance(table, pandas.DataFrame)
