"""``bench`` over mesh sizes: its output, its files and its measurements."""

import csv

import pytest
import yaml

from softrobot_twin.scene import load_scene
from softrobot_twin.scene.schema import Control, Observer
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench_measurement import (
    CONTROL,
    OBSERVER,
    OUTSIDE,
    WHOLE_STEP,
    default_scene_path,
    given_cases,
    measure,
)
from test.run_files import rows_of

COLUMNS = """
scene nodes tets dof modes points rows contacts factorization threads steps stage median_ms p99_ms
max_ms ratio_to_superlu superlu_ms superlu_samples interrupted_share
resident_bytes full_ms ratio_to_full python_calls kernel_share beside_step_ms
"""


@pytest.fixture(scope="module")
def measured(column):
    return measure(given_cases([column])[0], 5)


@pytest.mark.libraries
def test_bench_writes_a_row_for_each_stage(column, tmp_path, call):
    call("bench", column, "--steps", 5, "--output", tmp_path / "made")
    simulation = Simulation.from_scene_file(column)
    rows = rows_of(tmp_path / "made" / "bench.csv")
    assert list(rows[0]) == COLUMNS.split()
    assert [row["stage"] for row in rows] == [*simulation.stages, OUTSIDE, WHOLE_STEP]
    for row in rows:
        assert 0.0 < float(row["median_ms"]) <= float(row["p99_ms"]) <= float(row["max_ms"])
        assert (row["scene"], row["steps"]) == ("column", "5")


@pytest.mark.exhaustive
def test_an_observer_is_a_stage_beside_the_step(measured):
    scene = load_scene(default_scene_path()).changed(observer=Observer())
    case = given_cases([default_scene_path()])[0]._replace(scene=scene)
    assert measure(case, 5).stages[OBSERVER].median > 0.0
    assert OBSERVER not in measured.stages


@pytest.mark.exhaustive
def test_control_is_a_stage_beside_the_step(measured):
    path = default_scene_path().with_name("finger.yaml")
    scene = load_scene(path).changed(
        integration="dynamic", cables={"rate": None}, control=Control(inputs="efforts"))
    case = given_cases([path])[0]._replace(scene=scene)
    assert measure(case, 5).stages[CONTROL].median > 0.0
    assert CONTROL not in measured.stages


@pytest.mark.exhaustive
def test_a_reduced_model_is_compared_with_its_full_one(tmp_path, call):
    reduced = default_scene_path().parent / "diamond_reduced.yaml"
    full = tmp_path / "full.yaml"
    content = yaml.safe_load(reduced.read_text())
    del content["body"]["reduced"]
    content["body"]["mesh"]["file"] = str(load_scene(reduced).mesh_path)
    full.write_text(yaml.safe_dump(content))
    call("bench", full, reduced, "--steps", 3, "--output", tmp_path)
    theirs, ours = (row for row in rows_of(tmp_path / "bench.csv") if row["stage"] == WHOLE_STEP)
    # Sizes are those of the mesh.
    assert (ours["nodes"], ours["tets"]) == (theirs["nodes"], theirs["tets"])
    modes = int(ours["modes"])
    assert 10 < modes < 60 and int(ours["dof"]) == modes and int(ours["points"]) > modes
    assert theirs["modes"] == theirs["points"] == theirs["full_ms"] == ""
    assert ours["full_ms"] == theirs["median_ms"]
    # A factorization of so few unknowns is no yardstick.
    assert ours["superlu_ms"] == "" and float(theirs["superlu_ms"]) > 0.0


@pytest.mark.exhaustive
def test_a_step_that_grew_is_marked_beside_an_earlier_run(column, tmp_path, call):
    call("bench", column, "--steps", 4, "--output", tmp_path)
    rows = rows_of(tmp_path / "bench.csv")
    whole = next(row for row in rows if row["stage"] == WHOLE_STEP)
    assert float(whole["python_calls"]) > 100.0
    assert 0.05 < float(whole["kernel_share"]) < 1.0
    assert float(whole["beside_step_ms"]) > 0.0

    def earlier(name, ratio, calls):
        path = tmp_path / f"{name}.csv"
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerow(whole | {"ratio_to_superlu": ratio, "python_calls": calls})
        return path

    slow, lean = earlier("slow", 1e6, 1e6), earlier("lean", 1e-6, 1.0)
    same = call("bench", column, "--steps", 4, "--compare", slow)
    assert "An earlier run" in same.output and "slower" not in same.output
    grown = call("bench", column, "--steps", 4, "--compare", lean)
    assert "slower, more calls" in grown.output
