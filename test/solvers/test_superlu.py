"""Facts of the SuperLU factorization, the oracle of the others."""

import numpy as np
import pytest

from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.superlu import SuperLU

pytestmark = pytest.mark.libraries


def assembled(count, seed, shift=1.0):
    """A random sparse positive definite block matrix, put together through the slots."""
    rng = np.random.default_rng(seed)
    rows, columns = rng.integers(0, count, (2, 3 * count))
    solver = SuperLU(rows, columns, count)
    A = np.zeros((3 * count, 3 * count))
    solver.clear()
    for a, b in zip(rows, columns, strict=True):
        c = rng.standard_normal(6) if a != b else rng.standard_normal(3)
        nodes = [max(a, b), min(a, b)] if a != b else [a]
        K = np.outer(c, c)
        index = np.concatenate([3 * node + np.arange(3) for node in nodes])
        A[np.ix_(index, index)] += K
        for i, row in enumerate(nodes):
            for j in range(i, len(nodes)):
                # nodes are sorted downwards, so (i, j) is a lower block
                put(solver, row, nodes[j], K[3 * i : 3 * i + 3, 3 * j : 3 * j + 3])
    for node in range(count):
        put(solver, node, node, shift * np.eye(3))
        A[3 * node : 3 * node + 3, 3 * node : 3 * node + 3] += shift * np.eye(3)
    return solver, A


def put(solver, row, column, block):
    offset, stride = solver.slots(np.array(row), np.array(column))
    for j in range(3):
        for i in range(3):
            solver.storage[offset + i + j * stride] += block[i, j]


@pytest.mark.parametrize("count, seed", [(1, 0), (2, 1), (7, 2), (40, 3)])
def test_slots_assemble_the_matrix_and_solve_inverts_it(count, seed):
    solver, A = assembled(count, seed)
    np.testing.assert_allclose(solver.matrix().toarray(), A, atol=1e-12)
    assert solver.factor()
    b = np.random.default_rng(9).standard_normal((count, 3))
    np.testing.assert_allclose(A @ solver.solve(b).ravel(), b.ravel(), atol=1e-9)


def test_condensing_and_expanding_agree_with_dense_algebra():
    solver, A = assembled(12, 5)
    rng = np.random.default_rng(0)
    H = NodeRows(
        np.array([0, 0, 1, 2, 2, 2]), np.array([3, 3, 7, 0, 11, 5]), rng.standard_normal((6, 3)), 3
    )
    dense = H.transposed(12).T
    b = rng.standard_normal((12, 3))
    assert solver.factor()
    condensed = solver.condense(H, b)
    inverse = np.linalg.inv(A)
    np.testing.assert_allclose(condensed.W, dense @ inverse @ dense.T, atol=1e-12)
    np.testing.assert_allclose(condensed.free, dense @ inverse @ b.ravel(), atol=1e-12)
    multipliers = np.array([0.3, -1.0, 2.0])
    np.testing.assert_allclose(
        solver.expand(multipliers).ravel(),
        inverse @ (b.ravel() + dense.T @ multipliers),
        atol=1e-12,
    )


def test_a_matrix_that_is_not_positive_definite_is_reported():
    solver, _ = assembled(10, 6, shift=-0.5)
    assert not solver.factor()


def test_a_singular_or_non_finite_matrix_is_reported():
    solver = SuperLU(np.array([0]), np.array([1]), 2)
    solver.clear()
    assert not solver.factor()
    solver.storage[:] = np.nan
    assert not solver.factor()


def test_blocks_above_the_diagonal_or_outside_the_pattern_are_refused():
    solver = SuperLU(np.array([0]), np.array([1]), 3)
    with pytest.raises(ValueError, match="above"):
        solver.slots(np.array([0]), np.array([1]))
    with pytest.raises(ValueError, match="outside"):
        solver.slots(np.array([2]), np.array([0]))


def test_row_counts_change_from_step_to_step():
    solver, A = assembled(12, 7)
    rng = np.random.default_rng(1)
    assert solver.factor()
    for count in (2, 0, 9, 1):
        entries = 3 * count
        H = NodeRows(
            rng.integers(0, max(count, 1), entries), rng.integers(0, 12, entries),
            rng.standard_normal((entries, 3)), count,
        )  # fmt: skip
        b, dense = rng.standard_normal((12, 3)), H.transposed(12)
        condensed = solver.condense(H, b)
        expected = dense.T @ np.linalg.solve(A, np.column_stack([dense, b.ravel()]))
        np.testing.assert_allclose(condensed.W, expected[:, :-1], atol=1e-12)
        np.testing.assert_allclose(condensed.free, expected[:, -1], atol=1e-12)
        wanted = np.linalg.solve(A, b.ravel() + dense.sum(axis=1))
        np.testing.assert_allclose(solver.expand(np.ones(count)).ravel(), wanted, atol=1e-12)
