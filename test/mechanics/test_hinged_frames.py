"""Facts of frames on hinges and ball joints: their moves, and what they give to their parents."""

import numpy as np
import pytest

from softrobot_twin.constraints.effector import EffectorPoints, Effectors
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.hinged_frames import (
    WORLD,
    HingeBlocks,
    HingedFrames,
    HingedTwists,
    Hinges,
)
from softrobot_twin.mechanics.kinematics import CarriedPoints, on_unknowns
from softrobot_twin.mechanics.laws.small_displacement import SmallDisplacement
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector, vector_from_rotation
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU
from test.finite_differences import MovedFrames

# Two free nodes; translation and rotation of a free body; a hinge and a ball joint on it, a hinge
# on a guided body, and a ball joint and a hinge on the world.
UNKNOWNS = 9
OWN = slice(4, 9)
HINGES, BALLS = (0, 2, 4), (1, 3)
FREE_BODY, GUIDED_BODY = 3, 7
FIRST_HINGED = 11


class Joined(MovedFrames):
    """Two free nodes and a fixed one, a free and a guided body, and five frames joined to them."""

    unknown_count = UNKNOWNS

    def __init__(self):
        rng = np.random.default_rng(4)
        axes = rng.standard_normal((5, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        axes[list(BALLS)] = 0.0
        self.joints = Hinges(
            np.array([FREE_BODY, FREE_BODY, GUIDED_BODY, WORLD, WORLD]),
            np.array([0, 0, -1, -1, -1]), rng.uniform(-0.5, 0.5, (5, 3)),
            np.array([rotation_from_vector(v) for v in rng.standard_normal((5, 3))]),
            axes, np.ones(5),
        )  # fmt: skip
        self.frames = HingedFrames(3, [True, False], 2, UNKNOWNS, self.joints, [1.0])
        self.points = CarriedPoints(UNKNOWNS, (self.frames,))
        self.free_index = np.concatenate([[0, -1, 1], self.frames.free_index()])
        poses = [(rng.standard_normal(3), rotation_from_vector(rng.standard_normal(3)))
                 for _ in range(2)]  # fmt: skip
        bodies = np.vstack([rng.standard_normal((3, 3)), RigidFrames.rest_nodes(poses)])
        hinged = RigidFrames.rest_nodes(self.frames.rest_poses(bodies))
        self.rest = np.vstack([bodies, hinged])
        self.state = self.moved(self.rest, rng.uniform(-0.05, 0.05, (UNKNOWNS, 3)))

    def second_slopes(self, energy, step=1e-4):
        """Second derivative of an energy in the chart of a move."""
        places = list(np.ndindex(UNKNOWNS, 3))
        out = np.zeros((len(places), len(places)))

        def at(i, j, a, b):
            move = np.zeros((UNKNOWNS, 3))
            move[places[i]] += a
            move[places[j]] += b
            return energy(self.moved(self.state, move))

        for i in range(len(places)):
            for j in range(i + 1):
                out[i, j] = out[j, i] = (
                    at(i, j, step, step) - at(i, j, step, -step)
                    - at(i, j, -step, step) + at(i, j, -step, -step)
                ) / (4.0 * step**2)  # fmt: skip
        return out

    def elastic(self):
        tets = np.array([
            [0, 2, 3, FIRST_HINGED + 1], [2, 4, FIRST_HINGED + 2, FIRST_HINGED + 5],
            [0, FIRST_HINGED + 6, FIRST_HINGED + 9, FIRST_HINGED + 14],
            [1, FIRST_HINGED + 3, FIRST_HINGED + 10, FIRST_HINGED + 17],
            [4, 5, FIRST_HINGED + 13, FIRST_HINGED + 18],
        ])  # fmt: skip
        corners = self.rest[tets]
        turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
        tets[turned] = tets[turned][:, [1, 0, 2, 3]]
        law = SmallDisplacement(*lame_parameters(10.0, 0.3))
        return Elements(TetMesh(self.rest, tets), self.free_index, law)


@pytest.fixture
def joined():
    return Joined()


def bound(terms):
    pairs = [stencil_pairs(term.stencils()) for term in terms]
    matrix = SuperLU(*(np.concatenate(side) for side in zip(*pairs, strict=True)), UNKNOWNS)
    for term in terms:
        term.bind(matrix.elimination_rank, matrix.slots)
    matrix.clear()
    return matrix


def hinge_point(joined, positions, k):
    parent, point = joined.joints.parents[k], joined.joints.points[k]
    if parent == WORLD:
        return point, np.eye(3)
    centre = positions[parent]
    R = (positions[parent + 1 : parent + 4] - centre).T
    return centre + R @ point, R


def test_hinged_frames_stay_at_their_hinge_points_and_turn_about_their_axes(joined):
    for k in range(5):
        point, R_parent = hinge_point(joined, joined.state, k)
        origin, R = joined.frames.pose(joined.state, 2 + k)
        np.testing.assert_allclose(origin, point, atol=1e-15)
        Q = joined.joints.rotations[k].T @ R_parent.T @ R
        turn = vector_from_rotation(Q)
        assert turn.any()
        if k in HINGES:
            angle = joined.frames.angles(joined.state)[k]
            np.testing.assert_allclose(turn, angle * joined.joints.axes[k], atol=1e-14)


def test_a_move_turns_the_parent_and_then_the_frame_in_world_axes(joined):
    rng = np.random.default_rng(9)
    move = 0.3 * rng.standard_normal((UNKNOWNS, 3))
    after = joined.moved(joined.state, move)
    for k, parent_turn in ((0, move[3]), (1, move[3]), (2, np.zeros(3)), (3, np.zeros(3))):
        _, before = joined.frames.pose(joined.state, 2 + k)
        own = move[4 + k]
        if k in HINGES:
            own = before @ joined.joints.axes[k] * own[0]
        expected = rotation_from_vector(parent_turn) @ rotation_from_vector(own) @ before
        np.testing.assert_allclose(joined.frames.pose(after, 2 + k)[1], expected, atol=1e-14)


def test_rows_are_the_derivative_by_all_unknowns(joined):
    effectors = tuple(
        EffectorPoints(f"e{k}", joined.frames.points(2 + k, [[0.1 * k, -0.2, 0.3]]), (0, 1, 2), 1.0)
        for k in range(5)
    )
    term = Effectors(effectors, joined.free_index)
    rows = RowStack([term], joined.points)
    rows.evaluate(joined.state)
    H = np.zeros((15, UNKNOWNS, 3))
    np.add.at(H, (rows.row_index, rows.node_index), rows.blocks)
    slopes = joined.slopes(term.positions)
    np.testing.assert_allclose(H.reshape(15, -1), slopes, atol=1e-8)
    assert np.abs(H[:, OWN]).max() > 0.1


class TwistEnergy(ForceTerm):
    """A force term on frames as a whole, by pairs of unknowns as those of a free body."""

    name = "twists"

    def __init__(self, joined, twists):
        self._joined = joined
        self._places = [twists.place(k) for k in range(5)]
        self._rest = [joined.frames.pose(joined.rest, 2 + k) for k in range(5)]
        self._pull = np.random.default_rng(1).standard_normal((5, 3))

    def stencils(self):
        return np.array([[p, p + 1] for p in self._places])

    def bind(self, rank, slots):
        self._slots = slots

    def energy(self, x):
        """Σ pull·c + Σ tr(M R) with a constant matrix M of each frame."""
        return sum(
            self._pull[k] @ self._joined.frames.pose(x, 2 + k)[0]
            + np.trace(self._matrix(k) @ self._joined.frames.pose(x, 2 + k)[1])
            for k in range(5)
        )

    @staticmethod
    def _matrix(k):
        return np.random.default_rng(50 + k).standard_normal((3, 3))

    def _parts(self, k, x):
        """Moment and Hessian in the chart exp([ψ]×) R, of tr(M R)."""
        N = self._joined.frames.pose(x, 2 + k)[1] @ self._matrix(k)
        moment = np.array([N[1, 2] - N[2, 1], N[2, 0] - N[0, 2], N[0, 1] - N[1, 0]])
        return moment, 0.5 * (N + N.T) - np.trace(N) * np.eye(3)

    def add_forces(self, x, forces):
        for k, place in enumerate(self._places):
            forces[place] -= self._pull[k]
            forces[place + 1] -= self._parts(k, x)[0]
        return 0

    def add(self, x, forces, storage, projected):
        self.add_forces(x, forces)
        for k, place in enumerate(self._places):
            offset, stride = self._slots(np.array([place + 1]), np.array([place + 1]))
            hessian = self._parts(k, x)[1]
            for i in range(3):
                for j in range(3):
                    storage[offset[0] + j * stride[0] + i] += hessian[i, j]


@pytest.mark.parametrize("whole, bars", [(False, (1e-6, 1e-5)), (True, (1e-8, 1e-6))])
def test_elements_and_whole_frames_have_the_forces_and_the_stiffness_of_their_energy(joined, whole, bars):
    twists = HingedTwists(joined.frames)
    plain = TwistEnergy(joined, twists) if whole else joined.elastic()
    term = on_unknowns(plain, twists if whole else joined.points)
    energy = plain.energy if whole else term.energy
    matrix, forces = bound([term]), np.zeros((UNKNOWNS, 3))
    term.add(joined.state, forces, matrix.storage, False)
    np.testing.assert_allclose(forces.ravel(), -joined.slopes(energy)[0], atol=bars[0])
    K = matrix.matrix().toarray()
    np.testing.assert_allclose(K, joined.second_slopes(energy), atol=bars[1] * np.abs(K).max())
    assert np.abs(K[9:12, 12:15]).max() > 0.1


def test_unused_numbers_keep_the_matrix_definite_and_the_angles_all_but_free(joined):
    term = HingeBlocks(joined.frames.own, joined.frames.is_ball, np.arange(1.0, 6.0))
    matrix = bound([term])
    term.add(joined.state, np.zeros((UNKNOWNS, 3)), matrix.storage, False)
    diagonal = matrix.matrix().toarray().diagonal().reshape(-1, 3)[OWN]
    np.testing.assert_allclose(diagonal[0], [1e-5, 1.0, 1.0])
    np.testing.assert_allclose(diagonal[1], 2e-5)
    matrix.clear()
    forces = np.zeros((UNKNOWNS, 3))
    term.add(joined.state, forces, matrix.storage, True)
    assert (matrix.matrix().toarray().diagonal().reshape(-1, 3)[OWN] > 1e-3).all()
    assert not forces.any()


def test_hinged_frames_follow_a_parent_that_is_placed(joined):
    x = joined.state.copy()
    relative = joined.frames.relative(x)
    angles = joined.frames.angles(x)
    joined.frames.place(x, 1, [1.0, 2.0, 3.0], rotation_from_vector([0.1, 2.0, -0.4]))
    joined.frames.follow(x, relative)
    np.testing.assert_allclose(joined.frames.relative(x), relative, atol=1e-14)
    np.testing.assert_allclose(joined.frames.angles(x), angles, atol=1e-14)
    point, _ = hinge_point(joined, x, 2)
    np.testing.assert_allclose(joined.frames.pose(x, 4)[0], point, atol=1e-14)


def test_many_small_turns_stay_on_the_axis_and_add_up(joined):
    move = np.zeros((UNKNOWNS, 3))
    move[3] = [2e-3, -1e-3, 5e-4]
    move[OWN, 0] = [1e-3, 2e-4, -3e-3, 1e-3, 7e-3]
    x, steps = joined.rest.copy(), 100_000
    for _ in range(steps):
        joined.frames.advance(x, move, 1.0)
    for k in range(5):
        point, R_parent = hinge_point(joined, x, k)
        origin, R = joined.frames.pose(x, 2 + k)
        np.testing.assert_allclose(origin, point, atol=1e-14)
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
        if k in HINGES:
            turned = rotation_from_vector(steps * move[4 + k, 0] * joined.joints.axes[k])
            Q = joined.joints.rotations[k].T @ R_parent.T @ R
            # Rounding of each step adds up like a random walk.
            np.testing.assert_allclose(Q, turned, atol=1e-11)
            np.testing.assert_allclose(Q @ joined.joints.axes[k], joined.joints.axes[k], atol=1e-14)
