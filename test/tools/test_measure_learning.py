"""The figures of many robots that learn, and of their simulations alone."""

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium")

from measure_learning import alone, commands_of, measure  # noqa: E402

from softrobot_twin.scene import load_scene  # noqa: E402
from softrobot_twin.simulation import Simulation  # noqa: E402

FINGER = Path(__file__).resolve().parents[2] / "config" / "scenes" / "finger.yaml"


@pytest.mark.exhaustive
def test_it_prints_what_a_step_costs_and_what_two_workers_give(capsys):
    measure(FINGER, 2, 3, 1, 0.0)
    told = capsys.readouterr().out
    assert "finger: 2 robots, full model of 1500 unknowns" in told
    # No round may have been quiet.
    figures = [float(one) for one in re.findall("median (nan|[0-9.]+)", told)]
    assert len(figures) == 8 and np.nanmin(figures) > 0.0


def test_the_simulations_alone_are_commanded_as_the_robots_are():
    scene = load_scene(FINGER)
    actions, setpoints = commands_of(scene, 2, 3)
    assert actions.shape == (3, 2, 2) and setpoints.shape == (2, 3, 2)
    simulations = [Simulation(scene) for _ in range(2)]
    assert alone(simulations, setpoints) > 0.0
    for simulation, own in zip(simulations, setpoints, strict=True):
        np.testing.assert_array_equal(simulation.state.setpoints, own[-1])
