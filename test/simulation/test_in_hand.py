"""An effector on a body that fingers hold by friction: it is moved in the hand, and carried.

The Grasper without its motor, so that three cables move its cube in three directions.
"""

from pathlib import Path

import numpy as np
import pytest
import yaml

from softrobot_twin.scene.loading import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation, Status

SCENE_FILE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "grasper.yaml"
STEP, GRIP, LIFT = 0.02, 0.018, 0.020
AWAY, HELD = 2.0e-3, 0.2e-3


@pytest.fixture(scope="module")
def held_cube():
    """A lifted cube, and the state in which it hangs in the fingers."""
    entries = yaml.safe_load(SCENE_FILE.read_text())
    del entries["motors"]
    simulation = Simulation(scene_from_mapping(entries, SCENE_FILE))
    closed = CommandSetpoints(simulation.rest_setpoints - GRIP, STEP)
    for _ in range(60):
        simulation.step(closed)
    simulation.model.guides.aim("palm", [0.0, 0.0, LIFT])
    for _ in range(90):
        simulation.step(closed)
    return simulation, simulation.state


def follow(simulation, state, targets):
    """Steps towards targets, one each: the results, and how far the cube is from them [m]."""
    simulation.restore(state)
    results = [simulation.step(FollowTargets(target[None], STEP)) for target in targets]
    places = np.array([result.effector_positions[0] for result in results])
    return results, np.linalg.norm(places - targets, axis=1)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_cube_goes_two_millimetres_in_the_fingers_and_stays_for_ten_seconds(held_cube, axis, side):
    simulation, state = held_cube
    simulation.restore(state)
    goal = simulation.effector_positions()[0] + side * AWAY * np.eye(3)[axis]
    results, left = follow(simulation, state, np.tile(goal, (50 + 500, 1)))
    assert left[50:].max() < HELD
    assert left[-1] < 1e-5
    assert results[-1].status is Status.OK and results[-1].report.active_limits == ()
    assert all(not result.status.is_failure for result in results)


@pytest.mark.slow
def test_the_palm_carries_the_cube_along_a_path_while_targets_lead_it_in_the_fingers(held_cube):
    """The palm goes 60 mm up and 30 mm aside at 50 mm/s, and the cube 1 mm to each side in the hand."""
    simulation, state = held_cube
    simulation.restore(state)
    start = simulation.effector_positions()[0]
    way = np.array([0.030, 0.0, 0.060])
    simulation.model.guides.aim("palm", way + [0.0, 0.0, LIFT])
    steps = int(np.ceil(np.linalg.norm(way) / (0.05 * STEP)))
    shares = np.minimum(np.arange(1, 2 * steps + 101) / steps, 1.0)[:, None]
    inside = 1e-3 * np.sin(np.pi * shares) * [0.0, 1.0, 0.0]
    # follow() restores the state; the palm's aim is no part of it.
    results, left = [], []
    for target in start + shares * way + inside:
        results.append(simulation.step(FollowTargets(target[None], STEP)))
        left.append(np.linalg.norm(results[-1].effector_positions[0] - target))
    assert max(left[-100:]) < HELD and max(left) < 3e-3
    assert results[-1].status is Status.OK
