"""The PneuNet gripper moves its ball in its fingers, as far as pressure and friction allow.

At equal pressures the held ball goes 0.06 mm down by each kPa: from 40 kPa 0.6 mm down to the valves'
limit of 50 kPa, and 0.8 mm up until 25 kPa, where its fingers have a sixth of their friction left.
"""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets, Status
from test.grasped_ball import lifted_ball, valves
from test.grasped_cube import LIFT, STEP

HELD, LEAST = 0.2e-3, 0.1


@pytest.fixture(scope="module")
def held_ball():
    """A lifted ball, and the state in which it hangs in the fingers."""
    simulation = lifted_ball(valves(least_grip_margin=LEAST))
    return simulation, simulation.state


def follow(held, way, steps):
    """Steps towards a target so far from the start [m]: the results, and the misses [m]."""
    simulation, state = held
    simulation.restore(state)
    goal = simulation.effector_positions()[0] + way
    results = [simulation.step(FollowTargets(goal[None], STEP)) for _ in range(steps)]
    return results, np.array([result.effector_errors[0] for result in results])


@pytest.mark.exhaustive
@pytest.mark.parametrize("way", [(2, 0, 0), (0, 0, -0.5)])
def test_a_ball_is_held_for_ten_seconds_where_the_fingers_reach(held_ball, way):
    results, left = follow(held_ball, 1e-3 * np.array(way), 550)
    assert left[50:].max() < HELD and left[-1] < 1e-5
    assert results[-1].status is Status.OK and results[-1].report.active_limits == ()


@pytest.mark.exhaustive
@pytest.mark.parametrize(("way", "limit"), [((0, 0, 2), "grip_margin"), ((0, 0, -2), "pressure_max")])
def test_a_target_beyond_reach_is_missed_with_its_limit_named_and_the_ball_stays(held_ball, way, limit):
    results, left = follow(held_ball, 1e-3 * np.array(way), 150)
    assert HELD < left[-1] < 1.5e-3 and np.ptp(left[-50:]) < 2e-5
    assert results[-1].status is Status.SATURATED
    assert sum(name.endswith(limit) for name in results[-1].report.active_limits) == 3
    margins = [[*result.report.figures.values()] for result in results]
    assert np.min(margins[-50:]) > LEAST - 0.01


@pytest.mark.exhaustive
@pytest.mark.parametrize("way", [(0, 0, 2), (6, 0, 0)])
def test_a_restored_state_takes_the_step_at_a_least_margin_that_it_would_have_taken(held_ball, way):
    simulation, state = held_ball
    simulation.restore(state)
    target = simulation.effector_positions() + 1e-3 * np.array(way)
    follow(held_ball, 1e-3 * np.array(way), 20)
    before = simulation.state
    straight = simulation.step(FollowTargets(target, STEP))
    simulation.restore(before)
    again = simulation.step(FollowTargets(target, STEP))
    margins = [[*result.report.figures.values()] for result in (straight, again)]
    assert np.min(margins) < LEAST + 0.01
    np.testing.assert_allclose(*margins, atol=1e-3)
    moved = np.abs(straight.setpoints - before.setpoints).max()
    assert np.abs(again.setpoints - straight.setpoints).max() < 0.05 * moved


@pytest.mark.exhaustive
def test_the_palm_carries_the_ball_along_a_path_while_targets_lead_it_in_the_fingers(held_ball):
    """The palm goes 60 mm up and 30 mm aside at 50 mm/s, and the ball 1 mm to each side in the hand."""
    simulation, state = held_ball
    simulation.restore(state)
    start, way = simulation.effector_positions()[0], np.array([0.030, 0.0, 0.060])
    simulation.model.guides.aim("palm", way + [0.0, 0.0, LIFT])
    steps = int(np.ceil(np.linalg.norm(way) / (0.05 * STEP)))
    shares = np.minimum(np.arange(1, 2 * steps + 101) / steps, 1.0)[:, None]
    inside, left = 1e-3 * np.sin(np.pi * shares) * [0.0, 1.0, 0.0], []
    for target in start + shares * way + inside:
        result = simulation.step(FollowTargets(target[None], STEP))
        left.append(result.effector_errors[0])
    print(f"{1e3 * max(left):.3f} mm on the way, {1e3 * max(left[-100:]):.4f} mm at the end")
    assert max(left) < 3e-3 and max(left[-100:]) < HELD
    assert result.status is Status.OK
