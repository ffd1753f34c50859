"""Named lengths and tensions."""

import math

import pytest

from softrobot_twin.control.arrival import NANOSECONDS, Arrival
from softrobot_twin.control.cable_input import CableInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.refusal import Refusal
from softrobot_twin.control.winding import Winding

NAMES = ("north", "west", "south")


def at(time):
    now = round((1000.0 + time) * NANOSECONDS)
    return Arrival("", now, now, time)


@pytest.fixture
def cables():
    return CableInput(Winding(NAMES), LoopSettings())


def test_values_are_put_in_the_order_of_the_simulation(cables):
    assert cables.accept(("south", "north", "west"), [3.0, 1.0, 2.0], [], at(0.0)) is None
    assert cables.lengths.tolist() == [1.0, 2.0, 3.0]
    assert cables.tensions is None
    # The order may change from message to message.
    assert cables.accept(("west", "south", "north"), [2.0, 3.0, 1.0], [], at(0.1)) is None
    assert cables.lengths.tolist() == [1.0, 2.0, 3.0]


def test_a_message_may_give_tensions_alone(cables):
    cables.accept(NAMES, [1.0, 2.0, 3.0], [], at(0.0))
    assert cables.accept(NAMES, [], [4.0, 5.0, 6.0], at(0.1)) is None
    assert cables.lengths is None
    assert cables.tensions.tolist() == [4.0, 5.0, 6.0]


@pytest.mark.parametrize(
    ("names", "lengths", "tensions", "refusal"),
    [
        (NAMES, [1.0, math.nan, 3.0], [], Refusal.NOT_FINITE),
        (NAMES, [1.0, 2.0, 3.0], [1.0, math.inf, 1.0], Refusal.NOT_FINITE),
        (NAMES, [1.0, 2.0], [], Refusal.WRONG_SIZE),
        (NAMES, [], [1.0] * 4, Refusal.WRONG_SIZE),
        (NAMES, [], [], Refusal.WRONG_SIZE),
        (NAMES[:2], [1.0, 2.0], [], Refusal.WRONG_NAMES),
        (("north", "west", "east"), [1.0, 2.0, 3.0], [], Refusal.WRONG_NAMES),
        (("north", "north", "west"), [1.0, 2.0, 3.0], [], Refusal.WRONG_NAMES),
        ((), [1.0, 2.0, 3.0], [], Refusal.WRONG_NAMES),
    ],
)
def test_a_message_that_does_not_fit_is_refused_and_counted(
    cables, names, lengths, tensions, refusal
):
    assert cables.accept(names, lengths, tensions, at(0.0)) is refusal
    assert cables.refusals.by_word() == {refusal.value: 1}
    assert cables.lengths is None and cables.tensions is None
    assert cables.age(1.0) == math.inf


def test_an_older_message_is_refused(cables):
    cables.accept(NAMES, [1.0, 2.0, 3.0], [], at(0.1))
    assert cables.accept(NAMES, [0.0] * 3, [], at(0.0)) is Refusal.OUT_OF_ORDER
    assert cables.lengths.tolist() == [1.0, 2.0, 3.0]
