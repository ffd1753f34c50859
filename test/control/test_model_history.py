"""The model of an earlier moment: by its time, and by where its actuators were."""

import numpy as np
import pytest

from softrobot_twin.control.model_history import APART, LONGEST_DELAY, ModelHistory, Moment

SECOND = 1_000_000_000


def history(capacity=256, travels=(0.04, 0.04)):
    return ModelHistory(np.array(travels), 2, 1, capacity)


def add(ticks, time, place, setpoints=(0.0, 0.0)):
    moment = Moment(np.full((2, 3), float(place)), np.full((1, 3), float(place)))
    ticks.add(time, np.array(setpoints), moment)


@pytest.mark.parametrize(("time", "place"), [
    (50, 1), (100, 1), (125, 1.5), (150, 2), (200, 3), (300, 3)])  # fmt: skip
def test_between_two_ticks_the_markers_lie_on_a_line_and_outside_the_nearest_one_counts(time, place):
    ticks = history()
    add(ticks, 100, 1)
    add(ticks, 200, 3)
    assert (ticks.at(time).markers == place).all()
    assert (ticks.at(time).effectors == place).all()


def test_only_the_newest_ticks_are_remembered():
    ticks = history(capacity=4)
    for tick in range(10):
        add(ticks, 100 * tick, tick)
        assert (ticks.at(0).markers == max(0, tick - 3)).all()
    assert (ticks.at(750).markers == 7.5).all()


def test_a_clock_that_was_set_back_starts_a_new_history():
    ticks = history()
    add(ticks, 1000, 1)
    add(ticks, 100, 2)
    assert (ticks.at(1000).markers == 2).all()


def test_nothing_is_known_before_the_first_tick():
    with pytest.raises(LookupError):
        history().at(0)
    assert history().executed(np.zeros(2), 0) is None


def test_measured_setpoints_tell_the_moment_that_the_device_executes():
    """However late it is: they are looked for on the way from tick to tick."""
    ticks, period = history(), SECOND // 40
    for tick in range(20):
        add(ticks, tick * period, tick, (0.001 * tick, 0.002 * tick))
    for late in (0.0, 3.0, 7.4, 12.0):
        found = ticks.executed(np.array([0.001, 0.002]) * (19.0 - late), 19 * period)
        assert found.markers == pytest.approx(np.full((2, 3), 19.0 - late))


def test_of_ticks_with_the_same_setpoints_the_newest_one_is_meant():
    ticks = history()
    for tick in range(5):
        add(ticks, tick * 1000, tick)
    assert (ticks.executed(np.zeros(2), 5000).markers == 4).all()


def test_setpoints_that_the_model_did_not_have_tell_no_moment():
    ticks, off = history(), 1.01 * APART * 0.04
    add(ticks, 0, 1)
    add(ticks, 1000, 2, (0.01, 0.0))
    assert ticks.executed(np.array([0.005, off]), 1000) is None
    assert ticks.executed(np.array([0.005, 0.98 * off]), 1000) is not None
    # Those of long ago are not meant.
    add(ticks, round(1.1 * LONGEST_DELAY * SECOND), 3, (0.02, 0.0))
    assert ticks.executed(np.array([0.005, 0.0]), round(1.2 * LONGEST_DELAY * SECOND)) is None
