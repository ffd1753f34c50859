"""The integrator of the closed loop."""

import numpy as np
import pytest

from softrobot_twin.control.target_correction import GREATEST_SHARE, TargetCorrection
from softrobot_twin.simulation import Status

STEP, GAIN, LIMIT = 0.05, 4.0, 0.005
LIMITED = tuple(status for status in Status if not status.is_success)


def error(x):
    return np.array([[x, 0.0, 0.0]])


def update(correction, x, status=Status.OK):
    correction.update(error(x), STEP, status, GAIN, LIMIT)
    return correction.offsets[0, 0]


def test_a_constant_fault_of_the_model_is_taken_away():
    correction, fault = TargetCorrection(1), 0.002
    for _ in range(100):
        left = fault - correction.offsets[0, 0]
        update(correction, left)
    assert left == pytest.approx(0.0, abs=1e-8)


def test_one_measurement_adds_gain_times_time_times_error():
    assert update(TargetCorrection(1), 0.001) == pytest.approx(GAIN * STEP * 0.001)


def test_a_linearized_step_is_corrected_like_an_exact_one():
    exact, linearized = (
        update(TargetCorrection(1), 0.001, status) for status in (Status.OK, Status.LINEARIZED)
    )
    assert linearized == exact > 0.0


def test_rare_measurements_take_in_no_more_than_a_share_of_the_error():
    correction = TargetCorrection(1)
    correction.update(error(0.001), 10.0, Status.OK, GAIN, LIMIT)
    assert correction.offsets[0, 0] == pytest.approx(GREATEST_SHARE * 0.001)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_it_settles_although_measurements_are_old(delay):
    """What is seen was commanded some measurements ago, and came after a long time each."""
    correction, fault = TargetCorrection(1), 0.002
    past = [0.0] * (delay + 1)
    for _ in range(200):
        past.append(correction.offsets[0, 0])
        left = fault - past[-1 - delay]
        correction.update(error(left), 10.0, Status.OK, GAIN, LIMIT)
    assert left == pytest.approx(0.0, abs=1e-6)


def test_the_correction_never_grows_past_its_limit():
    correction = TargetCorrection(1)
    for _ in range(1000):
        correction.update(np.array([[0.03, -0.04, 0.0]]), STEP, Status.OK, GAIN, LIMIT)
    assert np.linalg.norm(correction.offsets[0]) == pytest.approx(LIMIT)
    assert correction.offsets[0] == pytest.approx([0.003, -0.004, 0.0])


def test_it_leaves_its_limit_at_once_when_the_error_turns():
    correction = TargetCorrection(1)
    for _ in range(1000):
        update(correction, 0.05)
    assert update(correction, -0.001) < LIMIT


@pytest.mark.parametrize("status", LIMITED)
def test_it_does_not_wind_up_where_the_actuators_cannot_follow(status):
    correction = TargetCorrection(1)
    before = update(correction, 0.001)
    for _ in range(100):
        assert update(correction, 0.05, status) == before
    assert update(correction, -0.0005, status) < before


def test_it_stays_where_it_is_without_a_measurement():
    correction = TargetCorrection(1)
    before = update(correction, 0.001)
    assert update(correction, np.nan) == before


def test_it_fades_when_the_loop_is_opened():
    correction = TargetCorrection(1)
    before = update(correction, 0.001)
    correction.fade(STEP, GAIN)
    assert correction.offsets[0, 0] == pytest.approx(before * np.exp(-GAIN * STEP))


def test_reset_takes_it_away():
    correction = TargetCorrection(1)
    update(correction, 0.001)
    correction.reset()
    assert not correction.offsets.any()
