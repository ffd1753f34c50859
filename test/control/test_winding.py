"""Motors beside cables."""

import numpy as np
import pytest

from softrobot_twin.control.winding import Winding

CABLES = ("a", "b", "c")
REST = np.array([0.10, 0.12, 0.20])


@pytest.fixture
def winding():
    return Winding(CABLES, {"grip": ("b", "c"), "all": CABLES}, REST)


def test_a_motor_s_position_is_the_length_of_its_first_cable(winding):
    order = winding.order_of(("all",))
    lengths = np.array([0.08])[order.places] + order.offsets
    # All three are as much shorter as the first one.
    assert REST - lengths == pytest.approx([0.02] * 3)


def test_motors_and_cables_may_stand_side_by_side_in_any_order(winding):
    order = winding.order_of(("grip", "a"))
    lengths = np.array([0.11, 0.09])[order.places] + order.offsets
    assert lengths == pytest.approx([0.09, 0.11, 0.19])


def test_a_cable_s_own_length_is_taken_as_it_is(winding):
    order = winding.order_of(("c", "a", "b"))
    assert order.places.tolist() == [1, 2, 0]
    assert order.offsets.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    "names",
    [("all", "a"), ("grip", "b", "a"), ("a", "a", "b", "c"), ("a", "b", "x"),
     ("grip", "grip", "a")],
)
def test_names_that_are_unknown_or_wind_a_cable_twice_are_none(winding, names):
    assert winding.order_of(names) is None
