"""Row 30: a soft pad is dragged over a plane to and fro, with friction 0, 0.5 and 10.

In every step each contact's force is in its cone, and friction opposes sliding.
"""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status

STEP, PRESSED, WAY = 0.004, 0.0292, 0.004
SOLE, SHEAR, PRESSED_HEIGHT = 0.04, 1e5 / 2.6, 0.0192


def led(simulation, x, friction, steps=30):
    """Move the plate to a position and wait; returns the force of the floor [N], and the
    displacement of the sole.
    """
    simulation.model.guides.aim("plate", [x, 0.0, PRESSED])
    unsolved, on_the_way = 0, []
    for _ in range(steps):
        result = simulation.step(Hold(STEP))
        assert result.status in (Status.OK, Status.NOT_CONVERGED)
        unsolved += result.status is not Status.OK
        forces = result.contacts.forces
        assert np.all(forces[:, 2] >= 0.0)
        across = np.linalg.norm(forces[:, :2], axis=1)
        assert np.all(across <= friction * forces[:, 2] + 1e-9)
        on_the_way.append(forces.sum(axis=0))
    rest = simulation.model.nodes.rest_positions
    inner = (rest[:, 2] < 1e-9) & (np.abs(rest[:, :2]).max(axis=1) < 0.4 * SOLE)
    return np.array(on_the_way), (result.state.positions - rest)[inner], unsolved


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, 0.5, 10.0])
def test_the_cone_holds_in_both_directions(pad, friction):
    simulation = pad(friction, (3, 3, 2), 0.1, {"newton_iterations": 5},
                     damping={"mass": 5.0, "stiffness": 0.002})
    pressing, before, _ = led(simulation, 0.0, friction, 40)
    load = pressing[-1, 2]
    assert load > 1.0
    # So far that it slides at 0.5: friction can hold a shear of some 2 mm.
    ways = {0.0: 3 * WAY, 0.5: 3 * WAY, 10.0: 0.25 * WAY}
    for side in (1.0, -1.0, 1.0):
        forces, sole, unsolved = led(simulation, side * ways[friction], friction, 80)
        assert unsolved <= 4
        push = forces[-20:] if friction == 10.0 else forces[15:30]
        if friction == 0.0:
            assert np.abs(forces[:, :2]).max() < 1e-9
            np.testing.assert_allclose(sole[:, 0], before[:, 0] + side * ways[friction], atol=1e-4)
        elif friction == 0.5:
            # While the plate goes, friction pulls back with all that the load gives.
            assert 0.45 * load < np.max(-side * push[:, 0]) < 0.55 * load
        else:
            # It sticks: the sole stays, and the shear of the pad pulls at it.
            assert np.abs(sole - before).max() < 0.02 * ways[friction]
            sheared = -side * push[-1, 0] / (SHEAR * SOLE**2 * ways[friction] / PRESSED_HEIGHT)
            # G A d / h, less the effect of the free sides.
            assert 0.75 < sheared < 1.0
