"""Touches in a step: force in, displacement out, and the other way round."""

import numpy as np
import pytest
import yaml

from softrobot_twin.errors import CommandError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import FollowTargets, Hold, Simulation, Touched
from test.scene_changes import repeat_step

STEP = 0.05
TIP = [0.01, 0.01, 0.10]
NONE = np.full((1, 3), np.nan)


def mapping_of(column, **changes) -> dict:
    """The column, with a touch at its effector."""
    mapping = yaml.safe_load(column.read_text())
    mapping["body"]["mesh"]["file"] = str(column.parent / "column.vtk")
    mapping["touches"] = [{"name": "finger", "points": [TIP]}]
    mapping["effectors"][0]["directions"] = ["x", "y"]
    mapping["solver"] = {"newton_iterations": 20, "residual_tolerance": 1e-9}
    return mapping | changes


@pytest.fixture(scope="module")
def built(column):
    return Simulation(scene_from_mapping(mapping_of(column)))


@pytest.fixture
def pressed(built):
    """The column in balance under its weight."""
    built.reset()
    built.step(Hold(STEP))
    built.step(Hold(STEP))
    return built


def by_force(*force) -> Touched:
    return Touched(np.array([force], float), NONE)


def by_place(place) -> Touched:
    return Touched(NONE, np.array([place], float))


def press(simulation, touched, steps=3):
    for _ in range(steps):
        result = simulation.step(Hold(STEP), None, touched)
    return result


def test_a_small_force_displaces_the_point_by_its_compliance(pressed):
    linear = pressed.newton.tangent.linearized_state(pressed.state.positions, pressed.state.efforts).linear
    compliance = linear.W[linear.groups.effectors, linear.groups.effectors]  # x and y
    force = np.array([1e-5, -2e-5, 0.0])
    moved = press(pressed, by_force(*force)).touches.displacements[0]
    assert np.allclose(moved[:2], compliance @ force[:2], rtol=0.0, atol=1e-4 * np.linalg.norm(moved))


def test_the_force_that_holds_a_displaced_point_is_that_which_displaced_it(pressed):
    before = pressed.state
    force = np.array([0.002, 0.004, -0.01])
    by_the_force = press(pressed, by_force(*force))
    pressed.restore(before)
    held = press(pressed, by_place(by_the_force.touches.points[0]), 4)
    assert np.allclose(held.touches.forces[0], force, rtol=1e-6, atol=1e-8)
    assert np.allclose(held.state.positions, by_the_force.state.positions, atol=1e-9)


def test_the_work_of_a_press_is_stored(pressed):
    elastic = [term for term in pressed.model.forces if term.name != "gravity"]
    weights = next(t.weights for t in pressed.model.forces if t.name == "gravity")

    def energy():
        x = pressed.state.positions
        free = x[pressed.model.nodes.free_nodes]
        return sum(term.energy(x) for term in elastic) - float((weights * free).sum())

    start, before, work = pressed.touches.points[0], energy(), 0.0
    force, place = np.zeros(3), start
    for share in np.linspace(0.0, 1.0, 21)[1:]:
        result = press(pressed, by_place(start + share * np.array([0.004, 0.002, -0.0005])), 2)
        work += 0.5 * (force + result.touches.forces[0]) @ (result.touches.points[0] - place)
        force, place = result.touches.forces[0], result.touches.points[0]
    assert work > 1e-6
    assert energy() - before == pytest.approx(work, rel=2e-3)


def test_the_robot_is_back_where_it_was_when_the_finger_is_gone(pressed):
    rest = pressed.state.positions
    result = press(pressed, by_force(0.0, 0.04, 0.0))
    assert result.touches.is_touched.all()
    assert np.linalg.norm(result.touches.displacements[0]) > 1e-3
    for none in (None, by_force(0.0, 0.0, 0.0), Touched(NONE, NONE)):
        result = press(pressed, none)
        assert not result.touches.is_touched.any() and not result.touches.forces.any()
        assert np.allclose(result.state.positions, rest, atol=1e-9)


def test_a_state_with_a_touch_continues_as_it_would_have(pressed):
    place = pressed.touches.points[0] + [0.003, 0.0, 0.0]
    press(pressed, by_place(place), 1)
    saved = pressed.state
    onwards = press(pressed, by_place(place), 2).state
    pressed.restore(saved)
    assert np.array_equal(press(pressed, by_place(place), 2).state.positions, onwards.positions)


def test_while_touched_the_actuators_stay_and_then_targets_are_followed(built):
    built.reset()
    target = built.effector_positions() + [[0.004, 0.0, 0.0]]
    result = repeat_step(built, FollowTargets(target, STEP), 3)
    setpoints = result.setpoints.copy()
    result = built.step(FollowTargets(target, STEP), None, by_force(-0.02, 0.0, 0.0))
    assert np.array_equal(result.setpoints, setpoints)
    assert result.effector_positions[0, 0] < target[0, 0] - 1e-4
    result = repeat_step(built, FollowTargets(target, STEP), 3)
    assert result.effector_errors[0] < 1e-5


def test_a_robot_that_follows_targets_counteracts_a_known_force(column):
    touch = {"name": "finger", "points": [TIP], "while_touched": "follow_targets"}
    simulation = Simulation(scene_from_mapping(mapping_of(column, touches=[touch])))
    target = simulation.effector_positions() + [[0.004, 0.0, 0.0]]
    for force in (0.0, -0.02):
        for _ in range(5):
            touched = by_force(force, 0.0, 0.0)
            result = simulation.step(FollowTargets(target, STEP), None, touched)
        assert result.effector_errors[0] < 1e-5


def test_in_motion_a_constant_force_ends_at_the_displacement_of_statics(column, pressed):
    force = by_force(0.0, 0.01, 0.0)
    at_rest = press(pressed, force).touches.points[0]
    mapping = mapping_of(column, integration="dynamic")
    mapping["body"]["damping"] = {"mass": 20.0}
    moving = Simulation(scene_from_mapping(mapping))
    for _ in range(60):
        result = moving.step(Hold(STEP), None, force)
    assert np.allclose(result.touches.points[0], at_rest, atol=1e-6)


@pytest.mark.parametrize("touched, reason", [
    (Touched(np.ones((2, 3)), NONE), r"shape \(1, 3\)"),
    (Touched(np.full((1, 3), np.inf), NONE), "inf"),
    (Touched(np.ones((1, 3)), np.ones((1, 3))), "finger has a force and a place"),
])  # fmt: skip
def test_a_touch_that_does_not_fit_is_refused_and_nothing_changes(pressed, touched, reason):
    before = pressed.state
    with pytest.raises(CommandError, match=reason):
        pressed.step(Hold(STEP), None, touched)
    assert pressed.state is before


def test_a_huge_force_ends_in_a_status_with_finite_setpoints(pressed):
    before = pressed.state
    for _ in range(3):
        result = pressed.step(Hold(STEP), None, by_force(0.0, 0.0, -1e4))
        assert result.setpoints.tolist() == before.setpoints.tolist()
        assert np.isfinite(result.state.positions).all()
        assert not result.status.is_success
    pressed.reset()
    assert press(pressed, None).status.is_success
    assert np.allclose(pressed.state.positions, before.positions, atol=1e-9)
