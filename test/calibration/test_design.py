"""Designs by derivatives of equilibria: poses of a finger by heights of its cables and its modulus."""

import re
import time

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.calibration.design import DesignError, DesignSearch, Equilibria, hull_volume
from softrobot_twin.scene import load_scene
from test.places import ROOT

FINGER = ROOT / "config" / "scenes" / "finger.yaml"
PULLS = [(0.006, 0.0), (0.014, -0.004), (-0.004, 0.009)]
VARIABLES = {
    "base": {f"cables.flexor.points[{index}][2]": 1.0 for index in (0, 1, 2)},
    "end": {f"cables.flexor.points[{index}][2]": 1.0 for index in (3, 4, 5)},
    "modulus": "body.material.young_modulus",
}
HEIGHTS = {name: VARIABLES[name] for name in ("base", "end")}


def commands():
    return [st.setpoints(flexor_shortening_m=one, extensor_shortening_m=other) for one, other in PULLS]


@pytest.fixture(scope="module")
def finger():
    return st.load(FINGER, {"solver.residual_tolerance": 1.0e-11, "solver.newton_iterations": 20})


def test_derivatives_of_poses_are_differences_of_poses_that_are_settled_again(finger, drawn_rng):
    model = finger.design_model(VARIABLES, [*commands(), st.setpoints(flexor_length_m=0.085),
                                            st.efforts(flexor_tension_N=2.0), st.hold()])
    assert np.array_equal(model.start, [0.0, 0.0, 500e3])
    values = model.start + drawn_rng.uniform(-1.0, 1.0, 3) * [1.0e-3, 1.0e-3, 5.0e4]
    found = model.derivatives(values)
    weights = Equilibria(*(drawn_rng.normal(size=one.shape[:-1]) for one in found))
    expected = sum(np.tensordot(weight, one, weight.ndim) for weight, one in zip(weights, found))
    np.testing.assert_allclose(model.gradient(values, weights), expected, rtol=1e-9)
    for index, step in enumerate((1.0e-7, 1.0e-7, 50.0)):
        move = step * np.eye(3)[index]
        ends = [model.solve(values + side * move).found for side in (1, -1)]
        for own, one, other in zip(found, *ends):
            difference = (one - other) / (2.0 * step)
            assert np.abs(own[..., index] - difference).max() < 2e-6 * np.abs(difference).max()


def test_a_length_that_is_commanded_is_kept_and_a_shortening_too(finger):
    one, other = st.setpoints(flexor_length_m=0.085), st.setpoints(flexor_shortening_m=0.006)
    model = finger.design_model(HEIGHTS, [one, other])
    lengths = [model.solve([0.0, end]).states[pose].setpoints[0] for end in (0.0, 1e-3) for pose in (0, 1)]
    assert lengths[0] == lengths[2] == 0.085
    assert abs(lengths[3] - lengths[1]) > 1e-6, "the path at rest has another length"


@pytest.mark.exhaustive
def test_heights_of_cables_are_found_again_within_the_flatness_that_is_told(finger, drawn_rng):
    hidden = drawn_rng.uniform(-1.5e-3, 1.5e-3, 2)
    wanted = finger.design_model(HEIGHTS, commands()).solve(hidden).found.effectors
    before, began = finger.state, time.process_time()
    design = finger.optimise(
        [(command, {"tip": place[0]}) for command, place in zip(commands(), wanted)], HEIGHTS,
        (-0.003, 0.003), tolerance=1.0e-5)
    print(design, f"{time.process_time() - began:.1f} s of processor time")
    assert finger.state is before
    assert design.after < 1.0e-6 < design.before
    for value, aim, flat in zip(design.values.values(), hidden, design.flatness.values()):
        assert abs(value - aim) < flat < 1.0e-4


def test_a_move_by_the_flatness_changes_the_poses_by_the_tolerance(finger):
    model = finger.design_model(HEIGHTS, commands())
    wanted = model.solve(model.start).found.effectors
    found = DesignSearch(model, np.array([[-0.003, 0.003]] * 2)).meet(wanted, 1.0e-5)
    # Along the direction of which the poses tell least, and most.
    for told, shares in zip(found.told, found.directions):
        moved = model.solve(found.values + 0.006 * shares / told).found.effectors
        distance = np.sqrt((np.linalg.norm(moved - wanted, axis=2) ** 2).mean())
        assert distance == pytest.approx(1.0e-5, rel=0.05)


def test_what_poses_cannot_tell_is_told(finger):
    one = commands()[0]
    place = finger.design_model(HEIGHTS, [one]).solve([0.0, 0.0]).found.effectors[0, 0]
    design = finger.optimise([(one, {"tip": [None, None, place[2]]})], HEIGHTS, (-0.003, 0.003))
    assert any("the poses do not tell" in note and "base" in note for note in design.notes)
    assert max(design.flatness.values()) > 1.0e-3


@pytest.mark.exhaustive
def test_a_function_is_made_small_within_bounds(finger):
    def bent(found):
        slopes = Equilibria(np.zeros_like(found.effectors), np.zeros_like(found.efforts))
        slopes.effectors[1, 0, 2] = 1.0
        return found.effectors[1, 0, 2], slopes

    design = finger.optimise(bent, HEIGHTS, (-0.001, 0.001), commands())
    trial = finger.design_model(HEIGHTS, commands())
    corners = [trial.solve([one, other]).found.effectors[1, 0, 2]
               for one in (-0.001, 0.001) for other in (-0.001, 0.001)]
    assert design.after <= min(corners) + 1e-7 < design.before
    assert any("is at its bound" in note for note in design.notes)


def test_the_thickness_of_a_bar_is_found_by_its_sag():
    bar = st.build(
        name="bar", gravity=[0.0, 0.0, -9.81],
        body={"mesh": {"box": {"size": [0.1, 0.02, 0.01], "cells": [8, 2, 2]}, "translation": [0.0, 0.0, -0.005]},
              "element": "quadratic", "material": {"young_modulus": 5e5, "poisson_ratio": 0.4, "density": 1000.0},
              "fixed": [{"box": {"minimum": [-0.001, -1, -1], "maximum": [0.001, 1, 1]}}]},
        effectors=[{"name": "tip", "points": [[0.099, 0.011, 0.0005]]}])  # fmt: skip
    thickness = {"thickness": {"body.mesh.box.size[2]": 1.0, "body.mesh.translation[2]": -0.5}}
    sag = bar.design_model(thickness, [st.hold()]).solve([0.003]).found.effectors[0, 0]
    design = bar.optimise([(st.hold(), {"tip": sag})], thickness, (-0.003, 0.006))
    assert abs(design.values["thickness"] - 0.003) < design.flatness["thickness"] < 2e-4
    assert design.changes["body.mesh.box.size[2]"] == pytest.approx(0.013, abs=2e-5)


def test_a_function_without_its_derivatives_is_refused(finger):
    with pytest.raises(DesignError, match=r"objective: must return .* shapes \(3, 1, 3\) and \(3, 2\)"):
        finger.optimise(lambda found: (0.0, found.effectors), HEIGHTS, (-1e-3, 1e-3), commands())


@pytest.mark.exhaustive
def test_the_code_of_the_page_runs_and_its_workspace_grows(tmp_path, monkeypatch, drawn_rng):
    monkeypatch.chdir(tmp_path)
    for folder in ("config", "meshes"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "design.md").read_text(), re.S):
        exec(compile(block, "docs/design.md", "exec"), names)
    assert names["design"].after < 0.1 * names["design"].before
    assert names["wide"].after < 1.3 * names["wide"].before < 0.0
    model = names["diamond"].design_model(["cables[0].points[0]"], names["corners"])
    values = model.start + drawn_rng.uniform(-1e-3, 1e-3, 3) * [1.0, 0.0, 1.0]
    _, weights = names["workspace"](model.solve(values).found)
    slopes = model.gradient(values, weights)
    for index in (0, 2):
        move = 1e-6 * np.eye(3)[index]  # By 1e-5 the curvature adds up to 0.6 %, and limits begin to act.
        ends = [names["workspace"](model.solve(values + side * move).found)[0] for side in (1, -1)]
        assert slopes[index] == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-3, abs=1e-9)


@pytest.mark.exhaustive
def test_trials_with_an_actuator_at_its_limit_are_refused_and_told():
    tight = st.load(FINGER, {"cables.flexor.tension": [0.0, 6.0]})
    first = tight.design_model({"modulus": VARIABLES["modulus"]}, commands()[1:2])
    assert first.solve(first.start).found.efforts[0, 0] < 6.0

    def soft(found):
        return -found.efforts[0, 0], Equilibria(np.zeros_like(found.effectors), np.array([[-1.0, 0.0]]))

    design = tight.optimise(soft, ["body.material.young_modulus"], (1e5, 5e6), commands()[1:2])
    assert 5.4 < -design.after < 6.0, "it stops short of the limit"
    told = [note for note in design.notes if "a trial was refused" in note]
    assert told and "flexor: is at its greatest tension of 6 N in pose 0" in told[0]


def test_a_robot_whose_actuator_is_at_its_limit_is_refused_by_actuator_pose_and_limit():
    tight = st.load(FINGER, {"cables.flexor.tension": [0.0, 1.0]})
    with pytest.raises(DesignError, match=r"^flexor: is at its greatest tension of 1 N in pose 1, "
                                          "where it no longer holds its shortening$"):
        tight.design_model(HEIGHTS, [st.hold(), commands()[1]]).solve([0.0, 0.0])


def test_a_command_beyond_the_limit_of_an_actuator_is_refused(finger):
    far = st.setpoints(flexor_shortening_m=0.1)
    with pytest.raises(DesignError, match="flexor: .* shortening of 0.1 m in pose 0, .* 0.025 m"):
        finger.design_model(HEIGHTS, [far]).solve([0.0, 0.0])


@pytest.mark.exhaustive
def test_a_search_that_stops_at_a_kink_says_so_and_a_radius_takes_kinks_away(drawn_rng):
    keys, hidden = [f"cables[{index}].points[0][2]" for index in range(4)], drawn_rng.uniform(-2e-3, 2e-3, 4)
    commands = [st.setpoints({f"{cable}_shortening_m": pull for cable, pull in zip(
        ("north", "west", "south", "east"), drawn_rng.uniform(0.003, 0.012, 4))}) for _ in range(6)]
    for radius in (0.0, 0.004):
        changes = {f"cables[{index}].hold_radius": radius for index in range(4)}
        robot = st.load(FINGER.with_name("diamond.yaml"), changes | {
            "body.element": "linear", "body.mesh.file": str(ROOT / "meshes" / "diamond_1600.vtk")})
        model = robot.design_model(keys, commands)
        wanted = model.solve(model.start + hidden).found.effectors
        design = robot.optimise(
            [(one, {"tip": place[0]}) for one, place in zip(commands, wanted)], keys, (0.04, 0.05))
        errors = (design.found.solved.found.effectors - wanted).ravel()
        J = model.derivatives(design.found.values).effectors.reshape(errors.size, -1)
        left = float(np.linalg.norm(errors - J @ np.linalg.pinv(J) @ errors))
        promise = design.after - left / np.sqrt(len(commands))
        print(design, f"{promise:.3g} m less by derivatives", sep="\n")
        # In an element, the errors can also have a minimum of their own: there is no kink then.
        is_told = any("a kink is near" in note for note in design.notes)
        is_at_bound = any("is at its bound" in note for note in design.notes)
        assert is_told is bool(promise > 0.1 * design.tolerance) or is_at_bound and not is_told
    assert design.after < 1e-6
    assert np.abs(np.array(list(design.values.values())) - model.start - hidden).max() < 1e-4


def test_slack_cables_are_told(finger):
    slack = finger.design_model(HEIGHTS, [st.setpoints(extensor_shortening_m=-0.01)]).solve([0.0, 0.0]).slack
    assert "extensor" in slack[0]


REFUSED = [
    (dict(parameters={"two": {}}), "two: needs keys of numbers"),
    (dict(parameters={"one": VARIABLES["base"], "two": VARIABLES["base"]}), "is changed by two"),
    (dict(parameters=["cables.flexor.point"]), "cables.flexor.point"),
    (dict(bounds={"base": (-1e-3, 1e-3)}), "end: has no bounds"),
    (dict(bounds=(1e-3, 2e-3)), "base: is 0 m in the scene, outside of its bounds"),
    (dict(bounds=(1e-3, -1e-3)), "base: has the bounds"), (dict(tolerance=0), "tolerance: 0 must be"),
    (dict(bounds={"base": 1.0, "end": (0, 1)}), "must be a pair"), (dict(bounds=("low", 1)), "be a number"),
    (dict(bounds={"cables.*.rate": (0, 1)}), "a pair .* of a variable"),
    (dict(objective=[]), "needs at least one parameter and one pose"),
    (dict(objective=[(st.hold(), {"top": [0, 0, 0]})]), "top: is unknown"),
    (dict(objective=[(st.hold(), {"tip": [0, 0]})]), "must be 3 numbers"),
    (dict(objective=[(st.hold(), {})]), "wants no place"), (dict(commands=[st.hold()]), "belong to a function"),
    (dict(objective=[(st.targets(tip=[0, 0, 0]), {})]), "has no setpoints"),
]


@pytest.mark.parametrize(("changes", "reason"), REFUSED, ids=lambda one: one if isinstance(one, str) else "")
def test_a_design_that_cannot_be_asked_for_is_refused(finger, changes, reason):
    asked = dict(objective=[(st.hold(), {"tip": [0.1, 0.0, 0.0]})], parameters=HEIGHTS, bounds=(-1e-3, 1e-3))
    with pytest.raises(st.SoftRobotTwinError, match=reason):
        finger.optimise(**{**asked, **changes})


def test_a_scene_in_motion_has_no_designs(finger):
    moving = st.load(FINGER, {"integration": "dynamic"})
    with pytest.raises(DesignError, match="integration: dynamic has no equilibria"):
        moving.design_model(HEIGHTS, commands())


def test_a_design_is_written_shown_and_taken_over(tmp_path, finger):
    design = finger.optimise([(commands()[0], {"tip": [0.09, None, -0.03]})], HEIGHTS, (-0.003, 0.003))
    design.write(tmp_path / "new.yaml")
    written = load_scene(tmp_path / "new.yaml")
    places = [point[2] for point in written.cables[0].points]
    assert places[0] == pytest.approx(-0.005 + design.values["base"], abs=1e-12)
    other = finger.copy()
    other.change(design.changes)
    assert [point[2] for point in other.scene.cables[0].points] == places
    shown = repr(design)
    for word in ("base", "end", "±", "flatness"):
        assert word in shown


def test_the_volume_of_a_hull_has_derivatives(drawn_rng):
    points = drawn_rng.normal(size=(30, 3))
    volume, slopes = hull_volume(points)
    move = drawn_rng.normal(size=points.shape)
    ends = [hull_volume(points + side * 1e-6 * move)[0] for side in (1, -1)]
    assert volume > 0.0 and np.vdot(slopes, move) == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-6)


@pytest.mark.sampled
@pytest.mark.parametrize("path", sorted(FINGER.parent.glob("*.yaml")), ids=lambda path: path.stem)
def test_each_scene_is_written_and_read_again(path, tmp_path):
    from softrobot_twin.scene.loading import text_of

    scene = load_scene(path)
    (tmp_path / "again.yaml").write_text(text_of(scene))
    again = load_scene(tmp_path / "again.yaml")
    assert text_of(again) == text_of(scene)
