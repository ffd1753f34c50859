"""The Stifface renders a stiffness at a touched point that stays where it is."""

import numpy as np
import pytest
import yaml

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.loading import written_out
from softrobot_twin.simulation import (
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
    Status,
    Touched,
)
from test.builder import at_rest
from test.places import SCENES
from test.scene_changes import in_balance, repeat_step

STEP = 0.02
HELD = np.array([[0.0, 0.0, 0.022]])
DEPTH = 5.0e-4
NONE = np.full((1, 3), np.nan)


@pytest.fixture(scope="module")
def built():
    return Simulation.from_scene_file(SCENES / "stifface.yaml")


pad = at_rest("built")


def follow(pad, stiffness, steps=1, touched=None):
    wanted = np.array([[np.nan, np.nan, stiffness]])
    for _ in range(steps):
        result = pad.step(FollowTargets(HELD, STEP, stiffness=wanted), None, touched)
    return result


def stiffness_of(pad) -> float:
    return 1.0 / EffectorCompliance(pad).at_state().compliance[0, 2, 2]


def held_below(pad, depth, origin=None) -> Touched:
    place = np.array(pad.touches.points if origin is None else origin)
    place[:, 2] -= depth
    return Touched(NONE, place)


def felt(pad, depth=DEPTH) -> float:
    """Force by depth of a press [N/m]; the pad is as it was afterwards."""
    before, touched = pad.state, held_below(pad, depth)
    for _ in range(4):
        result = pad.step(Hold(STEP), None, touched)
    pad.restore(before)
    return -result.touches.forces[0, 2] / depth


def test_the_stiffness_can_be_more_than_tripled_while_the_point_stays(pad):
    for wanted in (150.0, 500.0):
        result = follow(pad, wanted, 40)
        assert result.status.is_success
        assert np.linalg.norm(result.effector_positions - HELD) < 1e-5
        assert stiffness_of(pad) == pytest.approx(wanted, rel=0.01)
        assert felt(pad) == pytest.approx(wanted, rel=0.03)


def test_a_profile_is_followed_within_three_percent(pad):
    follow(pad, 320.0, 40)
    errors, places, compliance = [], [], EffectorCompliance(pad)
    for step in range(100):
        wanted = 320.0 + 170.0 * np.sin(2.0 * np.pi * step / 100.0)
        result = follow(pad, wanted)
        errors.append(1.0 / (wanted * compliance.at_state().compliance[0, 2, 2]) - 1.0)
        places.append(np.linalg.norm(result.effector_positions - HELD))
    assert np.abs(errors).max() < 0.03
    assert max(places) < 1e-4


def test_a_stiffness_out_of_reach_is_told_with_the_limit_that_holds_it(pad):
    result = follow(pad, 5000.0, 80)
    assert not result.status.is_success
    assert "east.tension_max" in result.report.active_limits
    assert stiffness_of(pad) > 500.0


def test_a_press_feels_the_pad_and_not_its_cables_counteraction(pad):
    setpoints = follow(pad, 250.0, 40).setpoints.copy()
    touched = held_below(pad, 0.001)
    # The wanted stiffness changes during the press, and waits.
    result = follow(pad, 400.0, 4, touched)
    assert np.array_equal(result.setpoints, setpoints)
    assert result.touches.displacements[0, 2] == pytest.approx(-0.001, rel=1e-6)
    assert -result.touches.forces[0, 2] / 0.001 == pytest.approx(250.0, rel=0.03)
    follow(pad, 400.0, 40)
    assert stiffness_of(pad) == pytest.approx(400.0, rel=0.01)


def test_the_force_of_a_press_and_its_place_are_the_same_relation(pad):
    follow(pad, 300.0, 40)
    before = pad.state
    for _ in range(6):
        by_place = pad.step(Hold(STEP), None, held_below(pad, 0.003, before.memory["touches.points"]))
    pad.restore(before)
    for _ in range(6):
        by_force = pad.step(Hold(STEP), None, Touched(by_place.touches.forces, NONE))
    assert np.allclose(by_force.touches.points[0, 2], by_place.touches.points[0, 2], atol=1e-8)


def worst_of(pad, touched, setpoints) -> list:
    """Statuses of three steps that keep the cables, and end at finite places."""
    results = [pad.step(Hold(STEP), None, touched) for _ in range(3)]
    assert all(np.isfinite(result.state.positions).all() for result in results)
    assert all(np.array_equal(result.setpoints, setpoints) for result in results)
    return [result.status for result in results]


def test_a_finger_through_the_pad_and_the_greatest_force_are_told_and_undone(pad):
    before = follow(pad, 200.0, 40)
    deep = held_below(pad, 0.03, before.touches.points)
    for touched in (deep, Touched(np.array([[0.0, 0.0, -20.0]]), NONE)):
        # The greatest force is borne, but three steps do not bring the pad to balance.
        assert Status.OK not in worst_of(pad, touched, before.setpoints)
        result = in_balance(pad, Hold(STEP), 40)
        assert np.allclose(result.state.positions, before.state.positions, atol=1e-5)


def test_after_a_force_that_no_pad_could_bear_a_reset_begins_anew(pad):
    before = follow(pad, 200.0, 40)
    statuses = worst_of(pad, Touched(np.array([[0.0, 0.0, -1e4]]), NONE), before.setpoints)
    assert not any(status.is_success for status in statuses)
    pad.reset()
    assert np.array_equal(follow(pad, 200.0, 40).state.positions, before.state.positions)


@pytest.fixture(scope="module")
def mapping():
    mapping = written_out(yaml.safe_load((SCENES / "stifface.yaml").read_text()))
    mapping["body"]["mesh"]["file"] = str(SCENES.parents[1] / "meshes/stifface_282.msh")
    return mapping


def test_the_corner_and_the_foot_can_be_touched(mapping):
    touches = [{"name": "corner", "points": [[0.029, 0.029, 0.024]]},
               {"name": "foot", "points": [[0.034, 0.0, 0.0]]}]  # fmt: skip
    pad = Simulation(scene_from_mapping(mapping | {"touches": touches}))
    force = np.array([[0.0, 0.0, -0.05], [5.0, 0.0, -20.0]])
    for _ in range(4):
        result = pad.step(Hold(STEP), None, Touched(force, np.full((2, 3), np.nan)))
    assert result.status.is_success
    assert result.touches.displacements[0, 2] < -1e-4
    # The foot is fixed: the ground bears the force.
    assert not result.touches.displacements[1].any()


@pytest.mark.exhaustive
def test_a_press_on_the_device_finds_the_stiffness_of_the_twin(pad):
    device = Simulation.from_scene_file(SCENES / "stifface_device.yaml")
    for wanted in (180.0, 300.0, 480.0):
        result = follow(pad, wanted, 60)
        lengths = device.rest_setpoints - result.displacements
        repeat_step(device, CommandSetpoints(lengths, 1.0), 8)
        assert felt(device) == pytest.approx(wanted, rel=0.1)
