"""Kernels of a step against the same computed by array operations."""

import numpy as np
import pytest

from softrobot_twin.simulation.building.limits import find_limits, write_bounds
from softrobot_twin.simulation.step.inverse_actuation import write_near

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


def test_bounds_are_narrowed_to_what_is_near_and_never_cross():
    drives, scales = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0]), np.array([2.0, np.inf, *[2.0] * 4])
    lower = np.array([-3.0, -3.0, 2.0, -3.0, 0.7, -4.0])
    upper = np.array([0.5, np.inf, 3.0, 0.5, 0.7, 4.0])
    is_commanded, by_effort = np.arange(6) == 4, np.arange(6) == 5
    least, most = np.empty((2, 6))
    write_near(drives, 0.5, scales, is_commanded, by_effort, lower, upper, least, most)
    np.testing.assert_array_equal(least, [-1.0, -3.0, 2.0, 0.5, 0.7, -4.0])
    np.testing.assert_array_equal(most, [0.5, np.inf, 2.0, 0.5, 0.7, 4.0])
