"""Scenes of beams alone at the command line: what they print, write and refuse."""


import pytest
from test.run_files import rows_of


@pytest.mark.exhaustive
def test_a_run_records_the_nodes_of_a_beam(cantilever, tmp_path, call):
    call("simulate", cantilever, "--steps", 5, "--output", tmp_path / "run.csv",
         "--picture", tmp_path / "run.png")  # fmt: skip
    last = rows_of(tmp_path / "run.csv")[-1]
    assert float(last["rod_1_x_m"]) == pytest.approx(0.1, abs=1e-3)
    assert float(last["rod_2_z_m"]) == pytest.approx(float(last["tip_z_m"]))
    assert float(last["rod_2_z_m"]) < 0.0
    assert (tmp_path / "run.png").stat().st_size > 10_000
