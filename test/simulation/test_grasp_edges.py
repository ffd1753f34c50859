"""Targets of a body that fingers cannot hold, or only just touch: commands stay within their limits."""

import numpy as np
import pytest

from softrobot_twin.scene.loading import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation, Status
from test.grasped_cube import LIFT, SCENE_FILE, STEP, hand, lifted

RATE, WOUND = 0.020, (0.0, 0.040)  # m/s, m


def follow(simulation, way, steps):
    """Steps towards a target so far from the cube: the results. No command breaks rates and limits."""
    goal, before, results = simulation.effector_positions()[0] + way, simulation.state.setpoints, []
    for _ in range(steps):
        results.append(simulation.step(FollowTargets(goal[None], STEP)))
        assert np.abs(results[-1].setpoints - before).max() <= RATE * STEP * (1.0 + 1e-9)
        before = results[-1].setpoints
        wound = simulation.rest_setpoints - before
        assert wound.min() >= WOUND[0] - 1e-12 and wound.max() <= WOUND[1] + 1e-12
        assert results[-1].efforts.min() >= 0.0 and not results[-1].status.is_failure
    return results


def slippery(friction, of_floor):
    """The hand whose fingers have so much friction."""
    entries = hand()
    entries["contact"]["friction"] = of_floor
    entries["contact"]["between"][0]["friction"] = friction
    return entries


@pytest.mark.exhaustive
@pytest.mark.sampled
@pytest.mark.parametrize("of_floor", [0.0, 0.7])
@pytest.mark.parametrize("way", [(0, 0, 20), (3, 0, 0), (0, 3, 3)])
def test_without_friction_no_finger_lifts_the_cube_and_its_target_is_missed(of_floor, way):
    """Row 30: they close on it and slide off as the palm rises."""
    simulation = lifted(slippery(0.0, of_floor), 0.016, 70)
    height = simulation.effector_positions()[0, 2]
    assert height == pytest.approx(-0.104, abs=1e-5)
    results = follow(simulation, 1e-3 * np.array(way), 120)
    assert results[-1].effector_positions[0, 2] == pytest.approx(height, abs=1e-5)
    assert results[-1].status is Status.UNREACHABLE
    lengths = np.array([result.setpoints for result in results[-20:]])
    assert np.ptp(lengths, axis=0).max() < 1e-6


def test_a_cube_that_slides_out_of_its_fingers_is_told_as_lost():
    """Row 30: with a seventh of the friction that holds it."""
    simulation = Simulation(scene_from_mapping(slippery(0.1, 0.7), SCENE_FILE))
    closed = CommandSetpoints(simulation.rest_setpoints - 0.016, STEP)
    for _ in range(70):
        simulation.step(closed)
    simulation.model.guides.aim("palm", [0.0, 0.0, 2 * LIFT])
    results = follow(simulation, np.array([0.0, 0.0, 2 * LIFT]), 120)
    told = [set(result.report.active_limits) for result in results]
    for finger in ("finger_0", "finger_1", "finger_2"):
        assert any(f"{finger}.cube.slips" in limits for limits in told)
    assert any(limit.startswith("finger") and limit.endswith("lost") for limit in set().union(*told))
    assert results[-1].effector_positions[0, 2] == pytest.approx(-0.104, abs=1e-4)
    assert not results[-1].status.is_success


@pytest.mark.sampled
@pytest.mark.parametrize("beyond", [-1e-6, 0.0, 1e-6, 1e-4, 1e-3])
def test_fingers_that_just_touch_a_cube_rest_and_do_not_flicker(beyond):
    """Row 32: the cube stands on the floor, its target where the fingers begin to push it."""
    entries = hand()
    simulation = Simulation(scene_from_mapping(entries, SCENE_FILE))
    for wound in np.arange(0.0, 0.016, 2e-4):
        simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, STEP))
        pairs = simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, STEP)).contacts
        if any("finger" in pairs.names[pair][0] for pair in pairs.pairs):
            break
    results = follow(simulation, np.array([beyond, 0.0, 0.0]), 200)
    lengths = np.array([result.setpoints for result in results[-50:]])
    counts = {result.report.contact_count for result in results[-50:]}
    assert len(counts) == 1
    print(f"{wound:.4f} m: lengths within {np.ptp(lengths, axis=0).max():.1e} m, {counts} contacts")
    assert np.ptp(lengths, axis=0).max() < 1e-6
    assert results[-1].effector_errors[0] < max(2e-4, beyond + 1e-6)
