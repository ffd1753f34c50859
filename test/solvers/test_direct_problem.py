"""Cables with prescribed lengths or tensions."""

import numpy as np
import pytest

from softrobot_twin.solvers.direct_problem import (
    SHARING,
    solve_by_daqp,
    solve_direct,
    solve_towards,
)
from softrobot_twin.solvers.inverse_problem import Bounds

NONE = np.zeros(4), np.full(4, np.inf)


def compliance(seed, n=4):
    Y = np.random.default_rng(seed).standard_normal((2 * n, n))
    return 1e-3 * Y.T @ Y


def rounding(W, tensions, violation):
    """What equations of tensions may miss [m]: what cables share their load by, and rounding."""
    return SHARING * np.abs(W.diagonal() * tensions).max() + 1e-13 * np.abs(violation).max()


@pytest.mark.parametrize("seed", range(30))
def test_a_cable_is_taut_or_slack(seed):
    rng = np.random.default_rng(100 + seed)
    W, free, wound = compliance(seed), 1e-2 * rng.standard_normal(4), 1e-2 * rng.random(4)
    tensions = solve_direct(W, free, wound, *NONE)
    excess, size = W @ tensions + free - wound, rounding(W, tensions, free - wound)
    assert np.all(tensions >= 0.0)
    assert np.all(excess >= -size)
    assert np.all(np.abs(tensions * excess) <= size * tensions)


@pytest.mark.parametrize("seed", range(30))
def test_efforts_meet_their_equations_to_rounding(seed):
    rng = np.random.default_rng(300 + seed)
    W, free, wound = compliance(seed), 1e-2 * rng.standard_normal(4), 1e-2 * rng.random(4)
    most = rng.uniform(0.5, 20.0, 4)
    tensions = solve_direct(W, free, wound, np.zeros(4), most)
    excess = W @ tensions + free - wound
    slack, slipping = tensions == 0.0, tensions == most
    size = rounding(W, tensions, free - wound)
    assert np.all(excess[slack] >= -size)
    assert np.all(excess[slipping] <= size)
    assert np.abs(excess[~(slack | slipping)]).max(initial=0.0) <= size


@pytest.mark.parametrize("seed", range(30))
def test_the_proved_efforts_are_those_of_the_general_solver(seed):
    rng = np.random.default_rng(400 + seed)
    W, violation = compliance(seed, 9), 1e-2 * rng.standard_normal(9)
    bounds = np.zeros(9), rng.uniform(0.5, 20.0, 9)
    tensions = solve_direct(W, violation, np.zeros(9), *bounds)
    general = solve_by_daqp(W, violation, *bounds)
    np.testing.assert_allclose(tensions, general, atol=1e-4 * general.max())


def test_taut_cables_follow_equation_16():
    W = compliance(1)
    wound = W @ np.array([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(solve_direct(W, np.zeros(4), wound, *NONE), [1, 2, 3, 4], rtol=1e-7)


def test_a_cable_lengthens_at_its_greatest_tension():
    W = compliance(2)
    tensions = solve_direct(W, np.zeros(4), W @ np.full(4, 10.0), np.zeros(4), np.full(4, 5.0))
    assert np.all(tensions <= 5.0)
    assert tensions.max() == pytest.approx(5.0)


def test_the_same_cable_twice_shares_its_tension():
    W = np.full((2, 2), 1e-3)
    tensions = solve_direct(W, np.zeros(2), np.full(2, 2e-3), np.zeros(2), np.full(2, np.inf))
    np.testing.assert_allclose(tensions, [1.0, 1.0], rtol=1e-4)


def test_a_problem_that_is_not_finite_has_no_answer():
    assert solve_direct(np.full((4, 4), np.nan), np.zeros(4), np.ones(4), *NONE) is None


def test_given_tensions_are_met_within_the_length_limits():
    W = compliance(3)
    asked = np.array([0.0, 1.0, 2.0, 0.5])
    bounds = Bounds(np.full(4, -1.0), np.full(4, 1.0), np.zeros(4), np.full(4, 9.0))
    np.testing.assert_allclose(solve_towards(W, np.zeros(4), asked, bounds), asked, atol=1e-7)


def test_given_tensions_are_reduced_at_the_length_limit():
    W = compliance(4)
    asked = np.full(4, 5.0)
    free = W @ asked
    bounds = Bounds(np.full(4, -1.0), 0.8 * free, np.zeros(4), np.full(4, 9.0))
    found = solve_towards(W, np.zeros(4), asked, bounds)
    assert np.all(W @ found <= 0.8 * free + 1e-9)
    assert np.all(found >= 0.0)
