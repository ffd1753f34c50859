"""Results of steps are made when they are read, and tell the same whenever that is."""

import pickle

import numpy as np
import pytest

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Simulation
from test.places import SCENES


def steps_of(simulation, count):
    """Results of the first steps from rest: towards targets, else by setpoints."""
    simulation.reset()
    for number in range(1, count + 1):
        way = 1.0e-3 * number
        if simulation.inverse is not None:
            yield simulation.step(FollowTargets(simulation.effector_positions() + way, 0.02))
        else:
            scale = simulation.actuators.limits.drive_scale
            setpoints = simulation.actuators.setpoints(0.02 * number * scale)
            yield simulation.step(CommandSetpoints(setpoints, 0.02))


def told_by(result):
    """All that a result tells but times."""
    report = vars(result.report) | {"stage_times": None, "compute_time": None}
    arrays = [result.state.positions, result.setpoints, result.efforts, result.displacements,
              result.effector_positions, result.effector_errors]  # fmt: skip
    return result.status, repr(report), repr([one.tolist() for one in arrays]), repr(result.contacts)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["finger", "octoleg", "trunk_cylinders", "fetch_reduced"])
def test_a_result_that_is_read_later_tells_the_same(name):
    simulation = Simulation.from_scene_file(SCENES / f"{name}.yaml")
    at_once = [told_by(result) for result in steps_of(simulation, 4)]
    later = list(steps_of(simulation, 4))
    if simulation.effector_names:
        EffectorCompliance(simulation).at_state()
    simulation.reset()
    assert [told_by(result) for result in later] == at_once


def test_a_result_can_be_sent_to_another_process_before_it_is_read():
    (result,) = steps_of(Simulation.from_scene_file(SCENES / "finger.yaml"), 1)
    sent = pickle.loads(pickle.dumps(result))
    assert sent.status is result.status
    np.testing.assert_array_equal(sent.state.positions, result.state.positions)
