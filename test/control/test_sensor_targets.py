"""Targets of sensors in the loop, and what measured sensors correct."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import SensorTargetInput
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation

PERIOD, WANTED = 0.02, 0.0006
FRAME = "base_link"


@pytest.fixture
def robots(small_scene_mapping):
    """The model, and a robot with a spring at its tip that nobody modelled."""
    string = {"name": "side", "string": [[0.0, 0.0, 0.125], [0.0, 0.062, 0.025]], "weight": 1.0}
    mapping = {**small_scene_mapping, "sensors": [string]}
    spring = {"name": "drag", "stiffness": 200.0, "rest_length": 0.09,
              "ends": [{"on": "body", "point": [0.0, 0.0, 0.125]},
                       {"on": "world", "point": [0.0, 0.1, 0.125]}]}  # fmt: skip
    return tuple(Simulation(scene_from_mapping(one)) for one in (mapping, {**mapping, "springs": [spring]}))


def arrival(time, frame=FRAME):
    now = round((1000.0 + time) * NANOSECONDS)
    return Arrival(frame, now, now, time)


@pytest.mark.parametrize("closed_loop, most", [(False, np.inf), (True, 2e-6)])
def test_measured_sensors_bring_a_wrong_model_to_the_target(robots, closed_loop, most):
    model, robot = robots
    loop = TwinLoop(model, LoopSettings(closed_loop=closed_loop, correction_limit=0.02), Mode.INVERSE)
    target = model.sensor_readings()[0] - WANTED
    for tick in range(80):
        time = tick * PERIOD
        assert loop.sensors.accept(["side"], np.array([target]), [], arrival(time)) is None
        shown = robot.state.memory["sensors.length"][0]
        assert loop.inputs["measured_sensor_lengths"].accept(0, ["length"], shown, [], arrival(time)) is None
        outcome = loop.tick(time, arrival(time).ros_time)
        robot.step(CommandSetpoints(outcome.command.setpoints, PERIOD))
    last, silence = outcome.command.setpoints, 80 * PERIOD
    for tick in range(50):  # An old measurement counts no more.
        now = silence + tick * PERIOD
        outcome = loop.tick(now, arrival(now).ros_time)
    assert np.abs(outcome.command.setpoints - last).max() < 1e-5
    missed = abs(robot.sensor_readings()[0] - target)
    assert missed < most
    if not closed_loop:
        assert missed > 1e-4


def test_wanted_values_stay_and_what_is_not_wanted_is_refused():
    wanted = SensorTargetInput({"spine": True, "flex": False, "belly": True}, FRAME, LoopSettings())
    assert wanted.accept(["belly"], np.array([2e-6]), [], arrival(0.0)) is None
    assert wanted.accept(["spine"], np.array([0.1]), [], arrival(0.1)) is None
    np.testing.assert_array_equal(wanted.wanted, [0.1, np.nan, 2e-6])
    for names, values, others, refusal in (
        (["flex"], [0.1], [], Refusal.WRONG_NAMES), (["nobody"], [0.1], [], Refusal.WRONG_NAMES),
        (["spine", "spine"], [0.1, 0.1], [], Refusal.WRONG_NAMES),
        (["spine"], [0.1, 0.2], [], Refusal.WRONG_SIZE), (["spine"], [np.inf], [], Refusal.NOT_FINITE),
        (["spine"], [0.1], [1.0], Refusal.WRONG_FIELDS),
    ):  # fmt: skip
        assert wanted.accept(names, np.array(values), np.array(others), arrival(0.2)) is refusal
    assert wanted.accept(["spine", "belly"], np.full(2, np.nan), [], arrival(0.3)) is None
    assert not wanted.is_given
