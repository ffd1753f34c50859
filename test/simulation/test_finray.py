"""The printed Fin-Ray finger: it bends around what it is pressed against."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation, Status
from test.scene_changes import repeat_step, solved

SCENE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "finray.yaml"
AXIS = np.array([0.020, 0.0, 0.0])
PRESSED = 0.30
ELEMENTS = {"beams[0].elements": 36, "beams[1].elements": 36} | {
    f"beams[{rib}].elements": 4 for rib in range(2, 10)}  # fmt: skip


def pressed(changes=None, greatest=PRESSED, count=60):
    """The result at an angle of the servo, after a ramp and some steps of rest; all statuses."""
    finger = Simulation(load_scene(SCENE, changes or {}))
    angles = [*np.linspace(0.0, greatest, count), *[greatest] * 20]
    results = [finger.step(CommandSetpoints(np.array([angle]), 0.02)) for angle in angles]
    return results[-1], [result.status for result in results], finger


@pytest.fixture(scope="module")
def finger():
    return pressed()


def test_the_roller_and_the_weight_turn_against_the_servo(finger):
    result, _, simulation = finger
    assert result.status is Status.OK
    forces = result.contacts.forces
    assert forces[:, 0].sum() > 1.0, "the roller pushes the finger back"
    torque = np.cross(result.contacts.positions - AXIS, forces).sum(axis=0)[1]
    away = pressed({"obstacles[0].position": [-0.2, 0.0, -0.045]})[0]
    assert len(away.contacts.forces) == 0
    # The weight's torque hardly depends on how the finger is bent.
    assert result.efforts[0] == pytest.approx(away.efforts[0] - torque, rel=0.01)


def test_its_tip_bends_around_the_roller_and_without_ribs_it_is_pushed_back(finger):
    def ahead(tip):
        # How far the tip is turned about the axis beyond the servo's angle [rad].
        arm, rest = tip - AXIS, np.array([0.0, 0.0, -0.080]) - AXIS
        return np.arctan2(-arm[0], -arm[2]) - np.arctan2(-rest[0], -rest[2]) - PRESSED

    assert ahead(finger[0].effector_positions[0]) > 0.01
    scene = load_scene(SCENE)
    alone = Simulation(scene.changed(beams=scene.beams[:1]))
    for angle in [*np.linspace(0.0, PRESSED, 60), *[PRESSED] * 20]:
        result = alone.step(CommandSetpoints(np.array([angle]), 0.02))
    assert ahead(result.effector_positions[0]) < -0.1


def test_twice_as_many_elements_press_as_hard(finger):
    fine, _, _ = pressed(ELEMENTS)
    assert fine.efforts[0] == pytest.approx(finger[0].efforts[0], rel=0.05)
    np.testing.assert_allclose(
        fine.effector_positions, finger[0].effector_positions, atol=0.3e-3)


@pytest.mark.parametrize("angle", [0.2415, 0.2445, None])
def test_it_rests_where_contacts_close_and_open_in_turn(drawn_rng, angle):
    """From rest to 0.24 to 0.248 rad, two Newton steps that are right where they begin undo each other."""
    angle = drawn_rng.uniform(0.02, 0.3) if angle is None else angle
    finger = Simulation(load_scene(SCENE))
    rested = repeat_step(finger, CommandSetpoints(np.array([angle]), 0.02), 40)
    for _ in range(5):
        result = solved(finger, CommandSetpoints(np.array([angle]), 0.02))
        assert result.report.iterations == 1
        np.testing.assert_allclose(result.effector_positions, rested.effector_positions, atol=1e-6)


def test_it_presses_and_lets_go_over_the_whole_range(finger):
    result, statuses, simulation = pressed(greatest=0.35, count=150)
    for angle in np.linspace(0.35, 0.0, 150):
        result = simulation.step(CommandSetpoints(np.array([angle]), 0.02))
        statuses.append(result.status)
    assert set(statuses) == {Status.OK}
    np.testing.assert_allclose(
        result.effector_positions[0], [0.0, 0.0, -0.080], atol=0.1e-3)
