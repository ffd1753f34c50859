"""The loop on a scene that moves in time, with contact and a guided body."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.simulation import Hold, Simulation, Status
from test.places import SCENES

PERIOD = 0.01
SPEED, TURN_RATE = 0.05, 1.0
GRIP = 0.015


def pose_of(driver, name):
    simulation = driver.loop.simulation
    index = simulation.rigid_names.index(name)
    positions, quaternions = simulation.rigid_poses()
    return positions[index], Rotation.from_quat(quaternions[index])


def close(driver, ticks=150):
    rest = driver.loop.simulation.rest_setpoints
    assert driver.wind(["grip"], [rest[0] - GRIP]) is None
    return driver.tick(ticks)


def test_without_a_command_time_advances_and_the_cube_stays_on_the_floor(drive_grasper):
    driver = drive_grasper()
    outcome = driver.tick(20)
    assert outcome.activity is Activity.HOLDING and outcome.result.status.is_success
    assert driver.loop.simulation.state.time == pytest.approx(0.2)
    assert pose_of(driver, "cube")[0] == pytest.approx([0.0, 0.0, -0.104], abs=1e-5)
    # The floor carries the weight of the cube: 30 g.
    assert outcome.result.contacts.forces[:, 2].sum() == pytest.approx(0.2943, rel=1e-3)


def test_a_motor_closes_the_fingers_and_a_pose_lifts_the_cube(drive_grasper):
    driver = drive_grasper()
    window = DiagnosticsWindow()
    outcome = close(driver)
    rest = driver.loop.simulation.rest_setpoints
    assert outcome.result.setpoints == pytest.approx(rest - GRIP, abs=1e-6)
    assert driver.largest_step <= 0.02 * PERIOD + 2e-6
    height = pose_of(driver, "cube")[0][2]
    assert driver.lead("palm", 0.0, 0.0, 0.05) is None
    for _ in range(130):
        window.add(driver.tick())
    assert pose_of(driver, "palm")[0] == pytest.approx([0.0, 0.0, 0.05], abs=1e-9)
    # The contact with the floor opens, and the fingers yield by less than 2 mm.
    assert pose_of(driver, "cube")[0][2] - height == pytest.approx(0.05, abs=2e-3)
    names = [driver.outcomes[-1].result.contacts.names[pair]
             for pair in driver.outcomes[-1].result.contacts.pairs]
    assert names and all("floor" not in pair for pair in names)
    assert window.largest["contact_count"] >= 3
    assert 0.0 <= window.largest["contact_residual"] <= 1e-8
    assert 0.0 <= window.overlap_max < 1e-3


def test_a_pose_is_approached_no_faster_than_the_scene_allows(drive_grasper):
    driver = drive_grasper()
    driver.lead("palm", 0.0, 0.0, 0.05)
    heights = []
    for _ in range(30):
        outcome = driver.tick()
        heights.append(outcome.guided_poses["palm"].position[2])
    assert np.diff([0.0, *heights]) == pytest.approx(SPEED * PERIOD, abs=1e-9)
    # A newer pose wins at once.
    driver.lead("palm", 0.0, 0.0, 0.0)
    assert driver.tick().guided_poses["palm"].position[2] < heights[-1]


@pytest.mark.parametrize("quaternion", [(0.0, 0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0)])
def test_a_palm_commanded_to_turn_around_turns_no_faster_than_the_scene_allows(drive_grasper, quaternion):
    driver = drive_grasper()
    driver.lead("palm", 0.0, 0.0, 0.0, quaternion=quaternion)
    turned = Rotation.identity()
    for _ in range(30):
        outcome = driver.tick()
        assert outcome.result.report.inverted_count == 0
        now = Rotation.from_quat(outcome.guided_poses["palm"].quaternion)
        assert (now * turned.inv()).magnitude() == pytest.approx(TURN_RATE * PERIOD, abs=1e-9)
        turned = now


def test_a_palm_returns_home_at_its_speed_limit_although_the_model_failed(drive_grasper, monkeypatch):
    driver = drive_grasper()
    driver.lead("palm", 0.0, 0.0, 0.02)
    close(driver, 50)
    simulation = driver.loop.simulation
    failing = replace(simulation.step(Hold(PERIOD)), status=Status.DIVERGED)
    honest = simulation.step
    monkeypatch.setattr(
        simulation, "step",
        lambda command, budget=None: honest(command) if simulation.state.step_count < 5
        else failing,
    )  # fmt: skip
    driver.loop.reset()
    before, heights = driver.outcomes[-1].guided_poses["palm"].position[2], []
    assert before == pytest.approx(0.02)
    while driver.tick().activity is Activity.RETURNING:
        heights.append(driver.outcomes[-1].guided_poses["palm"].position[2])
        assert len(heights) < 200
    steps = np.abs(np.diff([before, *heights]))
    assert steps.max() <= SPEED * PERIOD + 1e-9
    assert heights[-1] == pytest.approx(0.0, abs=1e-6)


def test_a_disabled_loop_moves_no_body_and_continues_with_a_new_command(drive_grasper):
    driver = drive_grasper()
    driver.loop.disable()
    driver.lead("palm", 0.0, 0.0, 0.05)
    outcome = driver.tick(5)
    assert outcome.command is None
    assert pose_of(driver, "palm")[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    driver.loop.enable(driver.time)
    driver.tick(5)
    assert pose_of(driver, "palm")[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    driver.lead("palm", 0.0, 0.0, 0.05)
    driver.tick(5)
    assert pose_of(driver, "palm")[0][2] == pytest.approx(5 * SPEED * PERIOD)


def test_a_reset_moves_the_palm_home_before_it_restores_the_rest_shape(drive_grasper):
    driver = drive_grasper()
    turned = Rotation.from_euler("z", 0.3).as_quat()
    driver.lead("palm", 0.0, 0.0, 0.02, quaternion=turned)
    driver.tick(50)
    assert pose_of(driver, "palm")[1].magnitude() == pytest.approx(0.3, abs=1e-9)
    assert driver.loop.reset() == "returning to rest"
    before = pose_of(driver, "palm")[0][2]
    while driver.loop.simulation.state.step_count:
        driver.tick()
        now = pose_of(driver, "palm")[0][2]
        assert abs(now - before) <= SPEED * PERIOD + 1e-9
        before = now
    assert before == 0.0
    assert driver.tick().activity is Activity.HOLDING


def test_a_scene_in_contact_with_an_effector_is_driven_by_length():
    leg = Simulation.from_scene_file(SCENES / "octoleg.yaml")
    loop = TwinLoop(leg, LoopSettings(rate=100.0), Mode.DIRECT)
    start = leg.effector_positions()
    arrival = Arrival("", 0, NANOSECONDS, 0.0)
    assert loop.direct.accept(["cable"], leg.rest_setpoints - 0.02, [], arrival) is None
    for tick in range(120):
        outcome = loop.tick(0.01 * tick, NANOSECONDS)
    assert outcome.activity is Activity.COMMANDED
    assert outcome.result.setpoints == pytest.approx(leg.rest_setpoints - 0.02, abs=1e-6)
    assert np.linalg.norm(outcome.result.effector_positions - start) > 0.02
    assert outcome.result.report.contact_count > 0
