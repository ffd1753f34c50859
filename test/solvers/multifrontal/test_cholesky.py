"""Facts of the multifrontal factorization as a step sees it."""

import numpy as np
import pytest
import scipy.sparse as sp

from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import SuperLU


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
    "one node": chain(1),
    "two nodes": chain(2),
    "three nodes": chain(3),
    "two nodes apart": (np.zeros(0, int), np.zeros(0, int), 2),
    "chain": chain(40),
    "star": star(30),
    "complete": complete(23),
    "grid": grid(5, 6, 7),
    "slab": grid(2, 9, 11),
    "two bodies": side_by_side(grid(3, 4, 5), grid(2, 3, 6)),
    "body, rod and isolated nodes": side_by_side(
        grid(3, 3, 3), chain(9), chain(1), random_graph(30, 7), chain(1)
    ),
    **{f"random {seed}": random_graph(10 + 17 * seed, seed, 2 + seed % 5) for seed in range(8)},
}


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
                self.solver.storage[offsets + i + j * strides] = (
                    blocks[r[lower], c[lower], j, i]
                )

    def constraint_rows(self, row_count, entries=None):
        entries = 3 * row_count if entries is None else entries
        rng = self.rng
        return NodeRows(
            rng.integers(0, max(row_count, 1), entries), rng.integers(0, self.count, entries),
            rng.standard_normal((entries, 3)), row_count,
        )  # fmt: skip


@pytest.fixture(params=list(PATTERNS), ids=str)
def system(request):
    return System(PATTERNS[request.param])


def test_solving_inverts_the_matrix(system):
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


def test_several_right_hand_sides_are_solved_column_by_column(system):
    assert system.solver.factor()
    b = system.rng.standard_normal((3 * system.count, 4))
    expected = np.linalg.solve(system.A, b)
    np.testing.assert_allclose(system.solver.solve(b), expected, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("row_count", [0, 1, 7, 8, 19])
def test_condensing_gives_the_dense_compliance(system, row_count):
    H = system.constraint_rows(row_count)
    system.solver.prepare_rows(H.node_index, row_count)
    b = system.rng.standard_normal((system.count, 3))
    assert system.solver.factor()
    W, free = system.solver.condense(H, b)
    dense = H.transposed(system.count).T
    expected = dense @ np.linalg.solve(system.A, dense.T)
    size = np.abs(expected).max(initial=1e-300)
    np.testing.assert_allclose(W, expected, rtol=0, atol=1e-12 * size)
    np.testing.assert_array_equal(W, W.T)
    wanted = dense @ np.linalg.solve(system.A, b.ravel())
    np.testing.assert_allclose(free, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max(initial=1))


def test_expanding_solves_for_the_forces_of_the_constraints(system):
    H = system.constraint_rows(5)
    b = system.rng.standard_normal((system.count, 3))
    assert system.solver.factor()
    system.solver.condense(H, b)
    for multipliers in system.rng.standard_normal((3, 5)):
        forces = b.ravel() + H.transposed(system.count) @ multipliers
        expected = np.linalg.solve(system.A, forces)
        dx = system.solver.expand(multipliers).ravel()
        np.testing.assert_allclose(dx, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_solving_in_between_does_not_disturb_the_condensed_system():
    system = System(PATTERNS["grid"])
    H, b = system.constraint_rows(3), np.ones((system.count, 3))
    system.solver.factor()
    system.solver.condense(H, b)
    before = system.solver.expand(np.ones(3)).copy()
    system.solver.solve(system.rng.standard_normal((system.count, 3)))
    np.testing.assert_array_equal(system.solver.expand(np.ones(3)), before)


@pytest.mark.parametrize("row_count", [2, 9, 30])
def test_rows_that_were_not_announced_are_condensed_all_the_same(row_count):
    system = System(PATTERNS["grid"], seed=3)
    system.solver.prepare_rows(np.array([0]), 1)
    system.solver.factor()
    for count in (row_count, 1, row_count + 8):
        H = system.constraint_rows(count)
        W, _ = system.solver.condense(H, np.zeros((system.count, 3)))
        dense = H.transposed(system.count)
        expected = dense.T @ np.linalg.solve(system.A, dense)
        np.testing.assert_allclose(W, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_entries_of_one_row_and_node_add_up():
    system = System(PATTERNS["chain"])
    system.solver.factor()
    twice = NodeRows(np.array([0, 0]), np.array([5, 5]), np.array([[1.0, 0, 2], [0, 3, 1]]), 1)
    once = NodeRows(np.array([0]), np.array([5]), np.array([[1.0, 3, 3]]), 1)
    b = np.zeros((system.count, 3))
    assert system.solver.condense(twice, b).W == system.solver.condense(once, b).W


def test_the_same_input_gives_the_same_bits():
    first, second = (System(PATTERNS["body, rod and isolated nodes"], seed=5) for _ in range(2))
    H, b = first.constraint_rows(6), first.rng.standard_normal((first.count, 3))
    results = []
    for system in (first, second, first):
        assert system.solver.factor()
        W, free = system.solver.condense(H, b)
        results.append((W.copy(), free.copy(), system.solver.expand(np.ones(6)).copy()))
    for other in results[1:]:
        for mine, theirs in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_slots_put_together_the_lower_blocks(system):
    solver, count = system.solver, system.count
    order = np.argsort(solver.elimination_rank)
    rows, columns = np.divmod(np.arange(count * count), count)
    coupled = np.abs(system.A.reshape(count, 3, count, 3)).sum(axis=(1, 3)) > 0
    lower = (rows >= columns) & coupled[order[rows], order[columns]]
    offsets, strides = solver.slots(order[rows[lower]], order[columns[lower]])
    places = offsets[:, None, None] + np.arange(3)[:, None] + strides[:, None, None] * np.arange(3)
    assert np.unique(places).size == places.size
    blocks = system.A.reshape(count, 3, count, 3)[order[rows[lower]], :, order[columns[lower]], :]
    np.testing.assert_array_equal(solver.storage[places], blocks)


def test_blocks_above_the_diagonal_or_outside_the_pattern_are_refused():
    solver = Multifrontal(np.array([0]), np.array([1]), 3, order=np.array([0, 1, 2]))
    rank = solver.elimination_rank
    earlier, later = (0, 1) if rank[0] < rank[1] else (1, 0)
    with pytest.raises(ValueError, match="above"):
        solver.slots(np.array([earlier]), np.array([later]))
    first, last = sorted([0, 2], key=lambda node: rank[node])
    with pytest.raises(ValueError, match="outside"):
        solver.slots(np.array([last]), np.array([first]))


def test_what_is_written_above_a_diagonal_block_is_ignored():
    system = System(PATTERNS["grid"], seed=4)
    nodes = np.arange(system.count)
    offsets, strides = system.solver.slots(nodes, nodes)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        system.solver.storage[offsets + i + j * strides] = np.nan
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [0, 0.3, 1])
def test_a_matrix_that_is_not_positive_definite_is_told(value, place):
    system = System(PATTERNS["grid"], seed=2)
    node = int(place * (system.count - 1))
    offset, stride = system.solver.slots(np.array(node), np.array(node))
    system.solver.storage[offset + 1 + stride] = value
    assert not system.solver.factor()
    system.solver.storage[offset + 1 + stride] = system.A[3 * node + 1, 3 * node + 1]
    assert system.solver.factor()
    b = np.ones((system.count, 3))
    x = system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_a_matrix_with_a_negative_eigenvalue_is_told(seed):
    system = System(PATTERNS["slab"], seed=seed)
    smallest = np.linalg.eigvalsh(system.A)[0]
    identity = np.eye(3 * system.count)
    system.assemble(system.A - (smallest - 1e-6) * identity)
    assert system.solver.factor()
    system.assemble(system.A - (smallest + 1e-6) * identity)
    assert not system.solver.factor()


@pytest.mark.parametrize("scale", [1e-200, 1e-8, 1e8, 1e150])
def test_the_unit_of_the_matrix_does_not_matter(scale):
    system = System(PATTERNS["two bodies"])
    system.assemble(scale * system.A)
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = scale * system.solver.solve(b)
    np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("decades", [4, 8, 12])
def test_a_badly_conditioned_matrix_is_solved_as_well_as_arithmetic_allows(decades):
    system = System(PATTERNS["slab"], seed=1)
    A = np.eye(3 * system.count)
    for number, (row, column) in enumerate(zip(system.rows, system.columns, strict=True)):
        stretch = system.rng.standard_normal(6)
        dofs = np.concatenate([3 * row + np.arange(3), 3 * column + np.arange(3)])
        stiffness = 10.0 ** (decades * (number % 3) / 2)
        A[np.ix_(dofs, dofs)] += stiffness * np.outer(stretch, stretch)
    system.assemble(A)
    assert system.solver.factor()
    b = system.rng.standard_normal((system.count, 3))
    x = system.solver.solve(b).ravel()
    assert np.linalg.cond(A) > 0.1 * 10.0**decades
    residual = np.linalg.norm(A @ x - b.ravel())
    assert residual < 1e-15 * np.linalg.norm(A, 2) * np.linalg.norm(x) + 1e-15 * np.linalg.norm(b)


def test_a_failed_or_poisoned_solve_leaves_nothing_behind():
    system = System(PATTERNS["grid"], seed=6)
    H, b = system.constraint_rows(4), system.rng.standard_normal((system.count, 3))
    system.solver.factor()
    W, free = system.solver.condense(H, b)
    clean = W.copy(), free.copy(), system.solver.expand(np.ones(4)).copy()
    system.solver.condense(H, np.full_like(b, np.nan))
    system.solver.expand(np.full(4, np.nan))
    system.solver.solve(np.full_like(b, np.inf))
    W, free = system.solver.condense(H, b)
    again = W.copy(), free.copy(), system.solver.expand(np.ones(4)).copy()
    for mine, theirs in zip(clean, again, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_a_wrong_number_of_multipliers_is_refused():
    system = System(PATTERNS["chain"])
    system.solver.factor()
    system.solver.condense(system.constraint_rows(2), np.zeros((system.count, 3)))
    with pytest.raises(ValueError, match="3 multipliers for 2 rows"):
        system.solver.expand(np.zeros(3))


def test_any_order_gives_the_same_solution():
    pattern = PATTERNS["grid"]
    b = np.random.default_rng(1).standard_normal((pattern[2], 3))
    natural = np.arange(pattern[2])
    for order in (natural, natural[::-1], np.random.default_rng(2).permutation(natural)):
        system = System(pattern, order=order)
        assert system.solver.factor()
        x = system.solver.solve(b)
        np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


@pytest.mark.parametrize("order", [[0, 1], [0, 1, 1], [0, 1, 3], [-1, 0, 1]])
def test_an_order_that_is_no_permutation_is_refused(order):
    with pytest.raises(ValueError, match="permutation"):
        Multifrontal(*chain(3), order=np.array(order))


@pytest.mark.parametrize("pair", [(0, 3), (-1, 0)])
def test_pairs_outside_the_graph_are_refused(pair):
    with pytest.raises(ValueError, match="outside"):
        Multifrontal(np.array([pair[0]]), np.array([pair[1]]), 3)


def test_a_body_without_free_nodes_is_solved():
    solver = Multifrontal(np.zeros(0, int), np.zeros(0, int), 0)
    H = NodeRows(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), 2)
    assert solver.factor()
    W, free = solver.condense(H, np.zeros((0, 3)))
    np.testing.assert_array_equal(W, np.zeros((2, 2)))
    np.testing.assert_array_equal(free, np.zeros(2))
    assert solver.expand(np.zeros(2)).shape == (0, 3)


@pytest.mark.parametrize("seed", range(6))
def test_it_agrees_with_superlu(seed):
    pattern = random_graph(150, 100 + seed, 6)
    system, oracle = System(pattern, seed), SuperLU(*pattern)
    nodes = np.arange(150)
    for r, c in ((nodes, nodes), (np.maximum(*pattern[:2]), np.minimum(*pattern[:2]))):
        offsets, strides = oracle.slots(r, c)
        blocks = system.A.reshape(150, 3, 150, 3)[r, :, c, :]
        for i in range(3):
            for j in range(3):
                oracle.storage[offsets + i + j * strides] = blocks[:, i, j]
    assert system.solver.factor()
    assert oracle.factor()
    H, b = system.constraint_rows(7), system.rng.standard_normal((150, 3))
    mine, theirs = system.solver.condense(H, b), oracle.condense(H, b)
    np.testing.assert_allclose(mine.W, theirs.W, rtol=0, atol=1e-12 * np.abs(theirs.W).max())
    np.testing.assert_allclose(mine.free, theirs.free, rtol=0, atol=1e-12)
    multipliers = system.rng.standard_normal(7)
    np.testing.assert_allclose(
        system.solver.expand(multipliers), oracle.expand(multipliers), rtol=0, atol=1e-12
    )


def test_the_factorization_leaves_the_assembled_matrix_as_it_is(system):
    before = system.solver.storage.copy()
    system.solver.factor()
    np.testing.assert_array_equal(system.solver.storage, before)


@pytest.mark.parametrize("name", ["bar", "cube"])
def test_bodies_of_thousands_of_nodes_are_solved(name):
    rows, columns, count = grid(8, 8, 60) if name == "bar" else grid(15, 15, 15)
    rng = np.random.default_rng(0)
    solver = Multifrontal(rows, columns, count)
    low, high = np.minimum(rows, columns), np.maximum(rows, columns)
    size = 3 * count
    i, j = np.indices((3, 3))
    data = rng.standard_normal((len(low), 3, 3)).ravel()
    r = (3 * high[:, None, None] + i).ravel()
    c = (3 * low[:, None, None] + j).ravel()
    A = sp.coo_array((data, (r, c)), shape=(size, size)).tocsc()
    A = A + A.T
    A = (A + sp.diags(np.asarray(abs(A).sum(axis=1)).ravel() + 0.01)).tocsc()
    full = A.tocoo()
    rank = solver.elimination_rank
    row, column = full.row // 3, full.col // 3
    lower = rank[row] >= rank[column]
    offsets, strides = solver.slots(row[lower], column[lower])
    places = offsets + full.row[lower] % 3 + strides * (full.col[lower] % 3)
    solver.storage[places] = full.data[lower]
    assert solver.factor()
    b = rng.standard_normal((count, 3))
    np.testing.assert_allclose(A @ solver.solve(b).ravel(), b.ravel(), atol=1e-11)
