"""Facts of how targets are followed without friction."""

import numpy as np

from softrobot_twin.simulation import FollowTargets, Status
from test.scene_changes import repeat_step


def test_targets_of_nan_do_no_harm(beam):
    """What is free for a while is followed afterwards as if it had never been free."""
    simulation = beam()
    home = simulation.effector_positions()
    free = np.full_like(home, np.nan)
    near, far = home + [0.005, 0.0, -0.004], home + [0.6, 0.6, -0.6]
    for target in (free, far, free, near):
        for _ in range(150):
            result = simulation.step(FollowTargets(target, 0.02))
            assert not result.status.is_failure
    assert result.status is Status.OK


def test_a_robot_that_cannot_even_stay_goes_back(beam):
    """A move may lead where no correction is accepted, staying neither: then each step was refused."""
    simulation = beam()
    start = simulation.state.setpoints.copy()
    target = FollowTargets(simulation.effector_positions() + [0.3, 0.3, 0.0], 0.02)
    for steps in (8, 100):
        away = repeat_step(simulation, target, steps).setpoints
        simulation.inverse.refuse(True)
        back = repeat_step(simulation, target, 2).setpoints
        assert np.abs(back - start).sum() < 0.9 * np.abs(away - start).sum()
