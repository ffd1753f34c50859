"""The simulated device: servos, delay, noise and flaws."""

import numpy as np
import pytest

from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.errors import ParameterError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation

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


def test_noise_has_the_given_deviation_and_repeats_for_a_seed(simulation, rest):
    def markers(noise, seed):
        simulation.reset()
        device = SimulatedDevice(simulation, DeviceFlaws(marker_noise=noise, seed=seed))
        return np.array([device.read(0.0).marker_positions for _ in range(40)])

    exact, noisy = markers(0.0, 1), markers(0.0002, 1)
    assert (noisy - exact).std() == pytest.approx(0.0002, rel=0.1)
    assert np.array_equal(noisy, markers(0.0002, 1))
    assert not np.array_equal(noisy, markers(0.0002, 2))


def test_winches_hold_the_commanded_tensions_after_the_delay_in_place_of_lengths(simulation, rest):
    device = SimulatedDevice(simulation, DeviceFlaws(delay=0.05), follows="efforts")
    tensions = np.array([2.0, 1.8, 2.2, 1.8])
    device.read(0.0)
    device.apply(tensions, 0.0)
    early, *_, late = [device.read(time) for time in np.arange(STEP, 1.0, STEP)]
    # Before, the weight pulls at cables whose limits do not let them become longer.
    assert early.setpoints == pytest.approx(rest, abs=1e-9)
    assert late.efforts == pytest.approx(tensions, rel=1e-6)
    assert (late.setpoints < rest - 1e-4).all()


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


@pytest.mark.parametrize("flaws, name", [
    ({"delay": -0.1}, "device_delay"),
    ({"servo_rate": 0.0}, "device_servo_rate"),
    ({"marker_noise": float("nan")}, "device_marker_noise"),
    ({"valve_lag": -0.1}, "device_valve_lag"), ({"leak": -1e-12}, "device_leak"),
    ({"flow_limit": 0.0}, "device_flow_limit"),
    ({"pressure_noise": float("inf")}, "device_pressure_noise"),
])  # fmt: skip
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


@pytest.mark.parametrize("name, position, quaternion", [
    ("cube", [0, 0, 0], [0, 0, 0, 1]), ("palm", [0, 0, np.nan], [0, 0, 0, 1]),
    ("palm", [0, 0, 0.1], [0, 0, 0, 0]),
])  # fmt: skip
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


# --- cavities ------------------------------------------------------------------------------------

AIR = 101325.0
LOW, HIGH, SYRINGE = 1, 2, 3


@pytest.fixture
def quick_air(air_scene):
    """Makes the block with cavities, whose scene limits no rates; only the valves do."""
    scene = {**air_scene, "cavities": [dict(entry) for entry in air_scene["cavities"]]}
    for entry in scene["cavities"]:
        del entry["rate"]
    simulation = Simulation(scene_from_mapping(scene))
    simulation.warm_up()
    return simulation


def gas_of(device, simulation):
    """Product of absolute pressure and volume of the first two cavities [J], shape (2,)."""
    both = [LOW, HIGH]
    volumes = simulation.limits.displacement_scale[both]
    if device.result is not None:
        volumes = volumes + device.result.displacements[both]
    return (AIR + simulation.state.setpoints[both]) * volumes


def test_a_regulator_follows_with_a_first_order_lag(quick_air):
    device = SimulatedDevice(quick_air, DeviceFlaws(valve_lag=0.1, flow_limit=1.0))
    asked = quick_air.rest_setpoints + [0.0, 4000.0, -1000.0, 0.0]
    times, setpoints = played(device, asked, 0.5)
    grown = 1.0 - np.exp(-times / 0.1)
    assert setpoints[:, LOW] == pytest.approx(4000.0 * grown, rel=1e-6)
    assert setpoints[:, HIGH] == pytest.approx(-1000.0 * grown, rel=1e-6)


def test_a_leak_keeps_a_regulator_with_a_lag_below_its_command(quick_air):
    """T / (T + τ) of it, with T = (V + p C) / (p_ambient G)."""
    leak, lag = 1.0e-10, 0.1
    device = SimulatedDevice(quick_air, DeviceFlaws(valve_lag=lag, flow_limit=1.0, leak=leak))
    asked = quick_air.rest_setpoints + [0.0, 4000.0, 0.0, 0.0]
    _, setpoints = played(device, asked, 2.0)
    held = setpoints[-1, LOW]
    volumes, pressures = [], (held - 50.0, held + 50.0)
    for pressure in pressures:
        result = quick_air.step(CommandSetpoints(
            quick_air.rest_setpoints + [0.0, pressure, 0.0, 0.0], 1e3))
        volumes.append(quick_air.limits.displacement_scale[LOW] + result.displacements[LOW])
    compliance = np.diff(volumes)[0] / 100.0
    time = (np.mean(volumes) + (AIR + held) * compliance) / (AIR * leak)
    assert held == pytest.approx(4000.0 * time / (time + lag), rel=0.02) and held < 3700.0


def test_a_leak_that_takes_all_the_flow_keeps_the_pressure_from_rising(quick_air):
    """At Q / G as much leaks as flows in; without supply, the pressure falls to nothing."""
    flow, leak = 1e-6, 5e-10
    device = SimulatedDevice(quick_air, DeviceFlaws(flow_limit=flow, leak=leak))
    asked = quick_air.rest_setpoints + [0.0, 8000.0, 0.0, 0.0]
    _, setpoints = played(device, asked, 6.0)
    assert setpoints[-1, LOW] == pytest.approx(flow / leak, rel=0.02)


@pytest.mark.parametrize("pressure", [8000.0, -4000.0])
def test_the_gas_that_flows_into_and_out_of_a_soft_cavity_is_limited(quick_air, pressure):
    limit = 1e-6
    device = SimulatedDevice(quick_air, DeviceFlaws(flow_limit=limit))
    device.read(0.0)
    place = LOW if pressure > 0.0 else HIGH
    asked = quick_air.rest_setpoints.copy()
    asked[place] = pressure
    device.apply(asked, 0.0)
    gas, flows = [gas_of(device, quick_air)], []
    for number in range(1, 200):
        device.read(number * STEP)
        gas.append(gas_of(device, quick_air))
        flows.append(np.abs(gas[-1] - gas[-2])[place - LOW] / AIR / STEP)
        if device.read(number * STEP).setpoints[place] == pytest.approx(pressure, rel=1e-9):
            break
    assert quick_air.state.setpoints[place] == pytest.approx(pressure, rel=1e-9)
    # Of a step the compliance at its beginning is known.
    assert max(flows) <= 1.05 * limit
    assert np.mean(flows[:-1]) >= 0.9 * limit
    # Were it rigid, it would be there in less than half the time.
    assert len(flows) * limit * STEP * AIR > 2.0 * abs(pressure) * 2e-6


def test_a_syringe_moves_as_fast_as_its_limit_of_flow(quick_air):
    device = SimulatedDevice(quick_air, DeviceFlaws(valve_lag=0.5, flow_limit=1e-6))
    asked = quick_air.rest_setpoints + [0.0, 0.0, 0.0, 3e-7]
    _, setpoints = played(device, asked, 0.5)
    moved = np.diff(setpoints[:, SYRINGE], prepend=2e-6)
    assert moved.max() == pytest.approx(1e-6 * STEP, rel=1e-9)
    assert setpoints[-1, SYRINGE] == pytest.approx(2.3e-6, rel=1e-9)


def test_sensors_of_pressure_are_noisy_and_repeat_for_a_seed(quick_air):
    def readings(noise, seed):
        quick_air.reset()
        device = SimulatedDevice(quick_air, DeviceFlaws(pressure_noise=noise, seed=seed))
        return [device.read(0.0) for _ in range(200)]

    noisy = readings(30.0, 1)
    efforts = np.array([reading.efforts for reading in noisy])
    setpoints = np.array([reading.setpoints for reading in noisy])
    exact = readings(0.0, 1)[0]
    assert (efforts - exact.efforts)[:, [LOW, HIGH, SYRINGE]].std(axis=0) == pytest.approx(
        [30.0] * 3, rel=0.2
    )
    # The regulated pressure is what its sensor says; length and volume have encoders.
    assert np.array_equal(setpoints[:, [LOW, HIGH]], efforts[:, [LOW, HIGH]])
    assert (setpoints[:, [0, SYRINGE]] == exact.setpoints[[0, SYRINGE]]).all()
    assert np.array_equal(efforts, [reading.efforts for reading in readings(30.0, 1)])
    assert not np.array_equal(efforts, [reading.efforts for reading in readings(30.0, 2)])
