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
def test_moves_that_go_on_cost_nothing(least):
    assert taught([FORWARD] * 5, least=least) == least


def test_each_turn_back_as_far_as_it_went_makes_moves_dearer():
    weights = [taught([FORWARD, -FORWARD, FORWARD, -FORWARD][:count]) for count in (1, 2, 3, 4)]
    assert weights == [0.0, 8.0, 64.0, 512.0]
    assert taught([FORWARD, -FORWARD] * 50) == GREATEST


def test_turning_back_by_ever_less_is_coming_to_rest():
    assert taught([FORWARD * (-0.4) ** k for k in range(8)]) == 0.0


def test_moves_that_go_on_are_cheap_again_after_a_few():
    turns = [FORWARD, -FORWARD] * 3
    assert taught(turns) > 1e4
    assert taught(turns + [-FORWARD] * 20) == 0.0


def test_who_is_sent_back_and_forth_turns_back_rightly():
    assert taught([FORWARD, -FORWARD] * 3, [ASKED * (-1) ** k for k in range(7)]) == 0.0


def test_round_off_is_no_move():
    assert taught([FORWARD, -1e-12 * FORWARD, FORWARD, 1e-12 * FORWARD]) == 0.0
    turns = taught([FORWARD, -FORWARD])
    assert taught([FORWARD, -FORWARD] + [np.zeros(2)] * 20) == turns
