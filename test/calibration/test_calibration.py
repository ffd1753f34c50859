"""Numbers of a scene from what was measured at rest."""

import re
from copy import deepcopy

import numpy as np
import pytest

from softrobot_twin.calibration.calibration import (
    MARKERS,
    OBSERVED,
    CalibrationError,
    Measurements,
    Prediction,
    RestModel,
    Unknown,
    calibrate,
    deviations_with,
    estimate,
    suggestions,
    unknowns_of,
    usual_keys,
)
from softrobot_twin.calibration.calibration_report import why_not
from softrobot_twin.command_line.commands import program
from softrobot_twin.control.rest_watch import RestPose
from softrobot_twin.errors import NamedError
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.loading import read_changes
from softrobot_twin.scene.scene_parameters import changed_scene, parameters, tied, value_at
from softrobot_twin.scripting import build
from test.places import SCENES

BAR = {
    "name": "bar",
    "gravity": [0.0, 0.0, -9.81],
    "body": {
        "mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [6, 1, 1]}, "translation": [-0.05, -0.01, -0.01]},
        "element": "linear",
        "material": {"young_modulus": 3.0e5, "poisson_ratio": 0.4, "density": 1070.0},
        "fixed": [{"box": {"minimum": [-0.0501, -1, -1], "maximum": [-0.0499, 1, 1]}}],
    },
    "cables": [
        {"name": name, "pull_point": [-0.05, y, z], "axial_stiffness": 500.0,
         "points": [[-0.011, y, z], [0.043, y, z]], "shortening": [-0.01, 0.02]}
        for name, y, z in (("upper", 0.0, 0.009), ("left", 0.009, -0.006), ("right", -0.009, -0.006))
    ],
    "effectors": [{"name": "tip", "points": [[0.05, 0.0, 0.0]]}],
    "touches": [{"name": "weight", "points": [[0.048, 0.0, 0.0]]}],
    "markers": [{"id": i, "point": place} for i, place in enumerate(
        [[0.047, 0.003, 0.008], [0.047, -0.003, 0.008], [0.021, 0.002, 0.0095], [0.0021, -0.004, 0.0093]])],
    "solver": {"newton_iterations": 5, "residual_tolerance": 1e-8},
}  # fmt: skip
E, DENSITY = "body.material.young_modulus", "body.material.density"
NUMBERS = [E, "cables.*.offset", "marker_frame"]
NOISE = {"markers": 1e-4, "tension": 0.02}


@pytest.fixture(scope="module")
def bar():
    return scene_from_mapping(BAR)


@pytest.fixture
def random(drawn_rng):
    return drawn_rng


def poses_at(scene, shortenings, weights=None, with_tensions=True):
    """Poses whose measurements are still to be made; all their numbers are finite."""
    lengths = RestModel(scene, [], []).simulation.rest_setpoints
    count, forces = len(shortenings), np.zeros((len(shortenings), 1, 3))
    forces[:, 0, 2] = 0.0 if weights is None else -np.asarray(weights)
    efforts = np.full(len(lengths), 0.0 if with_tensions else np.nan)
    return [RestPose(lengths - shortenings[k], np.zeros((4, 3)), np.full((1, 3), np.nan), efforts,
                     forces[k], f"pose {k}") for k in range(count)]  # fmt: skip


def measured(scene, poses, noise=0.0, random=None):
    """The poses, with what a robot of this scene shows there."""
    shown = RestModel(scene, [], poses).predict(np.empty(0), False).values.reshape(len(poses), -1)
    found = []
    for pose, one in zip(poses, shown, strict=True):
        markers, efforts = one[:12].reshape(4, 3), pose.efforts.copy()
        efforts[np.isfinite(efforts)] = one[12:]
        if noise:
            markers = markers + noise * NOISE["markers"] * random.normal(size=(4, 3))
            efforts = efforts + noise * NOISE["tension"] * random.normal(size=len(efforts))
        found.append(pose._replace(markers=markers, efforts=efforts))
    return found


def drawn(random, count):
    return random.uniform(0.001, 0.006, (count, 3))


def true_scene(scene):
    """The scene of a robot, which differs from its twin's in all of `NUMBERS`."""
    values = {E: 2.6e5, "cables[0].offset": 4e-4, "cables[1].offset": -3e-4, "cables[2].offset": 2e-4}
    return changed_scene(scene, values | {
        "marker_frame.position": [1e-3, -5e-4, 8e-4], "marker_frame.rotation": [0.006, -0.004, 0.005]})


# --- derivatives ---------------------------------------------------------------------------------


def assert_derivatives(scene, poses, keys, share=1e-3, steps=None):
    handles = [one for key in keys for one in tied(scene, key)]
    model = RestModel(scene, handles, poses)
    values = np.array([one.read(scene) for one in handles])
    own = model.predict(values, True).jacobian
    assert not model.lost
    for column, step in enumerate(np.diag(steps or np.where(np.abs(values) > 1.0, 1e-3 * values, 2e-5))):
        ends = [model.predict(values + sign * step, False).values for sign in (1.0, -1.0)]
        differences = (ends[0] - ends[1]) / (2.0 * step[column])
        assert np.abs(own[:, column] - differences).max() <= share * np.abs(differences).max(), handles[column].key


@pytest.mark.parametrize("keys", [
    (E, DENSITY), ("cables.*.offset",), ("cables.*.axial_stiffness",), ("marker_frame",),
    ("markers.*.point",), ("cables[0].points[1]", "cables[0].pull_point"),
])  # fmt: skip
def test_derivatives_are_those_of_differences(bar, keys):
    turned = changed_scene(bar, {
        "marker_frame.rotation": [0.3, -0.2, 0.4], "marker_frame.position": [0.01, 0.02, 0.03],
        "marker_frame.scale": [1.01, 0.98, 1.02]})  # fmt: skip
    poses = poses_at(bar, np.array([[0.004, 0.001, 0.002], [0.002, 0.005, 0.003]]), [0.0, 0.05])
    assert_derivatives(turned, poses, keys)


@pytest.mark.exhaustive
def test_derivatives_by_gain_and_zero_of_a_regulator_are_those_of_differences():
    scene = load_scene(SCENES / "segment.yaml", {"cavities[1].pressure_gain": 0.95,
                                                 "cavities[1].pressure_offset": 200.0})  # fmt: skip
    pressures = 0.2 * RestModel(scene, [], []).simulation.limits.effort_max * np.array([0.3, 1.0, 0.6, 0.1])
    pose = RestPose(pressures, np.zeros((4, 3)), np.full((1, 3), np.nan), np.full(4, np.nan), np.zeros((0, 3)))
    assert_derivatives(scene, [pose], ("cavities[1].pressure_gain", "cavities[1].pressure_offset"), 2e-3, [1e-3, 10.0])


def test_derivatives_by_gain_and_zero_of_a_pressure_that_is_only_measured(air_scene):
    scene = deepcopy(air_scene)
    scene["cavities"][2] |= {"pressure_gain": 0.9, "pressure_offset": 80.0}
    pose = RestPose(np.array([0.098, 800.0, 0.0, 2.2e-6]), np.full((1, 3), np.nan), np.zeros((1, 3)),
                    np.zeros(4), np.zeros((0, 3)))  # fmt: skip
    assert_derivatives(scene_from_mapping(scene), [pose], (
        "cavities[2].pressure_gain", "cavities[2].pressure_offset", E), share=2e-3)


def test_derivatives_by_the_zero_of_a_hinge_are_those_of_differences():
    scene = load_scene(SCENES / "strider.yaml")
    pose = RestPose(np.array([0.1, -0.05, 0.02, 0.07]), np.zeros((4, 3)), np.full((1, 3), np.nan),
                    np.zeros(4), np.zeros((0, 3)))  # fmt: skip
    assert_derivatives(scene, [pose], ("hinge_motors.*.offset",))


def test_derivatives_by_an_arc_and_by_what_servos_yield_are_those_of_differences():
    scene = load_scene(SCENES / "emio.yaml")
    arcs = [{"at": "end", "radius": 0.0225, "angle": 0.35, "towards": [0, 0, 1]}]
    scene = changed_scene(scene, {"beams.*.arcs": arcs, "hinge_motors.*.stiffness": 5.0})
    pose = RestPose(np.array([0.3, -0.2, 0.4, 0.1]), np.zeros((4, 3)), np.full((1, 3), np.nan), np.zeros(4), np.zeros((0, 3)))
    keys = ("beams.*.arcs[0].angle#", "hinge_motors.*.stiffness#", "mounting[0].bodies[0].translation[0]#")
    assert_derivatives(scene, [pose], keys, 2e-3, [1e-3, 0.05, 1e-4])


def test_derivatives_by_tied_numbers_are_those_of_differences(bar):
    keys = ["+-+cables.*.offset", "+markers.*.point[0]", "+-cables[0].pull_point[1]+cables[1].axial_stiffness"]
    assert_derivatives(bar, poses_at(bar, np.array([[0.004, 0.003, 0.002]])), keys)


# --- what is found -------------------------------------------------------------------------------


def test_planted_numbers_are_found(bar, random):
    truth, shortenings = true_scene(bar), drawn(random, 12)
    poses = measured(truth, poses_at(bar, shortenings, 0.05 * (np.arange(12) % 2)), 1.0, random)
    found = calibrate(bar, poses, NUMBERS)
    by_luck = found._replace(validation=found.validation._replace(after={MARKERS: 0.0}))
    assert by_luck.systematic_error == pytest.approx(OBSERVED * np.sqrt(3.0) * found.estimate.noise[MARKERS])
    worse = found._replace(validation=found.validation._replace(after={MARKERS: 0.01}))
    assert worse.systematic_error == pytest.approx(0.01 * OBSERVED)
    assert found.is_accepted and found.not_told == ()
    wanted = np.array([one.parameter.read(truth) for one in found.estimate.unknowns])
    off = np.abs(found.estimate.values - wanted)
    assert np.all(off <= 2.5 * (found.estimate.intervals[:, 1] - found.estimate.values))
    assert found.estimate.noise[MARKERS] == pytest.approx(NOISE["markers"], rel=0.5)
    held = found.validation
    assert len(held.origins) == 3
    assert held.after[MARKERS] < 0.3 * held.before[MARKERS]


def test_one_marker_of_ten_that_is_far_off_hardly_matters(bar, random):
    truth = true_scene(bar)
    poses = measured(truth, poses_at(bar, drawn(random, 12)), 1.0, random)
    far = np.zeros((len(poses), 4, 1))
    far.flat[random.choice(far.size, far.size // 10, replace=False)] = 0.01
    wrong = [pose._replace(markers=pose.markers + own) for pose, own in zip(poses, far, strict=True)]
    found = calibrate(bar, wrong, NUMBERS)
    assert found.values[E] == pytest.approx(2.6e5, rel=0.02)
    assert found.values["marker_frame.position[0]"] == pytest.approx(1e-3, abs=2e-4)


class Linear:
    """A model that is linear in the numbers around a point."""

    def __init__(self, at, here):
        self._at, self._here = at, here

    def predict(self, numbers, with_jacobian):
        here = self._here
        return Prediction(here.values + here.jacobian @ (numbers - self._at), here.jacobian)


def test_intervals_of_95_percent_hold_the_truth_in_95_of_100_noisy_sets(bar, random):
    truth = true_scene(bar)
    unknowns = unknowns_of(bar, NUMBERS)
    # Linear numbers, so that a linear model has them all.
    linear = [Unknown(one.parameter, one.start, one.known * one.start if one.is_relative else one.known, False)
              for one in unknowns]  # fmt: skip
    poses = poses_at(bar, drawn(random, 8), 0.05 * (np.arange(8) % 2))
    model = RestModel(truth, [one.parameter for one in unknowns], poses)
    at = np.array([one.parameter.read(truth) for one in unknowns])
    here, own = model.predict(at, True), model.measured
    sigma = np.array([NOISE[kind] for kind in own.kinds])
    inside = []
    for _ in range(200):
        noisy = Measurements(here.values + sigma * random.normal(size=len(sigma)), own.kinds, own.poses)
        ends = estimate(Linear(at, here), noisy, linear).intervals
        inside.append((ends[:, 0] < at) & (at < ends[:, 1]))
    assert 0.90 <= np.mean(inside) <= 0.99
    assert np.mean(inside, axis=0).min() > 0.85


def test_without_keys_the_usual_numbers_are_fitted_as_far_as_the_data_tell(bar, random):
    truth = true_scene(changed_scene(bar, {"cables[2].points": [[0.043, -0.009, -0.006]]}))
    start = changed_scene(bar, {"cables[2].points": [[0.043, -0.009, -0.006]], "marker_frame": truth.marker_frame})
    assert ["cables[2].points.*[0]"] in usual_keys(start)
    assert ["cables[0].points.*[1]+cables[0].pull_point[1]"] in usual_keys(start)
    poses = measured(truth, poses_at(start, 0.004 + 0.3 * drawn(random, 12)), 1.0, random)
    found = calibrate(start, poses, [])
    assert found.is_accepted and len(found.not_told) >= 1
    # By how much each number may vary at best: the information of these poses with the noise that they have.
    candidates = unknowns_of(start, [])
    model = RestModel(truth, [one.parameter for one in candidates], found.poses)
    J = model.predict(np.array([one.parameter.read(truth) for one in candidates]), True).jacobian
    noise = np.array([[NOISE[kind]] for kind in model.measured.kinds])
    best = deviations_with(J * [one.slope(0.0) for one in candidates] / noise)
    keys, least = [one.parameter.key for one in found.estimate.unknowns], {one.parameter.key: d * one.known for one, d in zip(candidates, best)}
    for key, off in ((E, np.log(found.values[E] / 2.6e5)), ("cables[0].offset", found.values["cables[0].offset"] - 4e-4)):
        stated = found.estimate.deviations[keys.index(key)]
        assert abs(off) < 3.0 * stated and 0.6 < stated / least[key] < 1.5
    # Where the third cable pulls along itself is told with the zero of its winch: by their sum, where both are.
    moved = found.values.get("cables[2].points[0][0]", 0.043) - 0.043
    assert moved + found.values.get("cables[2].offset", 0.0) == pytest.approx(2e-4, abs=5e-4)


def test_equal_moduli_of_one_key_are_one_number(random):
    scene = load_scene(SCENES / "strider.yaml")
    (one,) = unknowns_of(scene, ["beams.*.material.young_modulus"])
    assert one.parameter.key == "beams[0].material.young_modulus and 3 more"
    assert set(one.parameter.changes(2e7)) == {f"beams[{i}].material.young_modulus" for i in range(4)}
    assert len(unknowns_of(scene, [f"beams[{i}].material.young_modulus" for i in range(4)])) == 4
    truth = changed_scene(scene, one.parameter.changes(31e6))
    poses = [RestPose(angles, np.zeros((4, 3)), np.full((1, 3), np.nan), np.zeros(4), np.zeros((0, 3)))
             for angles in random.uniform(-0.2, 0.2, (4, 4))]  # fmt: skip
    shown = RestModel(truth, [], poses).predict(np.empty(0), False).values.reshape(4, 16)
    seen = [pose._replace(markers=values[:12].reshape(4, 3) + 1e-5 * random.normal(size=(4, 3)), efforts=values[12:])
            for pose, values in zip(poses, shown, strict=True)]  # fmt: skip
    found = calibrate(scene, seen, ["beams.*.material.young_modulus"])
    assert found.values == {f"beams[{i}].material.young_modulus": pytest.approx(31e6, rel=1e-3) for i in range(4)}


# --- what cannot be known ------------------------------------------------------------------------


@pytest.mark.parametrize(("keys", "pair"), [
    ([E, DENSITY, "cables.*.offset"], {E, DENSITY}),
    (["cables[0].offset", "cables[0].pull_point[0]", DENSITY], {"cables[0].offset", "cables[0].pull_point[0]"}),
    (["cables[2].offset", "cables[2].pull_point[0]", E, "marker_frame"],
     {"cables[2].offset", "cables[2].pull_point[0]"}),
])  # fmt: skip
def test_numbers_that_the_data_cannot_tell_apart_are_named(bar, random, keys, pair):
    # Cables that do not stretch have no force of their own that would tell stiffness from weight.
    stiff = changed_scene(bar, {f"cables[{i}].axial_stiffness": None for i in range(3)})
    poses = measured(stiff, poses_at(stiff, drawn(random, 6), None, False), 0.2, random)
    found = calibrate(stiff, poses, keys)
    assert pair in map(set, found.not_told)
    assert not found.is_accepted


def test_a_number_that_the_data_say_nothing_about_stays_as_it_was(bar, random):
    truth = changed_scene(bar, {"cables[2].offset": 5e-4})
    # All three pull: a zero error of a slack cable shows nothing.
    poses = measured(truth, poses_at(bar, 0.004 + 0.3 * drawn(random, 8)), 0.2, random)
    found = calibrate(bar, poses, ["cables.*.offset", "cables[1].axial_stiffness"],
                      {"cables[1].axial_stiffness": 1e-4})  # fmt: skip
    assert found.not_told == (("cables[1].axial_stiffness",),)
    assert found.scene.cables[1].axial_stiffness == 500.0
    assert found.is_accepted
    assert found.values["cables[2].offset"] == pytest.approx(5e-4, abs=1e-4)


@pytest.mark.exhaustive
def test_what_a_suggestion_promises_comes_true(bar, random):
    truth = true_scene(bar)
    poses = measured(truth, poses_at(bar, drawn(random, 8), None, False), 1.0, random)
    keys = [E, "marker_frame"]
    found = calibrate(bar, poses, keys)
    best = next(one for one in suggestions(found) if one.words.startswith("hang"))
    own = np.flatnonzero([one.parameter.key == E for one in found.joint.unknowns])[0]
    assert best.deviations[own] < 0.7 * found.joint.deviations[own]
    # The weight of the suggestion is at the effector, 2 mm from the touch of this scene.
    weight = -float(best.poses[0].forces[-1, 2])
    again = poses_at(bar, np.array([RestModel(bar, [], []).simulation.rest_setpoints - pose.setpoints
                                    for pose in best.poses]), np.full(len(best.poses), weight), False)
    unknowns = unknowns_of(bar, keys)
    model = RestModel(bar, [one.parameter for one in unknowns], [*found.poses, *measured(truth, again, 1.0, random)])
    now = estimate(model, model.measured, unknowns)
    by_noise = now.noise[MARKERS] / found.joint.noise[MARKERS]
    got = now.deviations[own] / by_noise
    assert got < 0.8 * found.joint.deviations[own]
    # It is promised at numbers that are not known well yet, where other cables may be slack.
    assert best.deviations[own] / 3.0 < got < 3.0 * best.deviations[own]


def test_a_number_that_was_measured_otherwise_tells_those_beside_it(bar, random):
    stiff = changed_scene(bar, {f"cables[{i}].axial_stiffness": None for i in range(3)})
    truth = changed_scene(stiff, {E: 2.6e5, DENSITY: 1100.0})
    poses = measured(truth, poses_at(stiff, drawn(random, 8), None, False), 0.2, random)
    found = calibrate(stiff, poses, [E, DENSITY], {DENSITY: (1100.0, 11.0)})
    assert found.is_accepted and not found.not_told
    assert found.values[E] == pytest.approx(2.6e5, rel=0.05)
    assert found.values[DENSITY] == pytest.approx(1100.0, abs=33.0)
    # Without keys it is among the numbers, too.
    assert DENSITY in calibrate(stiff, poses, [], {DENSITY: (1100.0, 11.0)}).values


def test_what_is_known_of_numbers_that_are_not_fitted_is_refused(bar):
    with pytest.raises(CalibrationError, match="density: is known, but is none of the numbers"):
        unknowns_of(bar, [E], {DENSITY: 10.0})
    with pytest.raises(CalibrationError, match="is above zero"):
        unknowns_of(bar, [DENSITY], {DENSITY: (-3.0, 10.0)})


# --- what is not accepted ------------------------------------------------------------------------


def test_a_scene_that_does_not_become_better_is_not_accepted(bar, random):
    poses = measured(bar, poses_at(bar, drawn(random, 8)), 0.2, random)
    off = [pose if k % 4 == 3 else pose._replace(markers=pose.markers + [0.002, 0, 0])
           for k, pose in enumerate(poses)]  # fmt: skip
    found = calibrate(bar, off, ["marker_frame.position"])
    assert not found.validation.is_better
    assert not found.is_accepted


def test_a_pose_in_another_shape_is_set_aside_and_named(bar, random):
    poses = measured(bar, poses_at(bar, drawn(random, 6)), 0.2, random)
    poses[2] = poses[2]._replace(markers=poses[2].markers + [0.0, 0.0, 0.05])
    found = calibrate(bar, poses, [E])
    assert len(found.set_aside) == 1 and found.set_aside[0].startswith("pose 2: ")
    assert found.values[E] == pytest.approx(3e5, rel=0.05)


def test_a_robot_that_has_buckled_the_other_way_is_not_accepted_and_the_reason_is_told():
    twin, robot = (changed_scene(scene_from_mapping({**BAR, "gravity": [-9.81, 0.0, z]}), {E: 6e3}) for z in (-0.1, 0.1))
    found = calibrate(twin, measured(robot, poses_at(twin, np.full((6, 3), -0.01), 1e-5 * np.arange(6), False)), [E])
    assert found.is_elsewhere and not found.is_accepted
    assert why_not(found).startswith("the robot stands 60 mm from the model at most poses")


def test_too_few_poses_and_numbers_without_a_value_are_refused(bar, random):
    poses = measured(bar, poses_at(bar, drawn(random, 2)), 0.2, random)
    with pytest.raises(CalibrationError, match="2 poses at rest can be used, 3 are needed"):
        calibrate(bar, poses, [E])
    with pytest.raises(CalibrationError, match="effectors.* says how the model is used"):
        unknowns_of(bar, ["effectors.*.points"])


@pytest.mark.exhaustive
def test_a_wrong_model_says_what_it_cannot_know_and_halves_its_error_at_new_poses(random):
    """The robot is 20 % softer, its cables are tied 1 mm beside, and its mesh is another one."""
    meshes = SCENES.parents[1] / "meshes"
    twin, robot = (load_scene(SCENES / f"{name}.yaml", {"body.mesh.file": str(meshes / f"diamond_{nodes}.vtk")})
                   for name, nodes in (("diamond", 400), ("diamond_device", 600)))
    robot = changed_scene(robot, {E: 0.8 * twin.body.material.young_modulus})
    lengths = RestModel(twin, [], []).simulation.rest_setpoints
    nothing = np.full((1, 3), np.nan), np.full(4, np.nan), np.zeros((0, 3))
    poses = [RestPose(lengths - random.uniform(0.0, 0.008, 4), np.zeros((8, 3)), *nothing, f"pose {k}")
             for k in range(18)]  # fmt: skip
    shown = RestModel(robot, [], poses).predict(np.empty(0), False).values.reshape(18, 8, 3)
    seen = [pose._replace(markers=markers + NOISE["markers"] * random.normal(size=(8, 3)))
            for pose, markers in zip(poses, shown, strict=True)]  # fmt: skip
    found = calibrate(twin, seen[:12], [])
    told = {one.parameter.key for one in found.joint.unknowns}
    assert found.is_accepted and E in told
    # Along itself the place of a cable is the zero of its winch: of each cable one of both is told.
    assert found.not_told and not told & {key for (key,) in found.not_told}
    distances = []
    for scene in (twin, found.scene):
        model = RestModel(scene, [], seen[12:])
        model.predict(np.empty(0), False)
        distances.append(np.nanmedian(model.distances))
    print(f"at new poses {1e3 * distances[0]:.2f} mm before, {1e3 * distances[1]:.2f} mm after")
    assert distances[1] < 0.5 * distances[0]


def test_numbers_that_the_scene_does_not_take_are_a_pose_that_is_lost(bar):
    handles = parameters(bar, "cables[0].points[1][2]", "marker_frame.position[0]")
    model, begin = RestModel(bar, handles, poses_at(bar, np.array([[0.002, 0.001, 0.001]]))), np.array([0.009, 0.0])
    before = model.predict(begin, True)
    assert np.isnan(model.predict(np.array([0.2, 1.0]), True).values).all() and model.lost == [0]
    again = model.predict(begin, True)  # Nothing of the refused numbers is left.
    assert again.values == pytest.approx(before.values) and again.jacobian == pytest.approx(before.jacobian)


def test_what_two_sessions_tell_widens_the_intervals_of_a_third(bar, random):
    shifts = 5e-4 * np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    days = [[pose._replace(markers=pose.markers + shift, origin=f"day_{day}.csv, line {line}") for line, pose in enumerate(
        measured(bar, poses_at(bar, drawn(random, 8), None, False), 1.0, random))] for day, shift in enumerate(shifts)]  # fmt: skip
    one, two = (calibrate(bar, sum(days[2 - count : 2], []), [E, "cables.*.offset"], None, days[2]) for count in (1, 2))
    assert np.isnan(one.reach.between) and one.validation.inside[MARKERS] < 0.6
    assert two.reach.between == pytest.approx(5e-4 * np.sqrt(2.0), rel=0.5) and two.validation.inside[MARKERS] > 0.9


# --- files and faces -----------------------------------------------------------------------------

TEXT = """# A bar with a comment.
name: bar
gravity: [0.0, 0.0, -9.81]  # m/s²
body:
  mesh: {box: {size: [0.1, 0.02, 0.02], cells: [6, 1, 1]}, translation: [-0.05, -0.01, -0.01]}
  element: linear
  material:
    young_modulus: 3.0e5      # Pa, of the data sheet
    poisson_ratio: 0.4
    density: 1070.0
  fixed: [{box: {minimum: [-0.0501, -1, -1], maximum: [-0.0499, 1, 1]}}]
cables:
  - name: upper
    pull_point: [-0.05, 0.0, 0.009]
    points: [[0.043, 0.0, 0.009]]
effectors: [{name: tip, points: [[0.05, 0.0, 0.0]]}]
markers: [{id: 7, point: [0.047, 0.003, 0.008]}, {id: 2, point: [0.021, 0.002, 0.0095]}]
"""


@pytest.fixture
def files(tmp_path, random):
    """A scene, and a table of poses of a robot that is softer and has a zero error."""
    scene, table = tmp_path / "bar.yaml", tmp_path / "poses.csv"
    scene.write_text(TEXT)
    robot = load_scene(scene, {E: 2.5e5, "cables[0].offset": 4e-4})
    rows = ["upper_length_m," + ",".join(f"marker_{i}_{a}_m" for i in (7, 2) for a in "xyz")]
    rest = RestModel(robot, [], [])
    nothing = np.full((1, 3), np.nan), np.full(1, np.nan), np.zeros((0, 3))
    poses = [RestPose(rest.simulation.rest_setpoints - s, np.zeros((2, 3)), *nothing)
             for s in random.uniform(0.0, 0.005, 9)]  # fmt: skip
    shown = RestModel(robot, [], poses).predict(np.empty(0), False).values.reshape(9, 6)
    for pose, seen in zip(poses, shown + 2e-5 * random.normal(size=(9, 6)), strict=True):
        rows.append(",".join(map(repr, [float(pose.setpoints[0]), *seen.tolist()])))
    table.write_text("\n".join(rows))
    return scene, table


def run(*words):
    chosen = program("softrobot_twin").parse_args(["calibrate", *map(str, words)])
    return chosen.run(chosen)


def test_the_command_writes_a_scene_that_keeps_its_text(files, capsys):
    scene, table = files
    picture = scene.with_name("fit.png")
    assert run(scene, "--data", table, "--fit", E, "cables.*.offset", "--picture", picture) == 0
    told = capsys.readouterr().out
    assert "9 poses at rest" in told and "95 % interval" in told and "held back" in told
    assert picture.stat().st_size > 1000
    written = scene.with_name("bar_calibrated.yaml")
    found = load_scene(written)
    assert found.body.material.young_modulus == pytest.approx(2.5e5, rel=0.05)
    assert found.cables[0].offset == pytest.approx(4e-4, abs=1e-4)
    text = written.read_text()
    assert text.startswith("# A bar with a comment.") and "# Pa, of the data sheet; calibrated" in text
    assert "poses.csv" in text


def test_faulty_rows_are_named_and_left_out(files, capsys):
    scene, table = files
    head, *rows = table.read_text().split("\n")
    numbers = np.array([[float(word) for word in row.split(",")] for row in rows] * 2)
    numbers[12:16, [2, 5]] += 0.004  # the last of them is held back
    table.write_text("\n".join([head, *(",".join(map(repr, row.tolist())) for row in numbers)]))
    assert run(scene, "--data", table, "--fit", E, "cables.*.offset") == 0
    told = capsys.readouterr()
    assert re.search(r"left out: poses.csv, lines 14 to 17: measured 4.\d mm off \(x .0.\d, y .4.\d", told.err)
    assert load_scene(scene.with_name("bar_calibrated.yaml")).body.material.young_modulus == pytest.approx(2.5e5, rel=0.05)


def test_without_keys_the_command_tells_what_each_number_brings(files, capsys):
    scene, table = files
    assert run(scene, "--data", table, "--known", f"{DENSITY}=1070±10") == 0
    told = capsys.readouterr().out
    assert "what each number brings" in told and re.search(rf"{E} +[12]\.\d+e\+05 ± \S+ Pa +-\d", told)
    assert DENSITY in told and "bring nothing" in told


@pytest.mark.parametrize("known", ["body.material.density=", f"{E}=1e5±", f"{E}=1e5±-3", f"{E}=±0", "density"])
def test_what_is_known_is_refused_where_it_is_no_number(files, known):
    with pytest.raises(CalibrationError, match="--known"):
        run(files[0], "--data", files[1], "--fit", E, "--known", known)


@pytest.mark.parametrize("section", ["observer: {}", "observer: {systematic_error: 0.3}  # guessed"])
def test_the_proposal_tells_the_observer_what_the_model_is_off(files, capsys, section):
    scene, table = files
    third = "0.0095]}, {id: 9, point: [0.03, 0.002, 0.0095]}]"
    scene.write_text(TEXT.replace("0.0095]}]", third) + section)
    assert run(scene, "--data", table, "--fit", "cables.*.offset") == 0
    told = capsys.readouterr().out
    shown = float(re.search(r"systematic_error: (\S+)  # m", told)[1])
    held = float(re.search(r"markers +\S+ mm +(\S+) mm", told)[1])
    assert shown >= 0.94e-3 * OBSERVED * held
    assert load_scene(scene.with_name("bar_calibrated.yaml")).observer.systematic_error == shown
    # A modulus that is fitted too leaves less.
    assert run(scene, "--data", table, "--fit", E, "cables.*.offset") == 0
    better = load_scene(scene.with_name("bar_calibrated.yaml")).observer.systematic_error
    assert 0.0 < better < 0.5 * shown


@pytest.mark.sampled
@pytest.mark.parametrize("changes", [
    ["observer={}"], ["observer={systematic_error: 0.3}", "cables.upper.rate=0.1"],
    ["touches=[{name: finger, points: [[0.05, 0.0, 0.0]]}]", "gravity=[0.0, 0.0, -9.0]"],
    ["integration=dynamic"], ["body.material={young_modulus: 3.0e5, poisson_ratio: 0.4, density: 1000.0}"],
])  # fmt: skip
def test_what_is_set_for_the_calibration_is_in_the_proposal(files, capsys, changes):
    scene, table = files
    scene.write_text(TEXT.replace("0.0095]}]", "0.0095]}, {id: 9, point: [0.03, 0.002, 0.0095]}]"))
    assert run(scene, "--data", table, "--fit", E, "cables.*.offset", "--set", *changes) == 0
    written = scene.with_name("bar_calibrated.yaml")
    assert "as it was set for the calibration" in written.read_text()
    asked, found = load_scene(scene, read_changes(changes)), load_scene(written)
    fitted = {key: value_at(found, key) for key in (E, "cables[0].offset")}
    if found.observer is not None:
        fitted["observer.systematic_error"] = found.observer.systematic_error
    assert found == changed_scene(asked, fitted).changed(path=found.path)


@pytest.mark.parametrize("key, why", [
    ("observer.walk", "no number of the robot"), ("solver.energy_weight", "no number of the robot"),
    ("cables[0].friction", "its effect is not in the scene: give it a first value"),
])  # fmt: skip
def test_what_cannot_be_fitted_is_refused_by_name(bar, key, why):
    scene = changed_scene(bar, {"observer": {}})
    poses = poses_at(scene, np.array([[0.004, 0.001, 0.002]] * 4))
    with pytest.raises(NamedError, match=re.escape(key) + ".*" + why):
        calibrate(scene, measured(scene, poses), [key])


def test_weights_are_hung_on_soft_bodies_only():
    """The effector of Emio is on a rigid hub: nothing that touches are not built for is advised."""
    soft = [{"name": "tip", "points": [[0.05, 0.0, 0.0]]},
            {"name": "hub", "body": "lid", "points": [[0.06, 0.0, 0.0]]}]  # fmt: skip
    lid = {"name": "lid", "motion": "free", "box": {"size": [0.01, 0.02, 0.02]}, "density": 1000.0,
           "position": [0.055, 0.0, 0.0]}  # fmt: skip
    scene = scene_from_mapping(BAR | {"effectors": soft, "rigid_bodies": [lid], "body": BAR["body"] | {
        "attached": [{"to": "lid", "box": {"minimum": [0.0499, -1, -1], "maximum": [0.0501, 1, 1]}}]}})
    poses = measured(scene, [pose._replace(effectors=np.full((2, 3), np.nan)) for pose in poses_at(
        scene, np.array([[0.004, 0.001, 0.002], [0.002, 0.005, 0.003], [0.001, 0.002, 0.006],
                         [0.005, 0.004, 0.001]]))])  # fmt: skip
    advised = [one.words for one in suggestions(calibrate(scene, poses, [E]))]
    assert [one for one in advised if " on tip " in one] and not [one for one in advised if "hub" in one]


def test_the_command_writes_nothing_where_it_cannot_tell(files, capsys):
    scene, table = files
    assert run(scene, "--data", table, "--fit", E, DENSITY) == 1
    told = capsys.readouterr()
    assert f"{E}, {DENSITY}: the data do not tell them apart" in told.err
    assert "the standard deviation of" in told.err
    assert f"no scene is written: fit only one of {E} and {DENSITY}" in told.out
    assert not scene.with_name("bar_calibrated.yaml").exists()


def test_a_robot_in_python_calibrates_itself_by_a_table(files):
    scene, table = files
    robot = build(**{key: value for key, value in BAR.items() if key not in ("touches", "cables", "markers")},
                  cables=[{"name": "upper", "pull_point": [-0.05, 0, 0.009], "points": [[0.043, 0, 0.009]]}],
                  markers=[{"id": 7, "point": [0.047, 0.003, 0.008]}, {"id": 2, "point": [0.021, 0.002, 0.0095]}])  # fmt: skip
    before = robot.state
    found = robot.calibrate(table, [E, "cables.*.offset"])
    assert robot.state is before
    assert found.is_accepted
    robot.change(found.values)
    assert robot.scene.cables[0].offset == found.values["cables[0].offset"]
