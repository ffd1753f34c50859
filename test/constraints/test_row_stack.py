"""Facts of stacked rows: named groups, terms whose rows vary, rows on rigid bodies."""

import numpy as np
import pytest

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.mechanics.kinematics import CarriedPoints
from softrobot_twin.mechanics.rigid_bodies import RigidFrames

NODES = 5


class Points:
    """Rows that are coordinates of chosen nodes; a term as any other package could define it."""

    name, yields, takes_efforts = "points", False, False

    def __init__(self, group, nodes, varies=False, share=1.0):
        self.group, self.varies, self.share = group, varies, share
        self.choose(nodes)
        self.row_capacity = self.entry_capacity = len(nodes)
        self.reached_nodes = np.arange(NODES)
        self.kept, self.forgotten = None, False

    def choose(self, nodes):
        self.entry_nodes = np.array(nodes, np.int64)
        self.row_count = len(nodes)
        self.entry_rows = np.arange(self.row_count)
        self.scales = np.ones(self.row_count)
        self.last_multipliers = 10.0 + np.arange(self.row_count)

    def detect(self, positions):
        self.choose(np.flatnonzero(positions[:, 0] < 0.0))
        self.row_capacity = self.entry_capacity = max(self.entry_capacity, self.row_count)

    def evaluate(self, positions, blocks, values):
        blocks[:] = [1.0, 0.0, 0.0]
        values[:] = positions[self.entry_nodes, 0]

    def add_stiffness(self, positions, multipliers, storage, projected):
        storage[0] += multipliers.sum()

    def largest_share(self, positions, move):
        return self.share

    def remember(self, multipliers):
        self.kept = multipliers.copy()

    def forget(self):
        self.forgotten = True


@pytest.fixture
def stack():
    """Two terms of actuators, one of effectors, and contacts wherever x is negative."""
    return RowStack([
        Points("actuators", [0, 1], share=0.5), Points("actuators", [2]),
        Points("effectors", [3, 4]), Points("contacts", [], varies=True, share=0.8),
    ])  # fmt: skip


@pytest.fixture
def x():
    return np.random.default_rng(0).standard_normal((NODES, 3))


def dense(stack):
    H = np.zeros((stack.row_count, NODES, 3))
    np.add.at(H, (stack.row_index, stack.node_index), stack.blocks)
    return H


def test_every_term_gives_its_stiffness_and_the_largest_share_of_a_move(stack, x):
    x[:, 0] = [-1.0, -1.0, 1.0, 1.0, 1.0]
    stack.detect(x)
    # Two contacts remember 10 and 11; effectors carry no load.
    multipliers = stack.multipliers(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(multipliers, [1.0, 2.0, 3.0, 0.0, 0.0, 10.0, 11.0])
    storage = np.zeros(1)
    stack.add_stiffness(x, multipliers, storage, False)
    assert storage[0] == 27.0
    assert stack.largest_share(x, np.zeros_like(x)) == 0.5


def test_forces_are_the_transposed_rows_times_multipliers(stack, x):
    stack.evaluate(x)
    forces = np.zeros((NODES, 3))
    multipliers = np.array([1.0, 2.0, 3.0, 5.0, 7.0])
    stack.add_forces(multipliers, forces)
    np.testing.assert_array_equal(forces, np.einsum("k,kni->ni", multipliers, dense(stack)))


def test_rows_on_free_rigid_bodies_are_brought_to_their_unknowns():
    frames = RigidFrames(0, [False, True], 0, 2)
    points, index = CarriedPoints(2, (frames,)), frames.free_index()
    term = Points("effectors", index[index >= 0])
    term.reached_nodes = term.entry_nodes
    stack = RowStack([term], points)
    np.testing.assert_array_equal(stack.reached_nodes, [0, 1])
    term.evaluate = lambda positions, blocks, values: blocks.fill(1.0)
    stack.evaluate(frames.rest_nodes([([1.0, 2.0, 3.0], np.eye(3))] * 2))
    assert set(stack.node_index) == {0, 1} and stack.row_count == 4
