"""Slopes of functions of positions."""

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU


def central_slopes(function, x, nodes, step):
    """Central differences of a function by each coordinate of some nodes, the last axis."""
    columns = []
    for node in nodes:
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += step
            behind[node, axis] -= step
            columns.append((function(ahead) - function(behind)) / (2.0 * step))
    return np.stack(columns, axis=-1)


def slots_of_dense(count):
    """Slots of a dense matrix of so many unknowns, column by column."""
    return lambda rows, columns: (3 * rows + 9 * count * columns, np.full(len(rows), 3 * count))


def forces_of(term, x, count):
    """Forces of a term on so many unknowns [N], without inverted elements."""
    forces = np.zeros((count, 3))
    assert term.add_forces(x, forces) == 0
    return forces


def assert_stiffness_of_forces(term, x, free_index, atol):
    """The stiffness of a term, bound by `slots_of_dense`, is the slope of its forces; returns it.

    Args:
        term: The force term.
        x: Positions of nodes.
        free_index: Unknown of each node, -1 where it is fixed.
        atol: Error that is allowed [N/m].
    """
    free = np.flatnonzero(free_index >= 0)
    storage = np.zeros(9 * len(free) ** 2)
    term.add(x, np.zeros((len(free), 3)), storage, False)
    lower = storage.reshape(3 * len(free), 3 * len(free)).T
    # Blocks below the diagonal in the elimination order stand for those above it, too.
    found = np.where(lower != 0.0, lower, lower.T)
    slopes = central_slopes(lambda at: forces_of(term, at, len(free)).ravel(), x, free, 1e-6)
    np.testing.assert_allclose(found, -slopes, rtol=1e-6, atol=atol)
    return found


class MovedFrames:
    """A base of two free nodes, 0 and 2, and frames, whose unknowns can be moved.

    It has `frames`, the `state` that slopes are taken at, and `unknown_count`.
    """

    def moved(self, positions, move):
        x, move = positions.copy(), np.array(move, float)
        x[[0, 2]] += move[:2]
        self.frames.advance(x, move, 1.0)
        return x

    def slopes(self, function, step=1e-6):
        """Derivative of a function by every unknown at the state, by differences."""
        columns = []
        for place in np.ndindex(self.unknown_count, 3):
            move = np.zeros((self.unknown_count, 3))
            move[place] = step
            ahead = function(self.moved(self.state, move))
            behind = function(self.moved(self.state, -move))
            columns.append((np.ravel(ahead) - np.ravel(behind)) / (2.0 * step))
        return np.array(columns).T


def assert_slopes_of_actuators(term, nodes, efforts, size, seed=5, bar=1e-6):
    """The rows of a term are the slopes of its displacements, its stiffness that of its forces.

    Rows of what does not conserve energy have no displacement; their stiffness is assembled in part.

    Args:
        term: The constraint term of actuators.
        nodes: All nodes of the scene.
        efforts: Efforts of its rows, shape (row_count,).
        size: About how far unknowns are moved from rest [m].
        seed: Of that move.
        bar: Error that is allowed, by the largest number.
    """
    count, free = nodes.free_node_count, np.arange(nodes.free_node_count)
    state = nodes.rest_positions.copy()
    nodes.advance(state, size * np.random.default_rng(seed).standard_normal((count, 3)), 1.0)
    pairs = stencil_pairs(term.stencils(), count)
    matrix = SuperLU(*(np.concatenate([free, side]) for side in pairs), count)
    term.bind(matrix.elimination_rank, matrix.slots)
    rows = RowStack([term], nodes.carried)

    def forces(at):
        out = np.zeros((count, 3))
        rows.evaluate(at)
        rows.add_forces(efforts, out)
        return out.ravel()

    def slopes(function):
        columns = []
        for place in np.ndindex(count, 3):
            step, ends = np.zeros((count, 3)), (state.copy(), state.copy())
            step[place] = 1e-4 * size
            for end, sign in zip(ends, (1.0, -1.0), strict=True):
                nodes.advance(end, step, sign)
            columns.append((function(ends[0]) - function(ends[1])) / (2e-4 * size))
        return np.stack(columns, axis=-1)

    def values(at):
        rows.evaluate(at)
        return rows.values.copy()

    rows.evaluate(state)
    H = np.zeros((term.row_count, count, 3))
    np.add.at(H, (rows.row_index, rows.node_index), rows.blocks)
    H = H.reshape(term.row_count, -1)
    np.testing.assert_allclose(forces(state), efforts @ H, atol=1e-12 * np.abs(efforts @ H).max())
    if term.conserves:
        np.testing.assert_allclose(H, slopes(values), atol=bar * np.abs(H).max())
    matrix.clear()
    term.add_stiffness(state, efforts, matrix.storage)
    K, expected = matrix.matrix().toarray(), -slopes(forces)
    lacking = term.lacking_stiffness(state, efforts, 3 * count)
    if lacking is None:
        expected = 0.5 * (expected + expected.T)
    else:
        K = K + lacking.toarray()
        # All terms leave out ½ [τ]ₓ of their torques τ, which are in balance at rest.
        for one in () if nodes.carried is None else np.unique(nodes.carried.turning_unknowns):
            own, torque = slice(3 * one, 3 * one + 3), forces(state).reshape(-1, 3)[one]
            expected[own, own] -= 0.5 * np.cross(torque, np.eye(3)).T
    np.testing.assert_allclose(K, expected, atol=bar * max(np.abs(expected).max(), 1e-9))
    return K
