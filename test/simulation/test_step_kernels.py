"""Kernels of a step against the same computed by array operations."""

import numpy as np
import pytest

from softrobot_twin.simulation.building.limits import find_limits, write_bounds
from softrobot_twin.simulation.result import find_carrying
from softrobot_twin.simulation.step.inverse_actuation import keep_within, write_near, write_steps
from softrobot_twin.simulation.step.goals import DISPLACEMENT_MET, are_near
from softrobot_twin.simulation.step.situation import are_equal, longest_move

SEEDS = range(20)


@pytest.mark.parametrize("seed", SEEDS)
def test_bounds_of_a_step(seed):
    rng = np.random.default_rng(seed)
    at, by_effort = rng.standard_normal(6), rng.random(6) < 0.5
    limits = np.array([-rng.random(6), rng.random(6), -rng.random(6), rng.random(6)])
    rate, time_step = np.where(rng.random(6) < 0.3, np.inf, 3.0 * rng.random(6)), 0.1
    bounds, reach = np.empty((4, 6)), rate * time_step
    write_bounds(at, rate, time_step, by_effort, limits, bounds)
    for first, is_driven in ((0, ~by_effort), (2, by_effort)):
        least, most = limits[first : first + 2]
        lower = np.minimum(np.maximum(least, at - reach), at + reach)
        upper = np.maximum(np.minimum(most, at + reach), at - reach)
        np.testing.assert_array_equal(bounds[first], np.where(is_driven, lower, least))
        np.testing.assert_array_equal(bounds[first + 1], np.where(is_driven, upper, most))


def test_without_time_no_setpoint_moves_at_any_rate():
    bounds, at = np.empty((4, 2)), np.array([0.1, 0.2])
    limits = np.array([[-1.0, -1.0], [1.0, 1.0], [0.0, 0.0], [5.0, 5.0]])
    write_bounds(at, np.array([np.inf, 3.0]), 0.0, np.zeros(2, bool), limits, bounds)
    np.testing.assert_array_equal(bounds, [at, at, limits[2], limits[3]])


@pytest.mark.parametrize("seed", SEEDS)
def test_limits_that_bind(seed):
    rng = np.random.default_rng(seed)
    at, efforts, lower, upper, margins = rng.integers(0, 4, (5, 6)).astype(float)
    least, most = np.full(6, 0.5), np.full(6, 2.5)
    found = np.empty((6, 2), np.int64)
    any_binds = find_limits(at, efforts, lower, upper, margins, least, most, found)
    is_upper, is_lower = at >= upper - margins, at <= lower + margins
    np.testing.assert_array_equal(found[:, 0], np.where(is_upper, 1, np.where(is_lower, -1, 0)))
    is_most, is_least = efforts >= most, efforts <= least
    np.testing.assert_array_equal(found[:, 1], np.where(is_most, 1, np.where(is_least, -1, 0)))
    assert any_binds == (is_upper | is_lower | is_most | is_least).any()


@pytest.mark.parametrize("frictionless", [0, 7, 12])
def test_contacts_that_carry_force(frictionless):
    row_starts = np.cumsum([0, *[1] * frictionless, *[3] * (12 - frictionless)])
    multipliers = np.random.default_rng(frictionless).standard_normal(row_starts[-1])
    carrying = np.empty(12, np.int64)
    count = find_carrying(multipliers, row_starts, 0.5, carrying)
    expected = np.flatnonzero(multipliers[row_starts[:-1]] > 0.5)
    assert 0 < count < 12
    np.testing.assert_array_equal(carrying[:count], expected)


@pytest.mark.parametrize("seed", SEEDS)
def test_displacements_to_targets(seed):
    rng = np.random.default_rng(seed)
    targets, now = rng.standard_normal((2, 7))
    targets[rng.random(7) < 0.3] = np.nan
    effector, row_weights = np.sort(rng.integers(0, 3, 7)), rng.random(7)
    steps, weights = np.empty(7), np.empty(7)
    no_turns, squares = np.empty(0), np.zeros((3, 2))
    write_steps(targets, now, effector, row_weights, no_turns, 0.8, 1.0, squares, steps, weights)
    wanted = np.isfinite(targets)
    whole = np.where(wanted, targets - now, 0.0)
    distances = np.sqrt(np.bincount(effector, whole * whole, 3))
    shares = 0.8 / np.maximum(distances, 0.8)
    np.testing.assert_array_equal(steps, whole * shares[effector])
    # The slope of the tracking term stays that of the whole distances.
    np.testing.assert_array_equal(weights, np.where(wanted, row_weights, 0.0) / shares[effector])
    assert (np.bincount(effector, steps * steps, 3) <= 0.8**2 * (1.0 + 1e-12)).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_displacements_within_bounds(seed):
    rng = np.random.default_rng(seed)
    path, lower, upper = rng.standard_normal(5), -np.full(5, 2.0), np.full(5, 2.0)
    if seed % 2:
        upper[2] = path[2] - 10.0 ** -(seed % 5 + 10.0)
    within = np.empty(5)
    are_kept = keep_within(path, lower, upper, np.full(5, 1e-12), within)
    expected = np.minimum(np.maximum(path, lower), upper)
    np.testing.assert_array_equal(within, expected)
    assert are_kept == (np.abs(expected - path) <= 1e-12).all()


def test_bounds_are_narrowed_to_what_is_near_and_never_cross():
    drives, scales = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0]), np.array([2.0, np.inf, *[2.0] * 4])
    lower = np.array([-3.0, -3.0, 2.0, -3.0, 0.7, -4.0])
    upper = np.array([0.5, np.inf, 3.0, 0.5, 0.7, 4.0])
    is_commanded, by_effort = np.arange(6) == 4, np.arange(6) == 5
    least, most = np.empty((2, 6))
    write_near(drives, 0.5, scales, is_commanded, by_effort, lower, upper, least, most)
    np.testing.assert_array_equal(least, [-1.0, -3.0, 2.0, 0.5, 0.7, -4.0])
    np.testing.assert_array_equal(most, [0.5, np.inf, 2.0, 0.5, 0.7, 4.0])


def test_displacements_are_near_what_is_asked_where_nan_asks_nothing():
    made, scales = np.array([1.0, 2.0]), np.array([1.0, 10.0])
    off = 0.9 * DISPLACEMENT_MET * scales
    assert are_near(made + off, made, scales) and are_near(np.full(2, np.nan), made, scales)
    assert not are_near(made + [0.0, 1.3 * off[1]], made, scales)


def test_equal_situations_and_moves_of_actuators():
    first = np.array([1.0, np.nan, 2.0])
    assert are_equal(first, first.copy())
    for place, other in ((0, 1.5), (0, np.nan), (1, 0.0)):
        second = first.copy()
        second[place] = other
        assert not are_equal(first, second) and not are_equal(second, first)
    before, after, scales = np.random.default_rng(1).random((3, 5))
    assert longest_move(before, after, scales) == (np.abs(after - before) / scales).max()
    assert longest_move(*np.empty((3, 0))) == 0.0
