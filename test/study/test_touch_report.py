"""What a fingertip felt, out of the record of a touch."""

import numpy as np
import pytest

from softrobot_twin.study.touch_report import presses_of, touch_report, untouched
from softrobot_twin.study.tracking import TimedValues

NOTHING = TimedValues(np.empty(0), np.empty((0, 0)))


def record(stiffness=(200.0, 300.0), depth=0.001) -> TimedValues:
    """A press each two seconds, of a second, along -z; the last one is cut off early."""
    times = np.arange(0.0, 4.6, 0.02)
    phase = times % 2.0 - 1.0
    course = np.where(phase > 0.0, 0.5 * depth * (1.0 - np.cos(2.0 * np.pi * phase)), 0.0)
    course[np.abs(course) < 1e-12] = 0.0
    felt = np.where(times < 2.0, stiffness[0], stiffness[1])
    moves, forces = np.zeros((2, len(times), 3))
    moves[:, 2], forces[:, 2] = -course, -felt * course
    return TimedValues(times, np.hstack([moves, forces]))


def wanted() -> TimedValues:
    nan = np.nan
    return TimedValues(np.array([0.0, 2.5]), np.array([[nan, nan, 210.0], [nan, nan, 300.0]]))


def test_each_press_is_found_with_its_stiffness():
    presses = presses_of(record())
    assert [press.stiffness for press in presses] == pytest.approx([200.0, 300.0])
    assert presses[0].time == pytest.approx(1.02) and presses[1].time == pytest.approx(3.02)
    assert presses[0].depths.max() == pytest.approx(0.001)


def test_a_press_that_was_cut_off_is_left_out():
    whole = record()
    kept = whole.times < 3.1
    assert len(presses_of(TimedValues(whole.times[kept], whole.values[kept]))) == 1


def test_the_report_compares_with_what_was_wanted_when_the_press_began():
    report = touch_report(record(), record((202.0, 305.0)), wanted())
    assert [press["target_n_per_m"] for press in report["presses"]] == [210.0, 300.0]
    assert [press["twin_n_per_m"] for press in report["presses"]] == pytest.approx([202.0, 305.0])
    assert report["max_error_percent"] == pytest.approx(100.0 / 21.0)
    assert report["median_error_percent"] == pytest.approx(50.0 / 21.0)


def test_without_a_press_there_is_no_report_and_without_a_target_no_error():
    assert touch_report(NOTHING, NOTHING, NOTHING) is None
    still = record()
    assert touch_report(TimedValues(still.times, 0.0 * still.values), NOTHING, NOTHING) is None
    report = touch_report(still, NOTHING, NOTHING)
    assert report["max_error_percent"] is None
    assert [press["target_n_per_m"] for press in report["presses"]] == [None, None]


def test_what_a_finger_displaced_is_left_out():
    touch = record()
    values = TimedValues(np.array([0.5, 1.5, 2.5]), np.arange(9.0).reshape(3, 3))
    kept = untouched(values, touch)
    assert kept.times.tolist() == [0.5, 2.5] and kept.values[1].tolist() == [6.0, 7.0, 8.0]
    assert untouched(values, NOTHING) is values
