"""``bench`` over mesh sizes: its output, its files and its measurements."""

import pytest

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench_measurement import OUTSIDE, WHOLE_STEP, default_scene_path
from test.run_files import rows_of

COLUMNS = """
scene nodes tets dof modes points rows contacts factorization threads steps stage median_ms p99_ms
max_ms interrupted_share
resident_bytes
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
def test_a_reduced_model_is_timed_with_its_modes_and_points(tmp_path, call):
    call("bench", default_scene_path().parent / "diamond_reduced.yaml", "--steps", 3, "--output", tmp_path)
    row = rows_of(tmp_path / "bench.csv")[-1]
    modes = int(row["modes"])
    assert 10 < modes < 60 and int(row["dof"]) == modes and int(row["points"]) > modes
