"""``explain --stiffness``: principal stiffnesses, compliance and Jacobian of each effector."""

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.stiffness import actuation


def test_a_setpoint_and_a_displacement_name_the_same(column):
    simulation = Simulation.from_scene_file(column)
    length = float(simulation.rest_setpoints[0]) - 0.004
    one = actuation(simulation, ["a_shortening_m=0.004"])
    np.testing.assert_allclose(actuation(simulation, [f"a_length_m={length!r}"]), one, atol=1e-12)
    assert one[0] == 0.004 and not one[1:].any()
