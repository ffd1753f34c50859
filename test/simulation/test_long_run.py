"""Facts of runs that do not end: no drift in state or memory."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets
from test.memory import resident_memory

LAP = 200
STEPS = 100_000


@pytest.fixture
def stub(simulate, body_of, block):
    """The smallest robot that follows a circle: a stub of one cell with three cables."""

    def cable(name, x, y) -> dict:
        return {
            "name": name, "pull_point": [x, y, 0.0], "points": [[x, y, 0.04]],
            "shortening": [0.0, 0.02], "rate": 0.05, "tension": [0.0, 40.0],
        }  # fmt: skip

    foot = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]
    mesh = block(size=(0.02, 0.02, 0.04), cells=(1, 1, 1))
    return simulate(
        gravity=[0.0, 0.0, 0.0], body=body_of(mesh, "stub", young_modulus=3e5, fixed=foot),
        cables=[cable("east", 0.02, 0.01), cable("north", 0.005, 0.02), cable("south", 0.005, 0.0)],
        effectors=[{"name": "tip", "points": [[0.01, 0.01, 0.04]], "directions": ["x", "y"]}],
        solver={"newton_iterations": 1, "residual_tolerance": 1e-6},
    )  # fmt: skip


@pytest.mark.exhaustive
def test_a_hundred_thousand_steps_drift_neither_in_state_nor_in_memory(stub):
    simulation = stub
    angle = np.linspace(0.0, 2.0 * np.pi, LAP, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(LAP)], axis=1)
    targets = ([0.01, 0.01, 0.04] + 0.003 * circle)[:, None, :]
    for step in range(4 * LAP):
        result = simulation.step(FollowTargets(targets[step % LAP], 0.05))
    assert result.status.is_success
    early, memory = result, resident_memory()
    for step in range(4 * LAP, STEPS):
        result = simulation.step(FollowTargets(targets[step % LAP], 0.05))
    assert resident_memory() - memory < 8 * 2**20
    assert result.state.step_count == STEPS
    assert result.state.time == pytest.approx(0.05 * STEPS)
    np.testing.assert_allclose(result.state.positions, early.state.positions, atol=1e-8)
    np.testing.assert_allclose(result.setpoints, early.setpoints, atol=1e-8)
    np.testing.assert_allclose(result.efforts, early.efforts, atol=1e-4)
