"""The parallel robot of beams: four strips, turned at their ends by motors, carry a platform."""

import numpy as np
import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Hold, Simulation, Status
from test.places import SCENES
from test.scene_changes import repeat_step, solved

G = 9.81


@pytest.fixture
def strider():
    simulation = Simulation(load_scene(SCENES / "strider.yaml"))
    repeat_step(simulation, Hold(0.02), 5)
    return simulation


def reach(simulation, target, steps=60):
    return repeat_step(simulation, FollowTargets(np.array([target]), 0.02), steps)


def test_it_hangs_level_and_its_motors_bear_it_alike(strider):
    result = solved(strider, Hold(0.02))
    tip = strider.effector_positions()[0]
    np.testing.assert_allclose(tip[:2], 0.0, atol=1e-9)
    # The weight of 86 g lowers it by some millimetres.
    assert -0.170 < tip[2] < -0.165
    np.testing.assert_allclose(result.efforts, result.efforts[0], rtol=1e-6)
    assert result.efforts[0] > 0.003


def test_motors_that_turn_alike_lift_the_platform_and_opposite_ones_move_it_aside(strider):
    rest = strider.effector_positions()[0]
    result = repeat_step(strider, CommandSetpoints(np.full(4, 0.5), 0.02), 30)
    lifted = strider.effector_positions()[0]
    assert result.status is Status.OK
    np.testing.assert_allclose(lifted[:2], 0.0, atol=1e-9)
    assert lifted[2] > rest[2] + 0.015
    result = repeat_step(strider, CommandSetpoints(np.array([0.5, 0.0, -0.5, 0.0]), 0.02), 60)
    aside = strider.effector_positions()[0]
    assert result.status is Status.OK
    assert aside[0] > 0.02 and abs(aside[1]) < 1e-9


def test_its_tip_reaches_targets_in_all_directions(strider):
    rest = strider.effector_positions()[0].copy()
    for way in ([0.03, 0.0, 0.0], [-0.015, 0.02, 0.01], [0.0, 0.0, 0.03], [0.0, -0.02, -0.01]):
        result = reach(strider, rest + way)
        assert result.status is Status.OK
        assert np.linalg.norm(strider.effector_positions()[0] - rest - way) < 2e-5
    assert (np.abs(result.setpoints) < 0.9).all()


def test_a_target_out_of_reach_names_the_limits_of_the_motors(strider):
    result = reach(strider, [0.15, 0.0, -0.16], 80)
    assert result.status is Status.SATURATED
    assert set(result.report.active_limits) == {"motor_1.angle_max", "motor_3.angle_min"}
    tip = strider.effector_positions()[0]
    assert 0.035 < tip[0] < 0.1 and abs(tip[1]) < 1e-6


def test_no_motor_turns_faster_than_its_rate(strider):
    before = strider.state.setpoints.copy()
    for _ in range(10):
        strider.step(FollowTargets(np.array([[0.04, 0.0, -0.16]]), 0.02))
        now = strider.state.setpoints
        assert np.abs(now - before).max() <= 1.5 * 0.02 * (1.0 + 1e-9)
        before = now.copy()


def test_the_work_of_the_motors_is_the_energy_of_the_legs_and_of_the_weight(strider):
    def energy():
        return sum(term.energy(strider.state.positions) for term in strider.model.forces)

    def heights():
        legs = sum(
            beam.entry.material.density * beam.section.area
            * beam.node_lengths @ beam.nodes_mapping().positions(strider.state.positions)[:, 2]
            for beam in strider.model.beams
        )  # fmt: skip
        return G * (legs + 0.030 * strider.rigid_poses()[0][0, 2])

    way = np.array([0.6, 0.2, -0.4, 0.5])
    stored, work = [], 0.0
    last = None
    for share in np.linspace(0.0, 1.0, 31):
        result = solved(strider, CommandSetpoints(share * way, 1.0))
        if last is not None:
            work += 0.5 * (result.efforts + last.efforts) @ (result.setpoints - last.setpoints)
        stored.append(energy() + heights())
        last = result
    assert work == pytest.approx(stored[-1] - stored[0], rel=1e-3)
    assert abs(work) > 0.005
