"""What residuals of a fit tell, with linear models whose truth is known."""

import numpy as np
import pytest

from softrobot_twin.calibration.residual_analysis import (
    Linear,
    Reach,
    faulty,
    hysteresis,
    reach_of,
    selected,
    spread_between,
)

POSES, POINTS = 40, 3


def linear(rng, truth, noise=1.0):
    """A model fitted to measurements of a truth: residuals and numbers at the optimum."""
    J = rng.normal(size=(POSES * POINTS, len(truth))) * 5.0
    start = -J @ truth + noise * rng.normal(size=len(J))
    z = -np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ start)
    return Linear(start + J @ z, J, z, np.repeat(np.arange(POSES), POINTS))


@pytest.mark.parametrize("seed", range(5))
def test_the_numbers_that_differ_are_chosen_and_hardly_another(seed):
    rng, truth = np.random.default_rng(seed), np.zeros(20)
    truth[[3, 11, 17]] = [2.0, -0.7, 1.2]
    steps = selected(linear(rng, truth))
    chosen = [one.number for one in steps]
    assert chosen[0] == 3 and set(chosen) >= {3, 11, 17} and len(chosen) <= 5
    assert all(one.after < one.before for one in steps)


def test_given_numbers_are_taken_in_any_case(drawn_rng):
    assert [one.number for one in selected(linear(drawn_rng, np.zeros(4)), [2])][0] == 2


def test_of_two_numbers_that_do_the_same_one_is_chosen():
    rng = np.random.default_rng(2)
    found = linear(rng, np.array([1.5, 0.0]))
    J = np.repeat(found.jacobian[:, :1], 2, axis=1)
    start = found.residuals - found.jacobian @ found.z
    assert len(selected(Linear(start, J, np.zeros(2), found.poses))) == 1


def test_a_block_of_rows_is_faulty_and_a_wrong_model_is_not():
    rng = np.random.default_rng(5)
    off = 1e-3 * rng.normal(size=(60, 2, 3))
    off[20:26, :, 1] += 0.013
    off[3, 0] = np.nan
    found = faulty(off)
    assert np.flatnonzero(found.all(axis=1)).tolist() == list(range(20, 26)) and found.sum() == 12
    off[:40, :, 1] += 0.013
    assert not faulty(off).any()


def test_a_point_that_is_always_further_off_than_others_is_no_fault(drawn_rng):
    # Of normal noise one value in 27,000 counts as faulty.
    off = drawn_rng.uniform(-1e-4, 1e-4, size=(60, 8, 3))
    off[:, :2] *= 3.0
    assert not faulty(off).any()


def test_hysteresis_is_separated_from_noise():
    rng = np.random.default_rng(7)
    places = rng.uniform(-0.05, 0.05, (60, 3))
    off = 3e-4 * rng.normal(size=(60, 3))
    assert hysteresis(off, places) is None
    off[1:, 0] -= 4e-4 * np.sign(np.diff(places[:, 0]))
    off -= places @ np.linalg.lstsq(places, off)[0]  # A fit takes what grows with the place for its own.
    found = hysteresis(off, places)
    assert found.amplitudes[0, 0] == pytest.approx(4e-4, abs=1e-4) and np.count_nonzero(found.amplitudes) == 1
    assert found.before[0] == pytest.approx(5e-4, rel=0.25) and found.after[0] == pytest.approx(3e-4, rel=0.25)


def test_the_error_outside_grows_where_the_form_of_the_model_is_wrong():
    rng = np.random.default_rng(3)
    x = rng.uniform(-1.0, 1.0, (POSES, 2))
    J, factors = np.column_stack([x, np.ones(POSES)]) * 10.0, []
    for curved in (0.0, 8.0):
        start = curved * x[:, 0] ** 2 + rng.normal(size=POSES)
        z = -np.linalg.solve(J.T @ J + np.eye(3), J.T @ start)
        reach = reach_of(Linear(start + J @ z, J, z, np.arange(POSES)), x)
        factors.append(reach.factor)
        assert reach.factors(x).max() == 1.0 and reach.factors(np.array([[2.0, 2.0]]))[0] == reach.factor
    assert factors[0] < 1.3 and factors[1] > 1.5


def test_intervals_of_a_session_that_was_not_seen_hold_by_what_two_tell(drawn_rng):
    sessions, inside = np.repeat(["day_1.csv", "day_2.csv"], 20), []
    for _ in range(400):
        shifts, off = drawn_rng.normal(0.0, 1.4e-3, (3, 3)), drawn_rng.normal(0.0, 5e-4, (60, 3))
        off = off + np.repeat(shifts, 20, axis=0) - shifts[:2].mean(axis=0)  # what both share is fitted
        reach = Reach(*np.empty((4, 0)), tuple(np.unique(sessions)), spread_between(off[:40], sessions))
        inside.append(np.mean(np.abs(off[40:]) < 1.96 * np.hypot(off[:40].std(), reach.further)))
    assert 0.9 < np.mean(inside) < 0.99 and np.isnan(spread_between(off[:20], sessions[:20]))
