"""A stretch of targets, gone to and fro, stays in the stretch and leans all along."""

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.bench_measurement import TargetStretch, leaning_cases


def test_the_trunk_leans_all_along_the_stretch_that_is_timed():
    case = leaning_cases()[0]
    simulation = Simulation(case.scene)
    tour = TargetStretch(simulation, case.stretch)
    targets, contacts = [], []
    for _ in range(300):
        command = tour.next()
        targets.append(command.targets[0])
        contacts.append(simulation.step(command).report.contact_count)
    # From 5.6 s to 8.3 s and back: the way turns twice, with no jump.
    steps = np.linalg.norm(np.diff(targets, axis=0), axis=1)
    assert 0.0 < steps.max() < 1e-3
    np.testing.assert_allclose(targets[269 + 1], targets[0], atol=1.5e-3)
    assert np.count_nonzero(contacts) > 0.95 * len(contacts)
