"""Targets of an interval, followed forwards and backwards, stay inside it and in contact."""

import numpy as np
import pytest

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench_measurement import interval_targets, robot_cases


@pytest.mark.exhaustive
def test_the_trunk_is_in_contact_during_the_whole_timed_interval():
    case = next(case for case in robot_cases() if case.name == "trunk_700")
    simulation = Simulation(case.scene)
    tour = interval_targets(simulation, case.interval)
    targets, contacts = [], []
    for _ in range(300):
        command = next(tour)
        targets.append(command.targets[0])
        contacts.append(simulation.step(command).report.contact_count)
    # From 5.6 s to 8.3 s and back: the direction reverses twice, without a jump.
    steps = np.linalg.norm(np.diff(targets, axis=0), axis=1)
    assert 0.0 < steps.max() < 1e-3
    np.testing.assert_allclose(targets[269 + 1], targets[0], atol=1.5e-3)
    assert np.count_nonzero(contacts) > 0.95 * len(contacts)
