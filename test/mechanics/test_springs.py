"""Facts of springs."""

from typing import NamedTuple

import numpy as np
import pytest

from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector
from softrobot_twin.mechanics.springs import Springs, springs_along
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
        term = Springs(
            first, second, stiffness, rest_lengths, damping, self.free_index, self.frames, **more
        )
        return term, self.bound(term)

    def bound(self, term):
        return Shuffled(term)


@pytest.fixture
def world():
    rng = np.random.default_rng(0)
    frames = RigidFrames(SOFT, FREE, SOFT_FREE, UNKNOWNS)
    poses = [(rng.standard_normal(3), rotation_from_vector(rng.standard_normal(3))) for _ in FREE]
    positions = np.vstack([rng.standard_normal((SOFT, 3)), frames.rest_nodes(poses)])
    free_index = np.concatenate([np.arange(-1, SOFT_FREE), frames.free_index()])
    return World(frames, positions, free_index)


def forces_of(term, x):
    forces = np.zeros((UNKNOWNS, 3))
    assert term.add_forces(x, forces) == 0
    return forces


def stiffness_of(term, matrix, x, projected=False):
    matrix.storage[:] = 0.0
    forces = np.zeros((UNKNOWNS, 3))
    term.add(x, forces, matrix.storage, projected)
    np.testing.assert_array_equal(forces, forces_of(term, x))
    return matrix.dense()


def both(mapping, other):
    return mapping.followed_by(other)


def ends(world, kind):
    """Springs of one kind of ends: (first, second, offsets)."""
    frames = world.frames
    return {
        "soft to soft": (world.soft(0, 1, 2, 3, 2, 3, 4, 5), world.soft(4, 5, 6, 7, 4, 5, 6, 7),
                         None),
        "mass to mass": (world.nodes(1, 2), world.nodes(3, 0), None),
        "soft to world": (world.soft(1, 2, 3, 4), None, [[0.3, 0.2, 0.1]]),
        "soft to rigid": (world.soft(1, 2, 3, 4, 0, 4, 5, 7, 4, 5, 6, 7),
                          frames.points(0, POINTS), None),
        "rigid to rigid": (frames.points(2, POINTS), frames.points(0, POINTS[::-1] + 0.03), None),
        "rigid to guided": (frames.points(2, POINTS), frames.points(1, POINTS), None),
        "rigid to world": (frames.points(0, POINTS), None, POINTS[[1, 2, 0]] + 0.5),
        "some of each": (both(frames.points(0, POINTS[:2]), world.nodes(3, 1)),
                         both(world.soft(1, 2, 3, 4), frames.points(2, POINTS)),
                         np.full((4, 3), 0.01)),
    }[kind]  # fmt: skip


KINDS = ["soft to soft", "mass to mass", "soft to world", "soft to rigid", "rigid to rigid",
         "rigid to guided", "rigid to world", "some of each"]  # fmt: skip


def shaken(world):
    return world.moved(MOVE_LIMIT * np.random.default_rng(1).standard_normal((UNKNOWNS, 3)))


def slopes(world, x, function):
    """Derivative of a function by every unknown, by differences."""
    at, step, columns = world._replace(positions=x), 1e-6, []
    for unknown in range(UNKNOWNS):
        for axis in range(3):
            move = np.zeros((UNKNOWNS, 3))
            move[unknown, axis] = step
            ahead, behind = function(at.moved(move)), function(at.moved(move, -1.0))
            columns.append(np.ravel(ahead - behind) / (2 * step))
    return np.array(columns).T


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture(params=["stretched", "pressed"])
def rest_length(request):
    """Distances are about two metres."""
    return 0.3 if request.param == "stretched" else 5.0


def test_forces_are_minus_the_energys_slope(world, kind, rest_length):
    first, second, offsets = ends(world, kind)
    stiffness = np.linspace(50.0, 80.0, first.point_count)
    term, _ = world.springs(first, second, stiffness, rest_length, offsets=offsets)
    x = shaken(world)
    forces = forces_of(term, x)
    slope = slopes(world, x, term.energy).reshape(-1, 3)
    assert np.abs(forces).max() > 1.0
    np.testing.assert_allclose(forces, -slope, atol=1e-6 * np.abs(forces).max())


def test_stiffness_is_the_symmetric_part_of_the_forces_slope(world, kind, rest_length):
    first, second, offsets = ends(world, kind)
    term, matrix = world.springs(first, second, 60.0, rest_length, 3.0, offsets=offsets)
    term.begin_step(world.positions, np.zeros((UNKNOWNS, 3)), 0.1)
    x = shaken(world)
    slope = -slopes(world, x, lambda y: forces_of(term, y))
    K = stiffness_of(term, matrix, x)
    np.testing.assert_allclose(K, 0.5 * (slope + slope.T), atol=1e-6 * np.abs(K).max())
    # What is left out couples a rotation with itself only, and is half of its torque.
    rest = (slope - slope.T).reshape(UNKNOWNS, 3, UNKNOWNS, 3)
    rest[world.frames.rotations, :, world.frames.rotations] = 0.0
    np.testing.assert_allclose(rest, 0.0, atol=1e-6 * np.abs(K).max())


def test_the_projected_stiffness_is_never_negative(world, kind, rest_length):
    first, second, offsets = ends(world, kind)
    term, matrix = world.springs(first, second, 60.0, rest_length, offsets=offsets)
    K = stiffness_of(term, matrix, shaken(world), projected=True)
    values = np.linalg.eigvalsh(K)
    assert values.min() > -1e-13 * values.max()
    assert values.max() > 10.0


def test_a_pressed_spring_is_indefinite_unless_projected(world):
    term, matrix = world.springs(world.nodes(1), world.nodes(2), 60.0, 5.0)
    assert np.linalg.eigvalsh(stiffness_of(term, matrix, world.positions)).min() < -1.0


def test_springs_between_bodies_add_neither_force_nor_torque(world):
    for first, second in (
        (world.frames.points(2, POINTS), world.frames.points(0, POINTS[::-1])),
        (world.soft(1, 2, 3, 4, 2, 3, 4, 5, 1, 2, 6, 7), world.frames.points(0, POINTS)),
    ):
        term, _ = world.springs(first, second, 60.0, 0.1, 2.0)
        term.begin_step(world.positions, np.zeros((UNKNOWNS, 3)), 0.1)
        x = shaken(world)
        forces = forces_of(term, x)
        soft, (t, w) = forces[:SOFT_FREE], (world.frames.translations, world.frames.rotations)
        total = soft.sum(axis=0) + forces[t].sum(axis=0)
        torque = np.cross(x[1:SOFT], soft).sum(axis=0) + forces[w].sum(axis=0)
        torque += np.cross(x[world.frames.origins], forces[t]).sum(axis=0)
        assert np.abs(forces).max() > 1.0
        np.testing.assert_allclose([total, torque], 0.0, atol=1e-11)


def test_a_spring_between_two_points_of_one_rigid_body_does_nothing(world):
    points = world.frames.points(0, POINTS)
    first, second = (BarycentricMapping(points.nodes[i], points.barycentric_weights[i])
                     for i in ([0, 1], [1, 2]))  # fmt: skip
    term, matrix = world.springs(first, second, 60.0, 0.01)
    x = shaken(world)
    assert term.energy(x) > 0.1
    np.testing.assert_allclose(forces_of(term, x), 0.0, atol=1e-13)
    np.testing.assert_allclose(stiffness_of(term, matrix, x), 0.0, atol=1e-13)


def test_a_spring_without_length_and_rest_length_is_a_linear_one(world):
    x = world.positions
    term, matrix = world.springs(
        world.nodes(1), None, 60.0, 0.0, offsets=x[[1]]
    )
    np.testing.assert_array_equal(forces_of(term, x), 0.0)
    K = stiffness_of(term, matrix, x)
    np.testing.assert_array_equal(K[:3, :3], 60.0 * np.eye(3))
    away = x.copy()
    away[1] += [1e-12, 2e-12, 0.03]
    np.testing.assert_allclose(forces_of(term, away)[0], 60.0 * (x - away)[1], rtol=1e-12)
    np.testing.assert_allclose(stiffness_of(term, matrix, away), K, atol=1e-12)


def test_a_spring_pressed_to_no_length_pushes_nowhere_and_stays_finite(world):
    term, matrix = world.springs(world.nodes(1), None, 60.0, 0.5, offsets=world.positions[[1]])
    np.testing.assert_array_equal(forces_of(term, world.positions), 0.0)
    K = stiffness_of(term, matrix, world.positions)
    np.testing.assert_array_equal(K[:3, :3], 60.0 * np.eye(3))


def test_a_damper_takes_from_the_motion_and_rests_with_it(world, kind):
    first, second, offsets = ends(world, kind)
    damping = np.linspace(2.0, 3.0, first.point_count)
    term, _ = world.springs(first, second, 0.0, 1.0, damping, offsets=offsets)
    x = shaken(world)
    assert not forces_of(term, x).any()
    h = 0.05
    term.begin_step(world.positions, np.zeros((UNKNOWNS, 3)), h)
    np.testing.assert_array_equal(forces_of(term, world.positions), 0.0)
    # The work on a small further motion is minus the damping of the lengthening so far.
    move = np.random.default_rng(6).standard_normal((UNKNOWNS, 3))
    at, step = world._replace(positions=x), 1e-6
    faster = (term.lengths(at.moved(move, step)) - term.lengths(at.moved(move, -step))) / (2 * step)
    rate = (term.lengths(x) - term.lengths(world.positions)) / h
    assert np.sum(forces_of(term, x) * move) == pytest.approx(-np.sum(damping * rate * faster))


def test_a_spring_does_not_turn_what_it_pulls_at_the_centre(world):
    term, _ = world.springs(
        world.frames.points(0, [[0.0, 0.0, 0.0]]), None, 60.0, 0.1, offsets=[[1.0, 1.0, 1.0]]
    )
    forces = forces_of(term, world.positions)
    assert np.linalg.norm(forces[world.frames.translations[0]]) > 1.0
    np.testing.assert_array_equal(forces[world.frames.rotations], 0.0)


def test_springs_along_a_path_are_as_stiff_as_the_path_however_it_is_cut(world):
    ends_of_path = world.positions[[1, 2]]
    x = np.vstack([world.positions, np.linspace(*ends_of_path, 6)[[1, 1, 3]]])
    free_index = np.concatenate([world.free_index, [-1, -1, -1]])
    count = len(world.positions)
    path = world.nodes(1, count, count + 1, count + 2, 2)
    term = springs_along(path, 100.0, x, free_index, world.frames, damping=5.0)
    assert term.spring_count == 3
    assert term.energy(x) == pytest.approx(0.0, abs=1e-20)
    length = np.linalg.norm(ends_of_path[1] - ends_of_path[0])
    assert 1.0 / np.sum(1.0 / term.stiffness) == pytest.approx(100.0 / length)
    assert 1.0 / np.sum(1.0 / term.damping) == pytest.approx(5.0 / length)
    stretched = 1.01 * x
    assert term.energy(stretched) == pytest.approx(0.5 * 100.0 / length * (0.01 * length) ** 2)


def test_a_hung_chain_of_masses_carries_the_weight_below_each_spring():
    count, weight = 4, np.array([0.0, 0.0, -2.0])
    x = np.zeros((count + 1, 3))
    x[:, 2] = -0.1 * np.arange(count + 1)
    free_index = np.arange(-1, count)
    path = BarycentricMapping(np.arange(count + 1)[:, None], np.ones((count + 1, 1)))
    springs = springs_along(path, 50.0, x, free_index)
    weights = Gravity(np.ones(count), weight)
    matrix = SuperLU(*stencil_pairs(springs.stencils()), count)
    springs.bind(matrix.elimination_rank, matrix.slots)
    positions = x.copy()
    for _ in range(40):
        forces = np.zeros((count, 3))
        matrix.clear()
        for term in (springs, weights):
            if term is weights:
                term.add_forces(positions, forces)
            else:
                term.add(positions, forces, matrix.storage, True)
        K = matrix.matrix().toarray() + 1e-9 * np.eye(3 * count)
        positions[1:] += np.linalg.solve(K, forces.ravel()).reshape(-1, 3)
    tensions = springs.stiffness * (springs.lengths(positions) - springs.rest_lengths)
    np.testing.assert_allclose(tensions, 2.0 * np.arange(count, 0, -1), rtol=1e-6)


def test_ends_that_do_not_fit_are_refused(world):
    with pytest.raises(ValueError, match="2 first ends, 1 second ends"):
        world.springs(world.nodes(1, 2), world.nodes(3), 1.0, 0.0)
    with pytest.raises(ValueError, match="points in the world"):
        world.springs(world.nodes(1, 2), None, 1.0, 0.0)


def test_springs_between_what_does_not_move_add_nothing(world):
    term, matrix = world.springs(
        world.frames.points(1, POINTS[:1]), None, 60.0, 0.0, 1.0, offsets=[[0.0, 0.0, 0.0]]
    )
    assert term.energy(world.positions) > 0.1
    assert not forces_of(term, world.positions).any()
    assert not stiffness_of(term, matrix, world.positions).any()
