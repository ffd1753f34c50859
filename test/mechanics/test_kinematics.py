"""How nodes follow from unknowns: moves, displacements, and what carried points give to them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.cable import CablePath, Cables
from softrobot_twin.constraints.effector import EffectorPoints, Effectors
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.elements import Elements
from softrobot_twin.mechanics.inertia import MassDamping
from softrobot_twin.mechanics.kinematics import (
    CarriedPoints,
    CarriedRows,
    Nodes,
    on_unknowns,
    size_of_body,
    size_of_points,
)
from softrobot_twin.mechanics.laws.corotational import Corotational
from softrobot_twin.mechanics.laws.small_displacement import SmallDisplacement
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.rigid_bodies import AttachedNodes, RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU
from test.finite_differences import MovedFrames

UNKNOWNS = 6
FREE_POINTS = 3
POINTS = np.array([[0.1, 0.2, -0.3], [0.0, 0.0, 0.0], [2.0, -1.0, 0.5]])


def carried(frames):
    return CarriedPoints(UNKNOWNS, (frames,))


@pytest.fixture
def frames():
    """Two free bodies with a guided one between, behind two free nodes and a fixed one."""
    return RigidFrames(3, [True, False, True], 2, UNKNOWNS)


@pytest.fixture
def positions(frames):
    soft = np.random.default_rng(0).standard_normal((3, 3))
    poses = [
        ([1.0, 2.0, 3.0], rotation_from_vector([0.4, 2.0, 0.1])),
        ([0.0, 0.1, 0.0], rotation_from_vector([0.0, 2.0, 0.1])),
        ([-1.0, 0.3, 0.2], rotation_from_vector([-1.0, 0.5, 0.1])),
    ]
    return np.vstack([soft, frames.rest_nodes(poses)])


@pytest.fixture
def entries(frames):
    """Rows of a smooth function: δ_p = ½‖x_p‖² of points on all bodies, as entries of H."""
    free_index = np.concatenate([[0, -1, 1], frames.free_index()])
    mappings = [frames.points(body, POINTS) for body in range(3)]
    soft = BarycentricMapping(np.array([[0, 1, 2, 2]]), np.array([[0.2, 0.3, 0.5, 0.0]]))
    mapping = BarycentricMapping(
        np.vstack([m.nodes for m in (*mappings, soft)]),
        np.vstack([m.barycentric_weights for m in (*mappings, soft)]),
    )

    def evaluate(x):
        points = mapping.positions(x)
        index = free_index[mapping.nodes]
        kept = index >= 0
        rows = np.repeat(np.arange(len(points)), kept.sum(axis=1))
        blocks = mapping.barycentric_weights[:, :, None] * points[:, None, :]
        return 0.5 * np.sum(points**2, axis=1), (rows, index[kept], blocks[kept])

    return evaluate


def dense(rows, row_count):
    H = np.zeros((row_count, UNKNOWNS, 3))
    used = slice(0, rows.count)
    np.add.at(H, (rows.row_index[used], rows.node_index[used]), rows.blocks[used])
    return H


def moved(frames, positions, unknown, axis, step):
    x, move = positions.copy(), np.zeros((UNKNOWNS, 3))
    move[unknown, axis] = step
    x[[0, 2]] += move[:2]
    frames.advance(x, move, 1.0)
    return x


def test_rows_are_the_derivative_by_translation_and_rotation(frames, positions, entries):
    values, parts = entries(positions)
    rows = CarriedRows(carried(frames), len(parts[0]))
    rows.reduce(positions, *parts)
    H, step = dense(rows, len(values)), 1e-6
    for unknown in range(UNKNOWNS):
        for axis in range(3):
            ahead, _ = entries(moved(frames, positions, unknown, axis, step))
            behind, _ = entries(moved(frames, positions, unknown, axis, -step))
            slope = (ahead - behind) / (2 * step)
            np.testing.assert_allclose(H[:, unknown, axis], slope, atol=1e-8)
    assert np.abs(H[:, 2:]).max() > 1.0


def test_rows_of_effectors_on_rigid_bodies_are_their_derivative(frames, positions):
    free_index = np.concatenate([[0, -1, 1], frames.free_index()])
    effector = EffectorPoints("tip", frames.points(2, POINTS), (0, 1, 2), 1.0)
    term = Effectors((effector,), free_index)
    rows = CarriedRows(carried(frames), len(term.entry_rows))
    blocks, values = term.rows_at(positions)
    rows.reduce(positions, term.entry_rows, term.entry_nodes, blocks)
    H, step = dense(rows, term.row_count), 1e-6
    for unknown in (4, 5):
        for axis in range(3):
            ahead, behind = (
                term.positions(moved(frames, positions, unknown, axis, s)) for s in (step, -step)
            )
            slope = (ahead - behind).ravel() / (2 * step)
            np.testing.assert_allclose(H[:, unknown, axis], slope, atol=1e-9)


def test_a_cable_from_soft_to_rigid_bodies_has_rows_that_are_its_derivative(frames, positions):
    free_index = np.concatenate([[0, -1, 1], frames.free_index()])
    soft = BarycentricMapping(np.array([[0, 1, 2, 2]]), np.array([[0.2, 0.3, 0.5, 0.0]]))
    points = soft.followed_by(frames.points(0, POINTS)).followed_by(frames.points(2, POINTS[:1]))
    path = CablePath("c", points, np.array([0.5, 0.5, 0.5]))
    term = Cables((path,), free_index, positions)
    rows = CarriedRows(carried(frames), len(term.entry_rows))
    blocks, values = term.rows_at(positions)
    rows.reduce(positions, term.entry_rows, term.entry_nodes, blocks)
    H, step = dense(rows, 1), 1e-6
    for unknown in range(UNKNOWNS):
        for axis in range(3):
            ahead, behind = (
                term.lengths(moved(frames, positions, unknown, axis, s)) for s in (step, -step)
            )
            assert H[0, unknown, axis] == pytest.approx(-(ahead - behind)[0] / (2 * step), abs=1e-8)


class Attached(MovedFrames):
    """Two free nodes and a fixed one, two free rigid bodies; two nodes are attached to each."""

    unknown_count = UNKNOWNS

    def __init__(self):
        rng = np.random.default_rng(3)
        nodes, bodies = np.array([3, 4, 5, 6]), np.array([0, 0, 1, 1])
        local = rng.uniform(-0.5, 0.5, (4, 3))
        self.frames = RigidFrames(
            7, [True, True], 2, UNKNOWNS, [1.0, 1.0], AttachedNodes(nodes, bodies, local)
        )
        self.points = CarriedPoints(UNKNOWNS, (self.frames,))
        self.free_index = np.concatenate(
            [[0, -1, 1], self.frames.attached_index(), self.frames.free_index()]
        )
        poses = [(rng.standard_normal(3), rotation_from_vector(rng.standard_normal(3)))
                 for _ in range(2)]  # fmt: skip
        self.rest = np.vstack([rng.standard_normal((7, 3)), self.frames.rest_nodes(poses)])
        place = rng.uniform(-0.02, 0.02, (UNKNOWNS, 3))
        self.rest = self.moved(self.rest, 0.0 * place)
        self.frames.advance(self.rest, 1e-9 * place, 1.0)
        self.state = self.moved(self.rest, place)

    def mesh(self):
        tets = np.array([[0, 2, 3, 4], [1, 3, 4, 5], [0, 3, 5, 6], [2, 4, 5, 6], [0, 1, 2, 6]])
        corners = self.rest[tets]
        volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
        tets[volumes < 0.0] = tets[volumes < 0.0][:, [1, 0, 2, 3]]
        return TetMesh(self.rest, tets)

    def terms(self):
        mesh, lame = self.mesh(), lame_parameters(10.0, 0.3)
        masses = MassDamping(np.arange(3, 7), self.free_index[3:7], np.arange(1.0, 5.0), 0.7)
        masses.begin_step(self.rest, np.zeros((len(self.rest), 3)), 0.1)
        masses.begin_step = lambda x, v, h: None
        return {
            "corotational": Elements(mesh, self.free_index, Corotational(*lame)),
            "linear": Elements(mesh, self.free_index, SmallDisplacement(*lame)),
            "masses": masses,
        }

    def bound(self, term):
        matrix = SuperLU(*stencil_pairs(term.stencils()), UNKNOWNS)
        term.bind(matrix.elimination_rank, matrix.slots)
        matrix.clear()
        return matrix


@pytest.fixture
def attached():
    return Attached()


def symmetric_part(slope):
    return 0.5 * (slope + slope.T)


@pytest.mark.parametrize("kind", ["corotational", "linear", "masses"])
def test_elements_at_attached_nodes_have_forces_and_stiffness_of_the_rigid_bodies(attached, kind):
    term = on_unknowns(attached.terms()[kind], attached.points)
    matrix = attached.bound(term)

    def forces(x):
        out = np.zeros((UNKNOWNS, 3))
        term.add_forces(x, out)
        return out

    if kind != "masses":
        slope = attached.slopes(term.energy).reshape(-1, 3)
        np.testing.assert_allclose(forces(attached.state), -slope, atol=1e-6)
        assert np.abs(slope[2:]).max() > 0.1
    added = np.zeros((UNKNOWNS, 3))
    term.add(attached.state, added, matrix.storage, False)
    np.testing.assert_array_equal(added, forces(attached.state))
    K = matrix.matrix().toarray()
    expected = symmetric_part(-attached.slopes(forces))
    np.testing.assert_allclose(K, expected, atol=1e-7 * np.abs(K).max())
    matrix.clear()
    term.add(attached.state, added, matrix.storage, True)
    values = np.linalg.eigvalsh(matrix.matrix().toarray())
    assert values.min() > -1e-10 * values.max()


def test_cables_on_rigid_bodies_have_the_stiffness_of_their_turning_forces(attached):
    """Pull point on one body, guide points on another, on soft and on attached nodes."""
    soft = BarycentricMapping(np.array([[0, 1, 2, 4]]), np.array([[0.2, 0.3, 0.1, 0.4]]))
    points = attached.frames.points(0, POINTS[:1]).followed_by(soft)
    points = points.followed_by(attached.frames.points(1, POINTS[:2]))
    paths = (CablePath("on frames", points, None), CablePath("from world", points, np.ones(3)))
    term = Cables(paths, attached.free_index, attached.rest, attached.points)
    matrix = attached.bound(term)
    pulls = np.array([2.0, 3.0])
    rows = RowStack([term], attached.points)

    def forces(x):
        out = np.zeros((UNKNOWNS, 3))
        rows.evaluate(x)
        rows.add_forces(pulls, out)
        return out

    slope = attached.slopes(term.lengths)
    rows.evaluate(attached.state)
    H = np.zeros((2, UNKNOWNS, 3))
    np.add.at(H, (rows.row_index, rows.node_index), rows.blocks)
    np.testing.assert_allclose(H.reshape(2, -1), -slope, atol=1e-7)
    term.add_stiffness(attached.state, pulls, matrix.storage)
    K = matrix.matrix().toarray()
    assert np.abs(K[6:, 6:]).max() > 0.1
    expected = symmetric_part(-attached.slopes(forces))
    np.testing.assert_allclose(K, expected, atol=1e-7 * np.abs(K).max())
    matrix.clear()
    term.add_stiffness(attached.state, pulls, matrix.storage, projected=True)
    values = np.linalg.eigvalsh(matrix.matrix().toarray())
    assert values.min() > -1e-12 * values.max()


def test_a_move_of_carried_points_is_that_of_the_exact_rotation_to_first_order(attached):
    rng = np.random.default_rng(8)
    move = 1e-6 * rng.standard_normal((UNKNOWNS, 3))
    moves = attached.points.point_moves(attached.state, move)
    made = attached.moved(attached.state, move) - attached.state
    moving = attached.free_index >= 0
    np.testing.assert_allclose(moves[attached.free_index[moving]], made[moving], atol=1e-11)


@pytest.fixture
def nodes():
    """Three points, the last of four nodes held; without rigid bodies, and with two of them."""
    rest = np.zeros((4, 3))
    free, index = np.arange(FREE_POINTS), np.array([0, 1, 2, -1])
    plain = Nodes(rest, free, index, FREE_POINTS, 1.0)
    frames = RigidFrames(4, [True, True], FREE_POINTS, FREE_POINTS + 4, np.array([0.5, 2.0]))
    rest = np.vstack([rest, RigidFrames.rest_nodes([(np.zeros(3), np.eye(3))] * 2)])
    index = np.concatenate([index, frames.free_index()])
    return plain, Nodes(rest, free, index, FREE_POINTS + 4, 1.0, (frames,))


def largest_force(nodes, forces):
    largest = np.empty(1)
    nodes.write_largest(forces, True, largest)
    return largest[0]


def test_rotation_counts_by_the_displacement_of_the_rim(nodes):
    framed, move = nodes[1], np.zeros((FREE_POINTS + 4, 3))
    move[0], move[FREE_POINTS + 3] = [0.0, 0.3, 0.4], [0.0, 0.0, 0.3]
    assert framed.longest(move) == pytest.approx(0.6)
    assert largest_force(framed, move) == pytest.approx(0.5)
    move[FREE_POINTS + 1] = [0.4, 0.0, 0.3]
    assert framed.longest(move) == pytest.approx(0.6)
    assert largest_force(framed, move) == pytest.approx(1.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_nan_anywhere_makes_the_longest_displacement_nan(nodes, bad):
    for kind in nodes:
        for place in np.ndindex(kind.free_node_count, 3):
            move = np.ones((kind.free_node_count, 3))
            move[place] = bad
            assert not np.isfinite(kind.longest(move))
            assert not np.isfinite(largest_force(kind, move))


def test_the_move_between_two_states_leads_from_one_to_the_other(nodes):
    rng = np.random.default_rng(0)
    for kind in nodes:
        before, move = kind.rest_positions.copy(), rng.normal(size=(kind.free_node_count, 3))
        after = before.copy()
        kind.advance(after, move, 0.5)
        np.testing.assert_allclose(kind.displacement(before, after), 0.5 * move, atol=1e-14)
        np.testing.assert_array_equal(after[3], before[3])


def test_the_size_of_a_box_is_its_diagonal_wherever_it_is_and_however_it_is_turned(block):
    mesh = block(size=(0.02, 0.03, 0.1), cells=(1, 1, 5))
    turn = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    moved = mesh.node_positions @ turn.T + [3.0, -2.0, 1.0]
    diagonal = np.sqrt(0.02**2 + 0.03**2 + 0.1**2)
    assert size_of_body(mesh.node_positions, mesh.cells) == pytest.approx(diagonal, rel=1e-12)
    assert size_of_body(moved, mesh.cells) == pytest.approx(diagonal, rel=1e-12)
    corners = np.array([[x, y, z] for x in (0.0, 0.02) for y in (0.0, 0.03) for z in (0.0, 0.1)])
    assert size_of_points(corners @ turn.T + 5.0) == pytest.approx(diagonal, rel=1e-12)
    assert size_of_points(np.ones((1, 3))) == 0.0
