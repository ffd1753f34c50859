"""Setpoints and efforts by name, from commands and measurements."""

import math

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import (
    ActuatorInput,
    ActuatorNames,
    DirectActuatorInput,
    SelectedActuatorInput,
)
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS

NAMES = ("north", "west", "south")


def at(time):
    now = round((1000.0 + time) * NANOSECONDS)
    return Arrival("", now, now, time)


@pytest.fixture
def cables():
    return ActuatorInput(ActuatorNames(NAMES), LoopSettings())


def test_values_are_put_in_the_order_of_the_simulation(cables):
    assert cables.accept(("south", "north", "west"), [3.0, 1.0, 2.0], [], at(0.0)) is None
    assert cables.setpoints.tolist() == [1.0, 2.0, 3.0]
    assert cables.efforts is None
    # The order may change from message to message.
    assert cables.accept(("west", "south", "north"), [2.0, 3.0, 1.0], [], at(0.1)) is None
    assert cables.setpoints.tolist() == [1.0, 2.0, 3.0]


def test_a_message_may_give_tensions_alone(cables):
    cables.accept(NAMES, [1.0, 2.0, 3.0], [], at(0.0))
    assert cables.accept(NAMES, [], [4.0, 5.0, 6.0], at(0.1)) is None
    assert cables.setpoints is None
    assert cables.efforts.tolist() == [4.0, 5.0, 6.0]


@pytest.mark.parametrize("names, lengths, tensions, refusal", [
    (NAMES, [1.0, math.nan, 3.0], [], Refusal.NOT_FINITE),
    (NAMES, [1.0, 2.0, 3.0], [1.0, math.inf, 1.0], Refusal.NOT_FINITE),
    (NAMES, [1.0, 2.0], [], Refusal.WRONG_SIZE),
    (NAMES, [], [1.0] * 4, Refusal.WRONG_SIZE),
    (NAMES, [], [], Refusal.WRONG_SIZE),
    (NAMES[:2], [1.0, 2.0], [], Refusal.WRONG_NAMES),
    (("north", "west", "east"), [1.0, 2.0, 3.0], [], Refusal.WRONG_NAMES),
    (("north", "north", "west"), [1.0, 2.0, 3.0], [], Refusal.WRONG_NAMES),
    ((), [1.0, 2.0, 3.0], [], Refusal.WRONG_NAMES),
])  # fmt: skip
def test_a_message_that_does_not_fit_is_refused_and_counted(cables, names, lengths, tensions, refusal):
    assert cables.accept(names, lengths, tensions, at(0.0)) is refusal
    assert cables.refusals.by_word() == {refusal.value: 1}
    assert cables.setpoints is None and cables.efforts is None
    assert cables.age(1.0) == math.inf


def test_an_older_message_is_refused(cables):
    cables.accept(NAMES, [1.0, 2.0, 3.0], [], at(0.1))
    assert cables.accept(NAMES, [0.0] * 3, [], at(0.0)) is Refusal.OUT_OF_ORDER
    assert cables.setpoints.tolist() == [1.0, 2.0, 3.0]


def test_a_direct_message_leaves_the_others_what_earlier_ones_of_its_kind_gave():
    direct = DirectActuatorInput(ActuatorNames(NAMES), LoopSettings())
    assert direct.accept(NAMES[:1], [1.0], [], at(0.0)) is None
    assert direct.accept(NAMES[1:2], [2.0], [], at(0.1)) is None
    np.testing.assert_array_equal(direct.setpoints, [1.0, 2.0, np.nan])
    assert direct.accept(NAMES[2:], [], [3.0], at(0.2)) is None
    np.testing.assert_array_equal(direct.efforts, [np.nan, np.nan, 3.0])
    assert direct.setpoints is None


# --- slides ----------------------------------------------------------------------------------

@pytest.fixture
def with_slide():
    return ActuatorInput(ActuatorNames(("a", "b", "z"), by_position=("z",)), LoopSettings())


@pytest.mark.parametrize(
    "names, tensions", [(("a", "b"), [1.0, 2.0]), (("z", "b", "a"), [math.nan, 2.0, 1.0])]
)
def test_a_message_of_tensions_keeps_slides_in_place(with_slide, names, tensions):
    assert with_slide.accept(names, [], tensions, at(0.0)) is None
    assert with_slide.efforts[:2].tolist() == [1.0, 2.0]
    assert math.isnan(with_slide.efforts[2])


def test_a_message_of_lengths_must_give_the_slides_positions(with_slide):
    assert with_slide.accept(("a", "b"), [1.0, 2.0], [], at(0.0)) is Refusal.WRONG_NAMES
    assert with_slide.accept(("a", "b", "z"), [1.0, 2.0, 0.1], [], at(0.1)) is None
    assert with_slide.setpoints.tolist() == [1.0, 2.0, 0.1]


def test_a_force_for_a_slide_or_no_force_for_a_cable_is_refused(with_slide):
    names = ("a", "b", "z")
    assert with_slide.accept(names, [], [1.0, 2.0, 3.0], at(0.0)) is Refusal.WRONG_FIELDS
    assert with_slide.accept(names, [], [1.0, math.nan, math.nan], at(0.1)) is Refusal.NOT_FINITE
    # A device reports the measured force beside the position.
    assert with_slide.accept(names, [1.0, 2.0, 0.1], [1.0, 2.0, 3.0], at(0.2)) is None


# --- beside targets --------------------------------------------------------------------------

@pytest.fixture
def selected():
    names = ActuatorNames(("a", "b", "z"), {"both": ("a", "b")}, [0.2, 0.3, 0.0], ("z",))
    return SelectedActuatorInput(names, LoopSettings())


def test_only_actuators_named_in_a_message_are_commanded(selected):
    assert selected.accept(("z",), [0.02], [], at(0.0)) is None
    assert math.isnan(selected.setpoints[0]) and selected.setpoints[2] == 0.02
    # The next message says it anew: the slide is free again.
    assert selected.accept(("both",), [0.15], [], at(0.1)) is None
    assert selected.setpoints[:2] == pytest.approx([0.15, 0.25]) and math.isnan(selected.setpoints[2])


def test_a_message_without_names_releases_all_actuators(selected):
    selected.accept(("z",), [0.02], [], at(0.0))
    assert selected.accept((), [], [], at(0.1)) is None
    assert selected.setpoints is None


@pytest.mark.parametrize("names, lengths, tensions, refusal", [
    (("z",), [], [1.0], Refusal.WRONG_FIELDS),
    (("z",), [], [], Refusal.WRONG_SIZE),
    (("z",), [math.nan], [], Refusal.NOT_FINITE),
    (("x",), [0.1], [], Refusal.WRONG_NAMES),
    (("both", "a"), [0.1, 0.1], [], Refusal.WRONG_NAMES),
    ((), [0.1], [], Refusal.WRONG_SIZE),
])  # fmt: skip
def test_a_command_that_is_invalid_beside_targets_changes_nothing(
    selected, names, lengths, tensions, refusal
):
    selected.accept(("z",), [0.02], [], at(0.0))
    assert selected.accept(names, lengths, tensions, at(0.1)) is refusal
    assert selected.setpoints[2] == 0.02


def test_commands_time_out_unless_all_actuators_are_free(selected):
    selected.accept(("z",), [0.02], [], at(0.0))
    assert not selected.is_too_old(0.9, 1.0) and selected.is_too_old(1.1, 1.0)
    assert not selected.is_too_old(100.0, 0.0)
    selected.accept((), [], [], at(0.2))
    assert not selected.is_too_old(100.0, 1.0)
