"""The ring of the last ticks."""

import math

import numpy as np
import pytest

from softrobot_twin.control.loop_statistics import LoopStatistics


def test_figures_are_those_of_the_last_ticks_only():
    statistics = LoopStatistics(capacity=100)
    for _ in range(50):
        statistics.record(1.0, 9.0)
    for index in range(100):
        statistics.record(0.01, 0.001 * index)
    summary = statistics.summary()
    assert summary.period_mean == pytest.approx(0.01) and summary.period_max == 0.01
    assert summary.compute_p50 == pytest.approx(0.001 * np.percentile(np.arange(100), 50))
    assert summary.compute_p99 == pytest.approx(0.001 * np.percentile(np.arange(100), 99))
    assert summary.compute_max == pytest.approx(0.099)


def test_nothing_is_known_before_the_first_tick():
    assert all(math.isnan(value) for value in LoopStatistics().summary())


def test_the_first_tick_has_no_period():
    statistics = LoopStatistics()
    statistics.record(float("nan"), 0.002)
    assert math.isnan(statistics.summary().period_mean)
    assert statistics.summary().compute_max == 0.002
