"""Facts of runs that do not end: no drift in state or memory."""

import os
from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets

LAP = 200
STEPS = 100_000


def resident_memory() -> int:
    """Memory of this process [B]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def sideways_by_one_linearization(mapping):
    mapping["solver"] |= {"newton_iterations": 1, "qp_solver": "daqp"}
    mapping["effectors"][0]["directions"] = ["x", "y"]


@pytest.mark.slow
def test_a_hundred_thousand_steps_drift_neither_in_state_nor_in_memory(beam):
    simulation = beam(sideways_by_one_linearization)
    angle = np.linspace(0.0, 2.0 * np.pi, LAP, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(LAP)], axis=1)
    targets = ([0.01, 0.01, 0.1] + 0.01 * circle)[:, None, :]
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
