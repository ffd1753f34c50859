"""How effectors curve, learnt from moves."""

import numpy as np

from softrobot_twin.simulation import CommandSetpoints
from softrobot_twin.simulation.step.curvature import jacobian_by_drives
from softrobot_twin.simulation.step.time_budget import StageClock
from test.scene_changes import repeat_step


def test_j_by_drives_agrees_with_differences(beam):
    simulation = beam(lambda m: m["solver"].update(newton_iterations=20, residual_tolerance=1e-10))

    def places(shortenings):
        command = CommandSetpoints(simulation.actuators.setpoints(shortenings), 1.0)
        return repeat_step(simulation, command, 12).effector_positions.ravel()

    setpoints = np.array([0.008, 0.004, 0.0, 0.0])
    places(setpoints)
    state, bears = simulation.state, simulation.state.efforts > 1e-6
    linear = simulation.newton.linearize(state.positions.copy(), state.efforts, StageClock())
    J = jacobian_by_drives(linear.W, linear.groups.effectors, bears, bears, np.zeros(4))
    assert bears.any()
    for cable in np.flatnonzero(bears):
        step = 1e-6 * np.eye(4)[cable]
        difference = (places(setpoints + step) - places(setpoints - step)) / 2e-6
        np.testing.assert_allclose(J[:, cable], difference, rtol=0.0, atol=1e-5 * np.abs(J).max())
