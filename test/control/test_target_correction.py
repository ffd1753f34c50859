"""From targets to aims: approach of far targets, measured effectors, correction by misfit or integral."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.control.inputs import MarkerInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.model_history import Moment
from softrobot_twin.control.target_correction import (
    CALM_LEAST,
    MISFIT_SHARE,
    SURE_SHARE,
    UNALIGNED_TIME,
    EffectorMeasurement,
    EffectorMisfit,
    Law,
    TargetCorrection,
    approach,
    approach_poses,
)
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation, Status

HERE = np.array([[0.0, 0.0, 0.1], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
AIMS = np.array([[0.03, 0.04, 0.1], [0.1, 0.001, 0.0], [np.nan] * 3])


def test_a_far_target_is_approached_and_a_near_one_is_used_directly():
    points = approach(HERE, AIMS, 0.01)
    assert points[0] == pytest.approx([0.006, 0.008, 0.1])
    assert points[1].tolist() == AIMS[1].tolist()
    assert np.isnan(points[2]).all()


def test_position_and_orientation_of_a_far_pose_keep_pace():
    turns = np.full((3, 4), np.nan)
    here = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    turns[0] = [0.0, np.sin(0.5), 0.0, np.cos(0.5)]
    points, nearer = approach_poses(HERE, AIMS, here, turns, np.full(3, 0.12), 0.013)
    # 50 mm and 1 rad of 120 mm are 130 mm: a tenth of each.
    assert points[0] == pytest.approx([0.003, 0.004, 0.1])
    assert nearer[0] == pytest.approx([0.0, np.sin(0.05), 0.0, np.cos(0.05)])
    assert points[1].tolist() == AIMS[1].tolist()
    assert np.isnan(nearer[1:]).all()
    whole = approach_poses(HERE, AIMS, here, turns, np.full(3, 0.12), np.inf)
    assert np.array_equal(whole[0], AIMS, equal_nan=True)
    assert np.array_equal(whole[1], turns, equal_nan=True)


PREDICTED = np.array([[0.0, 0.0, 0.125]])


@pytest.fixture
def measurement(simulation):
    return EffectorMeasurement(simulation)


def misfit_of(**vectors):
    """Misfit with these vectors [m] by marker, the others hidden."""
    measured = np.full((8, 3), np.nan)
    for marker, vector in vectors.items():
        measured[int(marker[1:])] = vector
    return MarkerInput.misfit(measured, np.zeros((8, 3)))


def test_an_effector_is_moved_by_the_mean_misfit_of_its_visible_markers(measurement):
    # Markers 4 to 7 stand around the tip; marker 0 does not.
    misfit = misfit_of(m0=[9.0, 9.0, 9.0], m4=[0.001, 0.0, 0.0], m6=[0.003, 0.002, 0.0])
    assert measurement.effectors(PREDICTED, misfit) == pytest.approx(
        PREDICTED + [[0.002, 0.001, 0.0]]
    )


def test_an_effector_without_a_visible_marker_is_not_measured(measurement):
    misfit = misfit_of(m0=[0.001, 0.0, 0.0])
    assert np.isnan(measurement.effectors(PREDICTED, misfit)).all()
    assert not measurement.is_complete(misfit.vectors)
    assert measurement.is_complete(misfit_of(m7=[0.0, 0.0, 0.0]).vectors)


def test_an_error_is_measured_where_possible_and_else_predicted(measurement):
    targets = PREDICTED + [[0.003, 0.0, 0.004]]
    assert measurement.errors(targets, PREDICTED, np.full((1, 3), np.nan)) == pytest.approx(0.005)
    assert measurement.errors(targets, PREDICTED, targets) == pytest.approx(0.0)
    assert np.isnan(measurement.errors(np.full((1, 3), np.nan), PREDICTED, targets)).all()


def test_a_direction_that_is_not_controlled_has_no_error(small_scene_mapping):
    mapping = {**small_scene_mapping}
    mapping["effectors"] = [{**small_scene_mapping["effectors"][0], "directions": ["x", "z"]}]
    measurement = EffectorMeasurement(Simulation(scene_from_mapping(mapping)))
    targets = PREDICTED + [[0.003, 0.1, 0.004]]
    assert measurement.differences(targets, PREDICTED) == pytest.approx(
        np.array([[0.003, 0.0, 0.004]])
    )
    assert measurement.controlled(targets, PREDICTED) == pytest.approx(
        np.array([[0.003, 0.0, 0.129]])
    )
    assert measurement.errors(targets, PREDICTED, PREDICTED) == pytest.approx(0.005)


STEP, GAIN, LIMIT, FAULT = 0.05, 4.0, 0.005, 0.002
LIMITED = tuple(status for status in Status if not status.is_success)


def error(x):
    return np.array([[x, 0.0, 0.0]])


def update(correction, x, status=Status.OK):
    correction.update(error(x), STEP, status, GAIN, LIMIT)
    return correction.offsets[0, 0]


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_it_settles_although_measurements_are_old(delay):
    """A measurement shows a command of several measurements ago, with long intervals between."""
    correction, past = TargetCorrection(1), [0.0] * (delay + 1)
    for _ in range(200):
        past.append(correction.offsets[0, 0])
        left = FAULT - past[-1 - delay]
        correction.update(error(left), 10.0, Status.OK, GAIN, LIMIT)
    assert left == pytest.approx(0.0, abs=1e-6)


def test_the_correction_never_exceeds_its_limit():
    correction = TargetCorrection(1)
    for _ in range(1000):
        correction.update(np.array([[0.03, -0.04, 0.0]]), STEP, Status.OK, GAIN, LIMIT)
    assert np.linalg.norm(correction.offsets[0]) == pytest.approx(LIMIT)
    assert correction.offsets[0] == pytest.approx([0.003, -0.004, 0.0])


@pytest.mark.parametrize("status", LIMITED)
def test_it_does_not_integrate_where_the_actuators_cannot_follow(status):
    correction = TargetCorrection(1)
    before = update(correction, 0.001)
    for _ in range(100):
        assert update(correction, 0.05, status) == before
    assert update(correction, -0.0005, status) < before


def misfit(x, seen=4):
    return EffectorMisfit(error(x), np.array([seen]))


def settled(delay, factor, *options):
    """What is left of a fault [m], and the corrections [m], of 1500 measurements that come late.

    The robot moves `factor` times as far as the model; `options` are those of `follow`.
    """
    correction, past, left = TargetCorrection(1), [0.0] * (delay + 1), []
    for _ in range(1500):
        then = past[-1 - delay]
        left.append(FAULT + factor * then)
        correction.follow(misfit(left[-1] - then), *options)
        past.append(correction.offsets[0, 0])
    return np.array(left), past[delay + 1:]


@pytest.mark.parametrize("delay", [0, 3, 12])
@pytest.mark.parametrize("factor", [0.1, 1.0, 2.0])
def test_the_misfit_settles_with_any_delay_and_a_robot_that_moves_more_or_less(delay, factor):
    """A right model does not overshoot."""
    left, _ = settled(delay, factor, MISFIT_SHARE, 1.0)
    assert abs(left[-1]) < 1e-3 * FAULT
    assert factor > 1.0 or min(left) > -1e-9


@pytest.mark.parametrize("delay", [0, 3, 12])
@pytest.mark.parametrize("factor", [0.1, 1.0, 1.9, 2.0])
def test_a_change_that_cannot_be_noise_is_followed_faster_and_settles_too(delay, factor):
    left, corrections = settled(delay, factor, 1.0, 1.0, 1e-6)
    assert corrections[0] == pytest.approx(-SURE_SHARE * FAULT)
    # At twice the motion and a delay of 12 measurements it takes a thousand of them to halve.
    assert np.abs(left[-50:]).max() < (1e-3 if factor < 2.0 else 0.5) * FAULT


def test_a_change_that_may_be_noise_is_followed_slowly():
    correction, noise = TargetCorrection(1), 2e-4
    correction.follow(misfit(noise), 1.0, LIMIT, noise)
    assert correction.offsets[0, 0] == pytest.approx(-MISFIT_SHARE * noise)
    correction.reset()
    # How much noise there is may not be known.
    correction.follow(misfit(0.002), 1.0, LIMIT, 0.0)
    assert correction.offsets[0, 0] == pytest.approx(-MISFIT_SHARE * 0.002)


def test_the_misfit_is_compensated_however_far_the_target_is():
    """Actuators that cannot follow let nothing wind up: the misfit does not depend on the target."""
    correction = TargetCorrection(1)
    for tick in range(1, 60):
        correction.tick(LoopSettings(closed_loop=True), tick * 50_000_000, error(0.1),
                        misfit(0.002), Status.SATURATED)  # fmt: skip
    assert correction.law is Law.MISFIT
    assert correction.offsets[0] == pytest.approx([-0.002, 0.0, 0.0])


def test_it_follows_no_misfit_beyond_its_limit():
    correction = TargetCorrection(1)
    for _ in range(100):
        correction.follow(misfit(0.05), MISFIT_SHARE, LIMIT)
    assert np.linalg.norm(correction.offsets[0]) == pytest.approx(LIMIT)
    correction.follow(misfit(0.0), MISFIT_SHARE, LIMIT)
    assert np.linalg.norm(correction.offsets[0]) < 0.7 * LIMIT


def test_noise_moves_a_resting_robot_less_and_a_load_is_followed_at_once(drawn_rng):
    correction, noise = TargetCorrection(1), 2e-4
    rng, past = drawn_rng, []
    for _ in range(400):
        seen = misfit(0.0)._replace(positions=rng.normal(0.0, noise / 2.0, (1, 3)))
        correction.follow(seen, MISFIT_SHARE, LIMIT, noise, stands=True)
        past.append(correction.offsets[0].copy())
    # A filter of the first order leaves √(a / (2 - a)) of the noise.
    usual = noise / 2.0 * np.sqrt(MISFIT_SHARE / (2.0 - MISFIT_SHARE))
    assert np.std(past[100:]) < 3.0 * np.sqrt(CALM_LEAST) * usual
    correction.follow(misfit(0.003), MISFIT_SHARE, LIMIT, noise, stands=True)
    assert correction.offsets[0, 0] < -0.3 * MISFIT_SHARE * 0.003 / 0.35


def test_the_integrator_stands_in_after_a_second_without_a_known_moment():
    correction, settings = TargetCorrection(1), LoopSettings(closed_loop=True)
    period = 50_000_000
    correction.tick(settings, 20 * period, error(0.001), misfit(0.0), Status.OK)
    laws = []
    for tick in range(21, 60):
        correction.tick(settings, tick * period, error(0.001), None, Status.OK)
        laws.append(correction.law)
    waited = laws.index(Law.INTEGRATOR)
    assert (waited + 1) * 0.05 == pytest.approx(UNALIGNED_TIME, abs=0.11)
    assert correction.offsets[0, 0] > 0.0
    # In open loop nothing is corrected.
    correction.tick(LoopSettings(), 61 * period, None, None, Status.OK)
    assert correction.law is Law.NONE


@pytest.fixture
def posed(drive_posed):
    loop = drive_posed().loop
    model = Moment(loop.simulation.marker_positions(), loop.simulation.effector_positions())
    return loop.measurement, model


def test_markers_that_stand_apart_tell_the_rotation_of_an_effector(posed):
    measurement, model = posed
    turn = Rotation.from_rotvec([0.03, -0.02, 0.05])
    seen = turn.apply(model.markers) + [0.001, 0.0, -0.002]
    seen[5] = np.nan
    found = measurement.misfit(seen, model)
    assert found.seen.tolist() == [3]
    assert found.turns[0] == pytest.approx(turn.as_rotvec())
    there = turn.apply(model.effectors[0]) + [0.001, 0.0, -0.002]
    assert found.positions[0] == pytest.approx(there - model.effectors[0])


def test_markers_on_a_line_tell_no_rotation(posed):
    measurement, model = posed
    seen = model.markers + 0.001
    seen[[5, 7]] = np.nan
    found = measurement.misfit(seen, model)
    assert np.isnan(found.turns).all()
    assert found.positions[0] == pytest.approx([0.001] * 3)


def test_a_wanted_orientation_is_turned_back_by_its_misfit():
    correction, turn = TargetCorrection(1), Rotation.from_rotvec([0.0, 0.1, 0.0])
    turned = misfit(0.0)._replace(turns=turn.as_rotvec()[None])
    for _ in range(60):
        correction.follow(turned, MISFIT_SHARE, LIMIT)
    wanted = Rotation.from_rotvec([0.2, 0.0, 0.0])
    aim = Rotation.from_quat(correction.turned(wanted.as_quat()[None])[0])
    assert (turn * aim * wanted.inv()).magnitude() < 1e-9
    assert np.isnan(correction.turned(np.full((1, 4), np.nan))).all()


def test_markers_that_mirror_turn_a_wanted_orientation_no_further_than_the_limit():
    correction, length = TargetCorrection(1, np.array([0.05])), 0.05
    turned = misfit(0.0)._replace(turns=np.array([[0.0, 0.0, 3.0]]))
    for _ in range(20):
        correction.follow(turned, SURE_SHARE, 0.01)
    assert np.linalg.norm(correction.turns[0]) == pytest.approx(0.01 / length)


def test_markers_that_collapse_tell_no_rotation(posed):
    measurement, model = posed
    collapsed = np.tile(model.markers.mean(axis=0), (len(model.markers), 1))
    assert np.isnan(measurement.misfit(collapsed, model).turns).all()
