"""Targets at which a beam begins to touch a rod, and some nanometres to either side."""

import numpy as np

from softrobot_twin.simulation import FollowTargets, Simulation
from test.scene_changes import repeat_step

STEP = 0.05


def check_rest_at_the_edge(
    simulation: Simulation, settling: int, still: float, pressed: float, near: float
) -> None:
    """Checks that lengths and forces rest there.

    Args:
        simulation: A beam beside a rod, at rest.
        settling: Steps before they rest.
        still: By how much lengths may change then [m].
        pressed: By how much the force of the contact may [N].
        near: Greatest distance from the target [m].
    """

    def follow(target, steps):
        return repeat_step(simulation, FollowTargets(np.atleast_2d(target), STEP), steps)

    home = simulation.effector_positions()[0]
    # Where leaning begins is found by pulling the target back from behind the rod.
    touched = follow(home + [0.02, 0.0, -0.006], 80).effector_positions[0]
    for beyond in (-1e-5, -1e-8, 0.0, 1e-8, 1e-5):
        result = follow(touched + [beyond, 0.0, 0.0], settling)
        lengths, forces = result.setpoints, result.contacts.forces.sum(axis=0)
        for _ in range(40):
            result = follow(touched + [beyond, 0.0, 0.0], 1)
            np.testing.assert_allclose(result.setpoints, lengths, atol=still)
            np.testing.assert_allclose(result.contacts.forces.sum(axis=0), forces, atol=pressed)
        assert result.effector_errors[0] < near
