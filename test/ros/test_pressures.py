"""Cavities over ROS: absolute pressures on topics of their own."""

import math

import numpy as np
import pytest
import yaml
from rcl_interfaces.msg import Log
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Header
from std_srvs.srv import SetBool, Trigger

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.node_help import help_of
from softrobot_twin.ros.twin_node import TwinNode
from softrobot_twin.view.recording import CAN_SERVE
from test.builder import builder

UNNUMBERED = {"publication_sequence_number": None}
"""What rclpy tells of a message: by this, all are of one publisher."""

AIR = 101325.0
NAMES = ["east", "low", "high", "syringe"]
CAVITIES = ("low", "high", "syringe")
LOW, HIGH = 1, 2


@pytest.fixture(scope="session")
def air_file(air_scene, tmp_path_factory):
    file = tmp_path_factory.mktemp("scenes") / "air.yaml"
    file.write_text(yaml.safe_dump(air_scene))
    return file


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


def test_refused_pressures_are_counted_in_the_diagnostics(world, make_air, diagnostics):
    make_air()
    command = world.speaker(FluidPressure, "/twin/command/pressures/low")
    command.publish(pressure_of(world, math.nan))
    target = diagnostics("target", lambda status: status.level == b"\x01")
    assert target.message == "1 messages refused"
    assert target.values["refused_not_finite"] == "1"
    command.publish(pressure_of(world, 3000.0))
    limits = diagnostics("limits", lambda status: "pressure_min" in status.message)
    assert "low.pressure_min" in limits.message
    assert limits.values["pressure_limits_pa: low"] == "0 20000"
    assert float(limits.values["pressure_pa: low"]) == pytest.approx(0.0, abs=1e-6)
    assert limits.values["ambient_pressure_pa"] == "101325"


def test_the_ambient_pressure_cannot_change_while_a_twin_runs(world, make_air):
    twin = make_air()
    assert twin.describe_parameter("ambient_pressure").read_only
    with pytest.raises(ParameterError, match="below vacuum"):
        make_air(ambient_pressure=4000.0)


def test_a_second_publisher_of_a_measured_pressure_keeps_the_twin_disabled(world, make_air):
    make_air(use_device=True)
    topic = "/twin/measured_pressures/low"
    world.speaker(FluidPressure, topic)
    world.speaker(FluidPressure, topic)
    answer = world.ask(SetBool, "/twin/enable", SetBool.Request(data=True))
    assert not answer.success and f"2 publishers on {topic}" in answer.message


def test_the_pressure_of_sealed_gas_is_published_in_every_state(world, air_scene, tmp_path):
    low, high, syringe = air_scene["cavities"]
    sealed = {"name": "gas", "walls": high["walls"], "pressure": 500.0}
    file = tmp_path / "sealed.yaml"
    file.write_text(yaml.safe_dump(
        {**air_scene, "cavities": [low, syringe], "sealed_cavities": [sealed]}
    ))
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


def test_a_twin_starts_from_pressures_that_only_their_sensors_measure(world, make_air):
    twin = make_air(use_device=True, device_timeout=5.0)
    cables = world.hear(JointState, "/twin/cables", 100)
    others = world.speaker(JointState, "/twin/measured_cables")
    others.publish(JointState(header=Header(stamp=world.stamp()), name=["east", "syringe"],
                              position=[0.1, 2e-6]))
    world.speaker(FluidPressure, "/twin/measured_pressures/low").publish(
        pressure_of(world, AIR + 1500.0, frame_id="sensor_3"))
    world.until(lambda: np.isfinite(twin.loop.device.arrived[[0, 1, 3]]).all())
    refused = world.ask(SetBool, "/twin/enable", SetBool.Request(data=True))
    assert refused.message == "no measured setpoints of high arrive to start from"
    world.speaker(FluidPressure, "/twin/measured_pressures/high").publish(
        pressure_of(world, AIR - 700.0, frame_id=""))
    world.until(lambda: twin.loop.device.setpoints is not None)
    assert world.ask(SetBool, "/twin/enable", SetBool.Request(data=True)).success
    world.until(lambda: cables)
    assert list(cables[0].position) == pytest.approx([0.1, 1500.0, -700.0, 2e-6], abs=1.5)


# --- hostile messages ----------------------------------------------------------------------------

NUMBERS = (0.0, -0.0, math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -AIR, 1.0, 1e6)


class Witness:
    """Replaces the publishers of a twin, and checks every command."""

    def __init__(self, twin):
        self._limits = twin.loop.simulation.limits
        self._rest = np.array(twin.loop.simulation.rest_setpoints)
        self._low, self._high = self._limits.setpoint_range(self._rest)
        self._reach = self._limits.rate * twin.loop.settings.period
        self._slack = 1e-9 * np.maximum(1.0, self._limits.drive_scale)
        self._last, self.count, self.pressures = self._rest, 0, {}
        twin.cables.publish = self.judge
        for name, publisher in twin.pressures.items():
            publisher.publish = lambda message, name=name: self.judge_pressure(name, message)

    def judge(self, message):
        message = deserialize_message(message, JointState)
        setpoints = np.array(message.position)
        assert np.isfinite(setpoints).all() and np.isfinite(message.effort).all()
        assert (np.abs(setpoints - self._last) <= self._reach + self._slack).all()
        assert (setpoints >= self._low - self._slack).all()
        assert (setpoints <= self._high + self._slack).all()
        self._last, self.count = setpoints, self.count + 1

    def judge_pressure(self, name, message):
        pressure = deserialize_message(message, FluidPressure).fluid_pressure
        assert math.isfinite(pressure) and pressure > 0.0
        index = NAMES.index(name)
        if name != "syringe":
            # All actuators come first.
            assert pressure - AIR == pytest.approx(self._last[index], abs=1e-6)
        self.pressures[name] = self.pressures.get(name, 0) + 1


@pytest.mark.parametrize("mode", ["direct", "inverse"])
def test_no_pressure_causes_an_unsafe_command(world, make_air, mode):
    """A flood of arbitrary messages and service calls between ticks."""
    seed = int(np.random.SeedSequence().entropy % 2**32)
    print(f"seed {seed}")
    draw = np.random.default_rng(seed)
    twin = make_air(mode=mode)
    twin.stop()
    witness = Witness(twin)
    ends = [entry for entry in twin.subscriptions if entry.msg_type is FluidPressure]
    assert len(ends) == 6
    if mode == "inverse":
        arrival = twin.arrival(world.target_message((0.01, 0.01, 0.101)).header)
        assert twin.loop.targets.accept_point(0, (0.01, 0.01, 0.101), arrival) is None
    for tick in range(100):
        for _ in range(20 if tick % 50 else 300):
            pressure = AIR + draw.uniform(-1e4, 3e4)
            if draw.random() < 0.4:
                pressure = float(draw.choice(NUMBERS))
            frame = "base_link" if draw.random() < 0.8 else "map"
            ago = 0.0 if draw.random() < 0.8 else float(draw.choice([-3600.0, 0.01, 5.0]))
            message = pressure_of(world, pressure, ago, frame)
            ends[draw.integers(len(ends))].callback(serialize_message(message), UNNUMBERED)
        if draw.random() < 0.03:
            twin.reset(Trigger.Request(), Trigger.Response())
        if draw.random() < 0.05:
            twin.enable(SetBool.Request(data=bool(draw.random() < 0.6)), SetBool.Response())
        elif draw.random() < 0.2:
            twin.loop.enable(twin.monotonic())
        twin.tick()
        # An exception, also one of the checks in the publishers, ends only the tick.
        assert twin.failed_ticks == 0, twin.failure
    assert witness.count > 50 and witness.pressures.keys() == set(CAVITIES)
    refusals = (twin.loop.direct if mode == "direct" else twin.loop.selected).refusals
    for refusal in (Refusal.NOT_FINITE, Refusal.BELOW_VACUUM, Refusal.WRONG_FRAME, Refusal.STALE,
                    Refusal.FROM_THE_FUTURE, Refusal.OUT_OF_ORDER, Refusal.VOLUME_CONTROLLED):
        assert refusals.of(refusal) > 0, refusal


def test_the_help_of_the_nodes_states_units_of_pressure_topics():
    twin, device = help_of("twin"), help_of("device")
    for topic in ("~/pressures/<cavity>", "~/command/pressures/<cavity>",
                  "~/measured_pressures/<cavity>"):
        line = next(line for line in twin.splitlines() if f" {topic} " in line)
        assert "sensor_msgs/FluidPressure" in line and "Pa, absolute" in line
    assert "<twin>/measured_pressures/<cavity>" in device
    assert "ambient_pressure (default 101325.0 Pa)" in twin


@pytest.mark.skipif(not CAN_SERVE, reason="this rerun cannot read its files")
def test_a_recording_shows_walls_pressures_and_volumes_of_cavities(world, make_air, tmp_path):
    file = tmp_path / "run.rrd"
    twin = make_air(record_file=str(file), record_every=1, view_every=1)
    twin.stop()
    for _ in range(3):
        twin.tick()
        world.until(lambda: twin.feed.mirror.frames_logged == twin.tick_clock.ticks)
    simulation = twin.loop.simulation
    walls = simulation.cavity_positions()[LOW]
    volumes = simulation.cavities.volumes(simulation.state)
    twin.destroy_node()
    from rerun.chunk import RrdReader

    chunks = RrdReader(file).stream().to_chunks()

    def last(entity, component):
        batches = [chunk.to_record_batch() for chunk in chunks
                   if chunk.entity_path == entity and not chunk.is_static]
        cells = {step: cell for batch in batches if component in batch.schema.names
                 for step, cell in zip(batch.column("step").to_pylist(),
                                       batch.column(component).to_pylist())}
        return np.array(cells[max(cells)])

    names = [skin.name for skin in simulation.cavities.skins]
    assert set(CAVITIES) <= set(names)
    drawn = last(f"/robot/cavities/{names[LOW]}", "Mesh3D:vertex_positions")
    np.testing.assert_allclose(drawn, walls, atol=1e-7)
    shown = last("/plots/cavity_volumes", "Scalars:scalars")
    np.testing.assert_allclose(shown, 1e6 * volumes, rtol=1e-6)
    assert len(last("/plots/cavity_pressures", "Scalars:scalars")) == len(names)
    # Slides and motors have curves of their own, cavities are not drawn twice.
    assert "/plots/actuators" not in {chunk.entity_path for chunk in chunks}
