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


@pytest.mark.slow
def test_a_hundred_thousand_steps_drift_neither_in_state_nor_in_memory(diamond, circle):
    simulation = diamond()
    targets = circle(LAP)
    for step in range(4 * LAP):
        result = simulation.step(FollowTargets(targets[step % LAP], 0.05))
    early, memory = result, resident_memory()
    for step in range(4 * LAP, STEPS):
        result = simulation.step(FollowTargets(targets[step % LAP], 0.05))
    assert resident_memory() - memory < 8 * 2**20
    assert result.state.step_count == STEPS
    assert result.state.time == pytest.approx(0.05 * STEPS)
    np.testing.assert_allclose(result.state.positions, early.state.positions, atol=1e-8)
    np.testing.assert_allclose(result.lengths, early.lengths, atol=1e-8)
    np.testing.assert_allclose(result.tensions, early.tensions, atol=1e-4)
