"""Facts of rows H that change from step to step, on one body or several."""

import numpy as np
import pytest

from softrobot_twin.solvers.factorization import NodeRows

BODIES = ["two bodies", "body, rod and isolated nodes", "two nodes apart", "grid"]


def assert_condensed(system, H, count):
    """The compliance, the free motion and the expanded answer are those of dense algebra."""
    b = system.rng.standard_normal((system.count, 3))
    W, free = system.solver.condense(H, b)
    dense = H.transposed(system.count)
    expected = dense.T @ np.linalg.solve(system.A, np.column_stack([dense, b.ravel()]))
    size = np.abs(expected).max(initial=1e-300)
    np.testing.assert_allclose(W, expected[:, :-1], rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(free, expected[:, -1], rtol=0, atol=1e-12 * size)
    multipliers = system.rng.standard_normal(count)
    wanted = np.linalg.solve(system.A, b.ravel() + dense @ multipliers)
    dx = system.solver.expand(multipliers).ravel()
    np.testing.assert_allclose(dx, wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.parametrize("name", BODIES)
def test_row_counts_change_from_step_to_step(make_system, name):
    system = make_system(name, seed=11)
    system.solver.factor()
    system.solver.prepare_rows(np.arange(system.count), 40)
    for count in (3, 40, 0, 17, 1, 0, 64, 8, 7):
        assert_condensed(system, system.constraint_rows(count), count)


@pytest.mark.parametrize("name", ["chain", "slab", "grid", "two bodies"])
@pytest.mark.parametrize("row_count", [8, 40, 150])
def test_rows_on_single_nodes_spread_over_a_body_are_condensed(make_system, name, row_count):
    system = make_system(name, seed=row_count)
    system.solver.factor()
    rows = system.rng.permutation(row_count)
    nodes = np.arange(row_count) * system.count // row_count
    H = NodeRows(rows, nodes, system.rng.standard_normal((row_count, 3)), row_count)
    assert_condensed(system, H, row_count)


def test_separate_bodies_are_coupled_only_by_rows_on_both(make_system):
    system = make_system("two bodies")
    system.solver.factor()
    first, second = 0, system.count - 1
    H = NodeRows(
        np.array([0, 1, 2, 2, 4]), np.array([first, second, first, second, 1]), np.eye(3)[[0] * 5],
        6,
    )  # fmt: skip
    W, _ = system.solver.condense(H, np.zeros((system.count, 3)))
    assert W[0, 1] == W[1, 4] == 0.0
    assert W[2, 2] == pytest.approx(W[0, 0] + W[1, 1], rel=1e-14)
    assert W[2, 4] == pytest.approx(W[0, 4], rel=1e-14)
    assert not W[3].any() and not W[5].any()  # rows without entries


def test_rows_changed_in_place_are_recomputed(make_system):
    system = make_system("two bodies")
    system.solver.factor()
    H, b = system.constraint_rows(6), np.zeros((system.count, 3))
    system.solver.condense(H, b)
    H.node_index[:] = H.node_index[::-1].copy()
    dense = H.transposed(system.count)
    expected = dense.T @ np.linalg.solve(system.A, dense)
    np.testing.assert_allclose(system.solver.condense(H, b).W, expected, rtol=0, atol=1e-12)


def test_rows_that_move_to_other_nodes_in_the_same_arrays_are_condensed_there(make_system, drawn_rng):
    """Where a factor is asked for first, rows have their columns before `condense` looks at them."""
    system = make_system("slab", seed=3)
    system.solver.factor()
    H, b = system.constraint_rows(4), system.rng.standard_normal((system.count, 3))
    for call in range(80):
        if call % 4 == 0:
            # Four calls are enough for the driver to know the last ones.
            H.node_index[:] = drawn_rng.integers(0, system.count, len(H.node_index))
        if call % 8 == 0:
            system.solver.stages.begin_anew()
        assert system.solver.condense_low_rank(H, b) is None
        W, free = system.solver.condense(H, b)
        dense = H.transposed(system.count)
        expected = dense.T @ np.linalg.solve(system.A, np.column_stack([dense, b.ravel()]))
        size = np.abs(expected).max()
        np.testing.assert_allclose(W, expected[:, :-1], rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(free, expected[:, -1], rtol=0, atol=1e-12 * size)


def test_the_compliance_of_a_row_does_not_depend_on_other_rows(make_system):
    system = make_system("two bodies", seed=4)
    system.solver.factor()
    H, b = system.constraint_rows(20), np.zeros((system.count, 3))
    alone = H.row_index < 5
    few = NodeRows(H.row_index[alone], H.node_index[alone], H.blocks[alone], 5)
    all_of_them = system.solver.condense(H, b).W.copy()
    np.testing.assert_array_equal(system.solver.condense(few, b).W, all_of_them[:5, :5])


@pytest.mark.parametrize("name", ["two bodies", "two nodes apart", "body, rod and isolated nodes"])
def test_few_unknowns_give_the_compliance_by_a_factor(make_system, name):
    system = make_system(name, seed=3)
    system.solver.factor()
    count = 6 * system.count + 5
    H, b = system.constraint_rows(count), system.rng.standard_normal((system.count, 3))
    few = system.solver.condense_low_rank(H, b)
    multipliers = system.rng.standard_normal(count)
    moved = system.solver.expand(multipliers).copy()
    W, free = system.solver.condense(H, b)
    assert few.Yt.shape[0] == count and few.Yt.shape[1] <= 3 * system.count
    np.testing.assert_allclose(few.Yt @ few.Yt.T, W, rtol=0, atol=1e-13 * np.abs(W).max())
    np.testing.assert_allclose(few.free, free, rtol=0, atol=1e-13 * np.abs(free).max())
    np.testing.assert_array_equal(system.solver.expand(multipliers), moved)


def test_a_body_without_rows_adds_no_rank(make_system):
    system = make_system("two nodes apart")
    system.solver.factor()
    H = NodeRows(np.arange(12), np.zeros(12, np.int64), system.rng.standard_normal((12, 3)), 12)
    assert system.solver.condense_low_rank(H, np.zeros((2, 3))).Yt.shape == (12, 3)


def test_as_many_unknowns_as_rows_give_no_factor(make_system):
    system = make_system("grid")
    system.solver.factor()
    b = np.zeros((system.count, 3))
    assert system.solver.condense_low_rank(system.constraint_rows(8), b) is None
    assert system.solver.condense_low_rank(system.constraint_rows(0), b) is None
