"""Measured markers."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import MarkerInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS

IDS = np.array([7, 3, 5], dtype=np.uint32)
HERE = np.arange(9.0).reshape(3, 3)


def at(time, frame_id="base_link"):
    now = round((1000.0 + time) * NANOSECONDS)
    return Arrival(frame_id, now, now, time)


def ids(*numbers):
    return np.array(numbers, dtype=np.uint32)


@pytest.fixture
def markers():
    return MarkerInput(IDS, "base_link", LoopSettings(marker_timeout=0.5))


def test_markers_are_put_in_the_order_of_the_scene(markers):
    assert markers.accept(ids(3, 5, 7), HERE, at(0.0)) is None
    assert markers.positions.tolist() == HERE[[2, 0, 1]].tolist()


def test_a_marker_with_a_nan_or_not_in_the_message_is_hidden(markers):
    seen = HERE.copy()
    seen[0, 1] = np.nan
    markers.accept(ids(7, 3), seen[:2], at(0.0))
    assert np.isnan(markers.positions[[0, 2]]).all()
    assert markers.positions[1].tolist() == HERE[1].tolist()


def test_an_unknown_id_is_ignored_and_counted(markers):
    assert markers.accept(ids(3, 99, 0), HERE, at(0.0)) is None
    assert markers.unknown == 2
    assert markers.positions[1].tolist() == HERE[0].tolist()
    assert np.isnan(markers.positions[[0, 2]]).all()


@pytest.mark.parametrize("numbers, positions, arrival, refusal", [
    (ids(3, 5, 7), HERE, at(0.0, "camera"), Refusal.WRONG_FRAME),
    (ids(3, 5), HERE, at(0.0), Refusal.WRONG_SIZE),
    (ids(3, 5, 3), HERE, at(0.0), Refusal.DUPLICATE_ID),
    (ids(3, 5, 7), np.where(HERE == 4.0, np.inf, HERE), at(0.0), Refusal.NOT_FINITE),
    (ids(3, 5, 7), HERE, at(-2.0)._replace(ros_time=1000 * NANOSECONDS), Refusal.STALE),
])  # fmt: skip
def test_a_message_is_refused_as_a_whole_and_counted(markers, numbers, positions, arrival, refusal):
    assert markers.accept(numbers, positions, arrival) is refusal
    assert markers.refusals.by_word() == {refusal.value: 1}
    assert np.isnan(markers.positions).all()


def test_old_markers_are_not_used(markers):
    markers.accept(IDS, HERE, at(0.0))
    assert markers.measured(0.5).tolist() == HERE.tolist()
    assert np.isnan(markers.measured(0.51)).all()


def test_a_scene_without_markers_counts_received_messages():
    markers = MarkerInput(np.empty(0, dtype=np.uint32), "base_link", LoopSettings())
    assert markers.accept(IDS, HERE, at(0.0)) is None
    assert markers.unknown == 3 and markers.positions.shape == (0, 3)


def test_the_misfit_is_that_of_the_visible_markers():
    measured = HERE + [[0.003, 0.0, 0.0], [0.0, 0.004, 0.0], [np.nan] * 3]
    misfit = MarkerInput.misfit(measured, HERE)
    assert misfit.visible == 2
    assert misfit.rms == pytest.approx(np.sqrt((0.003**2 + 0.004**2) / 2))
    assert np.isnan(MarkerInput.misfit(np.full((3, 3), np.nan), HERE).rms)
