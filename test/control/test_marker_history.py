"""Where the markers were."""

import numpy as np
import pytest

from softrobot_twin.control.marker_history import MarkerHistory


def at(place):
    return np.full((2, 3), float(place))


def test_between_two_ticks_the_markers_lie_on_a_line():
    history = MarkerHistory(2)
    history.add(100, at(1))
    history.add(200, at(3))
    assert history.at(125).tolist() == at(1.5).tolist()


def test_outside_the_ticks_the_nearest_one_counts():
    history = MarkerHistory(2)
    history.add(100, at(1))
    history.add(200, at(3))
    assert history.at(50).tolist() == at(1).tolist()
    assert history.at(300).tolist() == at(3).tolist()
    assert history.at(200).tolist() == at(3).tolist()


def test_only_the_newest_ticks_are_remembered():
    history = MarkerHistory(2, capacity=4)
    for tick in range(10):
        history.add(100 * tick, at(tick))
    assert history.at(0).tolist() == at(6).tolist()
    assert history.at(750).tolist() == at(7.5).tolist()


def test_a_clock_that_was_set_back_begins_a_new_history():
    history = MarkerHistory(2)
    history.add(1000, at(1))
    history.add(100, at(2))
    assert history.at(1000).tolist() == at(2).tolist()


def test_no_markers_are_known_before_the_first_tick():
    with pytest.raises(LookupError):
        MarkerHistory(2).at(0)
