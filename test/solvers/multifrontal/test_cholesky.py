"""Facts of the multifrontal factorization as a step sees it."""

import numpy as np
import pytest
import scipy.sparse as sp

from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.solvers.multifrontal import Multifrontal
from softrobot_twin.solvers.superlu import SuperLU


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


def test_solving_in_between_does_not_disturb_the_condensed_system(make_system):
    system = make_system("grid")
    H, b = system.constraint_rows(3), np.ones((system.count, 3))
    system.solver.factor()
    system.solver.condense(H, b)
    before = system.solver.expand(np.ones(3)).copy()
    system.solver.solve(system.rng.standard_normal((system.count, 3)))
    np.testing.assert_array_equal(system.solver.expand(np.ones(3)), before)


@pytest.mark.parametrize("row_count", [2, 9, 30])
def test_rows_that_were_not_prepared_are_condensed(make_system, row_count):
    system = make_system("grid", seed=3)
    system.solver.prepare_rows(np.array([0]), 1)
    system.solver.factor()
    for count in (row_count, 1, row_count + 8):
        H = system.constraint_rows(count)
        W, _ = system.solver.condense(H, np.zeros((system.count, 3)))
        dense = H.transposed(system.count)
        expected = dense.T @ np.linalg.solve(system.A, dense)
        np.testing.assert_allclose(W, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_entries_of_one_row_and_node_add_up(make_system):
    system = make_system("chain")
    system.solver.factor()
    twice = NodeRows(np.array([0, 0]), np.array([5, 5]), np.array([[1.0, 0, 2], [0, 3, 1]]), 1)
    once = NodeRows(np.array([0]), np.array([5]), np.array([[1.0, 3, 3]]), 1)
    b = np.zeros((system.count, 3))
    assert system.solver.condense(twice, b).W == system.solver.condense(once, b).W


def test_slots_assemble_the_lower_blocks(system):
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


def test_a_wrong_number_of_multipliers_is_refused(make_system):
    system = make_system("chain")
    system.solver.factor()
    system.solver.condense(system.constraint_rows(2), np.zeros((system.count, 3)))
    with pytest.raises(ValueError, match="3 multipliers for 2 rows"):
        system.solver.expand(np.zeros(3))


def test_any_order_gives_the_same_solution(make_system):
    natural = np.arange(make_system("grid").count)
    b = np.random.default_rng(1).standard_normal((len(natural), 3))
    for order in (natural, natural[::-1], np.random.default_rng(2).permutation(natural)):
        system = make_system("grid", order=order)
        assert system.solver.factor()
        x = system.solver.solve(b)
        np.testing.assert_allclose(system.A @ x.ravel(), b.ravel(), atol=1e-12)


def test_a_body_without_free_nodes_is_solved():
    solver = Multifrontal(np.zeros(0, int), np.zeros(0, int), 0)
    H = NodeRows(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), 2)
    assert solver.factor()
    W, free = solver.condense(H, np.zeros((0, 3)))
    np.testing.assert_array_equal(W, np.zeros((2, 2)))
    np.testing.assert_array_equal(free, np.zeros(2))
    assert solver.expand(np.zeros(2)).shape == (0, 3)


@pytest.mark.parametrize("seed", range(6))
def test_it_agrees_with_superlu(make_system, seed):
    system = make_system("random 7", seed)
    count, nodes = system.count, np.arange(system.count)
    oracle = SuperLU(system.rows, system.columns, count)
    low, high = np.maximum(system.rows, system.columns), np.minimum(system.rows, system.columns)
    for r, c in ((nodes, nodes), (low, high)):
        offsets, strides = oracle.slots(r, c)
        blocks = system.A.reshape(count, 3, count, 3)[r, :, c, :]
        for i in range(3):
            for j in range(3):
                oracle.storage[offsets + i + j * strides] = blocks[:, i, j]
    assert system.solver.factor()
    assert oracle.factor()
    H, b = system.constraint_rows(7), system.rng.standard_normal((count, 3))
    mine, theirs = system.solver.condense(H, b), oracle.condense(H, b)
    np.testing.assert_allclose(mine.W, theirs.W, rtol=0, atol=1e-12 * np.abs(theirs.W).max())
    np.testing.assert_allclose(mine.free, theirs.free, rtol=0, atol=1e-12)
    multipliers = system.rng.standard_normal(7)
    np.testing.assert_allclose(
        system.solver.expand(multipliers), oracle.expand(multipliers), rtol=0, atol=1e-12
    )


@pytest.mark.exhaustive
@pytest.mark.parametrize("shape", [(8, 8, 60), (15, 15, 15)], ids=["bar", "cube"])
def test_bodies_of_thousands_of_nodes_are_solved(shape):
    index = np.arange(np.prod(shape)).reshape(shape)
    sides = [np.moveaxis(index, axis, 0) for axis in range(3)]
    low = np.concatenate([side[:-1].ravel() for side in sides])
    high = np.concatenate([side[1:].ravel() for side in sides])
    solver = Multifrontal(low, high, index.size)
    i, j = np.indices((3, 3))
    r = (3 * high[:, None, None] + i).ravel()
    c = (3 * low[:, None, None] + j).ravel()
    rng = np.random.default_rng(0)
    A = sp.coo_array((rng.standard_normal(len(r)), (r, c)), shape=(3 * index.size,) * 2).tocsc()
    A = A + A.T
    A = (A + sp.diags(np.asarray(abs(A).sum(axis=1)).ravel() + 0.01)).tocsc()
    full, rank = A.tocoo(), solver.elimination_rank
    lower = rank[full.row // 3] >= rank[full.col // 3]
    row, column = full.row[lower], full.col[lower]
    offsets, strides = solver.slots(row // 3, column // 3)
    solver.storage[offsets + row % 3 + strides * (column % 3)] = full.data[lower]
    assert solver.factor()
    b = rng.standard_normal((index.size, 3))
    np.testing.assert_allclose(A @ solver.solve(b).ravel(), b.ravel(), atol=1e-11)
