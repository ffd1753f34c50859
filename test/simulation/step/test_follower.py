"""Facts of how targets are followed without friction."""

import numpy as np

from softrobot_twin.simulation import FollowTargets, Status
from softrobot_twin.simulation.step.follower import GREATEST
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


def test_it_rests_with_a_wide_radius_where_the_nearest_place_is_reached(beam):
    """What is left of the promise there is round-off: the target is 1.2 mm out of reach."""
    simulation = beam()
    target = simulation.effector_positions() + [0.01, 0.0, -0.005]
    result = repeat_step(simulation, FollowTargets(target, 0.02), 100)
    assert result.status is Status.UNREACHABLE
    assert simulation.inverse.rests and simulation.inverse.move_limit > 0.01 * GREATEST


def test_what_is_learnt_is_forgotten_by_a_reset(beam, rod):
    simulation = beam(rod, {"body.element": "quadratic"})
    target = simulation.effector_positions() + [0.9, 0.9, 0.0]

    def follow() -> tuple[list, list]:
        simulation.reset()
        lengths, radii = [], []
        for _ in range(100):
            lengths.append(simulation.step(FollowTargets(target, 0.02)).setpoints)
            radii.append(simulation.inverse.move_limit)
        return lengths, radii

    (first, radii), (again, _) = follow(), follow()
    assert min(radii) < GREATEST
    np.testing.assert_array_equal(first, again)


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
