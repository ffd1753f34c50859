"""Springs between soft nodes, rigid bodies and the world, bound to a matrix of any order."""

from typing import NamedTuple

import numpy as np
import pytest

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.kinematics import CarriedPoints, on_unknowns
from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector
from softrobot_twin.mechanics.springs import Springs
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU

SOFT, SOFT_FREE = 8, 7
FREE = [True, False, True]
UNKNOWNS = SOFT_FREE + 4
MOVE_LIMIT = 0.1
POINTS = np.array([[0.05, -0.1, 0.2], [0.0, 0.0, 0.0], [-0.2, 0.1, 0.1]])


class Shuffled:
    """A matrix that eliminates the unknowns in another order than that of their numbers."""

    def __init__(self, term):
        self._rank = rank = np.random.default_rng(9).permutation(UNKNOWNS)
        rows, columns = stencil_pairs(term.stencils(), UNKNOWNS)
        self._matrix = matrix = SuperLU(rank[rows], rank[columns], UNKNOWNS)
        term.bind(rank, lambda i, j: matrix.slots(rank[i], rank[j]))
        self.storage = matrix.storage

    def dense(self):
        blocks = self._matrix.matrix().toarray().reshape(UNKNOWNS, 3, UNKNOWNS, 3)
        return blocks[self._rank][:, :, self._rank].reshape(3 * UNKNOWNS, 3 * UNKNOWNS)


class World(NamedTuple):
    """Eight soft nodes, the first one fixed, and three rigid bodies, the middle one guided."""

    frames: RigidFrames
    positions: np.ndarray
    free_index: np.ndarray

    def soft(self, *nodes):
        """Points each carried by four nodes, with weights that differ."""
        weights = np.array([0.1, 0.2, 0.3, 0.4])
        nodes = np.array(nodes).reshape(-1, 4)
        return BarycentricMapping(nodes, np.tile(weights, (len(nodes), 1)))

    def nodes(self, *nodes):
        return BarycentricMapping(np.array(nodes)[:, None], np.ones((len(nodes), 1)))

    def moved(self, move, share=1.0):
        x = self.positions.copy()
        x[1:SOFT] += share * move[:SOFT_FREE]
        self.frames.advance(x, move, share)
        return x

    def springs(self, first, second, stiffness, rest_lengths, damping=0.0, **more):
        term = Springs(first, second, stiffness, rest_lengths, damping, self.free_index, **more)
        term = on_unknowns(term, CarriedPoints(UNKNOWNS, (self.frames,)))
        return term, Shuffled(term)

    def begin(self, term, time_step):
        """Begins a step here, at rest."""
        term.begin_step(self.positions, np.zeros((UNKNOWNS, 3)), time_step)

    def forces(self, term, x):
        forces = np.zeros((UNKNOWNS, 3))
        assert term.add_forces(x, forces) == 0
        return forces

    def stiffness(self, term, matrix, x, projected=False):
        matrix.storage[:] = 0.0
        forces = np.zeros((UNKNOWNS, 3))
        term.add(x, forces, matrix.storage, projected)
        np.testing.assert_array_equal(forces, self.forces(term, x))
        return matrix.dense()

    def ends(self, kind):
        """Springs of one kind of ends: (first, second, offsets)."""
        frames = self.frames
        return {
            "soft to soft": (self.soft(0, 1, 2, 3, 2, 3, 4, 5), self.soft(4, 5, 6, 7, 4, 5, 6, 7),
                             None),
            "mass to mass": (self.nodes(1, 2), self.nodes(3, 0), None),
            "soft to world": (self.soft(1, 2, 3, 4), None, [[0.3, 0.2, 0.1]]),
            "soft to rigid": (self.soft(1, 2, 3, 4, 0, 4, 5, 7, 4, 5, 6, 7),
                              frames.points(0, POINTS), None),
            "rigid to rigid": (frames.points(2, POINTS),
                               frames.points(0, POINTS[::-1] + 0.03), None),
            "rigid to guided": (frames.points(2, POINTS), frames.points(1, POINTS), None),
            "rigid to world": (frames.points(0, POINTS), None, POINTS[[1, 2, 0]] + 0.5),
            "some of each": (frames.points(0, POINTS[:2]).followed_by(self.nodes(3, 1)),
                             self.soft(1, 2, 3, 4).followed_by(frames.points(2, POINTS)),
                             np.full((4, 3), 0.01)),
        }[kind]  # fmt: skip

    def shaken(self):
        """A state that is far from this one."""
        return self.moved(MOVE_LIMIT * np.random.default_rng(1).standard_normal((UNKNOWNS, 3)))

    def slopes(self, x, function):
        """Derivative of a function by every unknown, by differences."""
        at, step, columns = self._replace(positions=x), 1e-6, []
        for unknown in range(UNKNOWNS):
            for axis in range(3):
                move = np.zeros((UNKNOWNS, 3))
                move[unknown, axis] = step
                ahead, behind = function(at.moved(move)), function(at.moved(move, -1.0))
                columns.append(np.ravel(ahead - behind) / (2 * step))
        return np.array(columns).T


@pytest.fixture
def world():
    rng = np.random.default_rng(0)
    frames = RigidFrames(SOFT, FREE, SOFT_FREE, UNKNOWNS)
    poses = [(rng.standard_normal(3), rotation_from_vector(rng.standard_normal(3))) for _ in FREE]
    positions = np.vstack([rng.standard_normal((SOFT, 3)), frames.rest_nodes(poses)])
    free_index = np.concatenate([np.arange(-1, SOFT_FREE), frames.free_index()])
    return World(frames, positions, free_index)
