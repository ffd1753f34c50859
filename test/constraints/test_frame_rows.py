"""Facts of rows on rigid bodies."""

import numpy as np
import pytest

from softrobot_twin.constraints.cable import CablePath, Cables
from softrobot_twin.constraints.effector import EffectorPoints, Effectors
from softrobot_twin.constraints.frame_rows import FrameRows
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.rigid_frames import RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU

UNKNOWNS = 6
POINTS = np.array([[0.1, 0.2, -0.3], [0.0, 0.0, 0.0], [2.0, -1.0, 0.5]])


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
    rows = FrameRows(frames, len(parts[0]))
    rows.reduce(positions, *parts)
    H, step = dense(rows, len(values)), 1e-6
    for unknown in range(UNKNOWNS):
        for axis in range(3):
            ahead, _ = entries(moved(frames, positions, unknown, axis, step))
            behind, _ = entries(moved(frames, positions, unknown, axis, -step))
            slope = (ahead - behind) / (2 * step)
            np.testing.assert_allclose(H[:, unknown, axis], slope, atol=1e-8)
    assert np.abs(H[:, 2:]).max() > 1.0


def test_a_point_on_a_rigid_body_takes_two_entries(frames, positions, entries):
    _, parts = entries(positions)
    rows = FrameRows(frames, len(parts[0]))
    # Three points on each of two free bodies, and a soft one on two free nodes, one given twice.
    assert rows.reduce(positions, *parts) == 2 * 6 + 3
    assert np.all(rows.node_index[: rows.count] < UNKNOWNS)


def test_the_order_of_entries_does_not_matter(frames, positions, entries):
    values, parts = entries(positions)
    rows = FrameRows(frames, len(parts[0]))
    rows.reduce(positions, *parts)
    H = dense(rows, len(values))
    order = np.random.default_rng(5).permutation(len(parts[0]))
    rows.reduce(positions, *(part[order] for part in parts))
    np.testing.assert_allclose(dense(rows, len(values)), H, atol=1e-14)


def test_the_number_of_entries_may_change_from_call_to_call(frames, positions, entries):
    values, parts = entries(positions)
    rows = FrameRows(frames, 1)
    full = rows.reduce(positions, *parts)
    H = dense(rows, len(values))
    assert rows.reduce(positions, *(part[:0] for part in parts)) == 0
    assert not dense(rows, len(values)).any()
    assert rows.reduce(positions, *(part[:4] for part in parts)) == 2
    assert rows.reduce(positions, *parts) == full
    np.testing.assert_array_equal(dense(rows, len(values)), H)


def test_rows_of_effectors_on_rigid_bodies_are_their_derivative(frames, positions):
    free_index = np.concatenate([[0, -1, 1], frames.free_index()])
    effector = EffectorPoints("tip", frames.points(2, POINTS), (0, 1, 2), 1.0)
    term = Effectors((effector,), free_index, 1.0)
    rows = FrameRows(frames, len(term.entry_rows))
    blocks, values = np.empty((len(term.entry_rows), 3)), np.empty(term.row_count)
    term.evaluate(positions, blocks, values)
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
    # The stiffness of the pull stays with the soft nodes: frame nodes have no block of their own.
    matrix = SuperLU(*stencil_pairs(term.stencils(), UNKNOWNS), UNKNOWNS)
    term.bind(matrix.elimination_rank, matrix.slots)
    matrix.clear()
    term.add_stiffness(positions, np.array([2.0]), matrix.storage)
    K = matrix.matrix().toarray()
    assert K[:6, :6].any() and not K[6:].any()
    rows = FrameRows(frames, len(term.entry_rows))
    blocks, values = np.empty((len(term.entry_rows), 3)), np.empty(1)
    term.evaluate(positions, blocks, values)
    rows.reduce(positions, term.entry_rows, term.entry_nodes, blocks)
    H, step = dense(rows, 1), 1e-6
    for unknown in range(UNKNOWNS):
        for axis in range(3):
            ahead, behind = (
                term.lengths(moved(frames, positions, unknown, axis, s)) for s in (step, -step)
            )
            assert H[0, unknown, axis] == pytest.approx(-(ahead - behind)[0] / (2 * step), abs=1e-8)
