"""The names in a message: actuators and motors."""

import numpy as np
import pytest

from softrobot_twin.control.inputs import ActuatorNames

CABLES = ("a", "b", "c")
REST = np.array([0.10, 0.12, 0.20])


@pytest.fixture
def known():
    return ActuatorNames(CABLES, {"grip": ("b", "c"), "all": CABLES}, REST)


def test_a_motor_s_position_is_the_length_of_its_first_cable(known):
    order = known.order_of(("all",))
    lengths = np.array([0.08])[order.places] + order.offsets
    # All three are as much shorter as the first one.
    assert REST - lengths == pytest.approx([0.02] * 3)


def test_motors_and_cables_may_stand_side_by_side_in_any_order(known):
    order = known.order_of(("grip", "a"))
    lengths = np.array([0.11, 0.09])[order.places] + order.offsets
    assert lengths == pytest.approx([0.09, 0.11, 0.19])


def test_a_length_named_by_cable_is_used_unchanged(known):
    order = known.order_of(("c", "a", "b"))
    assert order.places.tolist() == [1, 2, 0]
    assert order.offsets.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("names", [
    ("all", "a"), ("grip", "b", "a"), ("a", "a", "b", "c"), ("a", "b", "x"), ("grip", "grip", "a"),
])  # fmt: skip
def test_unknown_names_and_duplicate_cables_are_refused(known, names):
    assert known.order_of(names) is None


def test_cables_not_named_in_a_message_have_no_value(known):
    order = known.order_of(("grip",))
    assert order.named.tolist() == [False, True, True]
    lengths = order.values(np.array([0.1])) + order.offsets
    assert np.isnan(lengths[0]) and lengths[1:] == pytest.approx([0.1, 0.18])
    assert not known.order_of(()).named.any()


def test_slides_are_addressed_by_name():
    known = ActuatorNames(("a", "b", "z"), by_position=("z",))
    assert known.by_position.tolist() == [False, False, True]
