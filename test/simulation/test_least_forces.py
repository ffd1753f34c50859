"""Normal forces that pairs shall at least press with, while targets lead what they hold."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene.loading import scene_from_mapping
from softrobot_twin.simulation import FollowTargets
from test.grasped_cube import SCENE_FILE, STEP, hand, lifted

GRIP, LEAST = 0.020, 0.3


def entries(least=LEAST, **of_pair):
    """The Grasper without its motor; two of its fingers shall press on the cube."""
    found = hand()
    fingers = [{"pair": [f"finger_{k}", "cube"], **of_pair} for k in range(3)]
    if least:
        fingers[0]["least_force"] = fingers[1]["least_force"] = least
    found["contact"]["between"][:1] = fingers
    return found


def normal_forces(simulation):
    """Sum of the normal forces of each finger on the cube [N]."""
    contacts, sums = simulation.model.contacts, dict.fromkeys(("finger_0", "finger_1", "finger_2"), 0.0)
    for pair, (normal, *_) in zip(contacts.pair[: contacts.count], contacts.memory.forces, strict=True):
        name = contacts.pair_names[pair][0]
        if name in sums:
            sums[name] += normal
    return sums


def follow(simulation, target, steps=200):
    """Steps towards a target: the results, misses [m], and normal forces of two fingers [N]."""
    results, left, forces = [], [], []
    for _ in range(steps):
        results.append(simulation.step(FollowTargets(target[None], STEP)))
        left.append(np.linalg.norm(results[-1].effector_positions[0] - target))
        found = normal_forces(simulation)
        forces.append((found["finger_0"], found["finger_1"]))
    return results, np.array(left), np.array(forces)


@pytest.mark.sampled
@pytest.mark.parametrize("way", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1)])
def test_targets_are_held_with_the_least_force_at_two_sides(way):
    simulation = lifted(entries(), GRIP, 70)
    start = simulation.effector_positions()[0]
    _, left, forces = follow(simulation, start + 1e-3 * np.array(way))
    print(way, left[50:].max(), forces[50:].min(axis=0))
    assert left[50:].max() < 0.2e-3
    assert forces[50:].min() > 0.99 * LEAST


@pytest.mark.exhaustive
def test_the_target_is_missed_before_the_grip_falls_below_its_least_force():
    """Without one the fingers open to let the cube down."""
    down, found = np.array([0.0, 0.0, -2e-3]), {}
    for least in (None, LEAST):
        simulation = lifted(entries(least), GRIP, 70)
        start = simulation.effector_positions()[0]
        results, left, forces = follow(simulation, start + down)
        found[least] = left[50:].max(), forces[50:].min(), results[-1].report.active_limits
        print(least, found[least])
    assert found[None][0] < 0.2e-3 and found[None][1] < 0.97 * LEAST
    assert found[LEAST][0] > 0.2e-3 and found[LEAST][1] > 0.99 * LEAST
    assert not any("least_force" in limit for limit in found[None][2])
    assert "finger_1.cube.least_force" in found[LEAST][2]


def test_a_least_force_of_a_pair_without_friction_is_refused():
    with pytest.raises(SceneError, match=r"between\[0\].least_force = 0.3.*without friction"):
        scene_from_mapping(entries(friction=0.0), SCENE_FILE)
