"""``bench`` over mesh sizes: its output, its files and its measurements."""

import pytest
import yaml

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench_measurement import OUTSIDE, WHOLE_STEP, default_scene_path
from test.run_files import rows_of

COLUMNS = """
scene nodes tets dof modes points rows contacts factorization threads steps stage median_ms p99_ms
max_ms interrupted_share
resident_bytes full_ms ratio_to_full
"""


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
