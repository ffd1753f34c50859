"""Facts of the least of a quadratic under a few equations."""

import numpy as np
import pytest

from softrobot_twin.solvers.least_under_equations import least_under_equations


def problem(seed, n=9, k=3):
    rng = np.random.default_rng(seed)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    P = (Q * np.logspace(0.0, -6.0, n)) @ Q.T
    return 0.5 * (P + P.T), rng.standard_normal(n), rng.standard_normal((k, n)), rng


@pytest.mark.parametrize("seed", range(10))
def test_it_is_the_solution_of_the_kkt_system(seed):
    P, g, rows, rng = problem(seed)
    wanted, fixed = rng.standard_normal(3), rng.standard_normal(2)
    z, duals, free = np.zeros(9), np.zeros(3), np.arange(2, 9)
    z[:2] = fixed
    assert least_under_equations(P, g, free, rows, wanted, z, duals)
    np.testing.assert_array_equal(z[:2], fixed)
    np.testing.assert_allclose(rows @ z, wanted, atol=1e-13 * np.abs(rows * z).max())
    slope = (P @ z + g + rows.T @ duals)[2:]
    assert np.abs(slope).max() < 1e-12 * np.abs(rows.T @ duals).max()


def test_rows_that_are_nearly_one_are_met_to_rounding_all_the_same():
    P, g, rows, rng = problem(0, k=2)
    rows[1] = rows[0] + 1e-6 * rng.standard_normal(9)
    z, duals, wanted = np.zeros(9), np.zeros(2), np.array([1.0, 1.0 + 1e-6])
    assert least_under_equations(P, g, np.arange(9), rows, wanted, z, duals)
    np.testing.assert_allclose(rows @ z, wanted, atol=1e-13 * np.abs(rows * z).max())


@pytest.mark.parametrize("second", [1.0, 2.0])
def test_rows_that_follow_from_each_other_are_left_to_others(second):
    P, g, rows, _ = problem(0, k=2)
    rows[1] = rows[0]
    wanted = np.array([1.0, second])
    assert not least_under_equations(P, g, np.arange(9), rows, wanted, np.zeros(9), np.zeros(2))


def test_more_rows_than_unknowns_are_left_to_others():
    P, g, rows, _ = problem(0, n=2, k=3)
    free = np.arange(2)
    assert not least_under_equations(P, g, free, rows, np.ones(3), np.zeros(2), np.zeros(3))


def test_what_is_not_convex_is_left_to_others():
    P, g, rows, _ = problem(0)
    free, wanted = np.arange(9), np.ones(3)
    assert not least_under_equations(P - np.eye(9), g, free, rows, wanted, np.zeros(9), np.zeros(3))
