"""What a scene says at load of a body that buckles at given tensions of its cables."""

import re
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    Simulation,
    scene_warnings,
)
from softrobot_twin.simulation.mesh_error import with_element
from softrobot_twin.simulation.result import UNSTABLE

DIAMOND = Path(__file__).resolve().parents[2] / "config" / "scenes" / "diamond.yaml"


def told(simulation) -> list[float]:
    """Tensions at which a body is said to buckle [N]."""
    found = [re.search(r"same tensions, ([\d.]+) N, it buckles", note) for note in simulation.notes]
    return [float(one[1]) for one in found if one]


def test_elements_that_do_not_lock_tell_that_the_diamond_buckles_and_linear_ones_hide_it(
    monkeypatch,
):
    # Quadratic elements have more nodes than a user waits for.
    monkeypatch.setattr(scene_warnings, "MOST_FREE_NODES", 10_000)
    scene = load_scene(DIAMOND)
    smoothed, quadratic, linear = (
        told(Simulation(with_element(scene, element)))
        for element in ("smoothed", "quadratic", "linear")
    )
    assert linear == []
    assert smoothed == [pytest.approx(quadratic[0], rel=0.1)]


def test_at_the_tensions_that_are_told_the_body_is_unstable():
    simulation = Simulation(load_scene(DIAMOND))
    (tension,) = told(simulation)
    assert np.array_equal(simulation.state.positions, simulation.model.nodes.rest_positions)

    def held(share):
        """A step at the tensions of a state in which all cables are wound in by a share."""
        simulation.reset()
        travel = simulation.limits.displacement_max
        for part in np.arange(0.05, share + 1e-9, 0.05):
            for _ in range(4):
                wound = simulation.actuators.setpoints(part * travel)
                result = simulation.step(CommandSetpoints(wound, 1e3))
        return result.efforts.max(), simulation.step(CommandEfforts(result.efforts, 1e3))

    below, stable = held(0.15)
    above, unstable = held(0.35)
    assert below < tension < above
    assert UNSTABLE not in stable.report.active_limits
    assert UNSTABLE in unstable.report.active_limits
