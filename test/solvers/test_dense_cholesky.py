"""Facts of the dense Cholesky factorization, against SuperLU on the same matrix."""

import numpy as np
import pytest

from softrobot_twin.solvers.dense_cholesky import DenseCholesky
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.superlu import SuperLU

COUNT = 7
PAIRS = np.tril_indices(COUNT)


def filled(made_by, matrix):
    """A factorization with all lower blocks of a matrix."""
    made = made_by(*PAIRS, COUNT)
    offsets, strides = made.slots(*PAIRS)
    for (a, b), o, stride in zip(np.transpose(PAIRS), offsets, strides, strict=True):
        for j in range(3):
            made.storage[o + j * stride : o + j * stride + 3] += matrix[
                3 * a : 3 * a + 3, 3 * b + j
            ]
    return made


@pytest.fixture
def seeded():
    seed = int(np.random.SeedSequence().entropy % 2**32)
    print(f"seed {seed}")
    return np.random.default_rng(seed)


@pytest.fixture
def problem(seeded):
    """A positive definite matrix, rows with repeated entries, and forces."""
    root = seeded.standard_normal((3 * COUNT, 3 * COUNT))
    matrix = root @ root.T + np.eye(3 * COUNT)
    rows = NodeRows(
        seeded.integers(0, 4, 20), seeded.integers(0, COUNT, 20), seeded.standard_normal((20, 3)), 4
    )
    return matrix, rows, seeded.standard_normal((COUNT, 3))


def test_it_condenses_expands_and_solves_as_superlu_does(problem):
    matrix, H, b = problem
    dense, sparse = filled(DenseCholesky, matrix), filled(SuperLU, matrix)
    assert dense.factor() and sparse.factor()
    found, expected = dense.condense(H, b), sparse.condense(H, b)
    np.testing.assert_allclose(found.W, expected.W, atol=1e-10 * np.abs(expected.W).max())
    np.testing.assert_allclose(found.free, expected.free, atol=1e-10)
    multipliers = np.array([1.0, -2.0, 0.5, 3.0])
    np.testing.assert_allclose(
        dense.expand(multipliers), sparse.expand(multipliers), atol=1e-10
    )
    np.testing.assert_allclose(dense.solve(b), sparse.solve(b), atol=1e-10)
    np.testing.assert_allclose(dense.matrix().toarray(), matrix, atol=1e-12)


def test_many_rows_are_condensed_by_a_factor_of_low_rank(problem, seeded):
    matrix, few, b = problem
    dense = filled(DenseCholesky, matrix)
    assert dense.factor()
    assert dense.condense_low_rank(few, b) is None
    count = 6 * COUNT
    H = NodeRows(
        np.arange(count), seeded.integers(0, COUNT, count), seeded.standard_normal((count, 3)), count
    )
    low, whole = dense.condense_low_rank(H, b), dense.condense(H, b)
    np.testing.assert_allclose(low.Yt @ low.Yt.T, whole.W, atol=1e-10 * np.abs(whole.W).max())
    np.testing.assert_allclose(low.free, whole.free, atol=1e-10)


def test_a_matrix_that_is_not_positive_definite_is_refused(problem):
    matrix, _, _ = problem
    for spoilt in (matrix - 2.0 * np.linalg.eigvalsh(matrix)[3] * np.eye(3 * COUNT),
                   np.where(np.eye(3 * COUNT) > 0, np.nan, matrix)):  # fmt: skip
        assert not filled(DenseCholesky, spoilt).factor()


def test_blocks_above_the_diagonal_are_refused():
    made = DenseCholesky(*PAIRS, COUNT)
    with pytest.raises(ValueError, match="above the diagonal"):
        made.slots(np.array([0]), np.array([1]))
    with pytest.raises(ValueError, match="outside the pattern"):
        made.slots(np.array([COUNT]), np.array([0]))
