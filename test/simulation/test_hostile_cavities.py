"""Cavities under commands of any size and order: nothing is lost, and home is found."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, FollowTargets, Hold
from test.scene_changes import in_balance

PRESSURES = (-1e9, -1e5, -1e3, 0.0, 1e3, 1e4, 1e5, 1e9)
VOLUMES = (-1.0, 0.0, 1e-9, 1e-6, 4e-6, 1e-5, 1e-4, 1.0)


def any_command(random, control):
    kind = random.integers(4)
    if kind == 0:
        setpoint = random.choice(PRESSURES if control == "pressure" else VOLUMES)
        return CommandSetpoints([setpoint], random.choice([0.0, 0.02, 1.0]))
    if kind == 1:
        return CommandEfforts([random.choice(PRESSURES)], 0.02)
    if kind == 2:
        away = random.standard_normal((1, 3)) * random.choice([1e-3, 1e-1])
        return FollowTargets(np.array([[0.01, 0.01, 0.06]]) + away, 0.02)
    return Hold(0.02)


@pytest.mark.sampled
@pytest.mark.parametrize("iterations", [1, 30])
@pytest.mark.parametrize("control", ["pressure", "volume"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_order_of_commands_turns_a_cavity_inside_out_or_loses_it(inflatable, control, iterations, seed):
    print("seed", seed)
    random = np.random.default_rng(seed)
    simulation = inflatable({
        "effectors": [{"name": "top", "points": [[0.01, 0.01, 0.06]]}],
        "solver": {"newton_iterations": iterations, "residual_tolerance": 1e-6},
    }, control=control, pressure=[-1e6, 1e6])  # fmt: skip
    (term,) = simulation.actuators.terms
    for _ in range(40):
        command = any_command(random, control)
        result = simulation.step(command)
        for array in (result.state.positions, result.setpoints, result.efforts):
            assert np.isfinite(array).all()
        assert term.volumes(result.state.positions)[0] > 0.0, command
    result = in_balance(simulation, CommandSetpoints(simulation.rest_setpoints, 0.02), 200)
    np.testing.assert_allclose(
        result.state.positions, simulation.model.nodes.rest_positions, atol=1e-6
    )
