"""Settings that may be changed while the loop runs."""

import math

import pytest

from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.errors import ParameterError


@pytest.mark.parametrize("name, value", [
    ("rate", 0.0), ("rate", math.inf), ("target_timeout", -1.0), ("speed_limit", math.nan),
    ("correction_gain", -0.1), ("marker_timeout", 0.0), ("workspace_max", (1.0, math.nan, 1.0)),
    ("workspace_min", (1.0, 1.0)), ("workspace_min", (2.0, 0.0, 0.0)),
])  # fmt: skip
def test_an_invalid_setting_is_refused_by_name_and_value(name, value):
    with pytest.raises(ParameterError) as raised:
        LoopSettings(**{name: value})
    assert raised.value.name == name
    assert raised.value.value == value or math.isnan(raised.value.value)


def test_swapped_limits_are_refused():
    with pytest.raises(ParameterError, match="must not be above workspace_max"):
        LoopSettings(workspace_min=(0.0, 0.0, 0.2), workspace_max=(1.0, 1.0, 0.1))


def test_the_period_is_that_of_the_rate():
    assert LoopSettings(rate=40.0).period == 0.025


def test_a_deadline_longer_than_the_period_is_refused_and_one_as_long_is_not():
    assert LoopSettings(rate=30.0, deadline=1.0 / 30.0).budget == 1.0 / 30.0
    with pytest.raises(ParameterError, match="longer than the period of 0.01 s at rate = 100 Hz"):
        LoopSettings(rate=100.0, deadline=0.02)
