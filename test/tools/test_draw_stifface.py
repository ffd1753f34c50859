"""The program that draws what stiffness the Stifface renders."""

import draw_stifface
import numpy as np
import pytest


def test_a_short_sweep_follows_its_profile_and_is_drawn(tmp_path, capsys):
    made = draw_stifface.sweep(0.4)
    assert np.abs(made.model / made.wanted - 1.0).max() < 0.03
    assert made.off.max() < 1e-4
    assert made.pressed == pytest.approx(200.0, rel=0.05) and np.isnan(made.device).all()
    draw_stifface.draw_sweep(made, tmp_path / "sweep.png")
    assert (tmp_path / "sweep.png").stat().st_size > 10_000
    draw_stifface.print_sweep(made)
    assert "the model at each step" in capsys.readouterr().out


def test_the_reach_is_drawn_over_the_whole_pad(tmp_path, capsys):
    places = np.array([[0.0, 0.0], [0.01, 0.0], [0.01, 0.01]])
    least, greatest = np.array([100.0, 200.0, 300.0]), np.array([400.0, 600.0, 600.0])
    made = draw_stifface.Reach(places, least, greatest)
    draw_stifface.draw_reach(made, tmp_path / "reach.png")
    assert (tmp_path / "reach.png").stat().st_size > 10_000
    draw_stifface.print_reach(made)
    assert "4.00" in capsys.readouterr().out


@pytest.mark.exhaustive
def test_the_stiffness_of_a_place_beside_the_middle_can_be_tripled(monkeypatch):
    monkeypatch.setattr(draw_stifface, "FACTOR", 1.2)
    simulation = draw_stifface.Simulation.from_scene_file(draw_stifface.SCENES / "stifface.yaml")
    for _ in range(60):
        command = draw_stifface.FollowTargets(
            draw_stifface.HELD, draw_stifface.TIME_STEP, stiffness=draw_stifface.wanted_along_z(250.0)
        )
        result = simulation.step(command)
    least, greatest = draw_stifface.reach_at(0.005, 0.005, result.setpoints)
    assert greatest > 3.0 * least
