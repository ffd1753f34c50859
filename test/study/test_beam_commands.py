"""Scenes of beams alone at the command line: what they print, write and refuse."""

import re

import numpy as np
import pytest
import yaml
from test.run_files import rows_of


@pytest.fixture
def cantilever(tmp_path):
    """Scene file of a cantilever whose tip is pulled up by a cable."""
    path = tmp_path / "cantilever.yaml"
    path.write_text(yaml.safe_dump({
        "name": "cantilever", "gravity": [0.0, 0.0, -9.81],
        "beams": [{
            "name": "rod", "points": [[0, 0, 0], [0.2, 0, 0]], "elements": 2,
            "section": {"circle": {"radius": 0.004}}, "fixed": ["start"],
            "material": {"young_modulus": 1.0e8, "poisson_ratio": 0.4, "density": 1100.0}}],
        "effectors": [{"name": "tip", "body": "rod", "points": [[0.2, 0, 0]]}],
        "cables": [{"name": "up", "body": "rod", "pull_point": [0, 0, 0.2],
                    "points": [[0.2, 0, 0]], "tension": [0, 10]}]}))
    return path


def test_explain_prints_the_stiffness_and_the_sag_of_a_beam(cantilever, call):
    done = call("explain", cantilever)
    assert done.code == 0, done.errors
    assert "200 mm long, circle of radius 4 mm" in done.output
    assert "EI 0.0201062 N m²" in done.output
    # q L⁴ / 8 EI: the weight is that of the elements' cubics, so that the ends sag as the beam's do.
    sag = 1100.0 * np.pi * 0.004**2 * 9.81 * 0.2**4 / (8.0 * 0.0201062)
    printed = float(re.search(r"actuators +([0-9.]+) mm", done.output)[1])
    assert printed == pytest.approx(1e3 * sag, rel=0.01)
    assert "not estimated: the scene has no deformable body" in done.output


def test_a_run_records_the_nodes_of_a_beam(cantilever, tmp_path, call):
    done = call("simulate", cantilever, "--steps", 5, "--output", tmp_path / "run.csv",
                "--picture", tmp_path / "run.png")  # fmt: skip
    assert done.code == 0, done.errors
    assert "rod, largest displacement" in done.output
    last = rows_of(tmp_path / "run.csv")[-1]
    assert float(last["rod_1_x_m"]) == pytest.approx(0.1, abs=1e-3)
    assert float(last["rod_2_z_m"]) == pytest.approx(float(last["tip_z_m"]))
    assert float(last["rod_2_z_m"]) < 0.0
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.parametrize("command", [("accuracy",), ("choose", "--rate", 100)])
def test_a_command_that_compares_meshes_refuses_a_scene_without_one(cantilever, call, command):
    done = call(command[0], cantilever, *command[1:])
    assert done.code == 2
    assert "this scene has no deformable body" in done.errors
