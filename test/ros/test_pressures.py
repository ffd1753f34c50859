"""Cavities over ROS: absolute pressures on topics of their own."""

import math

import pytest
from rcl_interfaces.msg import Log
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Header

from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.twin_node import TwinNode
from test.builder import builder
from test.scene_changes import yaml_file


AIR = 101325.0
NAMES = ["east", "low", "high", "syringe"]
CAVITIES = ("low", "high", "syringe")
LOW, HIGH = 1, 2


@pytest.fixture(scope="session")
def air_file(air_scene, tmp_path_factory):
    return yaml_file(tmp_path_factory.mktemp("scenes") / "air.yaml", air_scene)


@builder
def make_air(world, air_file, /, **parameters):
    """Makes a twin of the block with cavities."""
    defaults = {"scene_file": str(air_file), "rate": 50.0, "mode": "direct"}
    return world.add(TwinNode, **{**defaults, **parameters})


@builder
def make_device(world, air_file, /, **parameters):
    defaults = {"device_scene_file": str(air_file), "device_rate": 50.0}
    return world.add(DeviceNode, **{**defaults, **parameters})


def pressure_of(world, pressure, seconds_ago=0.0, frame_id="base_link"):
    header = Header(stamp=world.stamp(seconds_ago), frame_id=frame_id)
    return FluidPressure(header=header, fluid_pressure=float(pressure))


def stamp_of(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def test_pressures_are_published_absolute_with_the_stamp_of_all_actuators(world, make_air):
    make_air(ambient_pressure=9e4)
    cables = world.hear(JointState, "/twin/cables", 100)
    heard = {name: world.hear(FluidPressure, f"/twin/pressures/{name}", 100) for name in CAVITIES}
    command = world.speaker(FluidPressure, "/twin/command/pressures/low")
    command.publish(pressure_of(world, 9e4 + 2000.0))
    world.until(lambda: cables and math.isclose(cables[-1].position[LOW], 2000.0, rel_tol=1e-9))
    world.until(lambda: math.isclose(heard["low"][-1].fluid_pressure, 9.2e4, rel_tol=1e-9))
    for name in CAVITIES:
        by_stamp = {stamp_of(message): message for message in heard[name]}
        both = [(m, by_stamp[stamp_of(m)]) for m in cables if stamp_of(m) in by_stamp]
        assert len(both) > 3
        for joints, pressure in both:
            gauge = joints.effort[NAMES.index(name)]
            assert pressure.fluid_pressure == pytest.approx(9e4 + gauge, rel=1e-12)
            assert pressure.variance == 0.0 and pressure.header.frame_id == "base_link"
    assert list(cables[-1].name) == NAMES
    # Of a regulated cavity both values are its gauge pressure.
    assert cables[-1].position[LOW] == cables[-1].effort[LOW]
    assert cables[-1].position[3] == pytest.approx(2e-6)


def test_a_volume_is_not_commanded_by_a_pressure_and_the_log_says_what_does(world, make_air):
    twin = make_air()
    told = world.hear(Log, "/rosout")
    world.until(lambda: told or twin.get_logger().info("is this heard?"))
    command = world.speaker(FluidPressure, "/twin/command/pressures/syringe")
    command.publish(pressure_of(world, AIR + 1000.0))
    world.until(lambda: any("syringe: refused" in message.msg for message in told))
    line = next(message.msg for message in told if "syringe: refused" in message.msg)
    assert line == (
        "/twin/command/pressures/syringe: refused, volume_controlled: the scene controls this cavity "
        "by volume: command its volume [m³] on ~/command/cables"
    )
    assert twin.loop.direct.setpoints is None


def test_the_pressure_of_sealed_gas_is_published_in_every_state(world, air_scene, tmp_path):
    low, high, syringe = air_scene["cavities"]
    sealed = {"name": "gas", "walls": high["walls"], "pressure": 500.0}
    file = yaml_file(tmp_path / "sealed.yaml", {**air_scene, "cavities": [low, syringe], "sealed_cavities": [sealed]})
    world.add(TwinNode, scene_file=str(file), rate=50.0, mode="direct", use_device=True)
    gas = world.hear(FluidPressure, "/twin/pressures/gas")
    world.until(lambda: len(gas) > 2)
    # It expands a little from the pressure at rest.
    assert AIR + 200.0 < gas[-1].fluid_pressure < AIR + 500.1


# --- device --------------------------------------------------------------------------------------


def test_the_device_measures_absolute_pressures_with_their_variance(world, make_device):
    make_device(ambient_pressure=9e4, device_pressure_noise=10.0)
    cables = world.hear(JointState, "/twin/measured_cables", 100)
    heard = {
        name: world.hear(FluidPressure, f"/twin/measured_pressures/{name}", 100)
        for name in CAVITIES
    }
    world.until(lambda: min(map(len, (cables, *heard.values()))) > 4)
    for name in CAVITIES:
        by_stamp = {stamp_of(message): message for message in heard[name]}
        both = [(m, by_stamp[stamp_of(m)]) for m in cables if stamp_of(m) in by_stamp]
        assert both
        for joints, pressure in both:
            gauge = joints.effort[NAMES.index(name)]
            assert pressure.fluid_pressure == pytest.approx(9e4 + gauge, rel=1e-12)
            assert pressure.variance == 100.0


def test_a_device_follows_the_pressures_of_its_twin(world, make_air, make_device):
    """The twin is enabled from what is measured, and the device comes to the pressure."""
    # On a busy machine messages come late.
    patient = {"message_timeout": 20.0}
    device = make_device(device_pressure_noise=5.0, **patient)
    twin = make_air(use_device=True, device_timeout=20.0, **patient)
    heard = world.hear(FluidPressure, "/twin/measured_pressures/low", 100)
    world.until(lambda: twin.loop.device.setpoints is not None)
    world.until(lambda: twin.loop.enable(twin.monotonic())[0])
    commands = world.hear(FluidPressure, "/twin/pressures/low")
    world.until(lambda: commands)
    command = world.speaker(FluidPressure, "/twin/command/pressures/low")
    command.publish(pressure_of(world, AIR + 3000.0))
    world.until(lambda: heard and abs(heard[-1].fluid_pressure - AIR - 3000.0) < 40.0)
    assert device.device.refused == 0 and device.refusals.total == 0
    assert twin.loop.device.refusals.total == 0


# --- hostile messages ----------------------------------------------------------------------------
