"""The program that draws what stiffness the Stifface renders."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

PROGRAM = Path(__file__).resolve().parents[2] / "tools" / "draw_stifface.py"


@pytest.fixture(scope="module")
def program():
    spec = importlib.util.spec_from_file_location("draw_stifface", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_short_sweep_follows_its_profile_and_is_drawn(program, tmp_path, capsys):
    made = program.sweep(0.4)
    assert np.abs(made.model / made.wanted - 1.0).max() < 0.03
    assert made.off.max() < 1e-4
    assert made.pressed == pytest.approx(200.0, rel=0.05) and np.isnan(made.device).all()
    program.draw_sweep(made, tmp_path / "sweep.png")
    assert (tmp_path / "sweep.png").stat().st_size > 10_000
    program.print_sweep(made)
    assert "the model at each step" in capsys.readouterr().out


def test_the_reach_is_drawn_over_the_whole_pad(program, tmp_path, capsys):
    places = np.array([[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]])
    made = program.Reach(places, np.array([100.0, 200.0, 300.0]), np.array([400.0, 600.0, 600.0]))
    program.draw_reach(made, tmp_path / "reach.png")
    assert (tmp_path / "reach.png").stat().st_size > 10_000
    program.print_reach(made)
    assert "4.00" in capsys.readouterr().out


@pytest.mark.slow
def test_the_stiffness_of_a_place_beside_the_middle_can_be_tripled(program, monkeypatch):
    monkeypatch.setattr(program, "FACTOR", 1.2)
    simulation = program.Simulation.from_scene_file(program.SCENES / "stifface.yaml")
    for _ in range(60):
        command = program.FollowTargets(
            program.HELD, program.TIME_STEP, stiffness=program.wanted_along_z(250.0)
        )
        result = simulation.step(command)
    least, greatest = program.reach_at(0.005, 0.005, result.setpoints)
    assert greatest > 3.0 * least
