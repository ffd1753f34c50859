"""Systems to factorize: random positive definite block matrices on many patterns."""

import numpy as np
import pytest

from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal import Multifrontal
from test.builder import builder


def chain(count):
    return np.arange(count - 1), np.arange(1, count), count


def grid(*shape):
    index = np.arange(np.prod(shape)).reshape(shape)
    pairs = [
        (index[:-1].ravel(), index[1:].ravel()),
        (index[:, :-1].ravel(), index[:, 1:].ravel()),
        (index[..., :-1].ravel(), index[..., 1:].ravel()),
    ]
    return *(np.concatenate(side) for side in zip(*pairs, strict=True)), index.size


def random_graph(count, seed, mean_degree=4):
    rng = np.random.default_rng(seed)
    return *rng.integers(0, count, (2, count * mean_degree // 2)), count


def star(count):
    return np.zeros(count, dtype=int), np.arange(count), count


def complete(count):
    rows, columns = np.divmod(np.arange(count * count), count)
    return rows, columns, count


def side_by_side(*patterns):
    start, rows, columns = 0, [], []
    for r, c, count in patterns:
        rows.append(r + start)
        columns.append(c + start)
        start += count
    return np.concatenate(rows), np.concatenate(columns), start


PATTERNS = {
    "one node": chain(1), "two nodes": chain(2), "three nodes": chain(3),
    "two nodes apart": (np.zeros(0, int), np.zeros(0, int), 2), "chain": chain(40),
    "star": star(30), "complete": complete(23), "grid": grid(5, 6, 7), "slab": grid(2, 9, 11),
    "two bodies": side_by_side(grid(3, 4, 5), grid(2, 3, 6)),
    "body, rod and isolated nodes": side_by_side(
        grid(3, 3, 3), chain(9), chain(1), random_graph(30, 7), chain(1)
    ),
    **{f"random {seed}": random_graph(10 + 17 * seed, seed, 2 + seed % 5) for seed in range(8)},
}  # fmt: skip


class System:
    """A random symmetric positive definite matrix of 3×3 blocks, dense, on a pattern."""

    def __init__(self, pattern, seed=0, **options):
        self.rows, self.columns, self.count = pattern
        self.rng = np.random.default_rng(seed)
        size = 3 * self.count
        weight = np.zeros((self.count, self.count))
        weight[self.rows, self.columns] = weight[self.columns, self.rows] = 1.0
        np.fill_diagonal(weight, 1.0)
        A = self.rng.standard_normal((size, size)) * np.kron(weight, np.ones((3, 3)))
        A = 0.5 * (A + A.T)
        self.A = A + np.diag(np.abs(A).sum(axis=1) + 0.1)
        self.solver = Multifrontal(self.rows, self.columns, self.count, **options)
        self.assemble()

    def assemble(self, A=None):
        A = self.A if A is None else A
        blocks = A.reshape(self.count, 3, self.count, 3).transpose(0, 2, 3, 1)  # columns first
        rank = self.solver.elimination_rank
        r = np.concatenate([self.rows, self.columns, np.arange(self.count)])
        c = np.concatenate([self.columns, self.rows, np.arange(self.count)])
        lower = rank[r] >= rank[c]
        offsets, strides = self.solver.slots(r[lower], c[lower])
        self.solver.clear()
        for i in range(3):
            for j in range(3):
                self.solver.storage[offsets + i + j * strides] = (blocks[r[lower], c[lower], j, i])

    def constraint_rows(self, row_count, entries=None):
        entries = 3 * row_count if entries is None else entries
        rng = self.rng
        return NodeRows(
            rng.integers(0, max(row_count, 1), entries), rng.integers(0, self.count, entries),
            rng.standard_normal((entries, 3)), row_count,
        )  # fmt: skip


@pytest.fixture(params=list(PATTERNS), ids=str)
def system(request):
    """One system after the other, on every pattern."""
    return System(PATTERNS[request.param])


@builder
def make_system(name, seed=0, **options):
    """Makes a system on a pattern, given by name."""
    return System(PATTERNS[name], seed, **options)
