"""Angles of pulleys as commands and measurements of the loop."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.device import MeasuredSetpoints
from softrobot_twin.control.inputs import (
    ActuatorInput,
    ActuatorNames,
    AngleInput,
    SelectedActuatorInput,
)
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.scene.actuator_entries import Pulley
from softrobot_twin.simulation.building.limits import ActuatorLimits, Pulleys

NAMES = ("a", "b", "c", "d")
REST = np.array([0.2, 0.3, 0.25, 0.1])
RADIUS = 0.01


class Scene:
    """Cable a has a pulley, b and c that of a motor, d none."""

    class One:
        def __init__(self, name, pulley=None, cables=()):
            self.name, self.pulley, self.cables = name, pulley, cables

    own = Pulley(radius=RADIUS)
    cables = (One("a", own), One("b"), One("c"), One("d"))
    motors = (One("m", Pulley(radius=2 * RADIUS, winds="negative"), ("b", "c")),)


def came(time=1.0, stamp=0):
    return Arrival("", stamp, int(time * 1e9), time)


@pytest.fixture
def pulleys():
    return Pulleys(Scene, NAMES, REST)


@pytest.fixture
def direct(pulleys):
    names = ActuatorNames(NAMES, by_angle=("a", "b", "c"))
    keeper = ActuatorInput(names, LoopSettings())
    return keeper, AngleInput(pulleys, keeper, LoopSettings(), False)


@pytest.fixture
def measured(pulleys):
    infinite, many = np.full(4, np.inf), np.full(4, 0.05)
    limits = ActuatorLimits(
        NAMES, -many, many, infinite, np.zeros(4), infinite, REST, np.ones(4), -np.ones(4),
        np.zeros(4, bool), (("shortening_min", "shortening_max"),) * 4, ("tension",) * 4,
    )  # fmt: skip
    names = ActuatorNames(NAMES, by_angle=("a", "b", "c"))
    keeper = MeasuredSetpoints(names, REST, limits, LoopSettings())
    return keeper, AngleInput(pulleys, keeper, LoopSettings(), True)


def test_an_angle_commands_the_length_that_it_leaves_and_all_else_stays(direct):
    keeper, angles = direct
    assert angles.accept(["a"], [1.5], [], came()) is None
    assert keeper.setpoints[0] == REST[0] - RADIUS * 1.5
    assert np.isnan(keeper.setpoints[1:]).all() and keeper.efforts is None
    assert angles.accept(["m"], [-0.5], [], came(2.0)) is None
    assert keeper.setpoints[:3] == pytest.approx(REST[:3] - [0.015, 0.01, 0.01])
    assert keeper.age(2.5) == 0.5


def test_a_message_of_lengths_may_omit_wound_cables(direct):
    keeper, angles = direct
    assert keeper.accept(["d"], [0.09], [], came()) is None
    assert np.isnan(keeper.setpoints[:3]).all() and keeper.setpoints[3] == 0.09
    assert angles.accept(["m", "a"], [0.0, 1.0], [], came(2.0)) is None
    np.testing.assert_allclose(keeper.setpoints, [0.19, 0.3, 0.25, 0.09])
    # The next message keeps the angles, or replaces those that it names.
    assert keeper.accept(["d", "a"], [0.08, 0.2], [], came(3.0)) is None
    np.testing.assert_allclose(keeper.setpoints, [0.2, 0.3, 0.25, 0.08])
    assert keeper.accept(["a", "b"], [0.2, 0.3], [], came(4.0)) is Refusal.WRONG_NAMES


def test_a_message_of_tensions_names_all_cables_and_forgets_the_angles(direct):
    keeper, angles = direct
    angles.accept(["a"], [1.0], [], came())
    assert keeper.accept(["d"], [], [1.0], came(2.0)) is Refusal.WRONG_NAMES
    assert keeper.accept(NAMES, [], [1.0, 2.0, 3.0, 4.0], came(2.0)) is None
    assert keeper.efforts.tolist() == [1.0, 2.0, 3.0, 4.0] and keeper.setpoints is None
    assert angles.accept(["m"], [0.5], [], came(3.0)) is None
    assert keeper.efforts is None and np.isnan(keeper.setpoints[[0, 3]]).all()


@pytest.mark.parametrize("names, values, efforts, refusal", [
    (["a"], [np.nan], [], Refusal.NOT_FINITE),
    (["a"], [np.inf], [], Refusal.NOT_FINITE),
    (["a"], [], [], Refusal.WRONG_SIZE),
    (["a"], [1.0, 2.0], [], Refusal.WRONG_SIZE),
    ([], [], [], Refusal.WRONG_NAMES),
    (["b"], [1.0], [], Refusal.WRONG_NAMES),
    (["d"], [1.0], [], Refusal.WRONG_NAMES),
    (["nobody"], [1.0], [], Refusal.WRONG_NAMES),
    (["a", "a"], [1.0, 1.0], [], Refusal.WRONG_NAMES),
    (["a"], [], [1.0], Refusal.WRONG_FIELDS),
    (["a"], [1.0], [1.0], Refusal.WRONG_FIELDS),
])  # fmt: skip
def test_a_bad_command_is_refused_counted_and_changes_nothing(direct, names, values, efforts, refusal):
    keeper, angles = direct
    angles.accept(["a"], [0.5], [], came())
    before = keeper.setpoints.copy()
    assert angles.accept(names, values, efforts, came(2.0)) is refusal
    assert keeper.refusals.of(refusal) == 1
    np.testing.assert_array_equal(keeper.setpoints, before)
    assert keeper.age(2.0) == 1.0


def test_stale_and_reordered_angles_are_refused(direct):
    _, angles = direct
    late = Arrival("", int(1e9), int(60e9), 60.0)
    assert angles.accept(["a"], [0.5], [], late) is Refusal.STALE
    assert angles.accept(["a"], [0.5], [], Arrival("", int(60e9), int(60e9), 60.0)) is None
    old = Arrival("", int(59.9e9), int(60.1e9), 60.1)
    assert angles.accept(["a"], [0.5], [], old) is Refusal.OUT_OF_ORDER


def test_measured_angles_are_merged_with_measured_lengths(measured):
    keeper, angles = measured
    assert angles.accept(["a", "m"], [1.0, -1.0], [0.02, -0.08], came()) is None
    assert keeper.setpoints is None and keeper.unheard(1.0, 0.5) == ("d",)
    assert keeper.accept(["d"], [0.1], [], came(1.1)) is None
    np.testing.assert_allclose(keeper.setpoints, [0.19, 0.28, 0.23, 0.1])
    assert angles.accept(["m"], [-0.5], [-0.08], came(2.0)) is None
    np.testing.assert_allclose(keeper.setpoints, [0.19, 0.29, 0.24, 0.1])
    np.testing.assert_allclose(keeper.efforts[1:3], [2.0, 2.0])


def test_an_angle_that_no_cable_can_have_is_refused_by_name(measured):
    keeper, angles = measured
    assert angles.accept(["a"], [40.0], [], came()) is Refusal.OUT_OF_RANGE
    assert keeper.implausible.name == "a" and "a measures" in str(keeper.implausible)
    assert angles.accept(["a"], [1.0], [], came(2.0)) is None
    assert keeper.implausible is None


def test_an_angle_selects_its_cables_beside_targets(pulleys):
    names = ActuatorNames(NAMES, by_angle=("a", "b", "c"))
    keeper = SelectedActuatorInput(names, LoopSettings())
    angles = AngleInput(pulleys, keeper, LoopSettings(), False)
    assert angles.accept(["m"], [-0.5], [], came()) is None
    np.testing.assert_allclose(keeper.setpoints, [np.nan, 0.29, 0.24, np.nan])
    assert keeper.accept([], [], [], came(2.0)) is None
    assert keeper.setpoints is None
