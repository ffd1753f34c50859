"""Facts of how hard actuators are held, learnt from their moves."""

import numpy as np
import pytest

from softrobot_twin.simulation.proximal_weight import GREATEST, ProximalWeight

FORWARD = np.array([1e-3, -2e-3])
ASKED = np.array([0.01, 0.0, 0.02])


def taught(moves, asked=None, least=0.0) -> float:
    """The weight after moves [m] of two actuators."""
    proximal_weight, place = ProximalWeight(least), np.zeros(2)
    asked = [ASKED] * (len(moves) + 1) if asked is None else asked
    proximal_weight.learn(place, asked[0])
    for move, way in zip(moves, asked[1:], strict=True):
        place = place + move
        proximal_weight.learn(place, way)
    return proximal_weight.weight


@pytest.mark.parametrize("least", [0.0, 9.0])
def test_moves_in_one_direction_have_zero_weight(least):
    assert taught([FORWARD] * 5, least=least) == least


def test_each_full_reversal_increases_the_weight():
    weights = [taught([FORWARD, -FORWARD, FORWARD, -FORWARD][:count]) for count in (1, 2, 3, 4)]
    assert weights == [0.0, 8.0, 64.0, 512.0]
    assert taught([FORWARD, -FORWARD] * 50) == GREATEST


def test_shrinking_reversals_do_not_increase_the_weight():
    assert taught([FORWARD * (-0.4) ** k for k in range(8)]) == 0.0


def test_a_few_moves_in_one_direction_reduce_the_weight_to_zero():
    turns = [FORWARD, -FORWARD] * 3
    assert taught(turns) > 1e4
    assert taught(turns + [-FORWARD] * 20) == 0.0


def test_reversals_of_the_target_do_not_increase_the_weight():
    assert taught([FORWARD, -FORWARD] * 3, [ASKED * (-1) ** k for k in range(7)]) == 0.0


def test_round_off_does_not_count_as_a_move():
    assert taught([FORWARD, -1e-12 * FORWARD, FORWARD, 1e-12 * FORWARD]) == 0.0
    turns = taught([FORWARD, -FORWARD])
    assert taught([FORWARD, -FORWARD] + [np.zeros(2)] * 20) == turns
