"""Angles of motors in the control loop: a simulated device, and the last check of commands."""

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.command_gate import CommandGate
from softrobot_twin.control.device import MeasuredSetpoints
from softrobot_twin.control.inputs import ActuatorNames
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.errors import ParameterError
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
from test.places import SCENES


@pytest.fixture
def simulation():
    made = Simulation(load_scene(SCENES / "strider_device.yaml"))
    made.warm_up()
    return made


def test_simulated_motors_turn_to_their_angles_with_delay_and_at_their_speed(simulation):
    device = SimulatedDevice(simulation, DeviceFlaws(delay=0.04, angle_rate=1.0))
    device.read(0.0)
    device.apply(np.array([0.3, 0.0, -0.3, 0.0]), 0.0)
    assert not device.read(0.02).setpoints.any()
    readings = [device.read(0.02 * k).setpoints for k in range(2, 30)]
    steps = np.abs(np.diff(readings, axis=0)).max(axis=1)
    assert steps.max() == pytest.approx(0.02)
    np.testing.assert_allclose(readings[-1], [0.3, 0.0, -0.3, 0.0], atol=1e-9)
    reading = device.read(0.6)
    assert reading.efforts[0] > 0.01 > reading.efforts[2]
    assert reading.marker_positions[:, 0].mean() > 0.01


def test_a_speed_of_the_motors_that_is_not_above_zero_is_refused_by_name():
    with pytest.raises(ParameterError, match="device_angle_rate"):
        DeviceFlaws(angle_rate=0.0)
    with pytest.raises(ParameterError, match="device_angle_rate"):
        DeviceFlaws(angle_rate=float("nan"))


def test_the_last_check_names_angles_torques_and_rates_that_are_too_large(simulation):
    gate = CommandGate(simulation.actuator_names, simulation.rest_setpoints, simulation.limits)
    still, torques = np.zeros(4), np.zeros(4)
    assert gate.pass_on(still, torques, 0.02).violated == ()
    assert gate.pass_on([0.02, 0.0, 0.0, 0.0], torques, 0.02).violated == ()
    assert gate.pass_on([0.0, 0.1, 0.0, 0.0], torques, 0.02).violated == ("motor_2.rate",)
    assert gate.pass_on(still, [0.0, 0.0, 0.4, -0.4], 0.02).violated == (
        "motor_4.torque_min", "motor_3.torque_max"
    )  # fmt: skip
    found = gate.pass_on([0.0, 0.0, 0.0, 1.0], torques, 10.0).violated
    assert found == ("motor_4.angle_max",)


def test_negative_angles_that_a_device_measures_are_accepted_within_its_limits(simulation):
    names, limits = simulation.actuator_names, simulation.limits
    device = MeasuredSetpoints(
        ActuatorNames(names), simulation.rest_setpoints, limits, LoopSettings(), ("rad",) * 4
    )

    def take(angles, time):
        now = round((1000.0 + time) * NANOSECONDS)
        return device.accept(names, angles, [], Arrival("", now, now, time))

    assert take([-0.9, 0.9, -0.3, 0.0], 0.0) is None
    assert device.setpoints.tolist() == [-0.9, 0.9, -0.3, 0.0]
    assert take([-1.2, 0.0, 0.0, 0.0], 0.1) is Refusal.OUT_OF_RANGE
    assert (device.implausible.name, device.implausible.unit) == ("motor_1", "rad")


def test_a_motor_with_backlash_turns_back_before_its_strip_follows(simulation):
    play = 0.02
    device = SimulatedDevice(simulation, DeviceFlaws(angle_rate=100.0, backlash=play))
    device.read(0.0)
    time, found = 0.0, []
    for angle in (0.3, 0.3 - 0.5 * play, 0.3 - 1.5 * play):
        device.apply(np.array([angle, 0.0, 0.0, 0.0]), time)
        for _ in range(20):
            time += 0.02
            reading = device.read(time)
        assert reading.setpoints[0] == pytest.approx(angle, abs=1e-12)
        found.append(simulation.state.setpoints[0])
    np.testing.assert_allclose(found, [0.3 - 0.5 * play, 0.3 - 0.5 * play, 0.3 - play], atol=1e-12)


def test_measured_angles_have_their_noise(simulation):
    device = SimulatedDevice(simulation, DeviceFlaws(angle_noise=0.002, seed=3))
    angles = np.array([device.read(0.02 * k).setpoints for k in range(200)])
    np.testing.assert_allclose(angles.std(axis=0), 0.002, rtol=0.2)
    np.testing.assert_allclose(angles.mean(axis=0), 0.0, atol=6e-4)
