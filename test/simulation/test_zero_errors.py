"""Zero errors of winches, motors and regulators, and the frame of the cameras."""

from copy import deepcopy

import numpy as np
import pytest

import softrobot_twin as st
from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.inputs import MarkerInput
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.harness.equilibrium import bring_to_rest
from softrobot_twin.record.rest_poses import poses_of_table
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.scene.schema import MarkerFrame
from softrobot_twin.simulation import Simulation
from test.places import SCENES

OFFSETS = np.array([6e-4, -4e-4, 3e-4, -7e-4])
SHORTENINGS = np.array([0.012, 0.004, 0.010, 0.006])
FRAME = MarkerFrame(position=[0.1, -0.02, 0.3], rotation=[0.2, -0.1, 0.7])


def at_rest(scene, drives):
    simulation = Simulation(scene)
    assert bring_to_rest(simulation, simulation.actuators.setpoints(drives)).is_reached
    return simulation


@pytest.fixture(scope="module")
def diamond():
    return load_scene(SCENES / "diamond.yaml", {"body.mesh.file": "../../meshes/diamond_400.vtk"})


def test_a_zero_error_of_a_winch_is_in_its_length_and_nowhere_else(diamond):
    wrong = changed_scene(diamond, {f"cables[{i}].offset": e for i, e in enumerate(OFFSETS)})
    true, told = at_rest(diamond, SHORTENINGS), at_rest(wrong, SHORTENINGS)
    assert np.allclose(told.state.positions, true.state.positions, rtol=0.0, atol=1e-9)
    assert told.state.setpoints - true.state.setpoints == pytest.approx(OFFSETS, abs=1e-15)
    same_length = at_rest(wrong, SHORTENINGS + OFFSETS)
    assert same_length.state.setpoints == pytest.approx(true.state.setpoints, abs=1e-15)
    assert np.abs(same_length.state.positions - true.state.positions).max() > 1e-4


def test_angles_of_a_pulley_count_from_the_zero_of_its_winch(diamond):
    pulley = {"cables[0].pulley": {"radius": 0.01}}
    true = Simulation(changed_scene(diamond, pulley))
    wrong = Simulation(changed_scene(diamond, pulley | {"cables[0].offset": 1e-3}))
    lengths = true.rest_setpoints - 0.005
    assert wrong.pulleys.angles(lengths) == true.pulleys.angles(lengths) == pytest.approx([0.5])
    assert wrong.pulleys.angles(wrong.rest_setpoints) == pytest.approx([-0.1])


def test_a_zero_error_of_a_hinge_is_in_its_angle_and_nowhere_else():
    strider = load_scene(SCENES / "strider.yaml")
    wrong = Simulation(changed_scene(strider, {"hinge_motors[1].offset": 0.05}))
    true = Simulation(strider)
    own = true.actuators.of_section("hinge_motors")
    assert (wrong.rest_setpoints - true.rest_setpoints)[own] == pytest.approx([0, 0.05, 0, 0])
    assert wrong.actuators.drives(wrong.rest_setpoints)[own].tolist() == [0.0] * 4


WINCH, RADIUS, MOTOR = 1.5e-3, 0.01, 0.1
LOW, SYRINGE = (0.9, 150.0), (1.1, -200.0)
"""Gain and zero [Pa] of what regulates one cavity, and measures the pressure of another."""


@pytest.fixture(scope="module")
def air(air_scene):
    """A robot with a cable on a pulley and cavities by pressure and by volume, and its scene with zero
    errors."""
    scene = deepcopy(air_scene)
    scene["cables"][0]["pulley"] = {"radius": RADIUS}
    wrong = deepcopy(scene)
    wrong["cables"][0]["offset"] = WINCH
    for place, (gain, zero) in ((0, LOW), (2, SYRINGE)):
        wrong["cavities"][place] |= {"pressure_gain": gain, "pressure_offset": zero}
    return st.build(**scene), st.build(**wrong)


@pytest.fixture(scope="module")
def strider():
    """A robot with motors of hinges, and its scene with a zero error."""
    path = SCENES / "strider.yaml"
    return st.load(path), st.load(path, {"hinge_motors[1].offset": MOTOR})


def true_of(regulator, told):
    gain, zero = regulator
    return gain * (told - zero)


COMMANDS = {
    "east_length_m": (0.097, 0.097 - WINCH), "east_shortening_m": (0.004, 0.004),
    "east_angle_rad": (0.35, 0.35 + WINCH / RADIUS),
    "low_pressure_Pa": (1500.0, true_of(LOW, 1500.0)), "high_pressure_Pa": (700.0, 700.0),
    "syringe_volume_m3": (2.2e-6, 2.2e-6), "syringe_growth_m3": (2e-7, 2e-7),
    "east_tension_N": (0.4, 0.4), "syringe_pressure_Pa": (900.0, true_of(SYRINGE, 900.0)),
}  # fmt: skip
"""What is commanded of a robot with zero errors, and what has the same effect without them."""


@pytest.mark.parametrize("name", [*COMMANDS, "low_pressure_Pa as effort"])
def test_what_is_commanded_acts_without_the_zero_error_and_is_told_back(air, name):
    true, wrong = air
    name, _, as_effort = name.partition(" as ")
    told, acts = COMMANDS[name]
    makes = st.efforts if as_effort or name.endswith(("_N", "syringe_pressure_Pa")) else st.setpoints
    for robot in air:
        robot.reset()
    right = true.settle(makes({name: acts}), time_step=1.0)
    result = wrong.settle(makes({name: told}), time_step=1.0)
    assert np.allclose(result.positions, right.positions, rtol=0.0, atol=1e-9)
    assert result[name] == pytest.approx(told, rel=1e-9)
    assert right[name] == pytest.approx(acts, rel=1e-9)


def test_a_table_of_commands_acts_without_zero_errors_and_is_told_back(air):
    true, wrong = air
    names = ["east_angle_rad", "low_pressure_Pa", "high_pressure_Pa", "syringe_volume_m3"]
    rest = {"east_angle_rad": -WINCH / RADIUS, "low_pressure_Pa": LOW[1], "high_pressure_Pa": 0.0,
            "syringe_volume_m3": 2e-6}  # fmt: skip

    def run(robot, which):
        robot.reset()
        ends = {name: COMMANDS[name][which] for name in names}
        begin = rest if which == 0 else dict(rest, east_angle_rad=0.0, low_pressure_Pa=0.0)
        return robot.run({"time_s": [0.0, 1.0], **{name: [begin[name], ends[name]] for name in names}},
                         rate=20)

    told, right = run(wrong, 0), run(true, 1)
    columns = ["top_x_m", "top_y_m", "top_z_m", "syringe_volume_m3", "low_volume_m3"]
    assert np.allclose(told[columns], right[columns], rtol=1e-9, atol=1e-9)
    last = told.iloc[-1]
    assert [last[name] for name in names] == pytest.approx([COMMANDS[one][0] for one in names], rel=1e-9)
    pressure = right["syringe_pressure_Pa"].iloc[-1] / SYRINGE[0] + SYRINGE[1]
    assert last["syringe_pressure_Pa"] == pytest.approx(pressure)
    wrong.reset()
    again = wrong.run(told.copy())  # What a run wrote, given back.
    assert np.allclose(again[columns].iloc[-1], last[columns].to_numpy(float), rtol=1e-6, atol=1e-7)


def test_the_angle_of_a_motor_acts_without_its_zero_error_and_is_told_back(strider):
    true, wrong = strider
    name = f"{wrong.scene.hinge_motors[1].name}_angle_rad"
    for robot in strider:
        robot.reset()
    right = true.settle(st.setpoints({name: 0.15 - MOTOR}), time_step=1.0)
    result = wrong.settle(st.setpoints({name: 0.15}), time_step=1.0)
    assert np.allclose(result.positions, right.positions, rtol=0.0, atol=1e-9)
    assert result[name] == pytest.approx(0.15) and right[name] == pytest.approx(0.15 - MOTOR)


def test_limits_and_rates_are_those_of_what_is_regulated(air):
    """The greatest true pressure is 20 kPa, and what is commanded changes by 20 kPa a second."""
    low, high = air[1].simulation.limits.setpoint_range(air[1].simulation.rest_setpoints)
    place = air[1].simulation.actuator_names.index("low")
    assert [true_of(LOW, end[place]) for end in (low, high)] == pytest.approx([0.0, 2e4], abs=1e-9)
    air[1].reset()
    result = air[1].step(st.setpoints(low_pressure_Pa=high[place]), time_step=0.01)
    assert result["low_pressure_Pa"] == pytest.approx(LOW[1] + 200.0)
    assert "low.rate" in result.active_limits


@pytest.mark.parametrize("key, step", [("pressure_gain", 1e-3), ("pressure_offset", 5.0)])
def test_derivatives_by_what_a_regulator_means_are_those_of_differences(air_scene, key, step):
    def top(value):
        scene = deepcopy(air_scene)
        scene["cavities"][0] |= {"pressure_gain": 0.9, "pressure_offset": 150.0} | {key: value}
        robot = st.build(**scene)
        robot.settle(st.setpoints(low_pressure_Pa=3000.0, east_length_m=0.11 - 0.012), time_step=1.0)
        return robot

    value = {"pressure_gain": 0.9, "pressure_offset": 150.0}[key]
    own = np.array(top(value).sensitivity(f"cavities[0].{key}"))[:, 0]
    ends = [top(value + sign * step).effectors["top"] for sign in (1.0, -1.0)]
    differences = (ends[0] - ends[1]) / (2.0 * step)
    assert np.abs(own - differences).max() < 2e-3 * np.abs(differences).max()


def test_what_a_table_of_poses_tells_is_what_is_commanded(air):
    simulation = air[1].simulation
    rest = simulation.rest_setpoints
    table = {"east_angle_rad": [0.0], "low_pressure_Pa": [500.0], "high_pressure_Pa": [0.0],
             "syringe_growth_m3": [1e-7], "syringe_pressure_Pa": [300.0], "top_x_m": [0.01],
             "top_y_m": [0.01], "top_z_m": [0.1]}  # fmt: skip
    pose = poses_of_table(table, simulation)[0][0]
    assert pose.setpoints == pytest.approx([rest[0] - WINCH, 500.0, 0.0, rest[3] + 1e-7])
    assert pose.efforts[3] == 300.0


def test_messages_tell_what_is_commanded_and_the_robot_has_what_it_means(air):
    simulation = air[1].simulation
    air[1].reset()
    loop = TwinLoop(simulation, LoopSettings(rate=20.0), mode=Mode.DIRECT, ambient_pressure=1e5)
    now = [0.0]

    def tick(count=30):
        for _ in range(count):
            outcome = loop.tick(now[0], 10**9 + round(now[0] * 1e9))
            now[0] += 0.05
        return outcome.command

    def arrival():
        stamp = 10**9 + round(now[0] * 1e9)
        return Arrival("base_link", stamp, stamp, now[0])

    told = simulation.actuators.told_efforts
    assert loop.pressures.accept("low", 1e5 + 1500.0, arrival()) is None
    sent = tick()
    assert sent.setpoints[1] == pytest.approx(1500.0)
    assert sent.efforts[1] == pytest.approx(true_of(LOW, 1500.0))
    assert loop.cavities.absolute(told(sent.efforts))["low"] == pytest.approx(101500.0)
    names = ("east", "low", "high", "syringe")
    assert loop.direct.accept(names, [0.098, 600.0, 0.0, 2e-6], [], arrival()) is None
    assert tick().setpoints == pytest.approx([0.098, 600.0, 0.0, 2e-6])
    assert loop.direct.accept(("east", "low", "syringe"), [], [0.1, 600.0, 400.0], arrival()) is None
    sent = tick(60)
    assert told(sent.efforts)[[1, 3]] == pytest.approx([600.0, 400.0], rel=1e-4)
    assert sent.efforts[[1, 3]] == pytest.approx([true_of(LOW, 600.0), true_of(SYRINGE, 400.0)], rel=1e-4)


def test_a_simulated_device_measures_what_is_commanded_and_has_what_it_means(air):
    true, wrong = air
    ends = []
    for robot, pressure, length in ((true, true_of(LOW, 1500.0), 0.097 - WINCH), (wrong, 1500.0, 0.097)):
        robot.reset()
        device = SimulatedDevice(robot.simulation, DeviceFlaws(valve_lag=0.05), 1e5)
        wanted = np.array(robot.simulation.rest_setpoints)
        wanted[:2] = length, pressure
        device.read(0.0)
        device.apply(wanted, 0.0)
        for moment in range(1, 60):
            reading = device.read(0.05 * moment)
        assert reading.setpoints[:2] == pytest.approx([length, pressure], rel=1e-3)
        assert reading.efforts[1] == reading.setpoints[1]
        ends.append(reading)
    assert np.allclose(ends[0].effector_positions, ends[1].effector_positions, atol=1e-6)
    assert ends[1].efforts[3] == pytest.approx(ends[0].efforts[3] / SYRINGE[0] + SYRINGE[1], abs=0.5)


def test_the_frame_of_the_cameras_turns_and_moves_what_they_see():
    points = np.random.default_rng(3).normal(size=(5, 3))
    assert np.allclose(FRAME.of_cameras(FRAME.of_robot(points)), points, atol=1e-15)
    assert FRAME.of_robot(np.zeros(3)) == pytest.approx(FRAME.position)
    turned = MarkerFrame(rotation=[0.5 * np.pi, 0.0, 0.5 * np.pi])
    assert np.allclose(turned.of_robot(np.array([0.0, 1.0, 0.0])), [0.0, 0.0, 1.0])
    assert MarkerFrame().of_robot(points) is points


def test_measured_markers_come_to_the_loop_in_the_frame_of_the_robot():
    markers = MarkerInput(np.array([4, 2], np.uint32), "base", LoopSettings(), FRAME.of_robot)
    points = np.array([[0.0, 0.1, 0.2], [0.3, np.nan, 0.1]])
    assert markers.accept(np.array([2, 4], np.uint32), FRAME.of_cameras(points),
                          Arrival("base", 10**9, 10**9, 1.0)) is None  # fmt: skip
    assert markers.positions[1] == pytest.approx(points[0])
    assert np.isnan(markers.positions[0]).all()
