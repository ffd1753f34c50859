"""Facts of the nodes of a scene: how far they go, and how hard they are pushed."""

import numpy as np
import pytest

from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.mechanics.kinematics import Nodes

POINTS = 3


@pytest.fixture
def nodes():
    """Three points, the last of four nodes held; without rigid bodies, and with two of them."""
    rest = np.zeros((4, 3))
    free, index = np.arange(POINTS), np.array([0, 1, 2, -1])
    plain = Nodes(rest, free, index, POINTS, 1.0)
    frames = RigidFrames(4, [True, True], POINTS, POINTS + 4, np.array([0.5, 2.0]))
    rest = np.vstack([rest, RigidFrames.rest_nodes([(np.zeros(3), np.eye(3))] * 2)])
    index = np.concatenate([index, frames.free_index()])
    return plain, Nodes(rest, free, index, POINTS + 4, 1.0, (frames,))


def test_turning_counts_at_the_rim(nodes):
    framed, move = nodes[1], np.zeros((POINTS + 4, 3))
    move[0], move[POINTS + 3] = [0.0, 0.3, 0.4], [0.0, 0.0, 0.3]
    assert framed.longest(move) == pytest.approx(0.6)
    assert framed.largest_force(move) == pytest.approx(0.5)
    move[POINTS + 1] = [0.4, 0.0, 0.3]
    assert framed.longest(move) == pytest.approx(0.6)
    assert framed.largest_force(move) == pytest.approx(1.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_bad_number_anywhere_makes_the_longest_not_finite(nodes, bad):
    for kind in nodes:
        for place in np.ndindex(kind.free_node_count, 3):
            move = np.ones((kind.free_node_count, 3))
            move[place] = bad
            assert not np.isfinite(kind.longest(move))
            assert not np.isfinite(kind.largest_force(move))


def test_what_is_read_only_is_measured_too(nodes):
    for kind in nodes:
        move = np.full((kind.free_node_count, 3), 0.1)
        expected = kind.longest(move)
        move.setflags(write=False)
        assert kind.longest(move) == expected > 0.0


def test_a_move_goes_the_way_that_lies_between_the_states(nodes):
    rng = np.random.default_rng(0)
    for kind in nodes:
        before, move = kind.rest_positions.copy(), rng.normal(size=(kind.free_node_count, 3))
        after = before.copy()
        kind.advance(after, move, 0.5)
        np.testing.assert_allclose(kind.displacement(before, after), 0.5 * move, atol=1e-14)
        np.testing.assert_array_equal(after[3], before[3])
