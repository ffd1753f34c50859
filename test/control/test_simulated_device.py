"""The simulated device: servos, delay, noise and flaws."""

import numpy as np
import pytest

from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.errors import ParameterError

STEP = 0.02


def played(device, asked, duration):
    """Lengths at every reading under one constant command, shape (n, actuator_count)."""
    times = np.arange(0.0, duration, STEP)
    device.read(0.0)
    device.apply(asked, 0.0)
    return times[1:], np.array([device.read(time).setpoints for time in times[1:]])


@pytest.fixture
def rest(simulation):
    return simulation.rest_setpoints


def test_servos_move_to_a_command_within_their_rate(simulation, rest):
    device = SimulatedDevice(simulation, DeviceFlaws(servo_rate=0.02))
    _, lengths = played(device, rest - 0.002, 0.2)
    moved = np.abs(np.diff(np.vstack([rest, lengths]), axis=0))
    assert moved.max() <= 0.02 * STEP + 1e-9
    assert lengths[-1] == pytest.approx(rest - 0.002, abs=1e-7)


def test_a_command_takes_effect_after_the_delay(simulation, rest):
    device = SimulatedDevice(simulation, DeviceFlaws(delay=0.05, servo_rate=1.0))
    times, lengths = played(device, rest - 0.0005, 0.2)
    moved = np.abs(lengths - rest).max(axis=1) > 1e-6
    assert not moved[times < 0.049].any()
    assert moved[times >= 0.061].all()


def test_delayed_commands_keep_their_order(simulation, rest):
    device = SimulatedDevice(simulation, DeviceFlaws(delay=0.1, servo_rate=1.0))
    device.read(0.0)
    for tick in range(10):
        device.apply(rest - 0.0001 * tick, tick * STEP)
        reading = device.read(tick * STEP)
    assert reading.setpoints == pytest.approx(rest - 0.0001 * 4, abs=1e-7)


def test_noise_has_the_given_deviation_and_repeats_for_a_seed(simulation, rest):
    def markers(noise, seed):
        simulation.reset()
        device = SimulatedDevice(simulation, DeviceFlaws(marker_noise=noise, seed=seed))
        return np.array([device.read(0.0).marker_positions for _ in range(40)])

    exact, noisy = markers(0.0, 1), markers(0.0002, 1)
    assert (noisy - exact).std() == pytest.approx(0.0002, rel=0.1)
    assert np.array_equal(noisy, markers(0.0002, 1))
    assert not np.array_equal(noisy, markers(0.0002, 2))


@pytest.mark.parametrize("command", [[np.nan] * 4, [0.08] * 3, [np.inf, 0.08, 0.08, 0.08]])
def test_an_invalid_command_changes_nothing_and_is_counted(simulation, rest, command):
    device = SimulatedDevice(simulation, DeviceFlaws())
    _, lengths = played(device, np.array(command), 0.1)
    assert lengths == pytest.approx(np.tile(rest, (len(lengths), 1)), abs=1e-9)
    assert device.refused == 1


def test_a_servo_stops_at_the_limits_of_its_own_body(simulation, rest):
    device = SimulatedDevice(simulation, DeviceFlaws(servo_rate=10.0))
    _, lengths = played(device, rest + 0.05, 0.1)
    assert lengths.max() <= rest.max() + 1e-7


def test_a_step_of_zero_or_negative_time_moves_nothing(simulation, rest):
    device = SimulatedDevice(simulation, DeviceFlaws(servo_rate=0.02))
    device.apply(rest - 0.001, 0.0)
    device.read(1.0)
    assert device.read(1.0).setpoints.tolist() == rest.tolist()
    assert device.read(0.5).setpoints.tolist() == rest.tolist()


@pytest.mark.parametrize(
    ("flaws", "name"),
    [
        ({"delay": -0.1}, "device_delay"),
        ({"servo_rate": 0.0}, "device_servo_rate"),
        ({"marker_noise": float("nan")}, "device_marker_noise"),
    ],
)
def test_impossible_flaws_are_refused_by_parameter(flaws, name):
    with pytest.raises(ParameterError) as raised:
        DeviceFlaws(**flaws)
    assert raised.value.name == name


def test_a_body_with_inertia_does_not_move_in_zero_time(grasper):
    device = SimulatedDevice(grasper, DeviceFlaws())
    reading = device.read(0.0)
    assert device.result is None and reading.setpoints == pytest.approx(grasper.rest_setpoints)
    device.read(STEP)
    device.read(STEP)
    assert grasper.state.time == pytest.approx(STEP)


def test_a_guided_body_moves_to_its_pose_after_the_delay(grasper):
    device = SimulatedDevice(grasper, DeviceFlaws(delay=0.05))
    device.read(0.0)
    device.apply_pose("palm", np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.0, 0.0, 1.0]), 0.0)
    heights = []
    for time in np.arange(1, 20) * STEP:
        device.read(time)
        heights.append(device.rigid_poses()[0][0, 2])
    assert heights[:2] == [0.0, 0.0]
    # 50 mm/s, as the scene says.
    assert np.diff(heights)[2:9] == pytest.approx(0.05 * STEP, abs=1e-9)
    assert heights[-1] == pytest.approx(0.01, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "position", "quaternion"),
    [("cube", [0, 0, 0], [0, 0, 0, 1]), ("palm", [0, 0, np.nan], [0, 0, 0, 1]),
     ("palm", [0, 0, 0.1], [0, 0, 0, 0])],
)
def test_an_invalid_pose_moves_nothing_and_is_counted(grasper, name, position, quaternion):
    device = SimulatedDevice(grasper, DeviceFlaws())
    device.read(0.0)
    device.apply_pose(name, np.array(position), np.array(quaternion), 0.0)
    device.read(STEP)
    assert device.refused == 1
    assert device.rigid_poses()[0][0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_dynamic_device_in_contact_follows_and_holds_its_lengths(grasper):
    device = SimulatedDevice(grasper, DeviceFlaws(servo_rate=0.1))
    rest = grasper.rest_setpoints
    _, lengths = played(device, rest - 0.010, 1.0)
    # The body's own limit of 20 mm/s is slower than the servo.
    assert np.abs(np.diff(lengths, axis=0)).max() <= 0.02 * STEP + 1e-6
    assert lengths[-1] == pytest.approx(rest - 0.010, abs=1e-6)
