"""The pressure regulators of the hardware example: registers over Modbus TCP, units, and what is safe."""

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "hardware"
sys.path.insert(0, str(FOLDER))

from device_file import DeviceFileError  # noqa: E402
from modbus import ModbusTcp, SimulatedModule  # noqa: E402
from regulators import Regulator, RegulatorDevice, read_regulators  # noqa: E402
from servo_bus import BusError, BusTimeout, HardwareAlert  # noqa: E402
from simulated_regulators import SimulatedRegulators  # noqa: E402

from softrobot_twin.control.device import PressurisedDevice  # noqa: E402
from test.scene_changes import change_scene, yaml_file

COUNT = 50e3 / 4.0 * 10.0 / 32767
"""Pressure of a count of a monitor [Pa]."""


class Piped:
    """A device on simulated regulators.

    Attributes:
        now: The time of both [s]; it stands still but where a test moves it.
    """

    def __init__(self):
        self.now, self.devices = 0.0, []
        described = read_regulators(FOLDER / "regulators.yaml")
        self.simulated = SimulatedRegulators(described, 0.02, lambda: self.now)
        self.module = self.simulated.module
        self.described = described._replace(host="127.0.0.1", port=self.module.port, answer_time=1.0)

    def device(self):
        self.devices.append(RegulatorDevice(self.described))
        return self.devices[-1]

    def follow(self, device, pressures, seconds=1.0):
        """Commands and measures for a time; returns the last reading."""
        for _ in range(round(seconds / 0.02)):
            self.now += 0.02
            device.apply(np.asarray(pressures, float), self.now)
            reading = device.read(self.now)
        return reading

    def close(self):
        self.module.is_silent, self.module.spoil = False, lambda answer: answer
        for device in self.devices:
            device.close()
        self.module.close()


@pytest.fixture
def piped():
    piped = Piped()
    yield piped
    piped.close()


def test_messages_are_those_of_the_public_description():
    """Input register 8 has 10; register 1 becomes 3: the examples of the specification."""
    sent = []

    class Recorded(SimulatedModule):
        def _answer(self, request):
            sent.append(request)
            return super()._answer(request)

    module = Recorded(lambda outputs, register: 10)
    client = ModbusTcp("127.0.0.1", module.port, 1, 1.0)
    assert client.read_inputs(8, 1) == [10]
    client.write(1, 3)
    assert [request.hex() for request in sent] == ["0400080001", "0600010003"]
    assert module.outputs == {1: 3}
    client.close()
    module.close()


def test_pressures_are_followed_by_a_ramp_and_measured(piped):
    device = piped.device()
    assert isinstance(device, PressurisedDevice)
    assert device.cavity_names == device.actuator_names == tuple(f"chamber_{k}" for k in range(1, 5))
    assert device.read(0.0).setpoints == pytest.approx([0.0] * 4, abs=COUNT)
    wanted = [8e3, 0.0, 2e3, 0.0]
    # 20 kPa/s: after 0.2 s the first is at 4 kPa at most, the third is there.
    early = piped.follow(device, wanted, 0.22).setpoints
    assert 3e3 < early[0] <= 4.2e3 and early[2] == pytest.approx(2e3, abs=50.0)
    reading = piped.follow(device, wanted)
    assert reading.setpoints == pytest.approx(wanted, abs=2.0 * COUNT)
    np.testing.assert_array_equal(reading.efforts, reading.setpoints)
    assert 0.0 < device.pressure_variance < COUNT**2


@pytest.mark.parametrize("wrong", [10.1e3, -1.0, np.nan, np.inf])
def test_a_command_outside_of_the_limits_changes_no_pressure(piped, wrong):
    device = piped.device()
    piped.follow(device, [4e3] * 4)
    device.apply(np.array([5e3, 5e3, wrong, 5e3]), piped.now)
    assert device.refused == 1 and "chamber_3" in device.trouble
    for _ in range(10):
        piped.now += 0.02
        device.read(piped.now)
    assert list(piped.simulated.pressures.values()) == pytest.approx([4e3] * 4, abs=5.0)


def test_without_commands_all_are_vented_at_once_and_the_next_command_fills_them(piped):
    device = piped.device()
    piped.follow(device, [8e3] * 4)
    piped.now += 0.51
    device.read(piped.now)
    assert "no command arrives" in device.trouble and not any(piped.module.outputs.values())
    piped.now += 0.2
    assert device.read(piped.now).setpoints == pytest.approx([0.0] * 4, abs=10.0)
    assert piped.follow(device, [3e3] * 4).setpoints == pytest.approx([3e3] * 4, abs=2.0 * COUNT)
    assert device.trouble == ""


def test_all_are_vented_where_a_cavity_has_more_than_it_may(piped):
    device = piped.device()
    piped.follow(device, [8e3] * 4)
    piped.simulated.pressures["chamber_2"] = 13.5e3
    device.apply(np.full(4, 8e3), piped.now)
    device.read(piped.now)
    assert "chamber_2 has 13" in device.trouble and not any(piped.module.outputs.values())


def test_they_are_vented_before_the_first_command_and_after_the_end(piped):
    piped.module.outputs = {0: 3000, 3: 100}
    device = piped.device()
    assert set(piped.module.outputs.values()) == {0}
    piped.follow(device, [5e3] * 4)
    assert all(piped.module.outputs.values())
    assert device.close() == [] and not any(piped.module.outputs.values())


def test_the_watchdog_of_the_module_vents_where_the_process_hangs(piped):
    device = piped.device()
    piped.follow(device, [5e3] * 4)
    piped.now += 2.5 * piped.described.command_timeout
    piped.module.rest()
    assert not any(piped.module.outputs.values())


def test_a_monitor_that_is_cut_off_is_told_and_all_are_vented(piped):
    device = piped.device()
    piped.follow(device, [5e3] * 4)
    piped.simulated.cut.add("chamber_4")
    with pytest.raises(HardwareAlert, match=r"chamber_4: its monitor states 0.00 V, less than 1 V"):
        device.read(piped.now)
    assert not any(piped.module.outputs.values())


def test_a_module_that_does_not_answer_is_told_and_used_again(piped):
    piped.described = piped.described._replace(answer_time=0.3)
    device = piped.device()
    piped.follow(device, [5e3] * 4)
    piped.module.is_silent = True
    with pytest.raises(BusTimeout, match=r"127\.0\.0\.1: no answer"):
        device.read(piped.now)
    with pytest.raises(BusTimeout):
        device.recover()
    (problem,) = device.close()
    assert "may still be under pressure" in problem
    piped.module.is_silent = False
    device.recover()
    assert not any(piped.module.outputs.values())
    assert piped.follow(device, [2e3] * 4).setpoints == pytest.approx([2e3] * 4, abs=2.0 * COUNT)


def test_nobody_at_the_port_is_an_error_of_the_bus(piped):
    piped.module.close()
    with pytest.raises(BusError, match="refused"):
        piped.device()


def test_any_answers_end_a_measurement_as_an_error_of_the_bus(piped, drawn_rng):
    piped.described = piped.described._replace(answer_time=0.3)
    device, errors = piped.device(), 0
    piped.follow(device, [4e3] * 4)

    def lie(answer):
        kind, answer = drawn_rng.integers(3), bytearray(answer)
        if kind == 0:
            return drawn_rng.bytes(int(drawn_rng.integers(40)))
        if kind == 1:
            del answer[int(drawn_rng.integers(len(answer))) :]
        else:
            # TCP has check sums: values arrive whole, or not at all.
            answer[int(drawn_rng.integers(7))] ^= 1 << int(drawn_rng.integers(8))
        return bytes(answer)

    piped.module.spoil = lie
    for _ in range(30):
        try:
            device.read(piped.now)
        except BusError:
            errors += 1
    assert errors > 20


@pytest.mark.parametrize(("change", "key"), [
    ({"host": 3}, "host"), ({"ramp": 0.0}, "ramp"), ({"command_timeout": float("nan")}, "command_timeout"),
    ({"answer": 1.0}, "answer"), ({"regulators": []}, "regulators"),
    *(({f"regulators.1.{name}": value}, f"regulators[1].{name}") for name, value in (
        ("name", "chamber_1"), ("output", 0), ("input", 0), ("input_zero", 6.0), ("output_full", 11.0),
        ("least", 20e3), ("greatest", 60e3), ("full_pressure", 0.0), ("valve", 1))),
])  # fmt: skip
def test_a_file_that_cannot_be_is_refused_by_key_and_value(tmp_path, change, key):
    given = yaml.safe_load((FOLDER / "regulators.yaml").read_text())
    change_scene(given, change)
    file = yaml_file(tmp_path / "regulators.yaml", given)
    with pytest.raises(DeviceFileError) as raised:
        read_regulators(file)
    assert raised.value.key == key and str(file) in str(raised.value)


def test_the_file_of_the_example_fits_its_robot():
    from softrobot_twin.simulation import Simulation

    simulation = Simulation.from_scene_file(ROOT / "config/scenes/segment.yaml")
    own = read_regulators(FOLDER / "regulators.yaml").regulators
    assert tuple(one.name for one in own) == simulation.actuator_names
    limits = simulation.limits
    assert [one.least for one in own] == pytest.approx(limits.effort_min)
    assert [one.greatest for one in own] == pytest.approx(limits.effort_max)
