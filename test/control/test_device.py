"""Measured setpoints: accepted where the actuators of the scene can be."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.device import MeasuredSetpoints
from softrobot_twin.control.inputs import ActuatorNames
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.simulation.building.limits import ActuatorLimits

NAMES = ("a", "b", "lift")
REST = np.array([0.1, 0.2, 0.0])
LIMITS = ActuatorLimits(
    names=NAMES,
    displacement_min=np.array([0.0, -np.inf, -0.05]),
    displacement_max=np.array([0.04, np.inf, 0.0]),
    rate=np.full(3, 0.05),
    effort_min=np.zeros(3),
    effort_max=np.full(3, 10.0),
    displacement_scale=np.array([0.1, 0.2, 0.05]),
    effort_scale=np.full(3, 10.0),
    slopes=-np.ones(3), is_effort_driven=np.zeros(3, bool),
    limit_names=(("shortening_min", "shortening_max"),) * 3,
    effort_words=("tension",) * 3,
)


@pytest.fixture
def device():
    return MeasuredSetpoints(
        ActuatorNames(NAMES, by_position=("lift",)), REST, LIMITS, LoopSettings())


def take(device, *lengths, time=0.0):
    now = round((1000.0 + time) * NANOSECONDS)
    return device.accept(NAMES, lengths, [], Arrival("", now, now, time))


@pytest.mark.parametrize("lengths", [
    (0.1, 0.2, 0.0), (0.06, 0.2, 0.05), (0.0561, 5.0, -0.0049), (0.1039, 0.0, 0.0549),
    (0.08, 1e4, 0.02),
])  # fmt: skip
def test_measured_values_up_to_a_tenth_of_the_travel_beyond_the_limits_are_accepted(device, lengths):
    assert take(device, *lengths) is None
    assert device.implausible is None and device.setpoints.tolist() == list(lengths)


@pytest.mark.parametrize("lengths, name, value", [
    ((1e6, 0.2, 0.0), "a", 1e6), ((-5.0, 0.2, 0.0), "a", -5.0), ((0.1041, 0.2, 0.0), "a", 0.1041),
    ((0.0559, 0.2, 0.0), "a", 0.0559), ((0.1, -0.001, 0.0), "b", -0.001),
    ((0.1, 0.2, -0.0051), "lift", -0.0051), ((0.1, 0.2, 0.0551), "lift", 0.0551),
])  # fmt: skip
def test_impossible_measured_values_are_refused_and_named(device, lengths, name, value):
    take(device, *REST)
    assert take(device, *lengths, time=0.1) is Refusal.OUT_OF_RANGE
    assert device.setpoints.tolist() == REST.tolist()
    assert device.arrived.tolist() == [0.0] * 3
    assert device.refusals.by_word() == {"out_of_range": 1}
    assert device.implausible.name == name and device.implausible.value == value
    assert str(device.implausible).startswith(f"{name} measures {value:.6g} m, accepted are ")


def test_a_plausible_message_clears_the_warning(device):
    take(device, 1e6, 0.2, 0.0)
    take(device, *REST, time=0.1)
    assert device.implausible is None and device.arrived.tolist() == [0.1] * 3
