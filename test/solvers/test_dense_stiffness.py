"""Facts of a factorization with a few rows that couple many unknowns."""

import numpy as np
import pytest

from softrobot_twin.mechanics.force_term import NO_DENSE_ROWS, DenseRows
from softrobot_twin.solvers.dense_stiffness import NO_ROWS, DenseStiffness
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import SuperLU

pytestmark = pytest.mark.libraries


def coupled_chain(kind, random, n):
    """A factorization of a positive definite matrix of a chain of n nodes, and the matrix."""
    rows = np.concatenate([np.arange(n), np.arange(1, n)])
    columns = np.concatenate([np.arange(n), np.arange(n - 1)])
    inner = kind(rows, columns, n)
    rank, A = inner.elimination_rank, np.zeros((n, 3, n, 3))
    for r, c in zip(rows, columns, strict=True):
        r, c = (r, c) if rank[r] >= rank[c] else (c, r)
        place, stride = inner.slots(np.array([r]), np.array([c]))
        block = 9.0 * np.eye(3) if r == c else random.uniform(-1, 1, (3, 3))
        A[r, :, c], A[c, :, r] = block, block.T
        for i in range(3):
            for j in range(3):
                inner.storage[place + i + j * stride] = block[i, j]
    return inner, A.reshape(3 * n, 3 * n)


class Part:
    """A term with dense rows that reach all nodes."""

    def __init__(self, random, n, stiffness, scale=1.0):
        count = len(stiffness)
        self.dense_rows = DenseRows(
            np.repeat(np.arange(count), n), np.tile(np.arange(n), count),
            scale * random.standard_normal((count * n, 3)), np.array(stiffness),
        )  # fmt: skip

    def clear_dense_rows(self):
        self.dense_rows = NO_DENSE_ROWS

    def dense(self, n):
        rows = self.dense_rows
        S = NodeRows(*rows[:3], len(rows.stiffness)).transposed(n)
        return S @ np.diag(rows.stiffness) @ S.T


@pytest.mark.parametrize("kind", [Multifrontal, SuperLU])
def test_it_condenses_and_solves_as_the_whole_matrix(kind, drawn_rng):
    random, n = drawn_rng, 12
    inner, A = coupled_chain(kind, random, n)
    # Rows of both signs in each part: they are sorted.
    parts = [Part(random, n, [30.0, -0.02]), Part(random, n, [-0.03, 0.4])]
    whole = DenseStiffness(inner, parts)
    whole.prepare_rows(np.arange(n), 5)
    A += sum(part.dense(n) for part in parts)
    assert whole.factor()
    b = random.standard_normal((n, 3))
    H = NodeRows(np.array([0, 1, 1]), np.array([3, 0, 7]), random.standard_normal((3, 3)), 2)
    Ht = H.transposed(n)
    np.testing.assert_allclose(whole.solve(b).ravel(), np.linalg.solve(A, b.ravel()), atol=1e-11)
    found, multipliers = whole.condense(H, b), np.array([0.3, -2.0])
    np.testing.assert_allclose(found.W, Ht.T @ np.linalg.solve(A, Ht), atol=1e-11)
    np.testing.assert_allclose(found.free, Ht.T @ np.linalg.solve(A, b.ravel()), atol=1e-11)
    other = random.standard_normal((n, 3))
    np.testing.assert_allclose(whole.solve(other).ravel(), np.linalg.solve(A, other.ravel()), atol=1e-11)
    # What was condensed is still there after another system was solved.
    np.testing.assert_allclose(
        whole.expand(multipliers).ravel(), np.linalg.solve(A, b.ravel() + Ht @ multipliers),
        atol=1e-11,
    )  # fmt: skip


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_matrix_that_negative_rows_make_indefinite_is_told(share, drawn_rng):
    random, n = drawn_rng, 12
    inner, A = coupled_chain(Multifrontal, random, n)
    added, taken = Part(random, n, [3.0, 2.0]), Part(random, n, [-1.0])
    A += added.dense(n)
    S = NodeRows(*taken.dense_rows[:3], 1).transposed(n)
    # 1 - k S A⁻¹ Sᵀ is the pivot of the row.
    k = share / (S.T @ np.linalg.solve(A, S)).item()
    taken.dense_rows = taken.dense_rows._replace(stiffness=np.array([-k]))
    assert (np.linalg.eigvalsh(A - k * S @ S.T)[0] > 0.0) == (share < 1.0)
    whole = DenseStiffness(inner, [taken, added])
    assert whole.factor()
    if share < 1.0:
        whole.condense(NO_ROWS, np.zeros((n, 3)))
        return
    with pytest.raises(np.linalg.LinAlgError, match="indefinite"):
        whole.condense(NO_ROWS, np.zeros((n, 3)))
