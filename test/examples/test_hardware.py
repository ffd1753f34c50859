"""The bus of servos of the hardware example: packets, units, and what is safe."""

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "hardware"
sys.path.insert(0, str(FOLDER))

import servo_bus as bus_module  # noqa: E402
from device_file import DeviceFileError  # noqa: E402
from servo_bus import (  # noqa: E402
    BusError,
    BusTimeout,
    ChecksumError,
    HardwareAlert,
    PacketReader,
    SerialPort,
    ServoBus,
    ServoError,
    crc16,
    packet,
)
from servos import (  # noqa: E402
    HARDWARE_ERROR,
    OPERATING_MODE,
    TICKS_PER_TURN,
    WATCHDOG,
    Servo,
    ServoDevice,
    read_servos,
)
from simulated_servos import MODEL, SimulatedBus, SimulatedServo, Terminal  # noqa: E402
from test.scene_changes import change_scene, yaml_file

REST = 0.1


def description(file="servos.yaml", **changes):
    """The servos of an example's file, at a rate that a pseudo-terminal need not have."""
    return read_servos(FOLDER / file)._replace(
        **{"baud_rate": 115200, "answer_time": 1.0} | changes
    )


class Wired:
    """A device on simulated servos, through a pseudo-terminal.

    Attributes:
        now: The time of the servos [s]: it stands still but where a test moves it, so that a busy
            machine changes nothing.
    """

    def __init__(self, **changes):
        described, self.now = description(**changes), 0.0
        self.servos = {one.id: SimulatedServo(one.zero_ticks, 40960.0, lambda: self.now)
                       for one in described.servos}  # fmt: skip
        self.bus = SimulatedBus(self.servos)
        self.terminal = Terminal(self.bus)
        self.described = described._replace(port=self.terminal.path)
        self.devices = []

    def device(self):
        self.devices.append(ServoDevice(self.described))
        return self.devices[-1]

    def wait(self, device, seconds):
        """Lets time pass, once the servos have done what was sent to them."""
        device.bus.ping(1)
        self.now += seconds

    def follow(self, device, lengths):
        """Commands and measures until the servos are there; returns the last reading."""
        for _ in range(500):
            self.now += 0.02
            device.apply(lengths, self.now)
            reading = device.read(self.now)
            ticks = [abs(one.by_tick) for one in device.description.servos]
            if (np.abs(reading.setpoints - lengths) < np.maximum(ticks, 1e-4)).all():
                return reading
        raise AssertionError(f"not there: {reading.setpoints - lengths}, {device.trouble}")

    def close(self):
        self.bus.silent.clear()
        for device in self.devices:
            device.close()
        self.terminal.close()


@pytest.fixture
def wired():
    wired = Wired()
    yield wired
    wired.close()


@pytest.fixture
def wired_hinges():
    wired = Wired(file="emio_servos.yaml")
    yield wired
    wired.close()


def rest(device):
    return np.array([one.zero for one in device.description.servos])


def test_packets_are_those_of_the_public_description():
    # The examples of https://emanual.robotis.com/docs/en/dxl/protocol2
    assert packet(1, bus_module.PING) == bytes.fromhex("FFFFFD00010300 01 194E")
    asked = bytes.fromhex("8400 0400")
    assert packet(1, bus_module.READ, asked) == bytes.fromhex("FFFFFD00010700 02 84000400 1D15")
    answer = bytes.fromhex("FFFFFD00010800 55 00A6000000 8CC0")
    assert packet(1, bus_module.STATUS, bytes.fromhex("00A6000000")) == answer
    both = bytes.fromhex("8400 0400 01 02")
    assert packet(bus_module.BROADCAST, bus_module.SYNC_READ, both) == bytes.fromhex(
        "FFFFFD00FE0900 82 840004000102 CEFA"
    )
    goals = bytes.fromhex("7400 0400 01 96000000 02 AA000000")
    assert packet(bus_module.BROADCAST, bus_module.SYNC_WRITE, goals) == bytes.fromhex(
        "FFFFFD00FE1100 83 740004000196000000 02AA000000 8287"
    )
    assert crc16(b"") == 0


def test_any_content_is_read_as_it_was_written_in_any_pieces(drawn_rng):
    choices = np.array([0xFF, 0xFF, 0xFD, 0x00, 0x55], np.uint8)
    for _ in range(200):
        # Mostly the bytes of the header, so that some must be stuffed.
        contents = [drawn_rng.choice(choices, drawn_rng.integers(0, 20)).tobytes() for _ in range(3)]
        stream = b"".join(b"\x12" + packet(7, 0x55, content) for content in contents)
        reader, found, place = PacketReader(), [], 0
        while place < len(stream):
            size = int(drawn_rng.integers(1, 12))
            found += reader.feed(stream[place : place + size])
            place += size
        assert [one.parameters for one in found] == contents


def test_a_turn_of_the_pulley_winds_its_circumference():
    servo = Servo("north", 1, 1, 2048, REST, 0.05, 0.2, 0.01)
    assert servo.setpoint(2048) == REST
    assert servo.setpoint(2048 + TICKS_PER_TURN) == pytest.approx(REST - 2 * np.pi * 0.01)
    for length in (0.05, 0.0873, 0.2):
        assert abs(servo.setpoint(servo.ticks(length)) - length) <= 0.5 * abs(servo.by_tick)
    other = servo._replace(direction=-1)
    assert other.setpoint(2048 + 100) == pytest.approx(REST + 100 * 2 * np.pi * 0.01 / 4096)
    # 100 units are 0.269 A, with 1.8 N m/A at 10 mm: 48 N.
    assert servo.effort(100, 1.8) == pytest.approx(100 * 2.69e-3 * 1.8 / 0.01)
    assert servo.effort(-100, 1.8) == 0.0 and other.effort(-100, 1.8) > 0.0


def test_a_servo_of_a_hinge_turns_as_it_says_and_may_push_and_pull():
    servo = Servo("hip", 1, -1, 1000, 0.1, -1.0, 1.0)
    assert servo.setpoint(1000 - TICKS_PER_TURN // 4) == pytest.approx(0.1 + 0.5 * np.pi)
    assert servo.ticks(servo.setpoint(777)) == 777
    assert servo.effort(100, 1.8) == pytest.approx(-100 * 2.69e-3 * 1.8)
    assert servo.strains(-0.5, 0.0, 0.2) and not servo.strains(-0.5, 0.2, 0.0)
    assert servo.strains(0.5, 0.2, 0.0) and not servo.strains(0.5, 0.0, 0.2)


OF_PULLEYS = [
    ({"baud_rate": "fast"}, "baud_rate"),
    ({"torque_constant": 0.0}, "torque_constant"),
    ({"greatest_tension": float("nan")}, "greatest_tension"),
    ({"command_timeout": 30.0}, "command_timeout"),
    ({"mode": "velocity"}, "mode"),
    ({"speed": 3}, "speed"),
    ({"port": None}, "port"),
    ({"servos": []}, "servos"),
    ({"servos": 3}, "servos"),
    ({"mode": "position"}, "servos[0].least_length"),
    *(({f"servos.0.{key}": value}, f"servos[{place}].{key}") for key, value, place in (
        ("id", 2, 1), ("name", "west", 1), ("radius", 10.0, 0), ("direction", 0, 0),
        ("zero_ticks", 1.5, 0), ("pulley", 1, 0), ("least_length", 0.3, 0))),
]  # fmt: skip
OF_HINGES = [
    ({"greatest_torque": None}, "greatest_torque"), ({"largest_turn": 20.0}, "largest_turn"),
    ({"largest_jump": 0.02}, "largest_jump"), ({"servos.0.zero_length": 0.1}, "servos[0].zero_length"),
    ({"servos.1.least_angle": 2.5}, "servos[1].least_angle"),
    ({"servos.1.greatest_angle": 3.5}, "servos[1].least_angle"),
    ({"servos.2.radius": 0.01}, "greatest_tension"),
]


@pytest.mark.parametrize(("example", "change", "key"), [
    *(("servos", *one) for one in OF_PULLEYS), *(("emio_servos", *one) for one in OF_HINGES),
])  # fmt: skip
def test_a_file_or_a_servo_that_cannot_be_is_refused_by_key_and_value(tmp_path, example, change, key):
    given = yaml.safe_load((FOLDER / f"{example}.yaml").read_text())
    change_scene(given, change)
    file = yaml_file(tmp_path / "servos.yaml", given)
    with pytest.raises(DeviceFileError) as raised:
        read_servos(file)
    assert raised.value.key == key and str(file) in str(raised.value)


def test_a_bus_pings_reads_and_writes(wired):
    port = SerialPort(wired.terminal.path, 115200)
    bus = ServoBus(port, 1.0)
    assert bus.ping(1) == MODEL
    bus.write(2, 65, b"\1")
    assert bus.read(2, 65, 1) == b"\1" and wired.servos[2].table[65] == 1
    with pytest.raises(ServoError, match="servo 2: a value is out of range"):
        bus.read(2, 250, 20)
    with pytest.raises(BusTimeout, match="servo 9: no answer"):
        ServoBus(port, 0.05).ping(9)
    wired.bus.damaged.add(3)
    with pytest.raises(ChecksumError, match="servo 3"):
        bus.ping(3)
    wired.bus.damaged.clear()
    wired.bus.noise, wired.bus.echoes = b"\xff\xff\x00", True
    assert bus.ping(3) == MODEL
    port.close()


def test_a_port_that_cannot_be_used_is_told(tmp_path):
    with pytest.raises(BusError, match="cannot be opened"):
        SerialPort(str(tmp_path / "none"), 57600)
    plain = tmp_path / "plain"
    plain.write_text("")
    with pytest.raises(BusError, match="not a serial port"):
        SerialPort(str(plain), 57600)
    with pytest.raises(BusError, match="baud_rate 12345"):
        SerialPort(str(plain), 12345)


def test_the_torque_is_off_until_the_first_command_and_after_the_end(wired):
    device = wired.device()
    assert device.actuator_names == ("north", "west", "south", "east")
    assert all(servo.table[OPERATING_MODE] == 4 for servo in wired.servos.values())
    reading = device.read(0.0)
    np.testing.assert_allclose(reading.setpoints, rest(device), atol=1e-9)
    assert not any(servo.has_torque for servo in wired.servos.values())
    wired.follow(device, rest(device) - [0.004, 0.002, 0.0, 0.002])
    assert all(servo.has_torque for servo in wired.servos.values())
    # North winds up by more ticks, south by fewer.
    assert wired.servos[1].position > 2048 and wired.servos[4].position < 2048
    assert device.close() == []
    assert not any(servo.has_torque for servo in wired.servos.values())


def test_the_tension_is_that_of_the_current(wired):
    device = wired.device()
    wired.servos[1].current, wired.servos[4].current = 20, -10
    efforts = device.read(0.0).efforts
    per_unit = 2.69e-3 * 1.8 / 0.010
    np.testing.assert_allclose(efforts, [20 * per_unit, 0.0, 0.0, 10 * per_unit])


def test_a_jump_is_refused_and_no_servo_moves(wired):
    device = wired.device()
    device.apply(rest(device), 0.0)
    assert device.refused == 1 and "nothing was measured" in device.trouble
    device.read(0.0)
    for wrong in ([-0.03, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 0.0]):
        device.apply(rest(device) + wrong, 0.0)
        device.read(0.0)
    device.apply(rest(device) + 0.009, 0.0)
    assert "is not within" in device.trouble
    assert device.refused == 4
    assert not any(servo.has_torque for servo in wired.servos.values())


def test_without_commands_the_servos_stop_where_they_are(wired):
    device = wired.device()
    for servo in wired.servos.values():
        servo.speed = 200.0
    device.read(0.0)
    device.apply(rest(device) - 0.01, 0.0)
    device.read(0.01)
    wired.wait(device, 0.05)
    device.read(0.6)
    assert "no command arrives" in device.trouble
    wired.wait(device, 0.05)
    stopped = device.read(0.7).setpoints
    wired.wait(device, 0.1)
    np.testing.assert_allclose(device.read(0.8).setpoints, stopped, atol=1e-9)
    # It stopped on the way, and goes on with the next command.
    assert (stopped > rest(device) - 0.009).all()
    assert all(servo.has_torque for servo in wired.servos.values())
    device.apply(rest(device) - 0.01, 0.9)
    device.read(0.9)
    wired.wait(device, 0.05)
    assert (device.read(0.95).setpoints < stopped).all() and not device.trouble


def test_a_great_tension_stops_the_servos_but_they_may_unwind(wired):
    device = wired.device()
    wired.follow(device, rest(device) - 0.004)
    wired.servos[2].current = 60
    device.apply(rest(device) - 0.006, wired.now)
    device.read(wired.now)
    assert "west pulls 29.1 N, more than 20 N" in device.trouble
    wired.wait(device, 0.02)
    assert (device.read(wired.now).setpoints > rest(device) - 0.0045).all()
    wired.follow(device, rest(device) - 0.002)
    assert not device.trouble


def test_the_watchdog_of_the_servos_stops_them_when_the_process_hangs(wired):
    wired.described = wired.described._replace(command_timeout=0.1)
    device = wired.device()
    now = wired.now
    device.read(now)
    device.apply(rest(device), now)
    device.read(now)
    assert all(servo.table[WATCHDOG] == 5 for servo in wired.servos.values())
    wired.wait(device, 0.25)
    for servo in wired.servos.values():
        servo.move()
        assert servo.table[WATCHDOG] == 255
    # Afterwards they follow again, after a measurement and with the torque switched on anew.
    device.recover()
    assert not any(servo.has_torque for servo in wired.servos.values())
    device.apply(rest(device), now)
    assert "nothing was measured" in device.trouble
    device.read(wired.now)
    wired.follow(device, rest(device) - 0.002)


def test_a_servo_that_is_missing_hot_or_damaged_is_told_and_the_others_are_off(wired):
    wired.bus.silent.add(3)
    with pytest.raises(BusTimeout, match="servo 3"):
        wired.device()
    wired.bus.silent.clear()
    wired.servos[2].table[HARDWARE_ERROR] = 0x20
    with pytest.raises(HardwareAlert, match="servo 2"):
        wired.device()
    wired.servos[2].table[HARDWARE_ERROR] = 0
    device = wired.device()
    wired.follow(device, rest(device) - 0.002)
    wired.bus.damaged.add(1)
    with pytest.raises(ChecksumError, match="servo 1"):
        device.read(wired.now)
    wired.bus.damaged.clear()
    wired.servos[4].table[HARDWARE_ERROR] = 0x04
    with pytest.raises(HardwareAlert, match="servo 4"):
        device.read(wired.now)
    assert device.close() == []
    assert not any(wired.servos[one].has_torque for one in (1, 2, 3))


def test_a_torque_that_may_still_be_on_is_told(wired):
    device = wired.device()
    wired.follow(device, rest(device) - 0.002)
    wired.bus.silent.add(2)
    problems = device.close()
    assert len(problems) == 1 and "servo 2" in problems[0] and "may still be on" in problems[0]
    assert not wired.servos[1].has_torque and not wired.servos[4].has_torque


def test_any_answers_end_a_measurement_as_an_error_of_the_bus(wired, drawn_rng):
    device = wired.device()
    wired.follow(device, rest(device) - 0.002)
    device.bus.timeout, now = 0.01, wired.now  # it waits for what will not come
    honest, count = wired.bus.answer, [0]

    def lie(content):
        answer = bytearray(honest(content))
        kind = drawn_rng.integers(4)
        if kind == 0:
            return bus_module.HEADER * 1000
        if kind == 1:
            return drawn_rng.bytes(int(drawn_rng.integers(300)))
        if kind == 2 and answer:
            del answer[int(drawn_rng.integers(len(answer))) :]
        elif answer:
            answer[int(drawn_rng.integers(len(answer)))] ^= 1 << int(drawn_rng.integers(8))
        return bytes(answer)

    wired.bus.answer = lie
    for _ in range(60):
        try:
            lengths = device.read(now).setpoints
        except BusError:
            count[0] += 1
        else:
            # What is believed is where the servos are.
            np.testing.assert_allclose(lengths, rest(device) - 0.002, atol=2e-4)
    wired.bus.answer = honest
    assert count[0] > 20


def test_servos_of_hinges_follow_and_stop_where_a_torque_is_too_large(wired_hinges):
    device = wired_hinges.device()
    assert all(servo.table[OPERATING_MODE] == 3 for servo in wired_hinges.servos.values())
    device.read(0.0)
    aims = np.array([0.4, -0.3, 0.0, 0.2])
    wired_hinges.follow(device, aims)
    assert wired_hinges.servos[1].position > 2048 > wired_hinges.servos[2].position
    device.apply(aims - [0.6, 0.0, 0.0, 0.0], wired_hinges.now)
    assert "servo_1 would jump from 0.40" in device.trouble and device.trouble.endswith("0.5 rad")
    # 0.35 N m are 118 units of current at 1.1 N m/A.
    wired_hinges.servos[2].current = -130
    device.apply(aims + [0.0, -0.2, 0.0, 0.0], wired_hinges.now)
    device.read(wired_hinges.now)
    assert device.trouble.startswith("servo_2 turns by -0.385 N m, more than 0.35 N m")
    wired_hinges.follow(device, aims + [0.0, 0.2, 0.0, 0.0])
    assert device.trouble == ""


@pytest.mark.parametrize(("file", "scene"), [("servos", "diamond"), ("emio_servos", "emio")])
def test_the_file_of_the_example_fits_its_robot(file, scene):
    from softrobot_twin.simulation import Simulation

    simulation = Simulation.from_scene_file(ROOT / "config/scenes" / f"{scene}.yaml")
    servos = read_servos(FOLDER / f"{file}.yaml").servos
    assert tuple(servo.name for servo in servos) == simulation.actuator_names
    lengths = [servo.zero for servo in servos]
    np.testing.assert_allclose(lengths, simulation.rest_setpoints, atol=1e-4)
    low, high = simulation.limits.setpoint_range(simulation.rest_setpoints)
    assert all(servo.least <= least for servo, least in zip(servos, low, strict=True))
    assert all(servo.greatest >= most for servo, most in zip(servos, high, strict=True))
