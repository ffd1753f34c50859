"""The actuation by one kernel against the same found by the general functions, to the bit."""

import numpy as np
import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import FollowTargets, Simulation
from softrobot_twin.simulation.step.inverse_actuation import InverseActuation
from test.places import SCENES

STEPS = 30


def followed(name, seed, by_kernel, monkeypatch):
    """Positions and efforts on the way to random targets, and how many steps the kernel proved."""
    proved, guess = [], InverseActuation.guessed

    def guessed(*given):
        found = guess(*given) if by_kernel else None
        proved.append(found is not None)
        return found

    monkeypatch.setattr(InverseActuation, "guessed", guessed)
    simulation = Simulation(load_scene(SCENES / f"{name}.yaml"), with_warnings=False)
    rng, rest, ways = np.random.default_rng(seed), simulation.effector_positions(), []
    size = simulation.model.nodes.size
    for step in range(STEPS):
        if step % 10 == 0:
            # Far ones, too: there cables become slack, and limits bind.
            way = rng.standard_normal(rest.shape) * size * (0.005, 0.5, 0.02)[step // 10]
        result = simulation.step(FollowTargets(rest + way, 0.02))
        ways.append(np.concatenate([result.state.positions.ravel(), result.efforts]))
    return np.array(ways), sum(proved)


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["finger", "flexo", "fetch_reduced", "diamond_reduced", "trunk"])
def test_by_one_kernel_a_robot_goes_the_same_way_to_the_bit(name, seed, monkeypatch):
    found, proved = followed(name, seed, True, monkeypatch)
    expected, none = followed(name, seed, False, monkeypatch)
    np.testing.assert_array_equal(found, expected)
    assert proved > 2 and none == 0
