"""Facts of a factorization with a few rows that couple many unknowns."""

import numpy as np
import pytest

from softrobot_twin.solvers.dense_stiffness import DenseStiffness
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import SuperLU


@pytest.mark.parametrize("kind", [Multifrontal, SuperLU])
def test_it_condenses_and_solves_as_the_whole_matrix(kind):
    random, n = np.random.default_rng(4), 12
    rows = np.concatenate([np.arange(n), np.arange(1, n)])
    columns = np.concatenate([np.arange(n), np.arange(n - 1)])
    inner = kind(rows, columns, n)
    rank = inner.elimination_rank
    for r, c in zip(rows, columns, strict=True):
        r, c = (r, c) if rank[r] >= rank[c] else (c, r)
        place, stride = inner.slots(np.array([r]), np.array([c]))
        block = 9.0 * np.eye(3) if r == c else random.uniform(-1, 1, (3, 3))
        for i in range(3):
            for j in range(3):
                inner.storage[place + i + j * stride] = block[i, j]
    whole = DenseStiffness(inner)
    dense = NodeRows(np.repeat([0, 1], n), np.tile(np.arange(n), 2),
                     random.standard_normal((2 * n, 3)), 2)  # fmt: skip
    stiffness = np.array([30.0, 0.4])
    whole.prepare_rows(np.arange(n), 5)
    whole.set_rows(dense, stiffness)
    assert whole.factor()
    b = random.standard_normal((n, 3))
    A = np.linalg.inv(np.column_stack([
        inner.solve(unit.reshape(n, 3)).ravel().copy() for unit in np.eye(3 * n)
    ]))  # fmt: skip
    S = dense.transposed(n)
    A += S @ np.diag(stiffness) @ S.T
    H = NodeRows(np.array([0, 1, 1]), np.array([3, 0, 7]), random.standard_normal((3, 3)), 2)
    Ht = H.transposed(n)
    found, multipliers = whole.condense(H, b), np.array([0.3, -2.0])
    np.testing.assert_allclose(found.W, Ht.T @ np.linalg.solve(A, Ht), atol=1e-12)
    np.testing.assert_allclose(found.free, Ht.T @ np.linalg.solve(A, b.ravel()), atol=1e-12)
    np.testing.assert_allclose(
        whole.expand(multipliers).ravel(), np.linalg.solve(A, b.ravel() + Ht @ multipliers),
        atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(whole.solve(b).ravel(), np.linalg.solve(A, b.ravel()), atol=1e-12)
